"""Importing replant and asking for help are instant: nothing heavy is loaded, and little time goes by."""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
from pathlib import Path

import pytest

import replant

HEAVY = {"numba", "llvmlite", "scipy", "matplotlib", "pyarrow", "control", "pandas", "xarray", "sklearn"}
HEAVY |= {"paho", "serial"}
BUDGET = 0.3  # s, over `import numpy` for the package, over `python -c pass` for the command
REPORT = "import sys, json; print(json.dumps(sorted({name.partition('.')[0] for name in sys.modules})))"


def loaded(statement: str) -> set[str]:
    """The top-level modules in a fresh interpreter after ``statement``."""
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", f"{statement}\n{REPORT}"], capture_output=True, text=True, check=True
    )
    return set(json.loads(run.stdout.splitlines()[-1]))


def test_importing_replant_loads_nothing_heavy() -> None:
    modules = loaded("import replant")
    assert {"replant", "numpy"} <= modules
    assert not modules & {*HEAVY, "click", "rich"}


@pytest.mark.parametrize("arguments", [["--help"], ["-h"], ["--version"]], ids=lambda arguments: arguments[0])
def test_asking_for_help_loads_nothing_heavy(arguments: list[str]) -> None:
    call = f"main({arguments})"
    modules = loaded(
        f"from replant.cli import main\ntry:\n    {call}\nexcept SystemExit as stop:\n    assert not stop.code"
    )
    assert {"replant", "click"} <= modules
    assert not modules & {*HEAVY, "rich"}


def test_an_identifier_at_work_loads_numba_and_only_what_it_needs() -> None:
    """The counter-test: the check above would see the libraries if they were there."""
    modules = loaded(
        "import replant as rp\n"
        "ident = rp.Identifier(rp.Structure(1), 0.1, filter=rp.StateVariableFilter(5.0), scaling=None,"
        " optimizer=rp.Gradient(1.0))\nident.update(1.0, 1.0)"
    )
    assert {"numba", "scipy"} <= modules
    assert not modules & {"matplotlib", "pyarrow", "control", "pandas", "click"}


def test_every_public_name_resolves_and_is_listed_in_order() -> None:
    assert replant.__all__ == sorted(replant.__all__)
    assert len(set(replant.__all__)) == len(replant.__all__)
    for name in replant.__all__:
        assert getattr(replant, name) is not None
    public = {name for name, value in vars(replant).items() if not name.startswith("_") and not is_module(value)}
    assert public <= set(replant.__all__), "public, but not in __all__"


def is_module(value: object) -> bool:
    return type(value) is type(sys)


def test_every_public_name_has_a_docstring() -> None:
    for name in replant.__all__:
        if name != "__version__":
            assert (getattr(replant, name).__doc__ or "").strip()


def test_the_installed_command_and_the_module_are_the_same() -> None:
    command = Path(sys.executable).with_name("replant")
    if not command.exists():
        pytest.skip(f"no {command}: replant is on the path without being installed")
    outputs = [
        subprocess.run([*start, "--version"], capture_output=True, text=True, check=True).stdout
        for start in ([str(command)], [sys.executable, "-m", "replant"])
    ]
    assert outputs[0] == outputs[1]
    assert replant.__version__ in outputs[0]


def processor_time(*statements: str) -> list[float]:
    """Median processor time of fresh interpreters in s, taken in turns; other processes' load does not count."""
    times: list[list[float]] = [[] for _ in statements]
    for _ in range(7):
        for taken, statement in zip(times, statements, strict=True):
            before = os.times()
            subprocess.run([sys.executable, "-c", statement], check=True, stdout=subprocess.DEVNULL)
            after = os.times()
            taken.append(after.children_user + after.children_system - before.children_user - before.children_system)
    return [statistics.median(taken) for taken in times]


def test_importing_replant_is_quick() -> None:
    numpy, package = processor_time("import numpy", "import replant")
    assert package - numpy < BUDGET


def test_asking_for_help_is_quick() -> None:
    nothing, help_text = processor_time(
        "pass", "import sys\nsys.argv = ['replant', '--help']\nimport replant.__main__ as m\nm.main()"
    )
    assert help_text - nothing < BUDGET
