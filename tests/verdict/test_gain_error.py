"""How well abs G is known where the input excites it, and whether the newest samples contradict it."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.record import Record
from replant.model.uncertainty import Uncertainty
from replant.verdict.estimate_distance import LARGEST_ERROR, SIGMAS, distance, excited_frequencies, gain_findings
from replant.verdict.evidence import Evidence, Runs
from support.builders import binary
from support.cases import every

DT, SAMPLES = 0.05, 4000
PLANT, STRUCTURE, TRUE = rp.TransferFunction([2.0], [1.0, 4.0, 3.0]), rp.Structure(2), np.array([4.0, 3.0, 2.0])
KNOWN = np.diag((1e-3 * TRUE) ** 2)


def evidence(u: np.ndarray, y: np.ndarray, covariance: np.ndarray = KNOWN) -> Evidence:
    record = Record(u, y, np.array([DT]))
    return Evidence(STRUCTURE, DT, record, TRUE, covariance, TRUE, unseen=1000, learned=3000)


def noisy(seed: int, noise: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    u = binary(seed, SAMPLES, 8)
    y = PLANT.simulate(u, DT)
    return u, y + noise * y.std() * np.random.default_rng(seed).standard_normal(SAMPLES)


def findings(given: Evidence, covariance: np.ndarray = KNOWN) -> list[str]:
    runs = Runs.of(given)
    assert runs is not None
    return [found.status for found in gain_findings(given, runs, covariance, covariance)]


@pytest.mark.parametrize("omega", [0.5, 2.0, 8.0])
def test_a_sine_excites_its_own_frequency(omega: float) -> None:
    """Welch's window spreads a line over two bins either way, four of them where abs G is steep."""
    u = np.sin(omega * DT * np.arange(SAMPLES))
    excited = excited_frequencies(evidence(u, PLANT.simulate(u, DT)))
    bin_width = math.tau / (1024 * DT)
    assert np.abs(excited - omega).min() < bin_width
    assert np.abs(excited - omega).max() < 4.0 * bin_width


def test_a_short_record_still_asks_for_the_lowest_frequencies() -> None:
    """120 samples of steps, 6 s, resolve 1 rad/s; the plant's slowest pole lies there, and its static gain counts."""
    u = binary(1, 120, 4)
    excited = excited_frequencies(evidence(u, PLANT.simulate(u, DT)))
    assert excited.min() == pytest.approx(0.1)


@pytest.mark.parametrize("times", [0.99, 1.01])
def test_the_tenth_is_three_standard_deviations_of_abs_g(times: float) -> None:
    """A covariance scaled until the least known frequency is at the limit: below it nothing is said."""
    given = evidence(*noisy(1))
    worst = Uncertainty(STRUCTURE, TRUE, KNOWN).response(excited_frequencies(given))[0].max()
    scaled = KNOWN * (times * LARGEST_ERROR / SIGMAS / worst) ** 2
    changed = dataclasses.replace(given, after_change=True)
    assert findings(changed, scaled) == (["converging"] if times > 1.0 else [])
    assert findings(given, scaled) == []  # without a change nothing better is missed


def test_an_unknown_covariance_is_not_small() -> None:
    given = dataclasses.replace(evidence(*noisy(1)), after_change=True)
    assert findings(given, np.full((3, 3), np.nan)) == ["converging"]


def test_the_truth_is_seldom_contradicted() -> None:
    """Five lengths at a chance of 1e-4 each: of 80 records 0.04 are expected, and two have a chance of 0.1 %."""
    assert sum("inconsistent" in findings(evidence(*noisy(seed))) for seed in range(80)) <= 1


@every("entry", [0, 1, 2])
@every("factor", [0.8, 1.25])
def test_a_change_near_the_end_of_a_long_record_is_found(entry: int, factor: float) -> None:
    """The last 400 samples are of another plant: over the whole record that is next to nothing."""
    changed = TRUE.copy()
    changed[entry] *= factor
    u, y = noisy(entry)
    noise = y - PLANT.simulate(u, DT)
    after = rp.TransferFunction([changed[2]], [1.0, *changed[:2]]).simulate(u, DT)
    y = np.where(np.arange(SAMPLES) < SAMPLES - 400, PLANT.simulate(u, DT), after) + noise
    given = evidence(u, y)
    assert "inconsistent" in findings(given)
    runs = Runs.of(given)
    assert runs is not None
    whole = distance(runs.now, given.known, given.past, given.used, 1e-4)
    assert np.abs(whole.step / TRUE).max() < 0.5 * abs(factor - 1.0)
