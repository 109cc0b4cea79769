"""Refined instrumental variables: exact without noise, its own fixed point, and as sure as Cramer and Rao allow."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.solver import srivc
from replant.estimation.solver.refined_estimate import Refined
from replant.estimation.solver.srivc import refine
from replant.estimation.solver.srivc_steps import Problem
from replant.numerics.linear_algebra import compose
from replant.signals import prbs
from support.builders import AWKWARD, DT, binary, irregular_record, random_plant, true_parameters
from support.cases import every

every_plant = every("name", AWKWARD)


def made(name: str, samples: int = 2000, noise: float = 0.0, seed: int = 0, hold: str = "zoh") -> Record:
    """A record of a plant under a PRBS, white noise of a part ``noise`` of the output's spread.

    It begins at rest: what the input was before, a dead time ago, is in no record.
    """
    u = prbs(samples, bits=9, hold=6)
    u[:4] = 0.0
    y = AWKWARD[name][1].simulate(u, DT, input_hold=hold)
    return Record(u, y + noise * y.std() * np.random.default_rng(seed).standard_normal(samples), np.array([DT]), hold)


def relative(found: Refined, name: str) -> np.ndarray:
    """Errors of the coefficients, each relative to itself, or to the largest where it is zero."""
    structure, plant = AWKWARD[name]
    true = true_parameters(plant, structure.zeros)
    return np.abs(found.theta[: structure.size] - true) / np.where(true == 0.0, np.abs(true).max(), np.abs(true))


# --- without noise


@every_plant
@every("hold", ["zoh", "foh"])
def test_without_noise_it_is_exact(name: str, hold: str) -> None:
    """To rounding: no error of discretisation is left.

    But for the filter of the integrator, whose pole lies at the margin m: straight lines join the output, an error of
    m dt^2/8 times its curvature.
    """
    found = refine(AWKWARD[name][0], made(name, hold=hold))
    assert found is not None
    assert found.converged
    assert found.acceptable
    assert relative(found, name).max() < (1e-3 if name == "integrator" else 1e-6)
    assert found.variance < 1e-12 * made(name, hold=hold).y.var()


@every("name", ["order 2", "delay of 2.37 samples", "feedthrough"])
@every("hold", ["zoh", "foh"])
def test_a_clock_that_jitters_costs_nothing(name: str, hold: str) -> None:
    structure, plant = AWKWARD[name]
    if name.startswith("delay"):  # dead times of the fine grid are exact
        structure, plant = rp.Structure(2, 1, delay=2.38 * DT), rp.TransferFunction(plant.num, plant.den, 2.38 * DT)
    u, y, t = irregular_record(plant, 3, 1500, DT, jitter=0.4, input_hold=hold)
    found = refine(structure, Record(u, y, np.diff(t, prepend=-DT), hold))
    np.testing.assert_allclose(found.theta[: structure.size], true_parameters(plant, structure.zeros), rtol=1e-5)


def test_an_initial_state_and_an_offset_are_taken_up() -> None:
    """The record begins in the middle of a movement, and the sensor reads 5 too much: the same plant."""
    structure, plant = rp.Structure(3, 1), random_plant(9, 3, 1)
    u = binary(2, 3000, 7)
    y = plant.simulate(u, DT) + 5.0
    found = refine(structure, Record(u[777:], y[777:], np.array([DT])))
    np.testing.assert_allclose(found.theta[: structure.size], true_parameters(plant, 1), rtol=1e-6)
    assert found.theta[structure.size] == pytest.approx(5.0 * plant.den[-1], rel=1e-5)


def test_started_from_the_truth_or_from_anywhere_it_ends_in_the_same_place() -> None:
    structure, plant = AWKWARD["order 3"]
    record = made("order 3", noise=0.2)
    searched = refine(structure, record)
    start = np.zeros(searched.theta.size)
    start[: structure.size] = true_parameters(plant, 2)
    given = refine(structure, record, [start])
    away = np.abs(given.theta - searched.theta)[:6]
    assert (away < 0.01 * np.sqrt(np.diag(searched.covariance))[:6]).all()


def test_an_unstable_start_is_reflected_and_found_from() -> None:
    structure, plant = AWKWARD["order 2"]
    record = made("order 2")
    start = np.zeros(8)
    start[:4] = true_parameters(plant, 1)
    start[0] = -start[0]  # the poles on the right
    found = refine(structure, record, [start[: 2 * 2 + 1 + 2]])
    np.testing.assert_allclose(found.theta[:4], true_parameters(plant, 1), rtol=1e-6)


# --- with noise


@every_plant
def test_it_is_its_own_fixed_point(name: str) -> None:
    """The normal equations of the instruments hold at the solution: sum zeta (y - x) = 0.

    Each entry to a thousandth of its own standard deviation, sigma |zeta_i|.
    """
    structure = AWKWARD[name][0]
    record = made(name, noise=0.1)
    found = refine(structure, record)
    assert found.converged
    done = Problem(structure, record).run(found.theta)
    sums = done.zeta.T @ done.error
    assert (np.abs(sums) < 0.01 * math.sqrt(done.cost) * np.linalg.norm(done.zeta, axis=0)).all()
    # the equation error is the output error
    np.testing.assert_allclose(done.target - done.phi @ found.theta, done.error, atol=1e-9 * np.abs(record.y).max())


@every_plant
def test_the_covariance_is_cramer_and_raos_for_white_noise(name: str) -> None:
    """sigma^2 (sum psi psi')^-1, psi the slope of the output in each parameter, by differences of simulations.

    The colour found in white noise widens a variance by a few percent at the most; what the path tells of it scatters
    by sqrt(2 / blocks), of at least 32: four of these.
    """
    structure = AWKWARD[name][0]
    record = made(name, noise=0.05)
    found = refine(structure, record)
    problem = Problem(structure, record)
    columns = []
    for i in range(found.theta.size):
        step = 1e-3 * math.sqrt(found.covariance[i, i])
        ends = []
        for sign in (1.0, -1.0):
            moved = found.theta.copy()
            moved[i] += sign * step
            ends.append(-problem.run(moved).error)
        columns.append((ends[0] - ends[1]) / (2 * step))
    psi = np.stack(columns, axis=1)
    bound = found.variance * np.linalg.inv(psi.T @ psi)
    ratio = np.diag(found.covariance)[: structure.size] / np.diag(bound)[: structure.size]
    # the instruments join the model's output by straight lines, so their product differs by O(dt^2)
    assert ratio.min() > 0.9
    assert ratio.max() < 2.0
    np.testing.assert_allclose(
        compose(found.upper, found.diagonal), np.linalg.inv(information_of(structure, record, found)), rtol=1e-5
    )


def information_of(structure: rp.Structure, record: Record, found: Refined) -> np.ndarray:
    """The sum of zeta zeta', filtered by the noise model that the estimate came to."""
    problem = Problem(structure, record)
    done = problem.run(found.theta)
    problem.renew_noise(done)
    assert problem.noise.order == int(found.noise.order)
    zeta = problem.whiten(done.zeta)
    return zeta.T @ zeta


def test_estimates_scatter_as_the_covariance_says() -> None:
    """80 records: a chi-square of 80 x 4 degrees of freedom, over 320, has a standard deviation of 0.08; four of it."""
    structure, plant = rp.Structure(2, 1), AWKWARD["non-minimum phase"][1]
    true, total = true_parameters(plant, 1), 0.0
    for seed in range(80):
        found = refine(structure, made("non-minimum phase", samples=800, noise=0.1, seed=seed))
        away = found.theta[:4] - true
        total += float(away @ np.linalg.solve(found.covariance[:4, :4], away))
    assert total / 320 == pytest.approx(1.0, abs=0.32)


@pytest.mark.parametrize("runs", [30, pytest.param(80, marks=pytest.mark.slow)])
def test_coloured_noise_makes_the_covariance_honest(runs: int) -> None:
    """With noise through 1/(1 - 0.95 q) the plain sigma^2 P is far too small; the estimates scatter as ours says."""
    from scipy.signal import lfilter

    structure, plant = AWKWARD["order 1"]
    u = prbs(1500, bits=9, hold=6)
    y = plant.simulate(u, DT)
    true, total, plain = true_parameters(plant, 0), 0.0, 0.0
    for seed in range(runs):
        noise = lfilter([1.0], [1.0, -0.95], np.random.default_rng(seed).standard_normal(1700))[200:]
        found = refine(structure, Record(u, y + 0.03 * y.std() * noise, np.array([DT])))
        away = found.theta[:2] - true
        total += float(away @ np.linalg.solve(found.covariance[:2, :2], away))
        zeta = Problem(structure, Record(u, y, np.array([DT]))).run(found.theta).zeta
        white = found.variance * np.linalg.inv(zeta.T @ zeta)[:2, :2]
        plain += float(away @ np.linalg.solve(white, away))
    degrees = 2 * runs
    assert plain / degrees > 2.0
    assert total / degrees == pytest.approx(1.0, abs=4 * math.sqrt(2 / degrees))


# --- where nothing can be found


def test_uncertainty_falls_with_the_record_and_too_short_a_one_is_not_acceptable() -> None:
    structure = AWKWARD["order 2"][0]
    found = [refine(structure, made("order 2", samples=samples, noise=0.3)) for samples in (40, 400, 4000)]
    assert not found[0].acceptable
    assert found[2].acceptable
    assert found[2].uncertainty < 0.5 * found[1].uncertainty
    assert found[2].uncertainty < 0.1


@pytest.mark.parametrize(("converges", "times"), [(True, 1), (False, 2)])
def test_a_plain_root_that_has_converged_is_not_looked_for_again(
    monkeypatch: pytest.MonkeyPatch, converges: bool, times: int
) -> None:
    """Under coloured noise the filtered root is found beside it; one that has not converged goes on from there."""
    record = made("order 2", 1000)
    white = 0.05 * record.y.std() * np.random.default_rng(0).standard_normal(record.y.size)
    coloured = np.convolve(white, 0.8 ** np.arange(40))[: white.size]
    whole, found = srivc._plain, []

    def plain(*given: object, **how: object) -> object:
        found.append(dataclasses.replace(whole(*given, **how), converged=converges))
        return found[-1]

    monkeypatch.setattr(srivc, "_plain", plain)
    refined = refine(AWKWARD["order 2"][0], Record(record.u, record.y + coloured, record.intervals))
    assert refined is not None
    assert refined.noise_model.order > 0
    assert len(found) == times


@pytest.mark.slow
def test_what_each_of_several_records_begins_with_counts_as_fitted() -> None:
    """Of 30 records of 20 samples an offset and a state each, 90 numbers, take a seventh of the residual's power."""
    begins = tuple(range(20, 600, 20))
    structure, plant = rp.Structure(2), rp.TransferFunction([4.0], [1.0, 0.8, 4.0])
    variances = []
    for seed in range(9):
        random = np.random.default_rng(seed)
        u = np.repeat(random.choice([-1.0, 1.0], 120), 5)
        y = plant.simulate(u, 0.05) + 0.05 * random.standard_normal(600)
        found = refine(structure, Record(u, y, np.array([0.05]), begins=begins))
        assert found is not None
        variances.append(found.variance / 0.05**2)
    # of each the deviation is sqrt(2 / 507)
    assert abs(np.mean(variances) - 1.0) < 4.0 * np.sqrt(2.0 / 507 / len(variances))


@pytest.mark.slow
@every("seed", [2, 0, 3, 10, 1], quick=2)
def test_a_drift_larger_than_the_response_leads_no_start_and_no_choice_astray(seed: int) -> None:
    """A slow pole follows a random walk and simulates better; whitened, the plant is thousands of nats likelier."""
    rng, plant = np.random.default_rng(seed), rp.TransferFunction([2.0], [1.0, 2.0, 2.0])
    u = rng.uniform(-1.0, 1.0, 251).repeat(40)[:10_000]
    y = plant.simulate(u, 0.05) + 0.05 * rng.standard_normal(u.size) + 0.02 * np.cumsum(rng.standard_normal(u.size))
    found = refine(rp.Structure(2), Record(u - u.mean(), y - y.mean(), np.array([0.05])), nested=True)
    assert found is not None
    assert found.theta[:3] == pytest.approx([2.0, 2.0, 2.0], rel=0.15)


@every("seed", [26, 27, 29, 33, 176])
def test_an_unfiltered_estimate_is_no_surer_than_the_efficient_one(seed):
    """A short residual takes less slow noise than there is: short records beside a random walk, by Gauss and Markov."""
    rng = np.random.default_rng([seed, 411])
    samples, pole = int(rng.integers(100, 160)), 1.0 / rng.uniform(0.5, 3.0)
    u = np.repeat(rng.choice([-1.0, 1.0], 40), rng.integers(4, 12))[:samples]
    y = rp.TransferFunction([pole], [1.0, pole]).simulate(u, 0.1) + 0.02 * np.cumsum(rng.standard_normal(u.size))
    record = Record(u, y - y.mean(), np.array([0.1]))
    found = refine(rp.Structure(1), record)
    assert found is not None
    assert not found.noise.filters
    problem = Problem(rp.Structure(1), record)
    problem.noise = found.noise_model
    efficient = problem.conclude(problem.descend(found.theta, srivc.WHITENED, srivc.RENEWALS))
    assert (np.diag(found.covariance)[:2] >= 0.99 * np.diag(efficient.covariance)[:2]).all()
