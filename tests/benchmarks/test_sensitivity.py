"""Constants that are halved and doubled: whether the copy of the package takes them, and what is said then."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from support.compilers import without_optimization
from support.places import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))
sys.path.insert(0, str(ROOT / "tools"))

from constants_page import measurable

from sensitivity.adjustable import make_copy
from sensitivity.comparison import scaled, words, write
from sensitivity.outcome import Outcome

PLAIN = Outcome(error=0.01, status="trusted", late=float("inf"), alarms=0, faulty=False, figures="[1.0]")


def said(**changes: object) -> str:
    return words({"a": dataclasses.asdict(PLAIN)}, {"a": dataclasses.asdict(dataclasses.replace(PLAIN, **changes))})


@pytest.mark.slow
def test_a_copy_takes_a_constant_wherever_it_is_used(tmp_path: Path) -> None:
    make_copy(ROOT / "src" / "replant", tmp_path, measurable())
    look = """
from replant.verdict import estimate_tests
from replant.kernels.monitoring import outliers
from replant.fitting import structure_evidence
from replant.online import revision
print(estimate_tests.MOST_UNCERTAIN, structure_evidence.MOST_UNCERTAIN)
print(revision.GROWTH, outliers.GATE)
"""
    seen = []
    for changed in ({}, {"verdict.estimate_tests.MOST_UNCERTAIN": 0.3, "kernels.monitoring.outliers.GATE": 2064.0}):
        environment = os.environ | {"PYTHONPATH": str(tmp_path / "src"), "ADJUSTED_CONSTANTS": json.dumps(changed)}
        run = subprocess.run([sys.executable, "-c", look], env=environment, capture_output=True, text=True, check=True)
        seen.append([float(word) for word in run.stdout.translate(str.maketrans("", "", "(),")).split()])
    usual, other = seen
    assert usual[:2] == [measurable()["verdict.estimate_tests.MOST_UNCERTAIN"]] * 2
    assert other[:2] == [0.3] * 2
    assert other[2:-1] == usual[2:-1] == [measurable()["online.revision.GROWTH"]]
    assert (usual[-1], other[-1]) == (measurable()["kernels.monitoring.outliers.GATE"], 2064.0)


@pytest.mark.slow
def test_kernels_of_the_copy_are_compiled_with_its_values(tmp_path: Path) -> None:
    make_copy(ROOT / "src" / "replant", tmp_path, measurable())
    changed = {"kernels.monitoring.outliers.GATE": 2064.0}
    environment = os.environ | without_optimization(tmp_path) | {"ADJUSTED_CONSTANTS": json.dumps(changed)}
    command = [sys.executable, "-m", "translator.library", "--out", str(tmp_path / "made.so"), "--keep", str(tmp_path)]
    subprocess.run(command, env=environment, cwd=tmp_path / "tools", check=True)
    assert "#define outliers_GATE 2064.0" in (tmp_path / "kernels.c").read_text()


def test_values_are_halved_and_doubled_and_near_one_their_distance_from_it() -> None:
    assert scaled(8, 0.5) == 4
    assert scaled(1, 0.5) == 1
    assert scaled((2, 4.0), 2.0) == (4, 8.0)
    assert scaled(0.9, 0.5) == 0.95
    assert scaled(0.25, 2.0) == 0.5


def test_what_differs_is_said() -> None:
    assert said() == "nothing changes on these records"
    assert said(figures="[1.1]") == "no verdict changes, and no error by a quarter"
    assert said(status="converging") == "right estimates no longer trusted: 'a'"
    assert said(error=0.5) == "right estimates no longer trusted: 'a'; wrong ones trusted: 'a'; error of 'a' times 50"
    assert said(late=100.0) == "'a' noticed after 100 samples instead of never"
    assert said(alarms=3) == "3 samples held against 'a' instead of 0"


def test_it_is_written_below_its_constant_alone(tmp_path: Path) -> None:
    (tmp_path / "part.py").write_text(
        'A = 1\n"""One [count].\nOrigin: x.\nSensitivity: not measured.\n"""\n\n'
        'B = 2\n"""Two [count].\nOrigin: x.\nSensitivity: not\nmeasured.\n"""\n\nC = A\n'
    )
    write(
        [{"name": "part.B", "factor": 0.5, "words": "less"}, {"name": "part.B", "factor": 2.0, "words": "more"}],
        tmp_path,
    )
    assert (tmp_path / "part.py").read_text() == (
        'A = 1\n"""One [count].\nOrigin: x.\nSensitivity: not measured.\n"""\n\n'
        'B = 2\n"""Two [count].\nOrigin: x.\nSensitivity: halved, less; doubled, more.\n"""\n\nC = A\n'
    )
