"""The generated part of the border: for each kernel its arguments, what must hold of them, and the call itself."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from translator.function import Function
from translator.kinds import Array, Kind, Record, Tuple, UnsupportedError
from translator.program import Program, entry_kinds
from translator.records import BESIDE

HERE = Path(__file__).parent
#: The instruction sets for which each file is compiled beside "plain"; ``processor.h`` asks for each.
VARIANTS = {"kernels": ("avx2",), "lanes": ("avx2", "avx512")}
STEP = r"step\.\w+\.(step|\w+_one)"  # the kernels that take one sample
TAKER = "typedef double (*taker)(State *, double, double, double, double);"
#: What Python gives for a state, and what is made of it.
ARRAYS = {"ints": Array("i", 1), "reals": Array("d", 1), **BESIDE}
STATE = (
    "{{ {0}.p, {0}.n[0], {1}.p, {1}.n[0], {{ {2}.p, {2}.n[0], {2}.n[1] }}, {{ {3}.p, {3}.n[0], {3}.n[1] }}, "
    "{{ {4}.p, {4}.n[0], {4}.n[1] }} }}"
)


def entries(program: Program, kernels: list[Any]) -> list[tuple[Any, Function, list[str]]]:
    """Return each kernel with its translation and its requirements in C.

    These may call what `kernels.step.soundness` has.
    """
    found = []
    soundness = vars(importlib.import_module(f"{program.package}.step.soundness"))
    for kernel in kernels:
        function = program.function(kernel.python, entry_kinds(kernel.python))
        function.know_arguments_alone()
        function.scope = soundness | function.scope
        conditions = [function.truth(ast.parse(text, mode="eval").body) for text in kernel.requirements]
        found.append((kernel, function, conditions))
    return found


def runner(kernel: Any, function: Function, conditions: list[str]) -> str:
    """Return the function that runs a kernel with the arguments that Python gave, where all holds."""
    lines, number = [f"static const char *run_{function.name}(argument *a)", "{"], 0
    for name, kind in zip(function.parameters, function.own_kinds, strict=True):
        given = f"a[{number}]"
        for state in range(_states(kind)):
            arrays = STATE.format(*(f"a[{number + place}]" for place in range(len(ARRAYS))))
            lines.append(f"    State {name}_{state} = {arrays};")
            number += len(ARRAYS)
        if isinstance(kind, Record):
            lines.append(f"    State *{name} = &{name}_0;")
        elif isinstance(kind, Tuple):
            own, each = function.program.type_of(kind), (f"&{name}_{state}" for state in range(_states(kind)))
            lines += [
                f"    const {own} all_{name} = {{ {', '.join(each)} }};",
                f"    const {own} *{name} = &all_{name};",
            ]
        elif isinstance(kind, Array):
            sizes = ", ".join(f"{given}.n[{axis}]" for axis in range(kind.dimensions))
            lines.append(f"    {kind.name} {name} = {{ {given}.p, {sizes} }};")
        else:
            field = "d" if kind == "d" else "i != 0" if kind == "b" else "i"
            lines.append(f"    {_scalar(kind)} {name} = {given}.{field};")
        number += 0 if _states(kind) else 1
    for text, condition in zip(kernel.requirements, conditions, strict=True):
        lines += [f"    if (!{condition})", f'        return "{text}";']
    call = f"{function.name}({', '.join(function.parameters)})"
    returned = function.returns
    if returned == "v":
        lines.append(f"    {call};")
    elif isinstance(returned, Tuple):
        lines.append(f"    {function.program.type_of(returned)} result = {call};")
        lines += [f"    a[{i}].{_field(part)} = result.f{i};" for i, part in enumerate(returned.parts)]
    else:
        lines.append(f"    a[0].{_field(returned)} = {call};")
    return "\n".join([*lines, "    return NULL;", "}"])


def given(function: Function) -> Iterator[tuple[str, Kind, bool]]:
    """Go through what Python gives: name, kind, and whether it is written."""
    for name, kind in zip(function.parameters, function.own_kinds, strict=True):
        for part, own in [*ARRAYS.items()] * _states(kind) or [(name, kind)]:
            yield part, own, name in function.written


def table(every: list[tuple[Any, Function]], plain: int) -> str:
    """Return the table of all kernels: name, arguments, results; first so many of "kernels", then those of "lanes"."""
    parts = ["typedef struct { const char *name; char kind; int dimensions; bool written; } parameter;"]
    most = max(len(list(given(function))) for _, function in every)
    parts.append(f"enum {{ MOST_ARGUMENTS = {most}, FIRST_OF_LANES = {plain}, ALL_KERNELS = {len(every)} }};")
    parts.append(
        "typedef struct {\n    const char *name;\n    int count;\n    const parameter *parameters;\n"
        "    int result_count;\n    const char *results;\n    bool of_state;\n} kernel;"
    )
    rows = []
    for kernel, function in every:
        lines = [
            f'    {{ "{name}", {_letter(kind)}, {kind.dimensions if isinstance(kind, Array) else 0}, '
            f"{'true' if written else 'false'} }},"
            for name, kind, written in given(function)
        ]
        parts.append("\n".join([f"static const parameter parameters_of_{function.name}[] = {{", *lines, "};"]))
        returned = function.returns
        kinds = returned.parts if isinstance(returned, Tuple) else () if returned == "v" else (returned,)
        letters = "".join(str(kind) for kind in kinds)
        of_state = "true" if isinstance(function.own_kinds[0], Record) else "false"
        rows.append(
            f'    {{ "{kernel.name}", {len(lines)}, parameters_of_{function.name}, {len(letters)}, "{letters}", '
            f"{of_state} }},"
        )
    parts.append("\n".join(["static const kernel descriptions[ALL_KERNELS] = {", *rows, "};"]))
    return "\n\n".join(parts)


def choice() -> str:
    """Return the functions of each instruction set, and what chooses among them for this processor."""
    lists = {**VARIANTS, "takers": VARIANTS["kernels"]}
    lines, body = [TAKER], []
    for name, wider in lists.items():
        kind = "taker" if name == "takers" else "runner"
        lines.append(f"extern const {kind} {', '.join(f'{name}_{variant}[]' for variant in ('plain', *wider))};")
        lines.append(f"static const {kind} *{name} = {name}_plain;")
        body += [f"    if (serves_{variant}())\n        {name} = {name}_{variant};" for variant in wider]
    begin, end = "#if defined(WITH_VARIANTS)", "#endif"
    asked = [begin, (HERE / "processor.h").read_text("utf-8") + end]
    return "\n".join([*asked, *lines, "", "static void choose(void)", "{", begin, *body, end, "}"])


def sources(package: str, root: Path, kernels: list[Any]) -> dict[str, str]:
    """Return the C files by name: ``border.c``, and two that are compiled once for each instruction set."""
    vectorised = [kernel for kernel in kernels if ".step.ensemble" in kernel.python.__module__]
    plain = [kernel for kernel in kernels if kernel not in vectorised]
    programs = {"kernels": Program(package, root), "lanes": Program(package, root)}
    found = {"kernels": entries(programs["kernels"], plain), "lanes": entries(programs["lanes"], vectorised)}
    every = [(kernel, function) for own in found.values() for kernel, function, _ in own]
    steps = [(kernel, function) for kernel, function in every if re.fullmatch(STEP, kernel.name)]
    header, files = (HERE / "border.h").read_text("utf-8"), {}
    for name, program in programs.items():
        parts = [program.text(lanes=name == "lanes"), header, *(runner(*entry) for entry in found[name])]
        parts.append(_list("runner", name, [f"run_{function.name}" for _, function, _ in found[name]]))
        if name == "kernels":
            parts += [TAKER, _list("taker", "takers", [function.name for _, function in steps])]
        files[f"{name}.c"] = "\n\n".join(parts) + "\n"
    rows = [f'    {{ "{kernel.name}", {"true" if "collect" in kernel.name else "false"} }},' for kernel, _ in steps]
    collects = "\n".join(["static const struct { const char *name; bool collects; } steps[] = {", *rows, "};"])
    own = programs["kernels"]
    parts = [own.types(), header, f"#define at_BELIEVED {own.schema.BELIEVED}", table(every, len(plain)), collects]
    return {"border.c": "\n\n".join([*parts, choice(), (HERE / "border.c").read_text("utf-8")]), **files}


def _list(kind: str, name: str, functions: list[str]) -> str:
    """Return the C list of some functions of a file, as the border has them."""
    head = f"const {kind} OF_VARIANT({name})[]"
    return "\n".join([f"extern {head};", f"{head} = {{", *(f"    {function}," for function in functions), "};"])


def _states(kind: Kind) -> int:
    """Return how many states an argument is."""
    return len(kind.parts) if isinstance(kind, Tuple) else int(isinstance(kind, Record))


def _scalar(kind: Kind | None) -> str:
    return {"d": "double", "i": "int64_t", "b": "bool"}[str(kind)]


def _letter(kind: Kind) -> str:
    return f"'{kind.element if isinstance(kind, Array) else kind}'"


def _field(kind: Kind | None) -> str:
    if kind not in ("b", "d", "i"):
        raise UnsupportedError(f"a kernel that Python calls returns {kind}")
    return "d" if kind == "d" else "i"
