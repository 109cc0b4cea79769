"""The cross test: false alarms as rare as promised, and the unexplained part measured without bias."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom, chi2

import replant as rp
from replant.assessment.cross_test import FALSE_ALARM, unexplained
from replant.engine.record import Record
from replant.simulation.model_run import ModelRun, run_model
from support.builders import G1, binary

DT, SAMPLES = 0.1, 1500
STRUCTURE = rp.Structure(1)
TRUE = np.array([0.5, 1.25])
ALL = slice(0, SAMPLES)


def noise(seed: int, colour: float) -> np.ndarray:
    made = lfilter([1.0], [1.0, -colour], np.random.default_rng(seed).standard_normal(SAMPLES + 500))[500:]
    return np.asarray(made * np.sqrt(1.0 - colour**2))


def run_of(y: np.ndarray, u: np.ndarray) -> ModelRun:
    run = run_model(STRUCTURE, TRUE, Record(u, y, np.array([DT])), DT)
    assert run is not None
    return run


@pytest.mark.parametrize("colour", [0.0, 0.5, 0.9])
def test_a_right_model_is_hardly_ever_accused(colour: float) -> None:
    """300 records of a known plant: by chance one of 33 such tables has an alarm, one of 2200 has two.

    The statistic has a mean of q degrees of freedom over a limit of chi2's 1 - alpha quantile, below 0.6 for q < 40.
    """
    statistics = []
    for seed in range(300):
        u = binary(seed, SAMPLES, 5)
        statistics.append(unexplained(run_of(G1.simulate(u, DT) + 0.3 * noise(seed, colour), u), ALL, DT).statistic)
    assert binom.sf(1, 300, FALSE_ALARM) < 1 / 2200
    assert np.count_nonzero(np.array(statistics) > 1.0) <= 1
    assert chi2.mean(40) / chi2.ppf(1 - FALSE_ALARM, 40) < 0.6
    assert np.mean(statistics) < 0.6


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_what_the_model_misses_is_measured_with_its_doubt(colour: float) -> None:
    """A second, faster mode is missing, whose response has a known power: over 100 records the mean of the measured
    power is right within four standard errors and a tenth (the columns span such a response nearly), and the doubt of
    each within a half.
    """
    missing = rp.TransferFunction([1.0], [1.0, 3.0])
    found, expected = [], []
    for seed in range(100):
        u = binary(seed, SAMPLES, 5)
        missed = missing.simulate(u, DT)
        run = run_of(G1.simulate(u, DT) + missed + 0.3 * noise(seed, colour), u)
        part = unexplained(run, ALL, DT)
        found.append((part.power, part.std, part.statistic))
        expected.append(np.var(missed))
    powers, doubts, statistics = np.array(found).T
    error = powers - expected
    assert (statistics > 1.0).all()
    assert abs(error.mean()) < 4 * error.std() / 10 + 0.1 * np.mean(expected)
    assert 0.5 < error.std() / doubts.mean() < 1.5


def test_the_unit_of_the_output_does_not_matter() -> None:
    u = binary(1, SAMPLES, 5)
    y = G1.simulate(u, DT) + 0.3 * noise(1, 0.5) + 0.1 * np.roll(u, 7)
    part = unexplained(run_of(y, u), ALL, DT)
    scaled = run_model(STRUCTURE, TRUE * [1.0, 1e6], Record(u, 1e6 * y, np.array([DT])), DT)
    assert scaled is not None
    other = unexplained(scaled, ALL, DT)
    assert other.statistic == pytest.approx(part.statistic, rel=1e-6)
    assert other.power == pytest.approx(1e12 * part.power, rel=1e-6)


def test_feedback_is_no_fault_of_the_model() -> None:
    """The input answers to the noise that was: later inputs follow the residual, the model is right."""
    alarms = 0
    for seed in range(30):
        reference, e = binary(seed, SAMPLES, 20), 0.2 * noise(seed, 0.0)
        pole = np.exp(-0.5 * DT)
        x, u, y = 0.0, np.empty(SAMPLES), np.empty(SAMPLES)
        for k in range(SAMPLES):
            y[k] = x + e[k]
            u[k] = reference[k] - 0.5 * y[k - 1] if k else reference[k]
            x = pole * x + (1.0 - pole) * 2.5 * u[k]
        alarms += unexplained(run_of(y, u), ALL, DT).statistic > 1.0
    assert alarms == 0


def test_few_samples_take_few_columns() -> None:
    u = binary(1, 120, 5)
    run = run_model(rp.Structure(3), np.array([3.0, 3.0, 1.0, 1.0]), Record(u, np.cumsum(u), np.array([DT])), DT)
    assert run is not None
    assert np.isfinite(unexplained(run, slice(60, 120), DT).statistic)


def test_nothing_left_is_nothing_to_explain() -> None:
    u = binary(1, SAMPLES, 5)
    run = run_model(STRUCTURE, TRUE, Record(u, np.zeros(SAMPLES), np.array([DT])), DT)
    assert run is not None
    still = ModelRun(STRUCTURE, TRUE, u, np.zeros(SAMPLES), run.forced, run.states, run.zeta, run.nuisances)
    assert unexplained(still, ALL, DT).statistic == 0.0
