"""How far an estimate lies from where a record would put it: the step, and whether it is chance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.simulation.model_run import run_model
from replant.numerics.autoregression import whiteness
from replant.verdict.estimate_distance import Distance, distance, newest_distances
from replant.verdict.sensor_and_excitation import growth
from support.builders import binary
from support.cases import every

DT, SAMPLES = 0.05, 2000
EVERY, RECORD = np.ones(SAMPLES, bool), Record(np.zeros(SAMPLES), np.zeros(SAMPLES), np.array([DT]))
PLANT, STRUCTURE, TRUE = rp.TransferFunction([2.0], [1.0, 4.0, 3.0]), rp.Structure(2), np.array([4.0, 3.0, 2.0])


def coloured(seed: int, colour: float, samples: int = SAMPLES) -> np.ndarray:
    made = lfilter([1.0], [1.0, -colour], np.random.default_rng(seed).standard_normal(samples + 500))[500:]
    return np.asarray(made * np.sqrt(1.0 - colour**2))


def known(measured: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How many measured samples in a row come before each, and which are."""
    return replace(RECORD, measured=measured).predecessors, measured


def distance_of(estimate: np.ndarray, seed: int, noise: float, colour: float = 0.0, missing: float = 0.0) -> Distance:
    u = binary(seed, SAMPLES, 8)
    y = PLANT.simulate(u, DT) + noise * coloured(seed, colour)
    measured = np.random.default_rng([seed, 1]).random(SAMPLES) >= missing
    run = run_model(STRUCTURE, estimate, Record(u, y, np.array([DT]), measured=measured), DT)
    assert run is not None
    return distance(run, slice(0, SAMPLES), *known(measured), 0.05)


def test_without_noise_the_step_leads_to_the_truth() -> None:
    """To first order: what is left is the square of what was wrong, within a factor of ten."""
    for wrong in (1e-3, 1e-4):
        estimate = TRUE * (1.0 + wrong * np.array([1.0, -1.0, 0.5]))
        found = distance_of(estimate, seed=1, noise=0.0)
        assert (np.abs(estimate + found.step - TRUE) < 10 * wrong**2 * TRUE).all()
        assert found.statistic > 1.0


def test_the_step_is_that_of_any_zero_of_the_input() -> None:
    """An integrator's initial state makes up for another zero: the output by it depends on the coefficients, too."""
    truth, u = np.array([0.7, 0.0, 0.7]), binary(1, SAMPLES, 8) + 0.3
    y = rp.TransferFunction([0.7], [1.0, 0.7, 0.0]).simulate(u, DT)
    estimate, steps = truth + 1e-3 * np.array([0.7, 0.01, -0.7]), []
    for zero in (0.0, 0.3, -2.0):
        run = run_model(STRUCTURE, estimate, Record(u - zero, y, np.array([DT])), DT)
        assert run is not None
        steps.append(distance(run, slice(0, SAMPLES), *known(EVERY), 0.05).step)
    np.testing.assert_allclose(steps, [truth - estimate] * 3, atol=5e-6)
    np.testing.assert_allclose(steps[1:], [steps[0]] * 2, rtol=1e-4)


@pytest.mark.parametrize(("colour", "missing"), [(0.0, 0.0), (0.8, 0.0), (0.98, 0.15)])
def test_its_covariance_is_honest(colour: float, missing: float) -> None:
    """200 records, run with the true model: step' C^-1 step is chi2 with three degrees of freedom.

    Its mean lies within four standard errors of 3, a tenth more for a covariance that is itself estimated, and is
    allowed to be too large a covariance by a fifth; alarms at 5 % are below 11 % (four standard deviations).
    """
    found = [distance_of(TRUE, seed, 0.05, colour, missing) for seed in range(200)]
    squares = np.array([each.step @ np.linalg.solve(each.covariance, each.step) for each in found])
    error = np.sqrt(6.0 / 200)
    assert 3.0 * 0.8 - 4 * error < squares.mean() < 3.0 * 1.1 + 4 * error
    alarms = np.mean([each.statistic > 1.0 for each in found])
    assert alarms < 0.05 + 4 * np.sqrt(0.05 * 0.95 / 200)
    np.testing.assert_allclose([each.statistic for each in found], squares / chi2.ppf(0.95, 3), rtol=1e-6)


def test_the_error_of_an_estimate_of_other_samples_is_no_change() -> None:
    """150 models, as far from the truth as their covariance says, 8 % of each coefficient: none differs beyond chance.

    The square is chi2 with three degrees of freedom; its mean lies within four standard errors of 3, a tenth more for a
    slope that changes within such errors.  Without the models' covariance most of them are accused.
    """
    own, limit = np.diag((0.08 * TRUE) ** 2), chi2.ppf(0.95, 3)
    squares, accused = [], 0
    for seed in range(150):
        model = np.random.default_rng([seed, 2]).multivariate_normal(TRUE, own)
        u = binary(seed, 500, 8)
        record = Record(u, PLANT.simulate(u, DT) + 0.01 * coloured(seed, 0.5, 500), np.array([DT]))
        run, rows, past = run_model(STRUCTURE, model, record, DT), slice(0, 500), record.predecessors
        assert run is not None
        squares.append(limit * distance(run, rows, past, np.ones(500, bool), 0.05, own=own).statistic)
        accused += distance(run, rows, past, np.ones(500, bool), 0.05).statistic > 1.0
    error = np.sqrt(6.0 / 150)
    assert 3.0 - 4 * error < np.mean(squares) < 3.3 + 4 * error
    assert accused > 75


POLES = (0.0, 0.7, 0.9, 0.97, 0.99, 0.997)


@pytest.mark.parametrize("colour", [0.0, 0.8, 0.98])
def test_over_the_newest_samples_alone_coloured_noise_is_no_change(colour: float) -> None:
    """60 records, run with the true model, the newest 100, 200 and 400 of 2000 samples.

    The test's square is chi2 with three degrees of freedom, mean 3, over a scatter that is at least one: the median of
    four to eight such squares over its expected value, about 1.2 on average.  So the mean lies between 2 and 3, within
    four standard errors, and alarms at 1e-4 are not expected: 0.02 of 180.
    """
    squares: dict[int, list[float]] = {}
    limit = chi2.ppf(1.0 - 1e-4, 3)
    for seed in range(60):
        u = binary(seed, SAMPLES, 8)
        y = PLANT.simulate(u, DT) + 0.05 * coloured(seed, colour)
        run = run_model(STRUCTURE, TRUE, Record(u, y, np.array([DT])), DT)
        assert run is not None
        for count, found in newest_distances(run, *known(EVERY), (100, 200, 400, 5000), 1e-4):
            squares.setdefault(count, []).append(found.statistic * limit)
    assert list(squares) == [100, 200, 400]
    for each in squares.values():
        error = 4.0 * np.sqrt(6.0 / 60)
        assert 2.0 - error < np.mean(each) < 3.0 + error
        assert max(each) < limit


def test_over_the_newest_samples_alone_drift_is_no_change() -> None:
    """Noise of many time constants, 1/f over three decades, which no short autoregression whitens.

    Of 40 records and 3 lengths at 1e-4 one alarm has a chance of 1.2 %, if the scatter is known.  The median of eight
    may be half of it; 0.5 % of the squares are then beyond: 0.6 alarms are expected, and six have a chance of 4e-5.
    """
    alarms = 0
    for seed in range(40):
        u = binary(seed, SAMPLES, 8)
        drift = sum(coloured(10 * seed + k, pole) / coloured(10 * seed + k, pole).std() for k, pole in enumerate(POLES))
        y = PLANT.simulate(u, DT) + 0.03 * drift
        run = run_model(STRUCTURE, TRUE, Record(u, y, np.array([DT])), DT)
        assert run is not None
        alarms += sum(found.statistic > 1.0 for _, found in newest_distances(run, *known(EVERY), (50, 100, 200), 1e-4))
    assert alarms < 6


# --- whiteness, and the residual's growth


def test_white_noise_is_called_white() -> None:
    """The limit is that of 1 %: of 300, at most 10 beyond it (but for one in a thousand)."""
    statistics = np.array([whiteness(np.random.default_rng(seed).standard_normal(1000)) for seed in range(300)])
    assert np.count_nonzero(statistics > 1.0) <= 10
    assert whiteness(coloured(1, 0.3)) > 1.0
    assert whiteness(np.zeros(100)) == 0.0


@every("colour", [0.0, 0.9])
@every("tails", [False, True], ids=["normal", "outliers"])
def test_noise_that_does_not_grow_is_not_accused(colour: float, tails: bool) -> None:
    """400 pairs: four of its standard deviations are beyond chance, also for colour and outliers."""
    worst = 0.0
    for seed in range(400):
        noise = coloured(seed, colour)
        if tails:
            hit = np.random.default_rng([seed, 1]).random(SAMPLES) < 0.01
            noise = noise + 5.0 * hit * np.random.default_rng([seed, 2]).standard_normal(SAMPLES)
        worst = max(worst, abs(growth(noise[:1200], noise[1200:])[1]))
    assert worst < (5.0 if tails else 4.0)


@every("seed", [4, 3, 5, 12, 37], quick=1)
def test_of_noise_that_drifts_the_newest_block_is_not_accused(seed: int) -> None:
    """A random walk is largest at its end as often as elsewhere: of 40 such records five had been accused."""
    u = np.repeat(np.random.default_rng(seed).uniform(-1.0, 1.0, 35), 20)
    y, drift = PLANT.simulate(u, DT), np.cumsum(np.random.default_rng(seed + 99).standard_normal(700))
    found = rp.fit(u, y + 0.2 * y.std() * (drift - drift.mean()) / drift.std(), DT, STRUCTURE)
    assert not any("earlier stretch" in reason for reason in found.verdict.reasons)


def test_growth_has_no_unit_and_no_fear_of_zero() -> None:
    noise = coloured(1, 0.5)
    assert growth(noise[:1000], 3.0 * noise[1000:]) == pytest.approx(growth(1e9 * noise[:1000], 3e9 * noise[1000:]))
    assert growth(np.zeros(200), np.zeros(200)) == (1.0, 0.0)
    assert growth(np.zeros(200), noise[:200])[1] == np.inf


def thermostat(seed: int, samples: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """A heater with two positions: the disturbances alone decide when it is on."""
    noise = np.random.default_rng(seed).standard_normal(samples)
    away = 1.5 * coloured(seed, 0.999, samples)
    u, y, x, on = np.empty(samples), np.empty(samples), 0.0, 0.0
    slow = np.exp(-0.5 / 60.0)
    for k in range(samples):
        y[k] = x + away[k] + 0.05 * noise[k]
        on = 15.0 if y[k] < 14.0 else 0.0 if y[k] > 16.0 else on
        u[k] = on
        x = slow * x + 2.0 * (1.0 - slow) * on
    return u, y


@pytest.mark.slow
@every("seed", range(6), quick=2)
def test_where_disturbances_alone_move_a_loop_no_other_model_is_said_to_come_of_its_filter(seed: int) -> None:
    """The slopes explain much of the disturbances there: what they leave has another colour than the noise."""
    found = rp.fit(*thermostat(seed), 0.5, poles=1).verdict
    assert any("the loop is closed" in reason for reason in found.reasons), found.reasons
    assert not any("filtered by its noise model" in reason for reason in found.reasons), found.reasons
