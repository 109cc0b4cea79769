"""A clock that is not regular: jitter, missing samples, gaps, and stamps that cannot be."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.state import GAP
from replant.online.estimate import REASONS
from support.builders import AWKWARD, DT, identifier, irregular_record, record, state, true_parameters, two_modes
from support.cases import every

STRUCTURE, PLANT = rp.Structure(2, 1), rp.TransferFunction([1.0, 4.0], two_modes(2.0, 0.5))
TRUE = true_parameters(PLANT, 1)
NONE = dict.fromkeys(REASONS, 0)


def gaps(ident: rp.Identifier) -> int:
    return ident._state.gaps


# --- jitter


@every("name", ["order 1", "order 4", "non-minimum phase", "integrator", "feedthrough"], quick=2)
@every("hold", ["zoh", "foh"], quick=1)
def test_without_noise_jitter_costs_nothing(name: str, hold: str) -> None:
    structure, plant = AWKWARD[name]
    u, y, t = irregular_record(plant, 1, 2500, DT, jitter=0.4, input_hold=hold)
    ident = rp.Identifier(structure, DT, filter=rp.RefinedFilter(input_hold=hold))
    trace = ident.update_many(u, y, t)
    true = true_parameters(plant, structure.zeros)
    scale = np.where(true == 0.0, np.abs(true).max(), np.abs(true))
    assert (np.abs(ident.parameters - true) < (1e-4 if name == "integrator" else 1e-7) * scale).all()
    assert np.nanmax(np.abs(trace.errors[-500:])) < 1e-5 * np.abs(y).max()
    assert gaps(ident) == 0


def test_stamps_that_are_ignored_would_have_cost_much() -> None:
    """The counter-test: the same record, taken for regular."""
    u, y, _ = irregular_record(PLANT, 1, 4000, DT, jitter=0.4)
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u, y)
    assert np.abs(ident.parameters / TRUE - 1).max() > 1e-3


@every(("delay", "hold"), [(0.3, "zoh"), (1.0, "foh"), (2.38, "foh"), (7.5, "zoh")], quick=1)
def test_dead_time_on_a_clock_that_jitters(delay: float, hold: str) -> None:
    """Whole samples of dead time there are none then: every interval falls into pieces."""
    plant = rp.TransferFunction(PLANT.num, PLANT.den, delay * DT)
    u, y, t = irregular_record(plant, 2, 2000, DT, jitter=0.4, input_hold=hold)
    ident = rp.Identifier(rp.Structure(2, 1, delay=delay * DT), DT, filter=rp.RefinedFilter(input_hold=hold))
    ident.update_many(u, y, t)
    np.testing.assert_allclose(ident.parameters, TRUE, rtol=1e-5)


def test_a_fixed_filter_is_as_good_as_on_a_regular_clock() -> None:
    """What is left is the error of straight lines between samples of y, here and there."""
    errors = []
    for jitter in (0.0, 0.4):
        u, y, t = irregular_record(PLANT, 3, 6000, DT, jitter=jitter)
        ident = rp.Identifier(
            STRUCTURE, DT, filter=rp.StateVariableFilter(4.0), optimizer=rp.RecursiveLeastSquares(), instruments=False
        )
        ident.update_many(u, y, t)
        errors.append(np.abs(ident.parameters / TRUE - 1).max())
    assert errors[0] < 0.01
    assert errors[1] < 1.5 * errors[0] + 1e-3


@pytest.mark.parametrize("offset", [0.0, 1.7e9, -250.0])
def test_a_regular_clock_told_by_stamps_is_the_regular_clock(offset: float) -> None:
    """Also through the new solutions of the record; 2^-4 s is exact even in seconds since 1970."""
    dt = 0.0625
    u, y = record(PLANT, seed=1, samples=4000, dt=dt, noise=0.1)
    plain, stamped = rp.Identifier(STRUCTURE, dt), rp.Identifier(STRUCTURE, dt)
    expected = plain.update_many(u, y)
    trace = stamped.update_many(u, y, offset + dt * np.arange(4000))
    np.testing.assert_array_equal(trace.parameters, expected.parameters)
    np.testing.assert_array_equal(trace.errors, expected.errors)
    assert gaps(stamped) == 0
    assert stamped.rejected == NONE


def test_chunks_equal_the_whole_with_stamps_too() -> None:
    u, y, t = irregular_record(PLANT, 4, 1400, DT, jitter=0.3, dropped=0.1)
    whole, loop, chunked = (rp.Identifier(STRUCTURE, DT) for _ in range(3))
    expected = whole.update_many(u, y, t)
    errors = [loop.update(float(a), float(b), float(c)) for a, b, c in zip(u, y, t, strict=True)]
    np.testing.assert_array_equal(errors, expected.errors)
    edges = [0, 3, 499, 500, 501, 800, 1111, u.size]
    pieces = [chunked.update_many(u[a:b], y[a:b], t[a:b]) for a, b in itertools.pairwise(edges)]
    np.testing.assert_array_equal(np.vstack([piece.parameters for piece in pieces]), expected.parameters)
    assert state(whole) == state(loop) == state(chunked)


# --- missing samples


@pytest.mark.slow
def test_missing_samples_of_an_input_that_stood_cost_nothing() -> None:
    """Every value is held for eight samples, and none beside a change is missing."""
    u, y, t = irregular_record(PLANT, 5, 6000, DT, jitter=0.2, hold=8)
    phase = np.arange(u.size) % 8
    kept = ~np.isin(phase, [2, 3, 5]) | (np.random.default_rng(0).random(u.size) < 0.5)
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u[kept], y[kept], t[kept])
    assert kept.mean() < 0.85
    np.testing.assert_allclose(ident.parameters, TRUE, rtol=1e-7)
    assert gaps(ident) == 0


def test_with_any_sample_missing_the_estimate_stays_near() -> None:
    """A tenth at random: a change of the input may fall into a hole, and is then half known.

    The default holds within two percent, as is asked for under noise; taken for regular the record gives nonsense.
    """
    u, y, t = irregular_record(PLANT, 6, 2500, DT, jitter=0.2, dropped=0.1, hold=8)
    ident, ignoring = rp.Identifier(STRUCTURE, DT), rp.Identifier(STRUCTURE, DT)
    ident.update_many(u, y, t)
    ignoring.update_many(u, y)
    np.testing.assert_allclose(ident.parameters, TRUE, rtol=0.02)
    assert np.abs(ignoring.parameters / TRUE - 1).max() > 0.05


# --- gaps


def with_gap(seconds: float, before: int = 3000, after: int = 3000, noise: float = 0.0) -> tuple[np.ndarray, ...]:
    """A record that misses ``seconds`` in the middle, while the plant went on; and where."""
    missing = round(seconds / DT)
    u, y = record(PLANT, seed=7, samples=before + missing + after, dt=DT, hold=8, noise=noise)
    kept = np.ones(u.size, bool)
    kept[before : before + missing] = False
    return u[kept], y[kept], (DT * np.arange(u.size))[kept], before


@every("seconds", [1.2, 5.0, 500.0, 1e7 * DT])
@every("optimizer", [rp.KalmanTracking(1e-3)])
def test_over_a_gap_parameters_stay_and_learning_waits(seconds: float, optimizer: Any) -> None:
    """Until five of the slowest time constants have gone by since the gap's *end*, however long it was."""
    if seconds > 1000:
        u, y, t, cut = with_gap(5.0)
        t[cut:] += seconds
    else:
        u, y, t, cut = with_gap(seconds)
    ident = rp.Identifier(STRUCTURE, DT, optimizer=optimizer)
    ident.update_many(u[:cut], y[:cut], t[:cut])
    before, rested = ident.parameters, ident._state.rested
    trace = ident.update_many(u[cut:], y[cut:], t[cut:])
    assert gaps(ident) == 1
    waited = int((trace.parameters == before).all(axis=1).argmin())
    assert 5.0 / 1.0 <= waited * DT <= 2.5 * 5.0 / 1.0  # the poles decay by 1/s, known within a factor of two
    assert ident._state.rested - rested == waited
    # what is unknown has died out to e^-5, and the estimate never leaves the truth by more than that
    np.testing.assert_allclose(trace.parameters, np.tile(TRUE, (len(trace), 1)), rtol=0.02)
    np.testing.assert_allclose(ident.parameters, TRUE, rtol=1e-3)
    # filters began anew: the error dies out as the plant does
    assert np.abs(trace.errors[waited:]).max() < 0.02 * np.abs(y).max()


def test_just_below_the_limit_it_is_no_gap() -> None:
    u, y, t, _ = with_gap((GAP - 1.5) * DT)
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u, y, t)
    assert gaps(ident) == 0
    assert ident.samples == u.size


def test_many_gaps_do_not_blow_up() -> None:
    """Every 100 samples an hour goes by: learning never gets far, and nothing breaks."""
    u, y, t, _ = with_gap(5.0, before=1000, after=4000)
    t[1000:] += 3600.0 * (np.arange(4000) // 100)
    ident = rp.Identifier(STRUCTURE, DT, optimizer=rp.RecursiveLeastSquares(time_constant=5.0))
    trace = ident.update_many(u, y, t)
    assert gaps(ident) == 40
    np.testing.assert_allclose(trace.parameters[1000:], np.tile(TRUE, (4000, 1)), rtol=0.2)
    assert np.isfinite(ident._state.banks).all()


def test_a_gap_under_noise_costs_no_more_than_its_samples() -> None:
    u, y, t, _ = with_gap(50.0, noise=0.05)
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u, y, t)
    away = ident.parameters - TRUE
    assert away @ np.linalg.solve(ident.covariance, away) < 24.0  # chi-square of 4 degrees of freedom, 1 - 1e-4


@pytest.mark.parametrize("name", ["amsgrad", "gradient"])
def test_without_instruments_a_gap_waits_for_the_fixed_filter(name: str) -> None:
    u, y, t, cut = with_gap(30.0)
    ident = identifier(name, structure=STRUCTURE, dt=DT, filter=rp.StateVariableFilter(4.0))
    ident.update_many(u[:cut], y[:cut], t[:cut])
    before = ident.parameters
    trace = ident.update_many(u[cut:], y[cut:], t[cut:])
    waited = int((trace.parameters == before).all(axis=1).argmin())
    assert 5.0 / 4.0 <= waited * DT <= 2.5 * 5.0 / 4.0
    assert gaps(ident) == 1


# --- stamps that cannot be


BAD_STAMPS = [math.nan, math.inf, -math.inf]


@every("many", [False, True], ids=["update", "update_many"], quick=1)
@every("ready", [False, True], ids=["starting", "running"])
def test_a_bad_stamp_is_rejected_counted_and_leaves_no_trace(many: bool, ready: bool) -> None:
    u, y, t = irregular_record(PLANT, 8, 900, DT)
    spoiled, clean = rp.Identifier(STRUCTURE, DT), rp.Identifier(STRUCTURE, DT)
    count = 560 if ready else 100
    for ident in (spoiled, clean):
        ident.update_many(u[:count], y[:count], t[:count])
    assert (spoiled.status == "running") == ready
    before = state(spoiled) if ready else None
    expected = dict(NONE)
    for stamp in [*BAD_STAMPS, t[count - 1], t[count - 2], t[0], -1e9]:
        error = spoiled.update_many([1.0], [1.0], [stamp]).errors[0] if many else spoiled.update(1.0, 1.0, stamp)
        assert math.isnan(error)
        expected["not later" if math.isfinite(stamp) else "not finite"] += 1
        assert spoiled.rejected == expected
        assert spoiled.samples == count
    if ready:
        spoiled._state.earlier_time = clean._state.earlier_time  # of a clock that might be set
        assert {**state(spoiled), "ints": b""} == {**before, "ints": b""}
    for ident in (spoiled, clean):
        ident.update_many(u[count:], y[count:], t[count:])
    np.testing.assert_array_equal(spoiled.parameters, clean.parameters)
    np.testing.assert_array_equal(spoiled.covariance, clean.covariance)


def test_start_up_takes_a_chunk_as_it_takes_sample_by_sample() -> None:
    """With stamps and samples that are rejected before it begins and after."""
    u, y, t = irregular_record(PLANT, 1, 400, DT, jitter=0.2)
    for k, stamp in {3: t[1], 9: math.nan, 60: t[59], 61: t[20], 62: math.inf, 130: t[129], 300: t[7]}.items():
        t[k] = stamp
    u[[0, 40]], y[[7, 250]] = (math.nan, 1e200), (math.inf, math.nan)
    whole, parts, one_by_one = (rp.Identifier(STRUCTURE, DT, startup=100) for _ in range(3))
    trace = whole.update_many(u, y, t)
    edges = [0, 1, 5, 62, 63, 111, 113, 400]
    several = [parts.update_many(u[a:b], y[a:b], t[a:b]) for a, b in itertools.pairwise(edges)]
    errors = [one_by_one.update(*one) for one in zip(u, y, t, strict=True)]
    np.testing.assert_array_equal(trace.errors, errors)
    np.testing.assert_array_equal(trace.errors, np.concatenate([part.errors for part in several]))
    np.testing.assert_array_equal(trace.parameters, np.concatenate([part.parameters for part in several]))
    assert whole.rejected == {**NONE, "not finite": 4, "too large": 1, "not later": 5, "no output": 1}
    assert whole.status != "starting"
    assert state(whole) == state(parts) == state(one_by_one)


@every(
    ("u", "y", "t"),
    [
        *((1.0, 1.0, t) for t in ("a", None.__class__, [1.0], 1j)),
        *(([1.0, 2.0], [1.0, 2.0], t)
          for t in ([0.0], [0.0, 1.0, 2.0], [[0.0], [1.0]], ["a", "b"], [None, None])),
    ],
    ids=repr,
)  # fmt: skip
def test_stamps_that_are_no_numbers_or_of_another_shape_are_refused(u: Any, y: Any, t: Any) -> None:
    ident = identifier()
    ident.update(1.0, 0.5, 0.0)
    before = state(ident)
    with pytest.raises((rp.ArgumentTypeError, rp.InvalidArgumentError), match=r"^t must"):
        (ident.update_many if isinstance(u, list) else ident.update)(u, y, t)
    assert state(ident) == before


def test_the_articles_filter_knows_a_regular_clock_only() -> None:
    ident = identifier(filter=rp.StateVariableFilter(5.0, method="gbt"))
    for call in (lambda: ident.update(1.0, 1.0, 0.0), lambda: ident.update_many([1.0], [1.0], [0.0])):
        with pytest.raises(rp.InvalidArgumentError, match="gbt filter knows a regular clock only"):
            call()
    ident.update(1.0, 1.0)


def test_the_articles_filter_takes_no_feedthrough() -> None:
    with pytest.raises(rp.InvalidArgumentError, match="strictly causal"):
        rp.Identifier(rp.Structure(1, 1, feedthrough=True), DT, filter=rp.StateVariableFilter(5.0, method="gbt"))
