"""All functions that the entries need, each once for every combination of kinds that it is called with, as C text."""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

from translator import records
from translator.expressions import Value
from translator.function import Function
from translator.kinds import ANNOTATIONS, Array, C, Kind, Known, Record, Tuple, UnsupportedError
from translator.text import short

PRELUDE = Path(__file__).with_name("prelude.h")
LANES = Path(__file__).with_name("lanes.h")


class Program:
    """Translated functions.

    Parameters
    ----------
    package : str
        The package of the kernels: constants of its modules keep their names.
    root : Path
        Files are named from here.
    """

    def __init__(self, package: str, root: Path) -> None:
        self.package, self.root = package, root
        self.functions: dict[Any, Function] = {}
        self.finished: list[Function] = []
        self.structs: dict[Tuple, str] = {}
        self.arrays: dict[Array, None] = {}
        self.records: dict[Record, None] = {}
        self.members: dict[tuple[Record, str], Kind] = {}  # blocks that are cut out of tables
        self.constants: dict[str, str] = {}
        self.schema: Any = importlib.import_module(f"{package}.schema")
        self._names: dict[str, int] = {}

    # --- what the functions ask for

    def function(self, function: Callable[..., Any], kinds: tuple[Kind, ...]) -> Function:
        """Return the translation of a function for arguments of these kinds."""
        key = function, kinds
        if key not in self.functions:
            name = f"{short(function.__module__)}_{function.__name__.lstrip('_')}"
            known = [kind for kind in kinds if isinstance(kind, Known)]
            for kind in known:
                name += f"_{kind.name or getattr(kind.value, '__name__', 'known')}"
            count = self._names[name] = self._names.get(name, 0) + 1
            translated = Function(self, function, kinds, name if count == 1 else f"{name}_{count}")
            self.functions[key] = translated
            translated.translate()
            self.finished.append(translated)
        return self.functions[key]

    def type_of(self, kind: Kind | None) -> str:
        """Return the C type of a kind."""
        if isinstance(kind, Array):
            self.arrays[kind] = None
            return kind.name
        if isinstance(kind, Record):
            self.add_record(kind)
            return f"{kind.name} *" if records.is_whole(kind.table) else kind.name
        if isinstance(kind, Tuple):
            if kind not in self.structs:
                for part in kind.parts:
                    if not isinstance(part, Known):
                        self.type_of(part)
                self.structs[kind] = f"parts{len(self.structs) + 1}"
            return self.structs[kind]
        if isinstance(kind, str):
            return C[kind]
        raise UnsupportedError("a value that is known when translating has no type in C")

    def add_record(self, kind: Record) -> None:
        """Define the types of a table."""
        if records.is_whole(kind.table):
            self.records[Record(kind.table)] = None  # the other forms share the struct of its whole numbers
            self.arrays |= dict.fromkeys(records.BESIDE.values())
        self.records[kind] = None

    def place_of(self, function: Callable[..., Any]) -> str:
        """Return the file of a function, from the root."""
        path = Path(inspect.getsourcefile(function) or "")
        return path.relative_to(self.root).as_posix() if path.is_relative_to(self.root) else path.name

    @staticmethod
    def how(tree: ast.FunctionDef) -> str:
        """Return how a function is declared: its decorators say whether it melts into its callers, and of its loops."""
        decorators = [ast.unparse(decorator) for decorator in tree.decorator_list]
        if "short_loops" in decorators:
            return "SHORT_LOOPS static"
        return "INLINE" if "inlined" in decorators else "static"

    @functools.cache  # noqa: B019 - a program lives as long as the build
    def homes(self, module: str) -> dict[str, str]:
        """Return the names that a module imported from others of the package, with their homes."""
        tree = ast.parse(Path(sys.modules[module].__file__ or "").read_text("utf-8"))
        found = {}
        for node in tree.body:
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(self.package):
                found |= {alias.asname or alias.name: node.module or "" for alias in node.names}
        return found

    @staticmethod
    def parts_of(module: str, iterated: ast.AST) -> list[ast.expr]:
        """Return what a tuple is written with, where it is written in this module; else nothing."""
        if isinstance(iterated, ast.Tuple):
            return iterated.elts
        for node in ast.parse(Path(sys.modules[module].__file__ or "").read_text("utf-8")).body:
            if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == ast.unparse(iterated):
                return node.value.elts if isinstance(node.value, ast.Tuple) else []
        return []

    def intrinsic(self, function: Any, values: list[Value]) -> Value | None:
        """Return what the functions of `kernels.lanes` are in C; None for any other."""
        if getattr(function, "__module__", "") != f"{self.package}.lanes":
            return None
        codes, name = [code for code, _ in values], function.__name__
        if name == "prefetch":
            word = "fetch_lanes" if isinstance(values[0][1], Array) and values[0][1].element == "l" else "fetch_early"
            return f"{word}(&{codes[0]}.p[({codes[1]}) * {codes[0]}.n1 + {codes[2]}])", "v"
        if name == "copy":
            return f"memcpy({codes[0]}.p, {codes[1]}.p, (size_t){codes[1]}.n0 * sizeof *{codes[1]}.p)", "v"
        if name == "all_within":
            return f"all_within({codes[0]}, {codes[1]})", "b"
        if name == "gathered":
            return f"gathered({codes[0]}.p, {codes[1]}.p, {codes[2]})", "l"
        if name in ("if_less", "if_at_most"):
            each = (code if kind == "l" else f"broadcast({code})" for code, kind in values)
            return f"{name}({', '.join(each)})", "l"
        if name in ("members", "member"):
            own = Record(self.schema.StateSlots, "l" if name == "members" else "s")
            self.type_of(own)
            reals = f"({own.name}Reals *){'' if name == 'members' else '&'}{codes[1]}.p"
            row = "" if name == "members" else f" + {codes[2]} * {codes[0]}.n1"
            reals += "" if name == "members" else f"[{codes[2]}]"
            ints = f"(StateInts *)({codes[0]}.p{row})"
            return f"(&({own.name}){{ {ints}, {codes[0]}.n1, {reals} }})", own
        if name == "vectors":
            array = values[0][1]
            if not isinstance(array, Array) or array.strided or array.element != "d":
                raise UnsupportedError(f"vectors of {codes[0]}, which is no array of reals in C order")
            own = Array("l", array.dimensions - 1)
            sizes = ", ".join(f"{codes[0]}.n{axis}" for axis in range(own.dimensions))
            return f"({self.type_of(own)}){{ (lanes *){codes[0]}.p, {sizes} }}", own
        place = f"*(lanes *)&{codes[0]}.p[({codes[1]}) * {codes[0]}.n1 + {codes[2]}]"
        if name == "load":
            return f"({place})", "l"
        if name == "store":
            return f"{place} = {codes[3]}", "v"
        return None

    # --- text

    def types(self, *, lanes: bool = False) -> str:
        """Return the types of all functions as C."""
        used = sorted(self.arrays, key=lambda kind: (kind.dimensions, kind.name))
        parts = [PRELUDE.read_text("utf-8"), LANES.read_text("utf-8") if lanes else ""]
        parts += [kind.struct for kind in used]
        parts += [_cuts(kind) for kind in used if kind.dimensions == 1 and not kind.strided]
        parts += [records.structs(kind) for kind in sorted(self.records, key=lambda kind: (kind.element, kind.name))]
        parts += [records.accessor(self, kind, name, result) for (kind, name), result in self.members.items()]
        for kind, name in self.structs.items():
            fields = [
                f"{self.type_of(part)} f{index};"
                for index, part in enumerate(kind.parts)
                if not isinstance(part, Known)
            ]
            parts.append(f"typedef struct {{ {' '.join(fields)} }} {name};")
        return "\n\n".join(part for part in parts if part)

    def text(self, *, lanes: bool) -> str:
        """Return all functions as C, behind the types and constants that they use."""
        heads, bodies = [function.head for function in self.finished], [function.text for function in self.finished]
        constants = "\n".join(f"#define {name} {value}" for name, value in sorted(self.constants.items()))
        parts = [self.types(lanes=lanes), constants, "\n".join(f"{head};" for head in heads), *bodies]
        return "\n\n".join(part for part in parts if part) + "\n"


def entry_kinds(function: Callable[..., Any]) -> tuple[Kind, ...]:
    """Return the kinds of the arguments that Python gives, as the annotations say."""
    lines, first = inspect.getsourcelines(function)
    tree = ast.parse(textwrap.dedent("".join(lines))).body[0]
    assert isinstance(tree, ast.FunctionDef)
    kinds: list[Kind] = []
    for argument in tree.args.args:
        text = ast.unparse(argument.annotation) if argument.annotation else ""
        if text == "StateSlots":
            kinds.append(Record(function.__globals__[text]))
            continue
        if text == "States":
            kinds.append(Tuple((Record(function.__globals__[text].__args__[0]),) * function.__globals__["LANES"]))
            continue
        if text not in ANNOTATIONS:
            where = f"{inspect.getsourcefile(function)}:{first}"
            raise UnsupportedError(f"{where}: {argument.arg} needs one of the annotations {', '.join(ANNOTATIONS)}")
        kinds.append(ANNOTATIONS[text])
    return tuple(kinds)


def _cuts(kind: Array) -> str:
    """Return the two functions that cut a part out of an array."""
    name = kind.name
    return (
        f"INLINE {name} {name}_from({name} array, int64_t first)\n"
        f"{{\n    return ({name}){{ array.p + first, array.n0 - first }};\n}}\n"
        f"INLINE {name} {name}_part({name} array, int64_t first, int64_t end)\n"
        f"{{\n    return ({name}){{ array.p + first, end - first }};\n}}"
    )
