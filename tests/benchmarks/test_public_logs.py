"""The benchmark on public logs: its anchor finds the best model, and logs are read from git as the table says."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

import replant as rp
from support.cases import every
from support.places import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))

from public_logs.anchor import OutputError
from public_logs.command import Row, totals
from public_logs.records import git_folder, how_to_clone, read
from public_logs.table import LOGS, Log

DT = 0.1
PLANTS = {
    "one pole": ([2.0], [1.0, 0.5], 0.0),
    "one pole, dead time": ([2.0], [1.0, 0.5], 0.5),
    "two poles, one zero": ([1.0, 3.0], [1.0, 3.0, 2.0], 0.0),
    "weakly damped": ([4.0], [1.0, 0.02, 4.0], 0.0),
    "three poles": ([6.0], [1.0, 6.0, 11.0, 6.0], 0.0),
}


def record(name: str, noise: float) -> tuple[OutputError, np.ndarray]:
    """Return the problem of a plant under steps of random length and height, and its true denominator."""
    numerator, denominator, delay = PLANTS[name]
    random = np.random.default_rng(3)
    u = np.repeat(random.standard_normal(60), 10)
    clean = rp.TransferFunction(numerator, denominator, delay=delay).simulate(u, dt=DT)
    y = clean + 7.0 + noise * clean.std() * random.standard_normal(u.size)
    return OutputError(u, y, DT, len(denominator) - 1, len(numerator) - 1, delay), np.array(denominator[1:])


@pytest.mark.slow
@every("name", PLANTS, quick=3)
def test_the_anchor_recovers_a_plant_without_noise(name: str) -> None:
    problem, true = record(name, 0.0)
    found = problem.best()
    np.testing.assert_allclose(found, true, rtol=1e-5)
    assert problem.fit(found) > 99.999


@every("name", PLANTS)
def test_the_anchor_fits_noise_no_worse_than_the_plant_does(name: str) -> None:
    problem, true = record(name, 0.3)
    assert problem.fit(problem.best()) >= problem.fit(true)


def test_the_anchor_is_at_least_as_good_as_what_it_is_given() -> None:
    problem, true = record("three poles", 0.1)
    poor = 2.0 * true
    assert problem.fit(problem.better(poor, [true])) >= problem.fit(true) > problem.fit(poor)


def test_a_pole_that_grows_within_the_record_counts_as_its_mirror_image() -> None:
    problem, true = record("one pole", 0.0)
    limit = 1.0 / (problem.u.size * DT)
    np.testing.assert_allclose(problem.tamed(-true - 2.0 * limit), true)
    np.testing.assert_array_equal(problem.tamed(np.array([-0.5 * limit])), [-0.5 * limit])


def test_columns_are_read_from_a_commit_of_a_git_directory(tmp_path: Path) -> None:
    folder = tmp_path / "owner+name"
    folder.mkdir()
    (folder / "log.csv").write_text("t;u;y\n0;1;2.5\n1;3;4.5\n2;5;6.5\n")
    savemat(folder / "log.mat", {"data": {"u": [1.0, 3.0, 5.0]}, "both": [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]})

    def git(*words: str) -> str:
        command = ["git", "-c", "user.name=a", "-c", "user.email=a@b", *words]
        return subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout.strip()

    git("init", "-q")
    git("add", ".")
    git("commit", "-qm", "log")
    commit = git("rev-parse", "HEAD")
    text = Log("log", "owner/name", commit, "log.csv", "", "", "1", "2", 1.0, 1, reference="0")
    found = read(tmp_path, text)
    assert found.r is not None
    assert [signal.tolist() for signal in (found.u, found.y, found.r)] == [[1, 3, 5], [2.5, 4.5, 6.5], [0, 1, 2]]
    found = read(
        tmp_path, replace(text, path="log.mat", input="data.u", output="both,1", reference="", rows=(1, None, 1))
    )
    assert found.r is None
    assert (found.u.tolist(), found.y.tolist()) == ([3, 5], [4, 6])


def test_a_missing_repository_is_named_with_the_command_that_clones_it(tmp_path: Path) -> None:
    log = LOGS[0]
    assert git_folder(tmp_path, log.repository) is None
    (line,) = how_to_clone(tmp_path, [log, log])
    assert line.startswith(f"git clone --bare https://github.com/{log.repository} ")
    subprocess.run(["git", "init", "-q", "--bare", line.split()[-1]], check=True)
    assert how_to_clone(tmp_path, [log]) == []


def test_totals_leave_out_logs_in_feedback_and_count_trusted_models_that_are_far_behind() -> None:
    log = replace(LOGS[0], loop="open")
    far = Row(log, 100, 90.0, (84.0, 89.5), ("trusted", "inconsistent"))
    away = replace(far, fits=(90.0, 89.5), away=(True, False), verdicts=("inconsistent", "inconsistent"))
    fit, run = totals([far, away, replace(far, log=replace(log, loop="closed"))])
    assert "on 0 of 2" in fit
    assert fit.count(log.name) == 1
    assert "on 2 of 2" in run
    assert log.name not in run


def test_every_log_has_a_name_of_its_own_and_a_whole_commit() -> None:
    assert len({log.name for log in LOGS}) == len(LOGS)
    assert all(len(log.commit) == 40 and set(log.commit) <= set("0123456789abcdef") for log in LOGS)
    assert all(log.loop == "closed" for log in LOGS if log.reference)
