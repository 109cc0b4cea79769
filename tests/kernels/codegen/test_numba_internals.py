"""The versions of Numba with which its private parts are used."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import replant as rp
from replant.kernels.codegen import numba_internals
from support.places import ROOT


def test_what_is_declared_is_what_is_tested() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    expected = {
        f"{name}>={major}.{oldest},<{major}.{newest + 1}"
        for name, ((major, oldest), (_, newest)) in numba_internals.TESTED.items()
    }
    assert expected <= set(declared)


@pytest.mark.parametrize("version", ["0.61.0", "0.64.0rc1", "0.68.1", "0.68.99dev0"])
def test_tested_versions_pass(version: str) -> None:
    numba_internals.check({"numba": version, "llvmlite": "0.50.0"})


@pytest.mark.parametrize("version", ["0.60.0", "0.69.0", "0.69.0rc1", "0.7.0", "1.0.0", "1.61.0", "0+unknown", "x"])
def test_others_are_refused_in_one_line_that_says_what_to_do(version: str) -> None:
    with pytest.raises(rp.UnsupportedDependencyError) as found:
        numba_internals.check({"numba": version, "llvmlite": "0.50.0"})
    assert isinstance(found.value, ImportError)
    assert str(found.value) == (
        f"numba {version} is installed, replant is tested with 0.61 to 0.68 and uses parts of it that change: "
        "pip install 'numba>=0.61,<0.69'"
    )
    with pytest.raises(rp.UnsupportedDependencyError, match=r"pip install 'llvmlite>=0\.44,<0\.51'"):
        numba_internals.check({"numba": "0.68.1", "llvmlite": "0.51.0"})


def test_the_command_line_says_it_without_a_traceback(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    log.write_text("t,u,y\n" + "".join(f"{k / 10},{k // 7 % 2},{k // 5 % 3}\n" for k in range(200)))
    program = (
        "import numba\nnumba.__version__ = '0.99.1'\nfrom replant.cli import main\n"
        f"main(['fit', {str(log)!r}, '--input', 'u', '--output', 'y', '--poles', '1'])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("replant: numba 0.99.1 is installed, ")
    assert done.stderr.count("\n") == 1
