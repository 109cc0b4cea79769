"""Conditioning keeps G(s): the original and the conditioned log give the same plant."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from replant.errors import InvalidArgumentError
from replant.logs import Log
from replant.logs.conditioning import detrend, from_rest, leave_out
from replant.logs.filtering import HALF_LENGTH, decimate, resample
from replant.signals import prbs, white_noise
from support.cases import every

G = rp.TransferFunction([4.0], [1.0, 0.8, 4.0])
TRUE = np.array([0.8, 4.0, 4.0])


def log_of(u: np.ndarray, y: np.ndarray, dt: float, t: np.ndarray | None = None, **more: object) -> rp.Log:
    return rp.Log(u, y, dt, t, "u", "y", Path("log.csv"), **more)  # type: ignore[arg-type]


def recorded(samples: int = 30_000, dt: float = 1e-3, hold: int = 50) -> rp.Log:
    u = prbs(samples, hold=hold, bits=10)
    return log_of(u, G.simulate(u, dt), dt)


@pytest.mark.parametrize("factor", [5, 25, 50])
def test_the_plant_of_a_decimated_log_is_that_of_the_log(factor: int) -> None:
    # the remaining error, of second order in the new sampling time: the filtered input is not piecewise linear
    thinned = decimate(recorded(), factor)
    found = rp.fit(thinned, poles=2)
    assert found.model.input_hold == "foh"
    assert np.abs(found.parameters / TRUE - 1).max() < 0.005
    held = rp.fit(thinned.input, thinned.output, thinned.dt, poles=2)
    assert np.abs(held.parameters / TRUE - 1).max() > np.abs(found.parameters / TRUE - 1).max()


def test_decimation_leaves_slow_signals_and_removes_those_it_would_alias() -> None:
    dt, factor, t = 1e-3, 10, np.arange(20_000) * 1e-3
    slow, fast = np.sin(2 * np.pi * 1.0 * t), np.sin(2 * np.pi * 61.0 * t)  # the new Nyquist frequency is 50 Hz
    thinned = decimate(log_of(slow + fast, slow, dt), factor)
    there = slice(HALF_LENGTH * factor, -HALF_LENGTH * factor, factor)
    half_a_sample_ago = np.sin(2 * np.pi * 1.0 * (t - dt / 2))  # where the held input is, on average
    assert np.abs(thinned.input - half_a_sample_ago[there]).max() < 2e-3
    assert np.abs(thinned.output - slow[there]).max() < 1e-3


def test_a_constant_stays_and_missing_samples_stay_missing() -> None:
    y = np.full(1000, 7.0)
    y[500] = np.nan
    thinned = decimate(log_of(np.ones(1000), y, 0.1), 4)
    np.testing.assert_allclose(thinned.input, 1.0)
    lost = np.isnan(thinned.output)
    assert lost[125 - HALF_LENGTH]
    assert lost.sum() == 2 * HALF_LENGTH + 1
    np.testing.assert_allclose(thinned.output[~lost], 7.0)


@pytest.mark.slow
def test_a_line_that_was_added_is_removed_and_the_mean_stays() -> None:
    log = recorded()
    drifting = log_of(log.input, log.output + np.linspace(-5.0, 5.0, len(log)), log.dt)
    straight, bent = rp.fit(detrend(log), poles=2), rp.fit(detrend(drifting), poles=2)
    np.testing.assert_allclose(bent.parameters, straight.parameters, rtol=1e-6)
    assert np.abs(bent.parameters / TRUE - 1).max() < 0.02
    assert detrend(drifting).output.mean() == pytest.approx(drifting.output.mean())


def test_detrending_looks_at_known_samples_alone() -> None:
    y = 3.0 + 0.5 * np.arange(100.0)
    y[10:20] = np.nan
    flat = detrend(log_of(np.ones(100), y, 1.0)).output
    assert np.isnan(flat[10:20]).all()
    np.testing.assert_allclose(flat[~np.isnan(y)], np.nanmean(y))


def test_resampling_keeps_the_integral_of_the_input_and_the_plant() -> None:
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.005, 0.015, 8000))
    u = prbs(8000, hold=40, bits=9)
    fine = np.arange(0.0, t[-1] + 0.001, 0.001)
    y_fine = G.simulate(u[np.clip(np.searchsorted(t, fine, "right") - 1, 0, None)], 0.001)
    late = log_of(u, np.interp(t, fine, y_fine), 0.01, t)
    again = resample(late, 0.01)
    assert again.stamps is None
    edges = again.time[[0, -1]] + np.array([0.0, 0.01])
    held = np.append(np.minimum(t[1:], edges[1]), edges[1]) - np.minimum(t, edges[1])
    assert again.input.sum() * 0.01 == pytest.approx(float(held @ u))
    found = rp.fit(again, poles=2, method="srivc")
    assert np.abs(found.parameters / TRUE - 1).max() < 0.02


def test_gaps_and_missing_samples_are_missing_after_resampling() -> None:
    t = np.concatenate([np.arange(50.0), 100 + np.arange(50.0)])
    u, y = np.ones(100), t.copy()
    y[20] = np.nan
    u[30] = np.nan
    again = resample(log_of(u, y, 1.0, t), 1.0)
    assert np.isnan(again.output[50:100]).all()
    assert np.isnan(again.input[50:100]).all()
    assert np.isnan(again.output[20])
    assert np.isnan(again.input[30])
    known = np.isfinite(again.output)
    np.testing.assert_allclose(again.output[known], again.time[known])
    assert known.sum() >= 96


def test_a_reference_goes_the_same_way() -> None:
    log = recorded(4000)
    with_r = log_of(log.input, log.output, log.dt, reference=log.input, reference_name="r")
    np.testing.assert_array_equal(decimate(with_r, 4).reference, decimate(with_r, 4).input)
    np.testing.assert_array_equal(detrend(with_r).reference, detrend(with_r).input)
    np.testing.assert_array_equal(resample(with_r, 1e-3).reference, resample(with_r, 1e-3).input)


def test_what_cannot_be_done_is_refused_in_a_sentence() -> None:
    late = log_of(np.zeros(5), np.zeros(5), 1.0, np.array([0.0, 1.0, 2.5, 3.0, 4.0]))
    with pytest.raises(rp.InvalidArgumentError, match="irregular"):
        decimate(late, 2)
    with pytest.raises(rp.InvalidArgumentError, match="needs more than 400"):
        decimate(log_of(np.zeros(400), np.zeros(400), 1.0), 20)
    with pytest.raises(rp.InvalidArgumentError, match="at least 2"):
        decimate(recorded(4000), 1)
    with pytest.raises(rp.InvalidArgumentError, match="more than twice"):
        resample(late, 3.0)
    with pytest.raises(rp.InvalidArgumentError, match="greater than 0"):
        resample(late, 0.0)


WORST = {
    "no sample": (np.empty(0), np.empty(0)),
    "one sample": (np.ones(1), np.ones(1)),
    "all missing": (np.ones(600), np.full(600, np.nan)),
    "not finite": (np.where(np.arange(600) == 5, np.inf, 1.0), np.where(np.arange(600) == 7, -np.inf, 1.0)),
    "too large": (np.full(600, 1e300), np.full(600, -1e308)),
}


@every("name", WORST)
@every(
    "change",
    [
        detrend,
        rp.from_rest,
        lambda log: decimate(log, 3),
        lambda log: resample(log, 0.1),
        lambda log: rp.bandpass(log, 1.0),
    ],
)
def test_the_worst_signals_are_missing_or_refused(name: str, change: Callable[[rp.Log], rp.Log]) -> None:
    try:
        changed = change(log_of(*WORST[name], 0.1))
    except rp.InvalidArgumentError:
        return
    for signal in (changed.input, changed.output):
        assert (np.isnan(signal) | (np.abs(signal) < 10.0)).all()


def test_resampling_makes_no_more_samples_than_there_is_to_know() -> None:
    log = log_of(np.ones(20), np.ones(20), 1.0)
    with pytest.raises(rp.InvalidArgumentError, match="less than half the usual interval"):
        resample(log, 1e-9)
    t = np.concatenate([np.arange(10.0), 3e7 + np.arange(10.0)])
    with pytest.raises(rp.InvalidArgumentError, match=r"a gap of 3e\+07 s follows sample 9"):
        resample(log_of(np.ones(20), np.ones(20), 1.0, t), 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_every_way_to_a_model_uses_the_hold_of_the_log(hold: str) -> None:
    u = np.convolve(white_noise(3000, 1.0), np.ones(20) / 20, "same")
    log = log_of(u, G.simulate(u, 0.05, input_hold=hold), 0.05, input_hold=hold)
    found = [rp.fit(log, poles=2), rp.run(log, poles=2), rp.search(log, poles=[2], zeros=[0]).best]
    found.append(rp.fit(log.input, log.output, 0.05, poles=2, filter=rp.RefinedFilter(hold)))
    for result in found:
        np.testing.assert_allclose(result.model.parameters[:3], TRUE, rtol=1e-4)
        assert result.model.input_hold == hold
    squares = rp.fit(log, poles=2, method="least_squares")
    assert squares.model.input_hold == hold
    np.testing.assert_allclose(squares.parameters, TRUE, rtol=1e-2)


@every("count", [1, 3, 7, 49, 99])
@every("start", [0.0, 1234.5, 1.7e9])
def test_stretches_that_follow_each_other_share_no_output_and_leave_none(count: int, start: float) -> None:
    log = Log(np.arange(100.0), np.arange(100.0), 0.1, start + 0.1 * np.arange(100))
    border = round(0.1 * count, 1)
    before, after = leave_out(log, [(border, None)]), leave_out(log, [(None, border)])
    assert before.output.tolist() == list(range(count))
    assert after.output[np.isfinite(after.output)].tolist() == list(range(count, 100))
    assert (before.withheld, after.withheld, after.input.size) == (0, count, 100)


def test_a_part_of_a_file_and_the_rest_before_it_do_not_move_a_stretch() -> None:
    u = np.repeat([0.0, 1.0, 0.0], 40)
    log = Log(u, u, 0.5, begin=10.0)
    for given in (log, from_rest(log)):
        missing = np.flatnonzero(np.isnan(leave_out(given, [(30.0, 35.0)]).output)) - given.rest
        assert missing[missing >= 0].tolist()[-10:] == list(range(40, 50))


@every(
    "stretch, mistake",
    [
        ((float("nan"), 2.0), "must be numbers, not NaN"),
        ((1.0, float("nan")), "must be numbers, not NaN"),
        ((3.0, 2.0), "3:2: a stretch must begin before it ends"),
        ((9.0, None), "no sample lies there"),
        *((none, "must be begins and ends in s") for none in ((1.0,), "ab", 5.0, np.array(5.0))),
    ],
)
def test_a_stretch_without_samples_is_refused_and_the_mistake_is_named(stretch: object, mistake: str) -> None:
    with pytest.raises(InvalidArgumentError, match=mistake):
        leave_out(Log(np.zeros(10), np.zeros(10), 0.5), [stretch])  # type: ignore[list-item]


@every("stretches", [np.array([[1, 1.5]]), [np.array([1, 1.5])], [[1, 1.5]], ((np.float32(1), 1.5),)])
def test_stretches_may_be_arrays(stretches) -> None:
    left = leave_out(Log(np.zeros(10), np.zeros(10), 0.5), stretches)
    assert np.flatnonzero(np.isnan(left.output)).tolist() == [2]
    kept = leave_out(Log(np.zeros(10), np.zeros(10), 0.5), use=stretches)
    assert np.flatnonzero(np.isfinite(kept.output)).tolist() == [2]


@pytest.mark.parametrize("stamped", [False, True])
@pytest.mark.parametrize(("begin", "rest"), [(None, 0), (7.0, 0), (None, 57), (7.0, 230)])
def test_stretches_count_from_the_first_row_of_the_file_after_decimation(
    stamped: bool, begin: float | None, rest: int
) -> None:
    """The output is the time in the file, which filter and decimation keep: the stretch has its outputs, no others."""
    dt = 0.1
    y = (begin or 0.0) + dt * np.arange(-rest, 1200)
    log = log_of(np.ones(y.size), y, dt, 500.0 + y if stamped else None, begin=begin, rest=rest)
    thinned = decimate(log, 5)
    cut = leave_out(thinned, [(30.0, 45.25)])
    was = thinned.output[: cut.output.size]
    np.testing.assert_array_equal(np.isnan(cut.output), (was > 30.0 - 1e-6) & (was < 45.25))
    assert cut.withheld == np.isnan(cut.output).sum() > 0
