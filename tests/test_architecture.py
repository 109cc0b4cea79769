"""The architecture: imports point one way, nothing below the logs touches the outside, heavy libraries come late."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import replant

SOURCE = Path(__file__).parents[1] / "src" / "replant"

#: From the ground up: a module may import from lower levels and from its own.  A name stands for its package too.
LEVELS: list[set[str]] = [
    {"kernels", "errors"},
    {"validation", "labels"},
    {"interop", "frames"},
    # the models: each knows at most those above its line
    {
        "realization",
        "preprocess",
        "replay",
        "trace",
        "optimizers",
        "least_squares",
        "signals",
        "factors",
        "batches",
        "thinning",
    },
    {"filters", "overview", "scatter"},
    {"transfer_function"},
    {"structure", "rigs", "response"},
    {"scaling"},
    {"settings", "uncertainty"},
    # the numbers of one record or one identifier, and what is read off them
    {"dimensions"},
    {"state"},
    {"regression", "refined", "blocks", "covariance", "free_run", "prediction"},
    {"assessment"},
    # the estimators
    {"defaults", "revision", "score"},
    {"startup"},
    {"constant"},
    {"renewal"},
    {"estimate", "identifier", "offline", "checkpoint"},
    {"search", "runs", "comparison", "sklearn", "ensemble"},
    # what touches the outside
    {"logs", "sources", "report", "live", "paper"},
    {"__init__"},
    {"cli"},
    {"__main__"},
]
#: Read and write files, and speak to the person at the terminal: these and nothing else.
OUTSIDE = {"checkpoint.files", "logs", "sources", "report", "live", "paper", "cli", "__main__"}
#: May be imported anywhere, at any time; everything else that is not Python's own or replant's is heavy.
LIGHT = {"numpy"}
HEAVY = {"numba", "llvmlite", "scipy", "matplotlib", "control", "pyarrow", "pandas", "xarray", "sklearn"}
HEAVY |= {"paho", "serial", "starlette", "uvicorn"}
#: Modules that are made of another package's classes: nothing of ours imports them but where it uses them.
ADAPTERS = {
    "sklearn": {"sklearn"},
    "live.dashboard.app": {"starlette"},
    "live.dashboard.security": {"starlette"},
}
TERMINAL = {"click", "rich"}
FILES = {"pathlib", "os", "io", "shutil", "tempfile", "glob", "socket", "select", "subprocess", "sys", "logging"}


def name_of(path: Path) -> str:
    """``filters``, ``kernels.step``, ``logs`` for its __init__."""
    parts = path.relative_to(SOURCE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts)


MODULES = {name_of(path): path for path in sorted(SOURCE.rglob("*.py"))}
TREES = {name: ast.parse(path.read_text(encoding="utf-8")) for name, path in MODULES.items()}
every_module = pytest.mark.parametrize("module", MODULES)


def level_of(module: str) -> int | None:
    top = module.partition(".")[0]
    return next((level for level, names in enumerate(LEVELS) if top in names), None)


def imports(tree: ast.AST, module: str, *, late: bool = True) -> Iterator[str]:
    """Every imported module by its full name; without ``late`` those alone that importing the module runs."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) and not late:
            continue
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test) and not late:
            continue
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:  # relative to the module's package
                package = ("replant." + module).split(".")
                if MODULES[module].name != "__init__.py":
                    package = package[:-1]
                base = ".".join([*package[: len(package) - node.level + 1], *filter(None, [base])])
            for alias in node.names:
                full = f"{base}.{alias.name}"
                yield full if full.removeprefix("replant.") in MODULES else base
        else:
            yield from imports(node, module, late=late)


def own(module: str, *, late: bool = True) -> set[str]:
    """The modules of replant that this one imports, ``__init__`` for replant itself."""
    found = {name for name in imports(TREES[module], module, late=late) if name.partition(".")[0] == "replant"}
    return {name.removeprefix("replant").removeprefix(".") or "__init__" for name in found}


def outside(module: str, *, late: bool = True) -> set[str]:
    """The top-level names of other packages that this module imports."""
    return {name.partition(".")[0] for name in imports(TREES[module], module, late=late)} - {"replant"}


def test_the_package_under_test_is_the_one_looked_at() -> None:
    assert Path(replant.__file__).parent == SOURCE
    assert {"__init__", "identifier", "kernels", "kernels.step"} <= set(MODULES)


def test_the_reader_of_imports_sees_every_kind() -> None:
    tree = ast.parse(
        "import numpy as np, scipy.signal\nfrom replant.kernels import layout as at\nfrom replant import filters\n"
        "from replant import __version__\nif np:\n    import numba\n"
        "class A:\n    import pandas\ndef f():\n    import control\n    g = lambda: __import__('os')\n"
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import pyarrow\n"
    )
    early = [
        "numpy",
        "scipy.signal",
        "replant.kernels.schema",
        "replant.regressor.filters",
        "replant",
        "numba",
        "pandas",
        "typing",
    ]
    assert list(imports(tree, "identifier", late=False)) == early
    assert set(imports(tree, "identifier")) == {*early, "control", "pyarrow"}
    relative = ast.parse("from . import layout\nfrom .step import step\nfrom ..filters import split_delay")
    assert list(imports(relative, "kernels.step")) == [
        "replant.kernels.schema",
        "replant.kernels.step.shared",
        "replant.regressor.filters",
    ]
    assert list(imports(ast.parse("from .step import step"), "kernels")) == ["replant.kernels.step.shared"]


@every_module
def test_every_module_has_its_level(module: str) -> None:
    assert level_of(module) is not None, f"place {module} in LEVELS"


def test_no_name_stands_in_two_levels() -> None:
    names = [name for level in LEVELS for name in level]
    assert len(names) == len(set(names))


@every_module
def test_imports_point_one_way(module: str) -> None:
    level = level_of(module)
    for imported in own(module):
        assert level_of(imported) is not None, f"{imported} has no level"
        assert level_of(imported) <= level, f"{module} (level {level}) imports {imported} from above"


def test_imports_make_no_circle() -> None:
    """Also within a level: every module can be taken away once all that it imports have been."""
    remaining = {module: own(module) - {module} for module in MODULES}
    while remaining:
        free = {module for module, needs in remaining.items() if not needs & set(remaining)}
        assert free, f"a circle among {sorted(remaining)}"
        remaining = {module: needs for module, needs in remaining.items() if module not in free}


@pytest.mark.parametrize("module", [module for module in MODULES if module.partition(".")[0] == "kernels"])
def test_kernels_know_numpy_math_numba_and_each_other(module: str) -> None:
    assert outside(module) <= {"__future__", "math", "operator", "typing", "numpy", "numba", "llvmlite"}
    assert {name.partition(".")[0] for name in own(module)} <= {"kernels"}


@every_module
def test_heavy_libraries_are_imported_where_they_are_used(module: str) -> None:
    """Not by importing a module: neither directly nor by the kernels, of which only the layout goes without Numba."""
    if module.partition(".")[0] != "kernels":
        assert not outside(module, late=False) & (HEAVY - ADAPTERS.get(module, set()))
        assert module in ADAPTERS or not own(module, late=False) & set(ADAPTERS)
        kernels = {name for name in own(module, late=False) if name.partition(".")[0] == "kernels"}
        assert not {name for name in kernels if outside(name, late=False) & HEAVY}


@every_module
def test_the_middle_does_not_touch_the_outside(module: str) -> None:
    """Below the logs: no files but for checkpoints, in one module; no terminal, nothing printed."""
    if {module, module.partition(".")[0]} & OUTSIDE:
        return
    assert not outside(module) & (TERMINAL | FILES)
    called = {
        node.func.id
        for node in ast.walk(TREES[module])
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }
    assert not called & {"open", "print", "input", "exec", "eval", "__import__"}
    attributes = {node.attr for node in ast.walk(TREES[module]) if isinstance(node, ast.Attribute)}
    assert not attributes & {"tofile", "fromfile", "memmap", "savetxt", "loadtxt", "savez", "read_text", "write_text"}


@every_module
def test_only_declared_packages_are_imported(module: str) -> None:
    allowed = set(sys.stdlib_module_names) | LIGHT | HEAVY | TERMINAL
    assert outside(module) <= allowed, "declare it in pyproject.toml, then here"
