"""Expressions of the kernels' subset: each becomes C text and a kind."""

from __future__ import annotations

import ast
import inspect
import math
import types
from typing import TYPE_CHECKING, Any

import numpy as np

from translator import records
from translator.kinds import RANK, Array, C, Kind, Known, Record, Tuple, UnsupportedError, describe, unify
from translator.text import bare, field, pointer, product, short

if TYPE_CHECKING:
    from translator.program import Program

Value = tuple[str, Kind]

ARITHMETIC: dict[type, str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.BitXor: "^", ast.BitAnd: "&", ast.BitOr: "|", ast.RShift: ">>",
    ast.LShift: "<<",
}  # fmt: skip
OF_LANES = {"+": "sum", "-": "difference", "*": "product", "/": "quotient"}  # in lanes.h
COMPARISONS: dict[type, str] = {
    ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
}  # fmt: skip
OF_A_REAL = {"sqrt": "d", "log": "d", "cos": "d", "sin": "d", "isnan": "b", "isinf": "b", "isfinite": "b"}
ABSOLUTE = {"i": "llabs", "d": "fabs", "l": "lanes_abs"}
FOLDED = {"np.finfo", "float", "int"}  # calls whose value is known when translating


class Expressions:
    """What translates the expressions of one function; `function.Function` adds the statements."""

    program: Program
    scope: dict[str, Any]  # the globals of its module, and what it closes over
    kinds: dict[str, Kind]  # of its variables
    assigned: set[str]
    roots: dict[str, set[str]]  # by variable: the parameters whose arrays it looks into
    written: set[str]  # parameters whose arrays are written
    pointed: set[str]  # parameters that are pointers to tuples: a copy costs more than what many functions do
    aliases: dict[str, str]  # variables that are parts of others

    # --- what is known when translating

    def known(self, node: ast.AST) -> Any:
        """Return the value of an expression without variables; KeyError where it has some."""
        for part in ast.walk(node):
            if isinstance(part, ast.Name) and part.id in self.assigned:
                if not isinstance(self.kinds.get(part.id), Known):
                    raise KeyError(part.id)
            elif isinstance(part, ast.Call) and ast.unparse(part.func) not in FOLDED:
                raise KeyError("a call")
        values = {name: kind.value for name, kind in self.kinds.items() if isinstance(kind, Known)}
        try:
            return eval(compile(ast.Expression(node), "", "eval"), self.scope | values)  # type: ignore[arg-type]
        except NameError:
            raise KeyError(ast.unparse(node)) from None

    def constant(self, value: Any, name: str = "") -> Value:
        """Return a constant; one with a name is defined under it."""
        if isinstance(value, bool | np.bool_):
            return ("true" if value else "false"), "b"
        if isinstance(value, np.unsignedinteger) or (isinstance(value, int) and value >= 2**63):
            code, kind = f"UINT64_C({int(value)})", "u"
        elif isinstance(value, int | np.integer):
            number = int(value)
            code, kind = (str(number) if abs(number) < 2**31 else f"INT64_C({number})"), "i"
        elif isinstance(value, float | np.floating):
            number = float(value)
            code = repr(number) if math.isfinite(number) else "(double)NAN" if math.isnan(number) else "INFINITY"
            code, kind = ("-INFINITY" if number == -math.inf else code), "d"
        else:
            return "", Known(value, name)
        if name == "lanes_LANES":  # as the compiler is told
            return name, kind
        if name:
            self.program.constants[name] = f"({code})" if code.startswith("-") else code
            return name, kind
        return (f"({code})" if code.startswith("-") else code), kind

    def global_name(self, node: ast.AST) -> str:
        """Return what a constant of a module is called in C, after the module that has it; "" for any other."""
        if isinstance(node, ast.Name):
            kind = self.kinds.get(node.id)
            if isinstance(kind, Known):
                return kind.name
            return f"{self.home_of(node.id)}_{node.id.lstrip('_')}"
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            owner = self.scope.get(node.value.id)
            if isinstance(owner, types.ModuleType) and owner.__name__.startswith(self.program.package):
                return f"{short(owner.__name__)}_{node.attr.lstrip('_')}"
            if inspect.isclass(owner):
                return f"{owner.__name__}_{node.attr}"
        return ""

    def home_of(self, name: str) -> str:
        """Return the module that a global name was imported from, or this one."""
        return short(self.program.homes(self.scope["__name__"]).get(name, self.scope["__name__"]))

    # --- casts

    def cast(self, value: Value, kind: Kind) -> str:
        """Return a value as one of this kind."""
        code, own = value
        if own == kind or isinstance(own, Known):
            return code
        if kind == "l":
            return f"broadcast({self.cast(value, 'd')})"
        if kind == "b" and own in ("i", "u", "d"):
            return f"({code} != 0)"
        if not (isinstance(own, str) and isinstance(kind, str) and own in RANK and kind in RANK and own != "l"):
            raise UnsupportedError(f"{describe(own)} does not become {describe(kind)}")
        if kind == "d" and code.isdigit():
            return f"{code}.0"
        return f"({C[kind]}){code if code.isidentifier() or code.startswith('(') else f'({code})'}"

    # --- expressions

    def expression(self, node: ast.AST) -> Value:
        """Translate an expression."""
        if isinstance(node, ast.Name | ast.Attribute | ast.Constant):
            try:
                return self.constant(self.known(node), self.global_name(node))
            except KeyError:
                pass
        elif isinstance(node, ast.Call | ast.UnaryOp | ast.Subscript):
            try:
                return self.constant(self.known(node))
            except KeyError:
                pass
        method = getattr(self, f"of_{type(node).__name__}", None)
        if method is None:
            raise UnsupportedError(f"{type(node).__name__} is no part of the subset: {ast.unparse(node)}")
        return method(node)  # type: ignore[no-any-return]

    def truth(self, node: ast.AST) -> str:
        """Translate what is tested."""
        return self.cast(self.expression(node), "b")

    def whole(self, node: ast.AST) -> str:
        """Translate an index or a count."""
        code, kind = self.expression(node)
        if kind not in ("i", "u"):
            raise UnsupportedError(f"{ast.unparse(node)} is {describe(kind)} and serves as an index")
        return code

    def of_Name(self, node: ast.Name) -> Value:
        if node.id not in self.kinds:
            raise UnsupportedError(f"{node.id} is not known here")
        code = f"(*{node.id})" if node.id in self.pointed else self.aliases.get(node.id, node.id)
        return code, self.kinds[node.id]

    def of_Attribute(self, node: ast.Attribute) -> Value:
        code, kind = self.expression(node.value)
        if isinstance(kind, Known):
            return self.constant(getattr(kind.value, node.attr))
        if isinstance(kind, Record):
            return records.member(self.program, code, kind, node.attr)
        if node.attr != "size" or not isinstance(kind, Array):
            raise UnsupportedError(f".{node.attr} of {describe(kind)}")
        return (f"{code}.n0" if kind.dimensions == 1 else f"({product(code, 0, kind.dimensions)})"), "i"

    def of_BinOp(self, node: ast.BinOp) -> Value:
        left, right, operator = self.expression(node.left), self.expression(node.right), type(node.op)
        if operator is ast.Div:
            kind = "l" if "l" in (left[1], right[1]) else "d"
            return self._operated("/", self.cast(left, kind), self.cast(right, kind), kind)
        if operator is ast.Pow:
            if (left[1], right[1]) != ("d", "d"):
                raise UnsupportedError("** of a whole number rounds differently from library to library: multiply")
            return f"pow({left[0]}, {right[0]})", "d"
        kind = unify(left[1], right[1])
        if operator in (ast.FloorDiv, ast.Mod) and kind == "i":
            return f"{'floor_div' if operator is ast.FloorDiv else 'floor_mod'}({left[0]}, {right[0]})", "i"
        if operator not in ARITHMETIC or isinstance(kind, Array | Tuple | Record | Known):
            raise UnsupportedError(f"{operator.__name__} of {describe(kind)}")
        if kind == "b":
            if operator not in (ast.BitAnd, ast.BitOr):
                raise UnsupportedError(f"{operator.__name__} of truths")
            return f"(bool)({left[0]} {ARITHMETIC[operator]} {right[0]})", "b"
        return self._operated(ARITHMETIC[operator], self.cast(left, kind), self.cast(right, kind), kind)

    def _operated(self, operator: str, left: str, right: str, kind: Kind) -> Value:
        if kind == "l":
            return f"{OF_LANES[operator]}({left}, {right})", kind
        return f"({left} {operator} {right})", kind

    def of_UnaryOp(self, node: ast.UnaryOp) -> Value:
        if isinstance(node.op, ast.Not):
            return f"(!{self.truth(node.operand)})", "b"
        code, kind = self.expression(node.operand)
        if isinstance(node.op, ast.USub) and kind in ("i", "d", "l"):
            return (f"minus({code})" if kind == "l" else f"(-{code})"), kind
        raise UnsupportedError(f"{type(node.op).__name__} of {describe(kind)}")

    def of_BoolOp(self, node: ast.BoolOp) -> Value:
        word = " && " if isinstance(node.op, ast.And) else " || "
        return f"({word.join(map(self.truth, node.values))})", "b"

    def of_Compare(self, node: ast.Compare) -> Value:
        left, parts = self.expression(node.left), []
        for operator, comparator in zip(node.ops, node.comparators, strict=True):
            right = self.expression(comparator)
            kind = unify(left[1], right[1])
            if type(operator) not in COMPARISONS or not isinstance(kind, str) or kind == "l":
                raise UnsupportedError(f"a comparison of {describe(kind)}: {ast.unparse(node)}")
            parts.append(f"({self.cast(left, kind)} {COMPARISONS[type(operator)]} {self.cast(right, kind)})")
            left = right
        return (parts[0] if len(parts) == 1 else f"({' && '.join(parts)})"), "b"

    def of_IfExp(self, node: ast.IfExp) -> Value:
        one, other = self.expression(node.body), self.expression(node.orelse)
        kind = unify(one[1], other[1])
        if kind == "l":
            return f"lanes_if({self.truth(node.test)}, {self.cast(one, kind)}, {self.cast(other, kind)})", kind
        return f"({self.truth(node.test)} ? {self.cast(one, kind)} : {self.cast(other, kind)})", kind

    def of_Tuple(self, node: ast.Tuple) -> Value:
        return self.tuple_of([self.expression(part) for part in node.elts])

    def tuple_of(self, values: list[Value]) -> Value:
        """Return values as a tuple."""
        kind = Tuple(tuple(own for _, own in values))
        codes = ", ".join(code for code, own in values if not isinstance(own, Known))
        return f"({self.program.type_of(kind)}){{ {codes} }}", kind

    def of_Subscript(self, node: ast.Subscript) -> Value:
        if isinstance(node.value, ast.Attribute) and node.value.attr == "shape":
            code, kind = self.expression(node.value.value)
            return f"{code}.n{self.known(node.slice)}", "i"
        code, kind = self.expression(node.value)
        if isinstance(kind, Tuple):
            return self._part_of_tuple(code, kind, node.slice)
        if not isinstance(kind, Array):
            raise UnsupportedError(f"an index of {describe(kind)}")
        places = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        return self._place_in(code, kind, list(places), ast.unparse(node))

    def _part_of_tuple(self, code: str, kind: Tuple, place: ast.AST) -> Value:
        if isinstance(place, ast.Slice):
            upper = self.known(place.upper) if place.upper else len(kind.parts)
            return self.tuple_of([(field(code, i), part) for i, part in enumerate(kind.parts[:upper])])
        try:
            index = self.known(place)
        except KeyError:
            first = kind.parts[0]
            if not isinstance(first, Record) or set(kind.parts) != {first}:
                raise UnsupportedError("a place in a tuple of other than tables is to be known") from None
            return f"(({self.program.type_of(first)} const *)&{code})[{self.whole(place)}]", first
        return field(code, index), kind.parts[index]

    def _place_in(self, code: str, kind: Array, places: list[ast.AST], text: str) -> Value:
        """Return an element, a row or a part of an array; or one lane of all, ``array[:, :, lane]``."""
        full = [isinstance(place, ast.Slice) and not (place.lower or place.upper) for place in places]
        if len(places) == kind.dimensions > 1 and all(full[:-1]) and not isinstance(places[-1], ast.Slice):
            own = Array(kind.element, kind.dimensions - 1, strided=True)
            sizes = ", ".join(f"{code}.n{axis}" for axis in range(kind.dimensions - 1))
            last = f"{code}.n{kind.dimensions - 1}"
            return f"({self.program.type_of(own)}){{ {code}.p + {self.whole(places[-1])}, {sizes}, {last} }}", own
        at, axis = "", 0
        for place in places:
            if isinstance(place, ast.Slice):
                break
            axis, rest = axis + 1, product(code, axis + 1, kind.dimensions)
            step = f"{self.whole(place)}" if not rest else f"({self.whole(place)}) * {rest}"
            at = f"{at} + {step}" if at else step
        if axis == kind.dimensions:
            if kind.strided:
                at = f"({at}) * {code}.stride"
            return f"{code}.p[{bare(at)}]", kind.element
        if kind.strided and kind.dimensions - axis > 1:
            raise UnsupportedError(f"a part of a lane: {text}")
        own = Array(kind.element, kind.dimensions - axis, kind.strided)
        sizes = [f"{code}.n{number}" for number in range(axis, kind.dimensions)]
        if axis < len(places):
            part = places[axis]
            if not isinstance(part, ast.Slice) or part.step or len(places) > axis + 1:
                raise UnsupportedError(f"such a part of an array: {text}")
            lower = self.whole(part.lower) if part.lower else "0"
            upper = self.whole(part.upper) if part.upper else sizes[0]
            if kind == Array(kind.element, 1):
                if part.upper:
                    return f"{kind.name}_part({code}, {bare(lower)}, {bare(upper)})", own
                return f"{kind.name}_from({code}, {bare(lower)})", own
            if lower != "0":
                rest = product(code, axis + 1, kind.dimensions)
                step = f"({lower}) * {rest}" if rest else lower
                at = f"{at} + {step}" if at else step
            sizes[0] = upper if lower == "0" else f"({upper}) - ({lower})"
        if kind.strided:
            at, sizes = (f"({at}) * {code}.stride" if at else ""), [*sizes, f"{code}.stride"]
        begin = f"{code}.p + {at}" if at else f"{code}.p"
        return f"({self.program.type_of(own)}){{ {begin}, {', '.join(sizes)} }}", own

    # --- calls

    def of_Call(self, node: ast.Call) -> Value:
        name = ast.unparse(node.func)
        if node.keywords or any(isinstance(argument, ast.Starred) for argument in node.args):
            raise UnsupportedError(f"a call with names or stars: {name}")
        if name.endswith(".reshape") and isinstance(node.func, ast.Attribute):
            return self._reshaped(node.func.value, node.args)
        if name == "getattr":
            return self.of_Attribute(ast.Attribute(node.args[0], self.known(node.args[1])))
        values = [self.expression(argument) for argument in node.args]
        builtin = self._builtin(name, values)
        if builtin:
            return builtin
        function = self.known(node.func)
        function = getattr(function, "python", function)
        own = self.program.intrinsic(function, values)
        if own:
            return own
        if not inspect.isfunction(function):
            raise UnsupportedError(f"a call of {name}, which is no kernel")
        callee = self.program.function(function, tuple(kind for _, kind in values))
        if callee.returns is None:
            raise UnsupportedError(f"{name} calls itself")
        for parameter, argument in zip(callee.parameters, node.args, strict=True):
            if parameter in callee.written:
                self.written |= self.roots_of(argument)
        codes = [
            self.pointer_to(value) if parameter in callee.pointed else value[0]
            for parameter, value in zip(callee.parameters, values, strict=True)
            if not isinstance(value[1], Known)
        ]
        return f"{callee.name}({', '.join(codes)})", callee.returns

    def pointer_to(self, value: Value) -> str:
        """Return where a tuple is."""
        return pointer(value[0]) or f"&{self.temporary(value)}"

    def temporary(self, value: Value) -> str:
        """Keep a value under a name of its own; see `function.Function`."""
        raise NotImplementedError

    def _reshaped(self, whole: ast.expr, axes: list[ast.expr]) -> Value:
        code, kind = self.expression(whole)
        if not isinstance(kind, Array) or kind.dimensions != 1 or kind.strided:
            raise UnsupportedError(f"another shape of {describe(kind)}")
        own = Array(kind.element, len(axes))
        return f"({self.program.type_of(own)}){{ {code}.p, {', '.join(map(self.whole, axes))} }}", own

    def _builtin(self, name: str, values: list[Value]) -> Value | None:
        if name in ("max", "min"):
            result = values[0]
            for value in values[1:]:
                kind = unify(result[1], value[1])
                result = f"{name}_{kind}({self.cast(result, kind)}, {self.cast(value, kind)})", kind
            return result
        if name == "abs":
            return f"{ABSOLUTE[str(values[0][1])]}({values[0][0]})", values[0][1]
        if name in ("int", "np.int64"):
            return self.cast(values[0], "i"), "i"
        if name == "np.uint64":
            return self.cast(values[0], "u"), "u"
        if name == "float":
            return self.cast(values[0], "d"), "d"
        if name.startswith("math."):
            if name[5:] not in OF_A_REAL:
                raise UnsupportedError(f"{name} is no part of the subset")
            kind = OF_A_REAL[name[5:]]
            if values[0][1] == "l" and name == "math.sqrt":
                return f"lanes_root({values[0][0]})", "l"
            return f"{'is_' + name[7:] if kind == 'b' else name[5:]}({self.cast(values[0], 'd')})", kind
        return None

    def roots_of(self, node: ast.AST) -> set[str]:
        """Return the parameters whose arrays an expression may look into."""
        names = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
        return set().union(*(self.roots.get(name, set()) for name in names))
