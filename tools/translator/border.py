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
VARIANTS = ("plain", "avx2", "avx512")
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


def runner(kernel: Any, function: Function, conditions: list[str], head: str) -> str:
    """Return the function that runs a kernel with the arguments that Python gave, where all holds."""
    lines, number = [head, "{"], 0
    for name, kind in zip(function.parameters, function.own_kinds, strict=True):
        given = f"a[{number}]"
        if isinstance(kind, Record):
            arrays = STATE.format(*(f"a[{number + place}]" for place in range(len(ARRAYS))))
            lines += [f"    State state_{name} = {arrays};", f"    State *{name} = &state_{name};"]
        elif isinstance(kind, Array):
            sizes = ", ".join(f"{given}.n[{axis}]" for axis in range(kind.dimensions))
            lines.append(f"    {kind.name} {name} = {{ {given}.p, {sizes} }};")
        else:
            field = "d" if kind == "d" else "i != 0" if kind == "b" else "i"
            lines.append(f"    {_scalar(kind)} {name} = {given}.{field};")
        number += len(ARRAYS) if isinstance(kind, Record) else 1
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
        for part, own in ARRAYS.items() if isinstance(kind, Record) else [(name, kind)]:
            yield part, own, name in function.written


def table(every: list[tuple[Any, Function, str]]) -> str:
    """Return the table of all kernels: name, arguments, results and runner."""
    parts = ["typedef struct { const char *name; char kind; int dimensions; bool written; } parameter;"]
    most = max(len(list(given(function))) for _, function, _ in every)
    parts.append(f"enum {{ MOST_ARGUMENTS = {most} }};")
    parts.append(
        "typedef struct {\n    const char *name;\n    int count;\n    const parameter *parameters;\n"
        "    int result_count;\n    const char *results;\n    runner run;\n} kernel;"
    )
    rows = []
    for kernel, function, run in every:
        own = [
            f'    {{ "{name}", {_letter(kind)}, {kind.dimensions if isinstance(kind, Array) else 0}, '
            f"{'true' if written else 'false'} }},"
            for name, kind, written in given(function)
        ]
        parts.append("\n".join([f"static const parameter parameters_of_{function.name}[] = {{", *own, "};"]))
        returned = function.returns
        kinds = returned.parts if isinstance(returned, Tuple) else () if returned == "v" else (returned,)
        letters = "".join(str(kind) for kind in kinds)
        rows.append(
            f'    {{ "{kernel.name}", {len(own)}, parameters_of_{function.name}, {len(letters)}, "{letters}", {run} }},'
        )
    parts.append("\n".join(["static kernel kernels[] = {", *rows, "};"]))
    return "\n\n".join(parts)


def steps(every: list[tuple[Any, Function, str]]) -> str:
    """Return the table of the kernels that take one sample."""
    found = [(kernel, function) for kernel, function, _ in every if re.fullmatch(r"step\.\w+\.step", kernel.name)]
    takes = "double (*take)(State *, double, double, double, double)"
    rows = [
        f'    {{ "{kernel.name}", {function.name}, {"true" if "collecting" in kernel.name else "false"} }},'
        for kernel, function in found
    ]
    return "\n".join([f"static const struct {{ const char *name; {takes}; bool collects; }} steps[] = {{", *rows, "};"])


def sources(package: str, root: Path, kernels: list[Any]) -> dict[str, str]:
    """Return the C files by name: ``kernels.c``, and ``lanes.c``, which is compiled once for each instruction set."""
    program, lanes = Program(package, root), Program(package, root)
    border = (HERE / "border.h").read_text("utf-8")
    vectorised = [kernel for kernel in kernels if ".step.ensemble" in kernel.python.__module__]
    plain = entries(program, [kernel for kernel in kernels if kernel not in vectorised])
    every, runners = [], []
    for kernel, function, conditions in plain:
        run = f"run_{function.name}"
        runners.append(runner(kernel, function, conditions, f"static const char *{run}(argument *a)"))
        every.append((kernel, function, run))
    inside, chosen, declared = [], [], []
    for kernel, function, conditions in entries(lanes, vectorised):
        run = f"run_{function.name}"
        inside.append(runner(kernel, function, conditions, f"const char *OF_VARIANT({run})(argument *a)"))
        inside.insert(0, f"const char *OF_VARIANT({run})(argument *a);")
        declared.append("\n".join(f"const char *{run}_{variant}(argument *a);" for variant in VARIANTS))
        chosen.append((len(every), run))
        every.append((kernel, function, f"{run}_plain"))
    program.constants["at_BELIEVED"] = str(program.schema.BELIEVED)
    choice = ["static void choose_lanes(void)", "{", "#if defined(WITH_VARIANTS)", "    __builtin_cpu_init();"]
    for variant, feature in (("avx2", "avx2"), ("avx512", "avx512f")):
        choice.append(f'    if (__builtin_cpu_supports("{feature}")) {{')
        choice += [f"        kernels[{number}].run = {run}_{variant};" for number, run in chosen] + ["    }"]
    choice += ["#endif", "}"]
    parts = [program.text(lanes=False), border, *runners, *declared, table(every), steps(every), "\n".join(choice)]
    return {
        "kernels.c": "\n\n".join([*parts, (HERE / "border.c").read_text("utf-8")]),
        "lanes.c": "\n\n".join([lanes.text(lanes=True), border, *inside]) + "\n",
    }


def _scalar(kind: Kind | None) -> str:
    return {"d": "double", "i": "int64_t", "b": "bool"}[str(kind)]


def _letter(kind: Kind) -> str:
    return f"'{kind.element if isinstance(kind, Array) else kind}'"


def _field(kind: Kind | None) -> str:
    if kind not in ("b", "d", "i"):
        raise UnsupportedError(f"a kernel that Python calls returns {kind}")
    return "d" if kind == "d" else "i"
