"""The code cells of every page run, in their order and in an empty folder, as `make docs` runs them for the site."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest

from support.cases import every
from support.places import ROOT

#: Cells show how to use the package, not how to close a file: Python does that where they end.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
CELL = re.compile(r"^```\{code-cell\}[^\n]*\n(?P<text>.*?)^```", re.DOTALL | re.MULTILINE)
SHELL = "%%sh -e\n"
CELLS = {
    path.relative_to(ROOT).as_posix(): found
    for path in sorted((ROOT / "docs").rglob("*.md"))
    if (found := [cell["text"] for cell in CELL.finditer(path.read_text(encoding="utf-8"))])
}
LOOP = "docs/tutorials/under-control.md"  # has a test of its own, which runs every cell of it


@contextmanager
def reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A folder and a terminal of one's own; what a page does to matplotlib and NumPy ends with it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    monkeypatch.setenv("COLUMNS", "88")
    printed = np.get_printoptions()
    with plt.rc_context():
        yield
    np.set_printoptions(**printed)
    plt.close("all")


def run(cell: str, names: dict[str, Any]) -> None:
    if cell.startswith(SHELL):
        done = subprocess.run(["sh", "-e"], input=cell.removeprefix(SHELL), capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    else:
        exec(compile(cell, "cell", "exec"), names)


@every("page", sorted(CELLS.keys() - {LOOP}), quick=1)
def test_the_cells_of_a_page_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names: dict[str, Any] = {"__name__": "__main__"}
    with reader(tmp_path, monkeypatch):
        for cell in CELLS[page]:
            run(cell, names)


def test_all_cells_are_found() -> None:
    written = sum(path.read_text(encoding="utf-8").count("```{code-cell}") for path in (ROOT / "docs").rglob("*.md"))
    assert sum(map(len, CELLS.values())) == written > 100


@pytest.mark.slow
def test_the_tutorial_of_a_loop_shows_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    names: dict[str, Any] = {"__name__": "__main__"}
    with reader(tmp_path, monkeypatch):
        for cell in CELLS[LOOP]:
            run(cell, names)
            if "reference=setpoint" in cell:
                names["referenced"] = names["found"]
    assert (np.abs(names["blind"].parameters / names["TRUTH"] - 1.0) > 0.5).all()
    assert names["plain"].verdict.status == "inconsistent"
    assert names["plain"].verdict.reasons[0].startswith("the loop is closed")
    found, unstable = names["referenced"], names["found"]
    assert (np.abs(found.parameters - names["TRUTH"]) < 2.0 * found.uncertainty.std).all()
    assert [each.status for each in (found.verdict, names["verdict"], unstable.verdict)] == ["trusted"] * 3
    assert (np.abs(unstable.parameters - [-1.0, 1.0]) < 3.0 * unstable.uncertainty.std).all()
    assert re.search(r"^without r .* inconsistent$", capsys.readouterr().out, re.MULTILINE)
