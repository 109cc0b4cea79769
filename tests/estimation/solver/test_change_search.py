"""A change within a record that one model explains is found, at its level and with its power."""

from __future__ import annotations

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.solver.change_contest import Supposition
from replant.estimation.solver.change_search import PlantChange, begin_of_change, change_at, change_within, surest_begin
from replant.estimation.solver.refined_estimate import without_nuisances
from replant.estimation.solver.solve import Solution, solve
from replant.estimation.solver.srivc_steps import Problem
from support.builders import binary
from support.cases import every

DT, SAMPLES = 0.1, 2000


def solved(seed: int, gain: float, load: float = 0.0) -> Solution:
    """Return the solution of a record in which the gain of 2 is another one in the second half, and a load comes."""
    u, after = binary(seed, SAMPLES, 10), np.arange(SAMPLES) >= SAMPLES // 2
    y = rp.TransferFunction([2.0], [1.0, 1.0]).simulate(u, DT) * np.where(after, gain / 2.0, 1.0) + load * after
    y += 0.25 * y.std() * np.random.default_rng([seed, 1]).standard_normal(SAMPLES)
    found = solve(rp.Structure(1), Record(u, y, np.array([DT])))
    assert found is not None
    return found


def begin_in(solution: Solution) -> int:
    return begin_of_change(rp.Structure(1), solution.record, solution.found.theta)


@pytest.mark.slow
@every("load", [0.0, 2.0], quick=1)
def test_one_plant_is_not_taken_for_two(load: float) -> None:
    """Each record has the chance 1e-4: of 40 none in 99.6 % of all cases."""
    assert not any(begin_in(solved(seed, 2.0, load)) for seed in range(40))


@every("begin", [777, 1000, 1234], quick=1)
def test_a_change_is_dated_to_the_sample(begin: int) -> None:
    """Each sample tells of it, and hardly any noise is beside: the largest statistic is that of the sample itself."""
    rng = np.random.default_rng(begin)
    slopes, is_since = rng.choice([-1.0, 1.0], (SAMPLES, 1)), np.arange(SAMPLES) >= begin
    error = slopes[:, 0] * (is_since - np.mean(is_since)) + 1e-3 * rng.standard_normal(SAMPLES)
    assert surest_begin(np.column_stack([slopes, error]), 1, 20, SAMPLES)[0] == begin


@pytest.mark.slow
@every("seed", range(5))
def test_a_gain_a_fifth_up_is_found_where_it_changed(seed: int) -> None:
    """Under noise of a quarter: (.1 / .27)^2 of the noise's power, over 2000 samples, is 137 in chi-squared."""
    solution = solved(seed, 2.4)
    begin = begin_in(solution)
    assert abs(begin - SAMPLES // 2) < SAMPLES // 10
    structure, theta = rp.Structure(1), solution.found.theta
    assert change_within(structure, solution.record, theta[: structure.size]) == PlantChange(SAMPLES - begin)
    found = change_at(structure, solution.record, theta, begin)
    assert found is not None
    claim = found.claim
    assert claim.supposition is Supposition.PART
    refined = claim.contest.estimate(claim)
    assert refined is not None
    assert abs(refined.theta[1] - 2.4) < 4.0 * refined.covariance[1, 1] ** 0.5


def test_a_short_record_is_not_searched() -> None:
    solution = solved(0, 2.4)
    assert begin_of_change(rp.Structure(1), solution.record.last(100), solution.found.theta) == 0


@every("seed", range(6), quick=2)
def test_that_the_plant_has_changed_is_sure_where_it_is_not_which_coefficients(seed: int) -> None:
    """Gain and pole are others in the last 60 s, and a gain of its own explains them nearly as well."""
    rng, after = np.random.default_rng(seed), np.arange(1500) >= 908
    u = np.sum([np.sin(w * DT * np.arange(1500) + rng.uniform(0, 6)) for w in (0.2, 0.5, 1.0, 2.0, 3.0)], axis=0)
    parts = (rp.TransferFunction(num, den).simulate(u * rows, DT)
             for num, den, rows in (([2.0], [1.0, 0.5], ~after), ([1.0], [1.0, 2.0], after)))  # fmt: skip
    y = np.sum(list(parts), axis=0)
    fitted = rp.fit(u, y + 0.3 * y.std() * rng.standard_normal(1500), DT, poles=1)
    assert fitted.verdict.status == "inconsistent"
    assert any("the plant seems to have changed" in reason for reason in fitted.verdict.reasons)


@every("delay", [0.0, 0.25], quick=2)
@every("missing", [False, True], quick=2)
def test_slopes_and_residual_by_the_input_alone_are_those_of_a_whole_pass(delay: float, missing: bool) -> None:
    rng = np.random.default_rng(4)
    u, structure = binary(4, 400), rp.Structure(2, zeros=1, delay=delay)
    y = rp.TransferFunction([2.0, 6.0], [1.0, 2.0, 5.0], delay=delay).simulate(u, 0.1) + 0.1 * rng.standard_normal(400)
    measured = rng.random(400) > 0.1 if missing else None
    record = Record(u, np.where(measured, y, 0.0) if missing else y, np.array([0.1]), measured=measured)
    problem = Problem(structure, record)
    model = without_nuisances(structure, np.array([2.1, 5.2, 1.9, 6.1]))
    signals = np.full((400, model.size + 1), np.nan)
    beside = problem.scores(model, signals)
    done = problem.run_whole(model, filled=False)
    output = rp.TransferFunction([1.9, 6.1], [1.0, 2.1, 5.2], delay=delay).simulate(u, 0.1)
    counts = record.is_measured & (np.arange(400) >= record.unknown(delay))
    assert beside == 1.0
    np.testing.assert_allclose(signals[:, :-1], done.zeta, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(signals[:, -1], np.where(counts, y - output, 0.0), rtol=1e-9, atol=1e-12)
