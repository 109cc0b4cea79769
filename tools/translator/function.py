"""One function of the kernels, for arguments of certain kinds: its statements, and the C function that comes of it."""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from translator.expressions import Expressions, Value
from translator.kinds import Array, Kind, Known, Record, Tuple, UnsupportedError, describe, unify
from translator.text import PATH, bare, comments_of, field

if TYPE_CHECKING:
    from translator.program import Program


class Function(Expressions):
    """The translation of a function for arguments of these kinds."""

    def __init__(self, program: Program, function: Callable[..., Any], kinds: tuple[Kind, ...], name: str) -> None:
        self.program, self.name = program, name
        self.file = program.place_of(function)
        lines, self.first_line = inspect.getsourcelines(function)
        source = textwrap.dedent("".join(lines))
        tree = ast.parse(source).body[0]
        assert isinstance(tree, ast.FunctionDef)
        self.tree, self.comments = tree, comments_of(source)
        self.doc = ast.get_docstring(tree) or ""
        self.parameters = [argument.arg for argument in tree.args.args]
        self.own_kinds = kinds
        self.kinds = dict(zip(self.parameters, kinds, strict=True))
        closed = inspect.getclosurevars(function).nonlocals if function.__closure__ else {}
        self.scope = {**function.__globals__, **closed}
        names = [node for node in ast.walk(tree) if isinstance(node, ast.Name)]
        self.assigned = {node.id for node in names if isinstance(node.ctx, ast.Store)} | set(self.parameters)
        self.loaded = {node.id for node in names if isinstance(node.ctx, ast.Load)}
        stores = [node.id for node in names if isinstance(node.ctx, ast.Store)]
        self.stored = {name: stores.count(name) for name in stores}
        self.pointed = {
            name for name, kind in self.kinds.items() if isinstance(kind, Tuple) and name not in self.stored
        }
        self.aliases: dict[str, str] = {}
        self.returns: Kind | None = None
        self.roots = {name: {name} for name, kind in self.kinds.items() if _has_arrays(kind)}
        self.written: set[str] = set()

    def translate(self) -> None:
        """Translate until no kind changes any more: a sum that begins as 0 may be found to be a float."""
        while True:
            before = dict(self.kinds), self.returns, {k: set(v) for k, v in self.roots.items()}, set(self.written)
            self.out: list[str] = []
            self.hoisted: dict[str, Kind] = {}
            self.declared: set[str] = set()
            self.own: dict[str, int] = {}  # the depth of the block that declares a variable, if that is no function's
            self.aliases = {}
            self.depth, self.temporaries, self.line, self.commented = 1, 0, 0, 0
            try:
                for statement in self.tree.body:
                    self.statement(statement)
            except UnsupportedError as error:
                if ".py:" in str(error):
                    raise
                raise UnsupportedError(f"{self.file}:{self.first_line + self.line - 1}: {error}") from None
            if (dict(self.kinds), self.returns, self.roots, self.written) == before:
                break
        self.returns = self.returns or "v"

    def know_arguments_alone(self) -> None:
        """Forget the variables, once translated: what must hold of the arguments is told of them alone."""
        self.assigned, self.kinds = set(self.parameters), dict(zip(self.parameters, self.own_kinds, strict=True))

    # --- the C function

    @property
    def head(self) -> str:
        """Its declaration."""
        arguments = [
            f"{self._passed(name, kind)}{name}"
            for name, kind in zip(self.parameters, self.own_kinds, strict=True)
            if not isinstance(kind, Known)
        ]
        how = self.program.how(self.tree)
        return f"{how} {self.program.type_of(self.returns)} {self.name}({', '.join(arguments) or 'void'})"

    def _passed(self, name: str, kind: Kind) -> str:
        own = self.program.type_of(kind)
        return f"const {own} *" if name in self.pointed else f"{own} "

    @property
    def text(self) -> str:
        """Its definition, behind its docstring."""
        lines = [f"/* {self.file}", *self.doc.replace("*/", "* /").splitlines()]
        doc = "\n".join(f"   {line}".rstrip() if number else line for number, line in enumerate(lines)) + " */"
        locals_ = []
        for name, kind in self.hoisted.items():
            start = " = 0" if kind in ("i", "u", "d") else " = false" if kind == "b" else " = {0}"
            locals_.append(f"    {self.program.type_of(kind)} {name}{start};")
        unused = [
            f"    (void){name};"
            for name, kind in zip(self.parameters, self.own_kinds, strict=True)
            if name not in self.loaded and not isinstance(kind, Known)
        ]
        return "\n".join([doc, self.head, "{", *locals_, *unused, *self.out, "}"])

    # --- statements

    def emit(self, code: str) -> None:
        """Write a line."""
        self.out.append("    " * self.depth + code)

    def statement(self, node: ast.stmt) -> None:
        """Translate a statement, with the comments before it and beside it."""
        self.line = node.lineno
        for line in range(self.commented + 1, node.lineno):
            text, alone = self.comments.get(line, ("", False))
            if alone:
                self.emit(f"/* {text} */")
        method = getattr(self, f"of_statement_{type(node).__name__}", None)
        if method is None:
            raise UnsupportedError(f"{type(node).__name__} is no part of the subset: {ast.unparse(node)[:60]}")
        begin = len(self.out)
        method(node)
        body = getattr(node, "body", None)
        last = body[0].lineno - 1 if body else node.end_lineno or node.lineno
        for line in range(node.lineno, last + 1):
            text, alone = self.comments.get(line, ("", True))
            if text and not alone and len(self.out) > begin:
                self.out[begin] += f"  /* {text} */"
        self.commented = max(self.commented, node.end_lineno or node.lineno)

    def block(self, body: list[ast.stmt]) -> None:
        """Translate the statements of a loop or a branch."""
        self.depth += 1
        self.commented = max(self.commented, body[0].lineno - 1 if body else 0)
        for statement in body:
            self.statement(statement)
        self.depth -= 1

    def of_statement_Expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Call) and ast.unparse(node.value.func) == "setattr":
            owner, name, value = node.value.args
            self.store(ast.Attribute(owner, self.known(name), ast.Store()), self.expression(value), value)
        elif not isinstance(node.value, ast.Constant):
            self.emit(f"{self.expression(node.value)[0]};")

    def of_statement_Pass(self, node: ast.Pass) -> None:
        pass

    def of_statement_Break(self, node: ast.Break) -> None:
        self.emit("break;")

    def of_statement_Continue(self, node: ast.Continue) -> None:
        self.emit("continue;")

    def of_statement_Return(self, node: ast.Return) -> None:
        if node.value is None:
            self.emit("return;")
            return
        value = self.expression(node.value)
        self.returns = unify(self.returns, value[1])
        if self.returns == "v":
            self.emit(f"{value[0]};")
            self.emit("return;")
        else:
            self.emit(f"return {bare(self.cast(value, self.returns))};")

    def of_statement_If(self, node: ast.If) -> None:
        try:
            known = self.known(node.test)
        except KeyError:
            self.emit(f"if ({bare(self.truth(node.test))}) {{")
            self.block(node.body)
            self._otherwise(node.orelse)
            self.emit("}")
            return
        for statement in node.body if known else node.orelse:
            self.statement(statement)

    def _otherwise(self, body: list[ast.stmt]) -> None:
        """Translate what is done else; ``elif`` stays on the level of its ``if``."""
        if len(body) == 1 and isinstance(body[0], ast.If) and not self._is_known(body[0].test):
            self.emit(f"}} else if ({bare(self.truth(body[0].test))}) {{")
            self.block(body[0].body)
            self._otherwise(body[0].orelse)
        elif body:
            self.emit("} else {")
            self.block(body)

    def _is_known(self, node: ast.AST) -> bool:
        try:
            self.known(node)
        except KeyError:
            return False
        return True

    def of_statement_While(self, node: ast.While) -> None:
        self.emit(f"while ({bare(self.truth(node.test))}) {{")
        self.block(node.body)
        self.emit("}")

    def of_statement_For(self, node: ast.For) -> None:
        over = ast.unparse(node.iter.func) if isinstance(node.iter, ast.Call) else ""
        if over not in ("range", "side_by_side", "in_turn") or not isinstance(node.target, ast.Name):
            self._unrolled(node)
            return
        assert isinstance(node.iter, ast.Call)
        bounds = node.iter.args
        first = self.whole(bounds[0]) if len(bounds) > 1 else "0"
        end = bounds[0] if len(bounds) == 1 else bounds[1]
        step = self.expression(bounds[2])[0].strip("()") if len(bounds) > 2 else "1"
        name = node.target.id if node.target.id != "_" else f"pass_{node.lineno}"
        written = {
            part.id
            for statement in node.body
            for part in ast.walk(statement)
            if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)
        }
        if name in written:
            raise UnsupportedError(f"{name} counts the loop and is assigned in it")
        kept = self.kinds.get(name)
        self.kinds[name] = "i"
        stop, keep = self.whole(end), ""
        if not stop.isdigit() and not (stop.isidentifier() and stop not in written):
            keep, stop = f", {name}_end = {bare(stop)}", f"{name}_end"
        change = {"1": f"{name}++", "-1": f"{name}--"}.get(step, f"{name} += {step}")
        sign = ">" if step.startswith("-") else "<"
        if over == "side_by_side":
            self._own_variables(node, written)
            self.emit("SIDE_BY_SIDE")
        elif self.program.how(self.tree).startswith("SHORT_LOOPS"):
            self.emit("SHORT_LOOP")
        self.emit(f"for (int64_t {name} = {first}{keep}; {name} {sign} {stop}; {change}) {{")
        self.block(node.body)
        if over == "in_turn":
            self.emit("IN_TURN;")
        self.emit("}")
        if kept is not None:
            self.kinds[name] = kept

    def _own_variables(self, loop: ast.For, written: set[str]) -> None:
        """Let each pass of a loop declare its variables: a compiler sees that no pass needs another one's."""
        inside = {id(part) for part in ast.walk(loop)}
        for part in ast.walk(self.tree):
            if isinstance(part, ast.Name) and part.id in written and id(part) not in inside:
                raise UnsupportedError(f"{part.id} is used outside of the passes side by side that assign it")
        self.own |= dict.fromkeys(written, self.depth + 1)

    def _unrolled(self, node: ast.For) -> None:
        """Translate a loop over the parts of a tuple that is known: once for each."""
        iterated, target = node.iter, node.target
        counted = isinstance(iterated, ast.Call) and ast.unparse(iterated.func) == "enumerate"
        if counted:
            assert isinstance(iterated, ast.Call)
            assert isinstance(target, ast.Tuple)
            iterated, (counter, target) = iterated.args[0], target.elts
        if any(isinstance(part, ast.Break | ast.Continue) for part in ast.walk(node)):
            raise UnsupportedError("break or continue in a loop over something else than a range")
        try:
            parts = self.known(iterated)
            names = [self.global_name(part) for part in self.program.parts_of(self.scope["__name__"], iterated)]
        except (KeyError, TypeError):
            raise UnsupportedError(f"a loop over something else than a range: {ast.unparse(node.iter)}") from None
        targets = list(target.elts) if isinstance(target, ast.Tuple) else [target]
        for number, part in enumerate(parts):
            if counted:
                self._know(counter, number, "")
            for each, value in zip(targets, part if isinstance(target, ast.Tuple) else (part,), strict=True):
                self._know(each, value, names[number] if names else "")
            self.emit("{")
            self.block(node.body)
            self.emit("}")

    def _know(self, target: ast.expr, value: Any, name: str) -> None:
        assert isinstance(target, ast.Name)
        if name:
            self.constant(value, name)
        self.kinds[target.id] = Known(value, name)

    # --- assignments

    def of_statement_AugAssign(self, node: ast.AugAssign) -> None:
        left = ast.copy_location(ast.BinOp(_loaded(node.target), node.op, node.value), node)
        self.store(node.target, self.expression(left))

    def of_statement_Assign(self, node: ast.Assign) -> None:
        if len(node.targets) == 1 and isinstance(node.targets[0], ast.Tuple) and isinstance(node.value, ast.Tuple):
            self._side_by_side(node.targets[0].elts, node.value.elts)
            return
        value = self.expression(node.value)
        for target in reversed(node.targets):
            self.store(target, value, node.value)
            if len(node.targets) > 1:
                value = self.expression(_loaded(target))

    def _side_by_side(self, targets: list[ast.expr], sources: list[ast.expr]) -> None:
        """Translate ``a, b = c, d``; by temporaries where a later source reads what an earlier target writes."""
        values = [self.expression(source) for source in sources]
        stored: set[str] = set()
        clash = False
        for target, source in zip(targets, sources, strict=True):
            parts = list(ast.walk(source))
            clash |= any(ast.unparse(part) in stored for part in parts if isinstance(part, ast.expr))
            clash |= (
                bool(stored)
                and any(isinstance(part, ast.Call) for part in parts)
                and not all(name.isidentifier() for name in stored)
            )
            stored.add(ast.unparse(target))
            if isinstance(target, ast.Subscript):
                stored.add(ast.unparse(target.value))
        if clash:
            values = [value if isinstance(value[1], Known) else (self.temporary(value), value[1]) for value in values]
        for target, value, source in zip(targets, values, sources, strict=True):
            self.store(target, value, source)

    def temporary(self, value: Value) -> str:
        """Keep a value under a name of its own."""
        self.temporaries += 1
        name = f"kept_{self.temporaries}"
        self.emit(f"const {self.program.type_of(value[1])} {name} = {bare(value[0])};")
        return name

    def store(self, target: ast.expr, value: Value, source: ast.expr | None = None) -> None:
        """Write a value where it belongs."""
        code, kind = value
        if isinstance(target, ast.Name):
            self._store_name(target.id, value, source)
        elif isinstance(target, ast.Tuple):
            if not isinstance(kind, Tuple) or len(kind.parts) != len(target.elts):
                raise UnsupportedError(f"{describe(kind)} is taken apart into {len(target.elts)}")
            whole = code if PATH.fullmatch(code) else self.temporary(value)
            for index, part in enumerate(target.elts):
                if not (isinstance(part, ast.Name) and part.id == "_"):
                    self.store(part, (field(whole, index), kind.parts[index]), source)
        elif isinstance(target, ast.Subscript | ast.Attribute):
            self.written |= self.roots_of(target.value)
            place, own = self.expression(_loaded(target))
            if not isinstance(own, str):
                raise UnsupportedError(f"{ast.unparse(target)} is {describe(own)} and is assigned as a whole")
            self.emit(f"{place} = {bare(self.cast(value, own))};")
        else:
            raise UnsupportedError(f"{type(target).__name__} is assigned")

    def _store_name(self, name: str, value: Value, source: ast.expr | None) -> None:
        code, kind = value
        if kind == "v":
            raise UnsupportedError(f"{name} is what a function without a result returns")
        own = self.kinds[name] = kind if isinstance(kind, Known) else unify(self.kinds.get(name), kind)
        if _has_arrays(own) and source is not None:
            self.roots[name] = self.roots.get(name, set()) | self.roots_of(source)
        if isinstance(kind, Known) or (name not in self.loaded and "(" not in code):
            return
        if isinstance(own, Tuple) and self._stays(name, code):
            self.aliases[name] = code
            return
        text = bare(self.cast(value, own))
        if name in self.parameters or name in self.declared or name in self.hoisted:
            self.emit(f"{name} = {text};")
        elif self.depth == self.own.get(name, 1):
            self.declared.add(name)
            self.emit(f"{self.program.type_of(own)} {name} = {text};")
        else:
            self.hoisted[name] = own
            self.emit(f"{name} = {text};")

    def _stays(self, name: str, code: str) -> bool:
        """Whether a tuple is part of another one, and both are what they are to the end: it needs no copy."""
        found = PATH.fullmatch(code)
        if found is None or self.depth > 1 or self.stored.get(name, 0) != 1 or name in self.parameters:
            return False
        return self.stored.get(found["root"], 0) <= (found["root"] not in self.parameters)


def _has_arrays(kind: Kind | None) -> bool:
    return isinstance(kind, Array | Record) or (isinstance(kind, Tuple) and any(map(_has_arrays, kind.parts)))


def _loaded(target: ast.expr) -> ast.expr:
    """Return what is assigned as what is read."""
    return ast.parse(ast.unparse(target), mode="eval").body
