"""What a module of the package may import and call, beside the order of the folders, which `.importlinter` holds.

    python tools/imports.py

It prints each fault with its module; no fault, no output.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterator
from functools import cache

from architecture import Graph, Package, circle

#: Read and write files, and speak to the person at the terminal: these and nothing else.
OUTSIDE = {
    "numerics.operating_system",
    "online.checkpoint_file",
    "online.second_process",
    "fitting.log_inspection",
    "fitting.model_file",
    "logs",
    "examples",
    "online.runs.full_trace",
    "report",
    "fleet",
    "live",
    "workbench",
    "paper",
    "cli",
    "__main__",
    "plotting.style",  # PNG in memory
}
#: Of Python's own, what kernels may import.
PLAIN = {"__future__", "collections", "contextlib", "enum", "functools", "math", "operator", "typing"}
#: May be imported anywhere, at any time; everything else that is not Python's own or replant's is heavy.
LIGHT = {"numpy"}
HEAVY = {"scipy", "matplotlib", "control", "pyarrow", "pandas", "xarray", "sklearn"}
HEAVY |= {"paho", "serial", "starlette", "sympy", "uvicorn"}
HEAVY |= {"distributed", "threadpoolctl"}
HEAVY |= {"h5py", "mcap", "mcap_ros2", "openpyxl", "pyulog", "zstandard"}
HEAVY |= {"asammdf", "nptdms"}  # in no extra, because they are under the LGPL: who has such files installs them
#: Modules that are made of another package's classes: nothing of ours imports them but where it uses them.
ADAPTERS = {
    "sklearn": {"sklearn"},
    "live.dashboard.app": {"starlette"},
    "live.dashboard.security": {"starlette", "uvicorn"},
    "workbench.app": {"starlette"},
}
#: Ask in which process they are, or say what a forked one does first; they touch no file.
FORKS = {"online.locking": {"os"}, "online.ensemble_members": {"os"}}
#: Finds the native library, and has it made in a clone.
LOADS = {"kernels.native": {"ctypes", "hashlib", "pathlib", "platform", "subprocess", "sys", "threading"}}
TERMINAL = {"click", "rich"}
FILES = {"pathlib", "os", "io", "shutil", "tempfile", "glob", "socket", "select", "subprocess", "sys", "logging"}
CALLS = {"open", "print", "input", "exec", "eval", "__import__"}
WRITES = {"tofile", "fromfile", "memmap", "savetxt", "loadtxt", "savez", "read_text", "write_text"}
MOST_BY_POSITION = 12  # of more arguments nobody sees which is which: arrays that go together are passed together


def of_kernels(package: Package, module: str) -> Iterator[str]:
    """Kernels know NumPy, mathematics, errors and each other."""
    if module.partition(".")[0] == "kernels":
        yield from (f"imports {name}" for name in package.outside(module) - {*PLAIN, "numpy", *LOADS.get(module, ())})
        own = {name.partition(".")[0] for name in package.own(module)}
        yield from (f"imports {name}, a kernel" for name in own - {"kernels", "errors"})


def of_heavy_libraries(package: Package, module: str) -> Iterator[str]:
    """Heavy libraries are imported where they are used, not by importing a module."""
    early = package.outside(module, late=False) & HEAVY
    yield from (
        f"imports {name} at its top: import it where it is used" for name in early - ADAPTERS.get(module, set())
    )
    if module not in ADAPTERS:
        adapters = package.own(module, late=False) & set(ADAPTERS)
        yield from (f"imports {name} at its top, which is heavy" for name in adapters)


def of_the_middle(package: Package, module: str) -> Iterator[str]:
    """Below the logs there are no files but checkpoints, no terminal, nothing printed."""
    if {module, module.partition(".")[0]} & OUTSIDE:
        return
    allowed = FORKS.get(module, set()) | LOADS.get(module, set())
    yield from (
        f"imports {name}: it reaches the outside" for name in package.outside(module) & (TERMINAL | FILES) - allowed
    )
    for node in ast.walk(package.trees[module]):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in CALLS:
            yield f"line {node.lineno}: calls {node.func.id}(): it reaches the outside"
        if isinstance(node, ast.Attribute) and node.attr in WRITES:
            yield f"line {node.lineno}: uses {node.attr}: it reaches the outside"


def of_declared_packages(package: Package, module: str) -> Iterator[str]:
    """Only declared packages are imported."""
    allowed = set(sys.stdlib_module_names) | LIGHT | HEAVY | TERMINAL
    yield from (
        f"imports {name}: declare it in pyproject.toml, then here" for name in package.outside(module) - allowed
    )


def of_the_face(package: Package, module: str) -> Iterator[str]:
    """What the public face is made of does not import the face: it would load all of it."""
    if module.partition(".")[0] not in ("cli", "__main__") and "__init__" in package.own(module):
        yield "imports replant itself: import the module that has the name"


def of_circles(package: Package, module: str) -> Iterator[str]:
    """No module imports itself by way of others, late or for its types: `.importlinter` looks at siblings alone."""
    graph, ways, seen = _circular(package), [[module]], set[str]()
    for way in ways if module in graph else ():
        for name in sorted(graph[way[-1]] & set(graph) - seen):
            if name == module:
                yield f"makes a circle: {' -> '.join([*way, name])}"
                return
            seen.add(name)
            ways.append([*way, name])


@cache
def _circular(package: Package) -> Graph:
    """Return the modules that circles are made of, and those that import them, with their imports."""
    graph = package.modules()
    return {module: graph[module] for module in circle(graph)}


def of_checks(package: Package, module: str) -> Iterator[str]:
    """What a check returns is used: one called for its exception leaves what the caller passed where it was."""
    for node in ast.walk(package.trees[module]):
        match node:
            case ast.Expr(value=ast.Call(func=ast.Name(id=name))) if name in _checks(package):
                yield f"line {node.lineno}: keep() what {name}() returns"


@cache
def _checks(package: Package) -> frozenset[str]:
    modules = [f"numerics.{name}" for name in ("arguments", "limits")]
    functions = (node for name in modules if name in package.trees for node in package.trees[name].body)
    names = {node.name for node in functions if isinstance(node, ast.FunctionDef)}
    return frozenset(names - {"keep", "granted"})


def of_long_signatures(package: Package, module: str) -> Iterator[str]:
    """No function takes many arguments by position, but a kernel, whose arguments the library checks one by one."""
    for node in ast.walk(package.trees[module]):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            if any(ast.unparse(each).startswith("kernel(") for each in node.decorator_list):
                continue
            if len(node.args.posonlyargs) + len(node.args.args) > MOST_BY_POSITION:
                yield f"line {node.lineno}: {node.name} takes more than {MOST_BY_POSITION} arguments by position"


RULES: tuple[Callable[[Package, str], Iterator[str]], ...] = (
    of_kernels,
    of_heavy_libraries,
    of_the_middle,
    of_declared_packages,
    of_the_face,
    of_circles,
    of_checks,
    of_long_signatures,
)


def faults(package: Package) -> list[str]:
    """Return what is to be mended, a line each."""
    return [
        f"{module}: {fault}" for module in package.files for rule in RULES for fault in sorted(rule(package, module))
    ]


if __name__ == "__main__":
    sys.exit("\n".join(faults(Package.read())) or 0)
