"""What to do next follows from the reason, for every reason that there is, and the command runs."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.cli import advice, results
from replant.online.runs.result import Result
from replant.verdict.verdict import STATUSES, Assessment
from support.builders import binary
from support.cases import every
from support.command import call
from support.places import ROOT

ROWS = [
    line.split("|")[1].strip()
    for line in (ROOT / "docs" / "verdict.md").read_text("utf-8").splitlines()
    if line.startswith("| ") and not line.startswith("| reason")
]


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log of 12 s plant with a dead time of 3 s, a set-point and a pump."""
    u, pump = binary(3, 600, 25), binary(4, 600, 40)
    y = rp.TransferFunction([2 / 12], [1.0, 1 / 12], delay=3.0).simulate(u, 1.0)
    y += 0.05 * np.random.default_rng(0).standard_normal(600)
    path = tmp_path / "log.csv"
    rows = [f"{k},{u[k]:g},{u[k] + 0.1 * pump[k]:g},{pump[k]:g},{y[k]:.5f}" for k in range(600)]
    path.write_text("t_s,u,r,pump,y\n" + "\n".join(rows) + "\n")
    return path


def said(row: str) -> str:
    """A row of the page of reasons as a verdict would say it."""
    reason = row.replace("x %", "5 %").replace("x s", "5 s")
    return f"column pump {reason}" if reason.startswith("explains") else reason


Watched = list[tuple[str, advice.NextStep]]


@pytest.fixture
def walked(monkeypatch: pytest.MonkeyPatch) -> Watched:
    """For each reason the step that follows from it, of every command that is run."""
    found: Watched = []

    def walk(result: Result, log: rp.Log, path: str, *, is_searched: bool) -> advice.NextStep:
        original: Callable[..., Any] = advice.next_step
        for row in ROWS:
            verdict = Assessment("inconsistent", (said(row),))
            found.append((row, original(replace(result, verdict=verdict), log, path, is_searched=is_searched)))
        return original(result, log, path, is_searched=is_searched)

    monkeypatch.setattr(results, "next_step", walk)
    return found


@pytest.mark.parametrize(
    "typed",
    [
        pytest.param(("fit", "-i", "u", "-o", "y", "-p", 2, "--reference", "r"), marks=pytest.mark.slow),
        pytest.param(("run", "-i", "u", "-o", "y", "-p", 1, "--optimizer", "amsgrad"), marks=pytest.mark.slow),
        pytest.param(("fit", "-i", "u", "-o", "y", "-p", "1:2"), marks=pytest.mark.slow),
    ],
)
def test_every_reason_has_a_next_command_that_runs(
    capsys, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, walked: Watched, typed: tuple[Any, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert call(capsys, typed[0], log, *typed[1:])[0] == 0
    assert len(walked) == len(ROWS)
    commands = {step.command for _, step in walked}
    assert len(commands) > 5
    assert all(step.words for _, step in walked)
    monkeypatch.setattr(results, "next_step", advice.next_step)
    for command in sorted(commands):
        _, *words = shlex.split(command.replace(advice.OTHER_LOG, str(log)))
        code, _, err = call(capsys, *words, *([] if "look" in words else ["--quiet"]))
        assert code == 0, (command, err)


@every("row", ROWS)
def test_every_reason_is_known_to_the_table(row: str) -> None:
    import re

    assert any(re.search(phrase, said(row)) for phrase, _ in advice.STEPS), row


def of_log(capsys, log: Path, *typed: object) -> list[str]:
    code, out, _ = call(capsys, *typed[:1], log, "-i", "u", "-o", "y", *typed[1:])
    assert code == 0
    return out.splitlines()


def test_the_range_of_dead_times_comes_from_the_data(capsys, log: Path) -> None:
    """Of a plant of 12 s with a dead time of 3 s, it reaches beyond that and not to a hundred."""
    lines = of_log(capsys, log, "fit", "-p", 1)
    first, last, step = map(float, shlex.split(lines[-1])[-1].split(":"))
    assert (first, 3.0 < last < 30.0, 0.5 <= step <= 5.0) == (0.0, True, True)
    code, out, _ = call(capsys, *shlex.split(lines[-1])[1:])
    assert code == 0
    assert "Verdict  trusted: keep the model" in out


def test_the_verdict_leads_with_what_to_do(capsys, log: Path) -> None:
    lines = of_log(capsys, log, "fit", "-p", 1)
    (verdict,) = [line for line in lines if line.startswith("Verdict")]
    assert verdict == "Verdict  inconsistent: search the structure and the dead time"
    assert "Next: search the structure and the dead time:" in lines


def test_what_to_do_fits_into_a_narrow_terminal(capsys, log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "48")
    lines = of_log(capsys, log, "fit", "-p", 1)
    first = next(number for number, line in enumerate(lines) if line.startswith("Verdict"))
    assert lines[first : first + 2] == ["Verdict  inconsistent: search the structure and", " " * 9 + "the dead time"]
    assert lines[-2] == "Next: search the structure and the dead time:"
    assert max(map(len, lines[first:-1])) <= 48


def test_a_log_with_fewer_samples_than_a_model_needs_is_refused_by_run_as_by_fit(capsys, tmp_path: Path) -> None:
    log = tmp_path / "two.csv"
    log.write_text("t,u,y\n0,1,2\n0.1,0,2.1\n")
    said = [call(capsys, command, log, "-i", "u", "-o", "y", "-p", 1) for command in ("run", "fit")]
    assert said[0] == said[1]
    assert (said[0][0], said[0][1]) == (2, "")
    assert "2 usable samples, fewer than the 3 that 2 parameters need" in said[0][2]


@pytest.mark.slow
def test_where_dead_times_alone_were_searched_for_the_number_of_poles_is_next(capsys, tmp_path: Path) -> None:
    u = np.where(np.arange(600) < 200, 0.0, 1.0)
    y = rp.TransferFunction([3.0], [1.0, 1.5, 1.0], 0.75).simulate(u, 0.1)
    y += 0.025 * np.random.default_rng(1).standard_normal(600)
    log = tmp_path / "step.csv"
    log.write_text("t_s,u,y\n" + "".join(f"{0.1 * k:.1f},{u[k]:g},{y[k]:.5f}\n" for k in range(600)))
    lines = of_log(capsys, log, "fit", "-p", 1, "--delay", "0:2:0.4")
    assert lines[-2] == "Next: search the number of poles, too:"
    code, out, _ = call(capsys, *shlex.split(lines[-1])[1:])
    assert code == 0
    assert "Verdict  trusted: keep the model" in out


def test_fit_has_used_all_samples_and_asks_for_more(capsys, tmp_path: Path) -> None:
    log = tmp_path / "short.csv"
    log.write_text("t_s,u,y\n" + "".join(f"{k},{k // 7 % 2},{k // 7 % 2 * 0.9 + k % 3 * 0.1:g}\n" for k in range(40)))
    lines = of_log(capsys, log, "fit", "-p", 1)
    assert "40 samples are too few for a verdict: it takes 100" in " ".join(lines)
    assert lines[-2] == "Next: record more, and fit both logs:"


def test_a_model_that_was_saved_is_checked_next(capsys, log: Path, tmp_path: Path) -> None:
    saved = tmp_path / "model.json"
    lines = of_log(capsys, log, "fit", "-p", 1, "--delay", 3, "--save", saved)
    assert lines[-1] == f"replant validate {saved} {advice.OTHER_LOG}"


def test_quiet_and_validated_commands_say_nothing_next(capsys, log: Path) -> None:
    for more in (("--quiet",), ("--validate", log)):
        lines = of_log(capsys, log, "fit", "-p", 1, "--delay", 3, *more)
        assert not any(line.startswith("Next") for line in lines)
        assert "Verdict  trusted" in lines


def test_of_a_step_test_the_rest_before_it_is_asked_for(capsys, tmp_path: Path) -> None:
    """The step is at the second sample: the gain is hardly told from the offset, unless the plant began at rest."""
    u = np.where(np.arange(150) < 1, 4.0, 8.0)
    y = rp.TransferFunction([1.5 / 15], [1.0, 1 / 15], 4.0).simulate(u - 4.0, 1.0)
    y += 30.0 + 0.05 * np.random.default_rng(5).standard_normal(150)
    log = tmp_path / "step.csv"
    log.write_text("t_s,u,y\n" + "".join(f"{k},{u[k]:g},{y[k]:.5f}\n" for k in range(150)))
    lines = of_log(capsys, log, "fit", "-p", 1, "--delay", 4)
    assert lines[-2] == "Next: if the plant began at rest, say so:"
    code, out, _ = call(capsys, *shlex.split(lines[-1])[1:])
    assert code == 0
    assert "Verdict  trusted: keep the model" in out


@every("command", ["fit", "run"], quick=1)
def test_of_a_lag_with_two_poles_one_is_tried_next(
    capsys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.chdir(tmp_path)  # the model may be saved
    u = binary(3, 1500, 8)
    y = rp.TransferFunction([2.0], [1.0, 1.0]).simulate(u, 0.05) + 1.0 * np.random.default_rng(5).standard_normal(1500)
    log = tmp_path / "lag.csv"
    log.write_text("t_s,u,y\n" + "".join(f"{0.05 * k:.2f},{u[k]:g},{y[k]:.5f}\n" for k in range(1500)))
    lines = of_log(capsys, log, command, "-p", 2, "--zeros", 1)
    assert lines[-2].endswith("try one pole:") or "or try one pole" in lines[-2]
    assert call(capsys, *shlex.split(lines[-1].replace(advice.OTHER_LOG, str(log)))[1:])[0] == 0


@pytest.mark.parametrize("command", ["look", "fit"])
def test_the_command_of_a_file_whose_name_begins_with_a_dash_runs(
    capsys, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    (tmp_path / "-3.csv").write_bytes(log.read_bytes())
    monkeypatch.chdir(tmp_path)
    words = ("-i", "u", "-o", "y", "-p", 1) if command == "fit" else ()
    code, out, err = call(capsys, command, *words, "--", "-3.csv")
    assert code == 0, err
    suggested = shlex.split(out.splitlines()[-1].replace(advice.OTHER_LOG, "./-3.csv"))
    assert suggested[:3] == ["replant", "fit", "./-3.csv"]
    assert call(capsys, *suggested[1:])[0] == 0


@pytest.mark.parametrize("status", [status for status in STATUSES if status != "trusted"])
def test_a_model_that_is_not_usable_is_never_to_be_kept(
    capsys, log: Path, monkeypatch: pytest.MonkeyPatch, status: str
) -> None:
    found = {}

    def walk(result: Result, log: rp.Log, path: str, *, is_searched: bool) -> advice.NextStep:
        for row in ROWS:
            verdict = Assessment(status, (said(row),))
            step = next_step(replace(result, verdict=verdict), log, path, is_searched=is_searched)
            found[row] = f"{step.words}: {step.command}"
        return next_step(result, log, path, is_searched=is_searched)

    next_step: Callable[..., Any] = advice.next_step
    monkeypatch.setattr(results, "next_step", walk)
    of_log(capsys, log, "fit", "-p", 1, "--delay", 3)
    assert len(found) == len(ROWS)
    assert not [row for row, step in found.items() if "keep the model" in step or "--save" in step]


@pytest.mark.parametrize(("has_column", "next_is"), [(True, "give the set-point"), (False, "search the structure")])
def test_in_a_loop_without_a_reference_the_structure_is_searched_where_no_column_may_be_one(
    capsys, log: Path, walked: Watched, has_column: bool, next_is: str
) -> None:
    if not has_column:
        kept = [
            ",".join((line.split(",")[0], line.split(",")[1], line.split(",")[4]))
            for line in log.read_text().splitlines()
        ]
        log.write_text("\n".join(kept) + "\n")
    of_log(capsys, log, "fit", "-p", 1, "--delay", 3)
    step = dict(walked)["the input answers the residual of the same sample"]
    assert step.words.startswith(next_is)


@pytest.mark.parametrize(
    ("names", "cells", "more"),
    [
        (("when",), lambda k: (f"2024-05-01T00:{k // 60:02d}:{k % 60:02d}",), ("--dt", 1)),
        (("stamp.sec", "stamp.nanosec"), lambda k: (f"{1_714_521_600 + k}", "500000000"), ("--dt", 1)),
        (("clock",), lambda k: (f"{k}",), ("--time", "clock")),
    ],
)
def test_a_time_is_no_set_point(
    capsys, log: Path, walked: Watched, names: tuple[str, ...], cells: Callable[[int], tuple[str, ...]], more: Any
) -> None:
    rows = [line.split(",") for line in log.read_text().splitlines()[1:]]
    lines = [",".join(("u", *names, "y")), *(",".join((r[1], *cells(k), r[4])) for k, r in enumerate(rows))]
    log.write_text("\n".join(lines) + "\n")
    of_log(capsys, log, "fit", "-p", 1, "--delay", 3, *more)
    step = dict(walked)["the input answers the residual of the same sample"]
    assert step.words.startswith("search the structure")
