"""The report of a running identification: its samples, at the times at which they were taken."""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.live.make_view import EstimateHistory, make_view
from replant.live.terminal_status import report_of
from replant.live.view import SessionInfo, View
from replant.report import result_page as report

pytestmark = pytest.mark.usefixtures("unrendered")

PLANT, DT = rp.TransferFunction([6.0], [1.0, 3.0]), 0.1
IRREGULAR = "on an irregular clock, usually at"


def report_at(t: np.ndarray) -> tuple[str, View]:
    """Return the report on a plant whose input steps every second, sampled at the times ``t``, and the view."""
    fine = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 400), 100)
    held = np.searchsorted(0.01 * np.arange(fine.size), t, side="right") - 1
    u = fine[held]
    y = PLANT.simulate(fine, 0.01)[held] + 0.01 * np.random.default_rng(1).standard_normal(t.size)
    identifier = rp.Identifier(poles=1, dt=DT)
    identifier.update_many(u, y, t)
    info = SessionInfo(at=float(t[-1]), source="log.csv")
    view = make_view(identifier, info, EstimateHistory(2))
    return report_of(identifier, view).decode(), view


def fit_in(page: str) -> float:
    return float(re.search(r"<dd>([\d.]+).%</dd><dt>fit, simulated", page.replace("\u00a0", " "))[1])


@pytest.mark.slow
def test_samples_of_an_irregular_clock_are_simulated_and_drawn_at_their_times() -> None:
    every = np.arange(1, 3000)
    kept = every[np.random.default_rng(2).uniform(size=every.size) > 0.3]  # a third was lost
    page, view = report_at(DT * kept)
    assert view.simulated > 80.0  # where the input steps while a sample is lost, the step comes late
    assert fit_in(page) == pytest.approx(view.simulated, abs=0.1)
    assert IRREGULAR in page


def test_a_regular_clock_stays_regular() -> None:
    page, view = report_at(DT * np.arange(1, 1500))
    assert fit_in(page) == pytest.approx(view.simulated, abs=0.1)
    assert IRREGULAR not in page


@pytest.mark.parametrize("is_long", [False, True])
@pytest.mark.parametrize("clock", ["regular", "irregular"])
def test_rows_of_the_history_stand_at_the_samples_of_their_times(
    clock: str, is_long: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows before the kept samples are left out; the others are numbered from the first kept sample."""
    seen: list[Any] = []

    def write(path: Path, result: Any, log: Any, **_: Any) -> Path:
        seen.append((result, log))
        path.touch()
        return path

    monkeypatch.setattr(report, "write_report", write)
    t = 1000.0 + DT * np.arange(1, 46_000 if is_long else 3000)
    t = t if clock == "regular" else t[np.random.default_rng(3).uniform(size=t.size) > 0.3]
    u = np.random.default_rng(0).choice([-1.0, 1.0], t.size // 10 + 1).repeat(10)[: t.size]
    y = PLANT.simulate(u, DT) + 0.01 * np.random.default_rng(1).standard_normal(t.size)
    plain = {
        "filter": rp.StateVariableFilter(cutoff=3.0),
        "instruments": False,
        "startup": 200,
    }  # nothing is solved again
    identifier, history = rp.Identifier(poles=1, dt=DT, **plain), EstimateHistory(2)
    ends = [400, 1000, t.size - 1000, t.size]
    for begin, end in itertools.pairwise([0, *ends]):
        identifier.update_many(u[begin:end], y[begin:end], t[begin:end])
        view = make_view(identifier, SessionInfo(at=float(t[end - 1]), source="log.csv"), history)
    report_of(identifier, view)
    ((result, log),) = seen
    before = t.size - log.output.size
    assert (before > 0) == is_long
    np.testing.assert_array_equal(result.history.samples, [end - before for end in ends if end > before])
