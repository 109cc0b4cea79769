"""``--reference`` of run, fit and compare: the column reaches the identifier, and what is wrong is said in one line."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.cli import main, run_fit_compare_options
from replant.cli import run_and_fit as fit_command
from replant.cli import run_and_fit as run_command
from replant.logs import open_recording
from replant.online.runs import run as online_run
from replant.online.runs import run_log
from support.cases import every

pytestmark = pytest.mark.usefixtures("unrendered")

DT, SAMPLES = 0.05, 2000
PLANT = rp.TransferFunction([2.0], [1.0, 0.5])
NAMED = ("--input", "u", "--output", "y", "--poles", "1")


@pytest.fixture
def signals() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice([-1.0, 1.0], SAMPLES // 10), 10)
    return u, PLANT.simulate(u, DT) + 3.0 + 0.01 * rng.standard_normal(SAMPLES), rng.standard_normal(SAMPLES)


@pytest.fixture
def log(tmp_path: Path, signals: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Path:
    path = tmp_path / "log.csv"
    rows = zip((DT * np.arange(SAMPLES)).round(6).tolist(), *(signal.tolist() for signal in signals), strict=True)
    path.write_text("t,u,y,w [rad/s]\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows))
    return path


@pytest.fixture
def given(monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray | None]:
    """What the identifiers were given as a reference."""
    kept: list[np.ndarray | None] = []

    class Watched(rp.Identifier):
        def update_many(self, u: Any, y: Any, t: Any = None, r: Any = None) -> rp.Trace:
            kept.append(r)
            return super().update_many(u, y, t, r)

    monkeypatch.setattr(online_run, "Identifier", Watched)
    return kept


def whole(parts: list[np.ndarray | None]) -> np.ndarray:
    return np.concatenate([part for part in parts if part is not None])


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    with pytest.raises(SystemExit):
        main([*map(str, arguments)])
    said = capsys.readouterr().err.strip()
    assert "Traceback" not in said
    assert said.count("\n") == 0
    return said


@every("held", [True, False], quick=1)
@every("column", ["w [rad/s]", "3"])
def test_run(
    log: Path, signals: tuple[np.ndarray, ...], given: list[np.ndarray | None], column: str, held: bool,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    given.clear()  # of the case before
    if not held:
        monkeypatch.setattr(run_fit_compare_options, "open_recording", partial(open_recording, most_held=500))
        monkeypatch.setattr(online_run, "FITTED", 700)
        monkeypatch.setattr(run_command, "FITTED", 700)
    main(["run", str(log), *NAMED, "--reference", column, "--json"])
    np.testing.assert_array_equal(whole(given), signals[2])
    assert json.loads(capsys.readouterr().out)["samples"] == SAMPLES


def test_run_without(log: Path, given: list[np.ndarray | None], capsys: pytest.CaptureFixture[str]) -> None:
    main(["run", str(log), *NAMED, "--json"])
    assert given
    assert all(part is None for part in given)
    capsys.readouterr()


def test_the_report_repeats_it(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["run", str(log), *NAMED, "--reference", "w [rad/s]", "--out", str(tmp_path / "out")])
    page = (tmp_path / "out" / "report.html").read_text()
    assert "reference=&#x27;w [rad/s]&#x27;" in page or "reference='w [rad/s]'" in page
    assert "r=log.reference" in page
    capsys.readouterr()


def test_a_missing_cell_is_a_sample_without_one(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = log.read_text().splitlines()
    lines[1500] = lines[1500].rpartition(",")[0] + ","
    log.write_text("\n".join(lines) + "\n")
    main(["run", str(log), *NAMED, "--reference", "3", "--json"])
    assert json.loads(capsys.readouterr().out)["rejected"]["no reference"] == 1


@pytest.mark.parametrize("command", ["run", "fit", "compare"])
def test_what_is_wrong_with_the_column_is_said(log: Path, capsys: pytest.CaptureFixture[str], command: str) -> None:
    assert "no column 'r'; there are: " in refused(capsys, command, log, *NAMED, "--reference", "r")
    assert "input and reference are the same column" in refused(capsys, command, log, *NAMED, "--reference", "u")
    lines = log.read_text().splitlines()
    lines[7] = lines[7].rpartition(",")[0] + ",red"
    log.write_text("\n".join(lines) + "\n")
    said = refused(capsys, command, log, *NAMED, "--reference", "3")
    assert f"{log}: line 8, column 'w [rad/s]'" in said


def test_an_optimizer_that_cannot_use_it_says_so(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = refused(capsys, "run", log, *NAMED, "--reference", "3", "--optimizer", "adam")
    assert "only the refined filter with recursive least squares uses a reference" in said


@pytest.mark.slow
def test_compare_gives_it_to_the_methods_that_use_one(
    log: Path, signals: tuple[np.ndarray, ...], given: list[np.ndarray | None], monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    fits: list[tuple[str, Any]] = []

    def fitted(*arguments: Any, method: str, reference: Any = None, **how: Any) -> rp.FitResult:
        fits.append((method, reference))
        return rp.fit(*arguments, method=method, **how)

    monkeypatch.setattr(run_log, "fit", fitted)
    methods = ("default", "recursive-least-squares", "gradient", "srivc", "least_squares")
    chosen = [word for method in methods for word in ("--optimizer", method)]
    main(["compare", str(log), *NAMED, "--reference", "3", *chosen, "--json"])
    capsys.readouterr()
    parts = [part for part in given if part is not None]
    trial, run = run_log.TRIAL, SAMPLES  # each of the two takes both
    np.testing.assert_array_equal(
        np.concatenate(parts), np.tile(np.concatenate([signals[2][:trial], signals[2][:run]]), 2)
    )
    assert {method for method, reference in fits if reference is not None} == {"srivc"}
    assert any(part is None for part in given)


@pytest.mark.parametrize("poles", ["1", "1:2"])
def test_fit_hands_it_on(
    log: Path, signals: tuple[np.ndarray, ...], poles: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    seen: list[np.ndarray] = []
    for name, real in (("fit", fit_command.fit), ("search", fit_command.search)):

        def wrapped(given: rp.Log, *, real: Any = real, **how: Any) -> Any:
            assert given.reference is not None
            seen.append(given.reference)
            return real(given, **how)

        monkeypatch.setattr(fit_command, name, wrapped)
    main(["fit", str(log), "--input", "u", "--output", "y", "--poles", poles, "--reference", "3", "--json"])
    np.testing.assert_array_equal(seen[0], signals[2])
    capsys.readouterr()
