"""Importing replant and asking for help load nothing heavy; how long they take `make bench` measures."""

from __future__ import annotations

import json
import os
import pydoc
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import replant
from replant import public as exported
from replant.cli import COMMANDS
from support.waiting import PATIENCE

HEAVY = {"scipy", "matplotlib", "pyarrow", "control", "pandas", "xarray", "sklearn"}
HEAVY |= {"distributed", "paho", "serial"}
REPORT = "import sys, json; print(json.dumps(sorted({name.partition('.')[0] for name in sys.modules})))"


def loaded(statement: str) -> set[str]:
    """The top-level modules in a fresh interpreter after ``statement``."""
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", f"{statement}\n{REPORT}"], capture_output=True, text=True, check=True
    )
    return set(json.loads(run.stdout.splitlines()[-1]))


HELP = "from replant.cli import main\ntry:\n    main([{!r}])\nexcept SystemExit as stop:\n    assert not stop.code"
AT_WORK = (
    "import replant as rp\n"
    "ident = rp.Identifier(rp.Structure(1), 0.1, filter=rp.StateVariableFilter(5.0), scaling=None,"
    " optimizer=rp.Gradient(1.0))\nident.update(1.0, 1.0)"
)


@pytest.mark.parametrize(
    ("statement", "some", "none"),
    [
        pytest.param("import replant", {"replant"}, {*HEAVY, "numpy", "click", "rich"}, id="import"),
        *(
            pytest.param(statement, {"replant", "numpy"}, {*HEAVY, "click", "rich"}, id=statement)
            for statement in ("import replant as rp; rp.Identifier", "from replant import *")
        ),
        *(
            pytest.param(HELP.format(option), {"replant", "click"}, {*HEAVY, "numpy", "rich"}, id=option)
            for option in ("--help", "-h", "--version")
        ),
        # the counter-test: the check would see the libraries if they were there
        pytest.param(
            AT_WORK, {"scipy"}, {"matplotlib", "pyarrow", "control", "pandas", "click"}, id="an identifier at work"
        ),
    ],
)
def test_what_is_done_loads_only_what_it_needs(statement: str, some: set[str], none: set[str]) -> None:
    modules = loaded(statement)
    assert some <= modules
    assert not modules & none


def test_the_help_of_no_command_loads_anything_heavy() -> None:
    """One process asks for the help of one after the other: the first that loads something is named."""
    program = f"""
import json, sys
from replant.cli import main
loaded = {{}}
for command in {list(COMMANDS)}:
    try:
        main([command, "--help"])
    except SystemExit as stop:
        assert not stop.code
    loaded[command] = sorted({{name.partition(".")[0] for name in sys.modules}} & set({sorted(HEAVY)}))
print(json.dumps(loaded))
"""
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=True, timeout=PATIENCE
    )
    of_each: dict[str, list[str]] = json.loads(run.stdout.splitlines()[-1])
    assert set(of_each) == set(COMMANDS)
    assert {command: names for command, names in of_each.items() if names} == {}


def test_with_background_nothing_is_loaded_between_samples() -> None:
    """The first solution would wait for SciPy, at 1 kHz for more than a hundred samples."""
    modules = loaded(
        "import sys, numpy as np, replant as rp\n"
        "if __name__ == '__main__':\n"
        "    ident = rp.Identifier(rp.Structure(1), 0.1, background=True)\n"
        "    before, rng = set(sys.modules), np.random.default_rng(0)\n"
        "    u = np.repeat(rng.choice([-1.0, 1.0], 100), 10)\n"
        "    y = rp.TransferFunction([2.0], [1.0, 1.0]).simulate(u, 0.1) + 0.05 * rng.standard_normal(1000)\n"
        "    for pair in zip(u, y):\n"
        "        ident.update(*pair)\n"
        "    assert ident.has_model\n"
        "    for name in before - {'sys'}:\n"
        "        del sys.modules[name]\n"
    )
    assert not modules & {"scipy", "numpy"}


def test_a_run_loads_no_part_of_scipy_that_is_slow_to_load(tmp_path: Path) -> None:
    """Its signal and stats take longer than all else that a run loads; a machine of one core waits for them."""
    generator = np.random.default_rng(0)
    u = np.repeat(generator.choice([-1.0, 1.0], 100), 8)
    y = replant.TransferFunction([2.0], [10.0, 1.0]).simulate(u, 1.0) + 0.1 * generator.standard_normal(800)
    np.savetxt(tmp_path / "log.csv", np.column_stack([u, y]), delimiter=",", header="u,y", comments="")
    program = (
        "import contextlib, io, os, sys\nfrom replant.cli import main\n"
        "with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):\n"
        f"    main(['run', {str(tmp_path / 'log.csv')!r}, '-i', 'u', '-o', 'y', '-p', '1', '--dt', '1', '--json'])\n"
        "assert 'scipy.special' in sys.modules\n"
        "assert not {'scipy.signal', 'scipy.stats', 'matplotlib'} & set(sys.modules)\n"
        "assert os.environ['OMP_NUM_THREADS'] == '1'\n"
    )
    own = {name: value for name, value in os.environ.items() if not name.endswith("NUM_THREADS")}
    run = subprocess.run([sys.executable, "-c", program], env=own, capture_output=True, text=True, timeout=PATIENCE)
    assert run.returncode == 0, run.stderr


def test_every_public_name_resolves_and_is_listed_in_order() -> None:
    assert replant.__all__ == sorted(replant.__all__)
    assert set(replant.__all__) == set(dir(replant))
    assert len(set(replant.__all__)) == len(replant.__all__)
    for name in set(replant.__all__) - {"__version__"}:
        assert getattr(replant, name) is getattr(exported, name), name
    modules = {"examples", "figures", "fleet", "rigs", "signals"}
    names = {name for name, value in vars(exported).items() if not name.startswith("_")}
    public = {name for name in names if name in modules or not is_module(getattr(exported, name))}
    assert public | {"__version__"} == set(replant.__all__), "public.py and __all__ differ"


def test_what_is_not_public_is_no_attribute() -> None:
    with pytest.raises(AttributeError, match="module 'replant' has no attribute 'Identifyer'"):
        replant.Identifyer  # noqa: B018


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


def test_help_of_the_package_begins_with_what_most_programs_need() -> None:
    """And it names nothing that there is not."""
    shown = pydoc.plain(pydoc.render_doc(replant))
    listed = re.findall(r"^ {8}(\w[\w, ]*?) {2,}", shown.partition(">>>")[0], re.MULTILINE)
    assert listed[:4] == ["fit", "run", "Identifier", "Model"]
    assert {name for entry in listed for name in entry.split(", ")} <= set(replant.__all__)
