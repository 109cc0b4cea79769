"""The architecture: imports point one way, nothing below the logs touches the outside, heavy libraries come late."""

from __future__ import annotations

import ast
import sys
from functools import cache
from pathlib import Path

import replant
from support.cases import every
from support.places import ROOT

sys.path.insert(0, str(ROOT / "tools"))
from architecture import SOURCE, Package, circle, levels, reduced

#: The folders, and the modules at the top, from the ground up: a module imports from its own folder and from those
#: before it.  A name stands for what lies below it, unless that is listed by itself.
ORDER = [
    "errors",
    "arguments",
    "limits",
    "operating_system",
    # the kernels: arrays in, arrays out
    *("kernels", "kernels.optimizers", "kernels.filters", "kernels.monitoring", "kernels.step"),
    # the stages from a sample to the regressor, and what they share
    *("interop", "time_stamps", "log", "statistics", "optimizers", "model", "regressor"),
    *("signals", "rigs", "settings"),
    # the kernels' arrays
    "engine",
    # estimators and their judgement
    *("checkpoint", "simulation", "plotting", "assessment", "identified", "offline", "online"),
    # what touches the outside
    *("data", "data.logs", "data.inspection", "data.streams", "examples", "runs", "sklearn"),
    *("report", "report.figures", "report.terminal", "report.html"),
    "fleet",
    *("live.outputs", "live.dashboard", "live.observer", "live.session", "live"),
    *("paper.drawing", "paper.tables", "paper.actuator", "paper"),
    *("public", "__init__", "cli", "__main__"),
]
#: Read and write files, and speak to the person at the terminal: these and nothing else.
OUTSIDE = {
    "operating_system.whole_file",
    "checkpoint.files",
    "identified.model_file",
    "data",
    "examples",
    "runs.full_trace",
    "report",
    "fleet",
    "live",
    "paper",
    "cli",
    "__main__",
    "log",  # it names its file
    "plotting.figure",  # PNG in memory
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
    "plotting.figure": {"matplotlib"},
    "live.dashboard.app": {"starlette"},
    "live.dashboard.connections": {"starlette", "uvicorn"},
    "live.dashboard.security": {"starlette"},
}
FORKS = {"online.turns": {"os"}}  # says what a forked process does first; it touches no file
#: Finds the native library, and has it made in a clone.
LOADS = {"kernels.native": {"ctypes", "hashlib", "pathlib", "platform", "subprocess", "sys", "threading"}}
TERMINAL = {"click", "rich"}
FILES = {"pathlib", "os", "io", "shutil", "tempfile", "glob", "socket", "select", "subprocess", "sys", "logging"}


PACKAGE = Package.read()
MODULES, TREES = PACKAGE.files, PACKAGE.trees
imports = PACKAGE.imports
own, outside = cache(PACKAGE.own), cache(PACKAGE.outside)
every_module = every("module", MODULES)


def place_of(module: str) -> int | None:
    """Where in `ORDER` a module belongs: the longest name that stands for it."""
    parts = module.split(".")
    names = (".".join(parts[:count]) for count in range(len(parts), 0, -1))
    return next((ORDER.index(name) for name in names if name in ORDER), None)


def test_the_package_under_test_is_the_one_looked_at() -> None:
    assert Path(replant.__file__).parent == SOURCE
    assert {"__init__", "online.identifier", "kernels", "kernels.step"} <= set(MODULES)


def test_the_reader_of_imports_sees_every_kind() -> None:
    tree = ast.parse(
        "import numpy as np, scipy.signal\nfrom replant.kernels import schema as at\nfrom replant import settings\n"
        "from replant import __version__\nif np:\n    import sympy\n"
        "class A:\n    import pandas\ndef f():\n    import control\n    g = lambda: __import__('os')\n"
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import pyarrow\n"
    )
    early = ["numpy", "scipy.signal", "replant.kernels.schema", "replant.settings", "replant"]
    early += ["sympy", "pandas", "typing"]
    assert list(imports(tree, "online.identifier", late=False)) == early
    assert set(imports(tree, "online.identifier")) == {*early, "control", "pyarrow"}
    relative = ast.parse("from . import stages\nfrom .stages import step\nfrom ..schema import PAST")
    assert list(imports(relative, "kernels.step.ensemble")) == [
        "replant.kernels.step.stages",
        "replant.kernels.step.stages",
        "replant.kernels.schema",
    ]
    assert list(imports(ast.parse("from .step import stages"), "kernels")) == ["replant.kernels.step.stages"]


@every_module
def test_every_module_has_its_place(module: str) -> None:
    assert place_of(module) is not None, f"place the folder of {module} in ORDER"


def test_order_names_each_folder_once_and_only_folders_that_there_are() -> None:
    assert len(ORDER) == len(set(ORDER))
    assert {name for name in ORDER if name not in MODULES} == set()


@every_module
def test_imports_point_one_way(module: str) -> None:
    for imported in own(module):
        assert place_of(imported) <= place_of(module), f"{module} imports {imported} from above"


def test_imports_make_no_circle() -> None:
    assert circle(PACKAGE.modules()) == set()
    assert circle(PACKAGE.rooms()) == set()
    assert circle(PACKAGE.rooms(top=True)) == set()


def test_levels_and_arrows_of_a_small_graph() -> None:
    graph = {"a": {"b", "c"}, "b": {"c"}, "c": set()}
    assert levels(graph) == {"a": 2, "b": 1, "c": 0}
    assert reduced(graph) == {"a": {"b"}, "b": {"c"}, "c": set()}
    assert circle(graph) == set()
    assert circle({"a": {"b"}, "b": {"a"}, "c": set()}) == {"a", "b"}


@every("module", [module for module in MODULES if module.partition(".")[0] == "kernels"])
def test_kernels_know_numpy_math_errors_and_each_other(module: str) -> None:
    assert outside(module) <= {*PLAIN, "numpy", *LOADS.get(module, ())}
    assert {name.partition(".")[0] for name in own(module)} <= {"kernels", "errors"}


@cache
def is_heavy(module: str) -> bool:
    """Whether importing a module of ours loads a heavy library, by itself or by what it imports."""
    return bool(outside(module, late=False) & HEAVY) or any(map(is_heavy, own(module, late=False)))


@every_module
def test_heavy_libraries_are_imported_where_they_are_used(module: str) -> None:
    """Not by importing a module: neither directly nor by the kernels."""
    if module.partition(".")[0] != "kernels":
        assert not outside(module, late=False) & (HEAVY - ADAPTERS.get(module, set()))
        assert module in ADAPTERS or not own(module, late=False) & set(ADAPTERS)
        assert not {name for name in own(module, late=False) if name.partition(".")[0] == "kernels" and is_heavy(name)}


@every_module
def test_the_middle_does_not_touch_the_outside(module: str) -> None:
    """Below the logs: no files but for checkpoints, in one module; no terminal, nothing printed."""
    if {module, module.partition(".")[0]} & OUTSIDE:
        return
    assert not outside(module) & (TERMINAL | FILES - FORKS.get(module, set()) - LOADS.get(module, set()))
    called = {
        node.func.id
        for node in ast.walk(TREES[module])
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }
    assert not called & {"open", "print", "input", "exec", "eval", "__import__"}
    attributes = {node.attr for node in ast.walk(TREES[module]) if isinstance(node, ast.Attribute)}
    assert not attributes & {"tofile", "fromfile", "memmap", "savetxt", "loadtxt", "savez", "read_text", "write_text"}


CHECKS = {
    node.name
    for module in ("arguments", "limits")
    for node in TREES[module].body
    if isinstance(node, ast.FunctionDef) and node.name not in ("keep", "granted")
}


@every_module
def test_what_a_check_returns_is_used(module: str) -> None:
    """A check that is called for nothing but its exception leaves what the caller passed where it was."""
    for node in ast.walk(TREES[module]):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call) and isinstance(node.value.func, ast.Name):
            assert node.value.func.id not in CHECKS, f"line {node.lineno}: keep() what {node.value.func.id}() returns"


@every_module
def test_no_function_takes_more_than_twelve_arguments_by_position(module: str) -> None:
    """Of so many nobody sees which is which: arrays that go together are passed together.

    But to a kernel, whose arguments the library takes one by one, and checks.
    """
    for node in ast.walk(TREES[module]):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            if any(ast.unparse(each).startswith("kernel(") for each in node.decorator_list):
                continue
            assert len(node.args.posonlyargs) + len(node.args.args) <= 12, f"line {node.lineno}: {node.name}"


@every_module
def test_only_declared_packages_are_imported(module: str) -> None:
    allowed = set(sys.stdlib_module_names) | LIGHT | HEAVY | TERMINAL
    assert outside(module) <= allowed, "declare it in pyproject.toml, then here"
