"""A fit on an irregular clock: as good as on a regular one, whatever the clock does."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

import replant as rp
from replant.estimation.engine.record import MOST_GAPS, Record, gaps_of
from replant.fitting.fit_result import FitResult
from replant.fitting.structure_search import search
from replant.model.state_space import Response
from support.builders import DT, binary, irregular_record, record, true_parameters, two_modes
from support.cases import every

STRUCTURE, PLANT = rp.Structure(2, 1), rp.TransferFunction([1.0, 4.0], two_modes(2.0, 0.5))
TRUE = true_parameters(PLANT, 1)
NOISE = 0.05
CERTAIN = 24.0  # chi-square of 4 degrees of freedom, 1 - 1e-4


def noise(seed: int, samples: int) -> np.ndarray:
    return NOISE * np.random.default_rng([seed, 9]).standard_normal(samples)


def jittering(seed: int) -> tuple[np.ndarray, ...]:
    u, y, t = irregular_record(PLANT, seed, 4000, DT, jitter=0.4)
    return u, y + noise(seed, y.size), t


def with_gaps(seed: int, lost: int = 50, every: int = 600, samples: int = 4400) -> tuple[np.ndarray, ...]:
    u, y = record(PLANT, seed, samples, DT, noise=NOISE)
    kept = np.arange(samples) % every >= lost
    return u[kept], y[kept], DT * np.arange(samples)[kept]


def of_two_rates(seed: int) -> tuple[np.ndarray, ...]:
    t = np.cumsum(np.concatenate([np.full(2400, DT), np.full(1600, 5 * DT)]))
    u = binary(seed, t.size, 5)
    y = Response(PLANT, 5 * DT).take(u, np.diff(t, prepend=0.0)).output  # of this dt no interval has lost samples
    return u, y + noise(seed, y.size), t


def short_gaps(seed: int) -> tuple[np.ndarray, ...]:
    return with_gaps(seed, lost=4, every=100, samples=4168)


@cache
def on_a_regular_clock(seed: int, samples: int) -> FitResult:
    return rp.fit(*record(PLANT, seed, samples, DT, noise=NOISE), DT, STRUCTURE)


CLOCKS = every("make", [jittering, with_gaps, short_gaps, of_two_rates])


@pytest.mark.slow
@CLOCKS
@every("seed", [1, 2], quick=1)
def test_the_fit_is_as_good_as_its_standard_deviations_say_and_as_on_a_regular_clock(make, seed: int) -> None:
    u, y, t = make(seed)
    fitted = rp.fit(u, y, DT, STRUCTURE, t=t)
    away = fitted.parameters - TRUE
    assert fitted.covariance is not None
    assert away @ np.linalg.solve(fitted.covariance, away) < CERTAIN
    regular = on_a_regular_clock(seed, u.size)
    assert regular.uncertainty is not None
    assert fitted.uncertainty is not None
    assert (fitted.uncertainty.std < 3.0 * regular.uncertainty.std).all()
    least = 100.0 * (1.0 - NOISE / np.std(y))  # what the noise leaves
    assert fitted.simulation.fit == pytest.approx(least, abs=1.5)
    assert fitted.one_step == pytest.approx(least, abs=1.5)


@pytest.mark.slow
@CLOCKS
def test_taken_for_regular_the_record_would_give_less(make) -> None:
    u, y, t = make(1)
    stamped, plain = rp.fit(u, y, DT, STRUCTURE, t=t), rp.fit(u, y, DT, STRUCTURE)
    errors = [np.abs(each.parameters / TRUE - 1.0).max() for each in (stamped, plain)]
    assert errors[0] < 0.03
    assert stamped.simulation.fit > plain.simulation.fit + 0.3


def test_without_noise_gaps_cost_nothing() -> None:
    u, y = record(PLANT, 3, 4000, DT)
    kept = np.arange(4000) % 500 >= 60
    fitted = rp.fit(u[kept], y[kept], DT, STRUCTURE, t=DT * np.arange(4000)[kept])
    np.testing.assert_allclose(fitted.parameters, TRUE, rtol=1e-6)
    assert fitted.simulation.fit > 99.9999


@pytest.mark.slow
@every("identified", [rp.fit, rp.run], quick=1)
def test_rows_without_an_input_are_as_rows_that_are_missing(identified) -> None:
    u, y = record(PLANT, 3, 4000, DT, noise=NOISE)
    lost = np.arange(4000) % 500 >= 440
    empty = identified(np.where(lost, np.nan, u), y, DT, STRUCTURE)
    missing = identified(u[~lost], y[~lost], DT, STRUCTURE, t=DT * np.arange(4000)[~lost])
    np.testing.assert_allclose(empty.parameters, missing.parameters, rtol=1e-9)
    assert empty.model.verdict.status == missing.model.verdict.status == "trusted"
    assert empty.simulation.fit == pytest.approx(missing.simulation.fit, abs=0.1)
    assert empty.simulation.fit == pytest.approx(100.0 * (1.0 - NOISE / np.std(y)), abs=1.5)


@every("seed", [22, 25, 26], quick=1)
@every("kind", ["rows", "inputs"])
def test_a_few_samples_between_two_gaps_are_no_stretch_to_search(seed: int, kind: str) -> None:
    rng, samples = np.random.default_rng(seed), 1500
    u, plant = rng.normal(0.0, 1.0, samples), rp.TransferFunction([2.0], [1.0, 0.5])
    y = plant.simulate(u, 0.1) + rng.normal(0.0, 0.1, samples)
    kept = np.ones(samples, bool)
    for begin in rng.integers(20, samples - 20, 25):
        between = rng.integers(1, 4)
        kept[begin : begin + 4] = kept[begin + 4 + between : begin + 9 + between] = False
    t = 0.1 * np.arange(samples)
    if kind == "rows":
        found = rp.fit(u[kept], y[kept], 0.1, poles=1, t=t[kept])
    else:
        found = rp.fit(np.where(kept, u, np.nan), y, 0.1, poles=1)
    away = found.parameters - [0.5, 2.0]
    assert found.covariance is not None
    assert away @ np.linalg.solve(found.covariance, away) < 18.4  # chi-square of 2, 1 - 1e-4


def test_gaps_and_a_dead_time() -> None:
    plant = rp.TransferFunction(PLANT.num, PLANT.den, 7.5 * DT)
    u, y = record(plant, 3, 4000, DT)
    kept = np.arange(4000) % 500 >= 60
    structure = rp.Structure(2, 1, delay=7.5 * DT)
    fitted = rp.fit(u[kept], y[kept], DT, structure, t=DT * np.arange(4000)[kept])
    np.testing.assert_allclose(fitted.parameters, TRUE, rtol=1e-5)
    assert fitted.simulation.fit > 99.99


@pytest.mark.slow
def test_the_search_uses_the_stamps_also_where_it_scores() -> None:
    u, y, t = with_gaps(4, samples=4000)
    found = search(u, y, DT, poles=(1, 2), zeros=(0, 1), t=t)
    assert (found.best.structure.poles, found.best.structure.zeros) == (2, 1)
    assert found.chosen.fit == pytest.approx(100.0 * (1.0 - NOISE / np.std(y)), abs=1.5)


@pytest.mark.slow
@pytest.mark.parametrize("jitter", [0.0, 0.4])
def test_the_search_finds_a_dead_time_between_coarse_points_of_a_grid(jitter: float) -> None:
    """The zero can make up for a part of it: the likelihood has another top at 0.1 s."""
    plant = rp.TransferFunction(PLANT.num, PLANT.den, 0.3)
    u, y, t = irregular_record(plant, 5, 1500, DT, jitter=jitter)
    found = search(u, y + noise(5, y.size), DT, poles=(2,), zeros=(1,), delays=(0.0, 0.2, 0.4), t=t)
    assert found.best.structure.delay == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize(("poles", "first"), [(1, 2), (2, 5)])
def test_too_few_samples_before_a_gap_are_no_hindrance(poles: int, first: int) -> None:
    """They answer to inputs before the record, or do not tell the initial state of their own part."""
    plant = rp.TransferFunction([4.0], [1.0, 4.0] if poles == 1 else [1.0, 0.8, 4.0], delay=4 * DT)
    u = binary(3, 1000, 10)
    y = plant.simulate(u, DT) + 0.01 * np.random.default_rng(3).standard_normal(u.size)
    kept = (np.arange(u.size) < first) | (np.arange(u.size) >= first + 30)
    fitted = rp.fit(u[kept], y[kept], DT, poles=poles, delay=plant.delay, t=DT * np.arange(u.size)[kept])
    assert fitted.parameters == pytest.approx(true_parameters(plant, 0), rel=0.02)


def test_least_squares_says_what_to_do() -> None:
    u, y, t = jittering(1)
    with pytest.raises(
        rp.InvalidArgumentError, match=r"least_squares needs a regular clock: use the method srivc, .*--dt"
    ):
        rp.fit(u, y, DT, STRUCTURE, method="least_squares", t=t)


@pytest.mark.parametrize(("row", "stamp"), [(3, 0.1), (3, 0.05), (2, np.nan)])
def test_a_stamp_that_does_not_increase_is_named(row: int, stamp: float) -> None:
    t = 0.05 * np.arange(100)
    t[row] = stamp
    with pytest.raises(rp.InvalidArgumentError, match=rf"t must be finite and strictly increasing; t\[{row}\]"):
        rp.fit(np.ones(100), np.ones(100), DT, STRUCTURE, t=t)


def days(seed: int, changes: float, count: int = 2, samples: int = 1500, pole: float = 0.0) -> tuple[np.ndarray, ...]:
    """So many days of 2/(60 s + 1), sampled each 2 s; the zero of the output is another one every day."""
    rng, plant, parts = np.random.default_rng([seed, 47]), rp.TransferFunction([2.0 / 60.0], [1.0, 1.0 / 60.0]), []
    for day in range(count):
        u = rng.uniform(-1.0, 1.0, samples // 50).repeat(50)
        noise = lfilter([0.02], [1.0, -pole], rng.standard_normal(u.size))
        y = plant.simulate(u, 2.0) + noise + 20.0 + changes * day
        parts.append((u, y, 86400.0 * day + 2.0 * np.arange(u.size)))
    u, y, t = (np.concatenate(signals) for signals in zip(*parts, strict=True))
    return u, y, t


@pytest.mark.parametrize("changes", [5.0, 0.02])
@every("seed", range(4), quick=2)
def test_a_load_may_begin_in_a_gap(changes: float, seed: int) -> None:
    u, y, t = days(seed, changes)
    found = rp.fit(u, y, 2.0, poles=1, t=t)
    assert found.loads.tolist() == [1500]
    assert found.parameters == pytest.approx([1.0 / 60.0, 2.0 / 60.0], rel=0.02)
    assert found.verdict.status == "trusted"
    assert any(reason.startswith("another load acts since 86,400 s") for reason in found.verdict.reasons)


@pytest.mark.slow
@pytest.mark.parametrize("pole", [0.0, 0.98])
@every("seed", range(4), quick=2)
def test_a_gap_is_no_load_by_itself(pole: float, seed: int) -> None:
    u, y, t = days(seed, 0.0, pole=pole)
    found = rp.fit(u, y, 2.0, poles=1, t=t)
    assert not found.loads.size
    assert found.rival is None
    assert found.verdict.status == "trusted"


@pytest.mark.slow
@every("seed", range(3), quick=1)
def test_of_several_gaps_each_is_asked(seed: int) -> None:
    u, y, t = days(seed, 0.0, count=7, samples=300)
    changed = np.where(t >= 4 * 86400.0, y + 1.0, y)
    for output, loads in ((y, []), (changed, [1200])):
        found = rp.fit(u, output, 2.0, poles=1, t=t)
        assert found.loads.tolist() == loads
        # gaps are no slow clock, by which the pole would be too fast
        assert found.parameters == pytest.approx([1.0 / 60.0, 2.0 / 60.0], rel=0.02)
        assert found.verdict.status == "trusted"


def test_the_interval_of_a_record_is_that_of_its_stretches() -> None:
    steps = np.ones(40)
    steps[[10, 30]] = 1e4
    assert Record(steps, steps, steps, usual=1.0).dt == 1.0
    assert Record(steps, steps, steps).dt > 500.0  # on another clock nothing is a gap


def test_a_gap_is_longer_than_what_is_usual_beside_it() -> None:
    steps = np.ones(50)
    steps[[10, 20]] = 3.0, 4.0
    steps[30:40] = 9.0  # a slower rate
    assert gaps_of(steps, 1.0).tolist() == [20]
    steps[35] = 90.0
    assert gaps_of(steps, 1.0).tolist() == [20, 35]
    steps[44:46] = 5.0, 6.0  # one sample between two gaps
    assert gaps_of(steps, 1.0).tolist() == [20, 35, 44, 45]
    assert gaps_of(np.ones(1), 1.0).size == 0


def test_of_very_many_gaps_the_longest_count() -> None:
    steps = np.ones(4 * MOST_GAPS)
    steps[1::2] = 5.0
    steps[101::200] = 50.0
    found = gaps_of(steps, 1.0)
    assert found.size == MOST_GAPS
    assert set(range(101, steps.size, 200)) <= set(found.tolist())


def test_of_what_is_lost_only_a_few_rows_between_two_others_are_restored() -> None:
    """Not a gap, nor what a slower rate leaves out: either may be of any length."""
    intervals = np.ones(60)
    intervals[[10, 20, 30]] = 2.0, 3.2, 1e9
    intervals[40:50] = 1e6
    u = np.cumsum(intervals)
    restored, places = Record(u, np.zeros(60), intervals, usual=1.0).restored
    assert restored.u.size == 63
    assert np.flatnonzero(np.diff(places) > 1).tolist() == [9, 19]
    np.testing.assert_array_equal(restored.u[places], u)
    np.testing.assert_allclose(restored.u[10:12], [11.0, 12.0])
    assert restored.count == 60
