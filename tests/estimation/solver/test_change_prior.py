"""What is known before a change: how much another G(s) explains of stretches of the record by itself."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.solver.change_evidence import Known
from replant.estimation.solver.srivc import refine
from replant.numerics.linear_algebra import inverse_of
from support.builders import binary

DT, SAMPLES = 0.1, 4000
STRUCTURE, PLANT = rp.Structure(1), rp.TransferFunction([2.0], [1.0, 1.0])


def known(u: np.ndarray, y: np.ndarray) -> tuple[Known, Record]:
    record = Record(u, y, np.array([DT]))
    found = refine(STRUCTURE, record, [], afresh=True)
    assert found is not None
    information = np.zeros((found.theta.size, found.theta.size))
    information[:2, :2] = inverse_of(found.covariance[:2, :2])
    before = Known.before(STRUCTURE, record, SAMPLES, found.theta, information, found.variance)
    assert before is not None
    return before, record


@pytest.mark.parametrize("length", [40, 200])
def test_of_a_linear_plant_stretches_are_explained_by_chance(length: int) -> None:
    """In each of K / length stretches two coefficients explain a chi-square of two: the mean over 20 records is 1."""
    found = []
    for seed in range(20):
        u = binary(seed, SAMPLES, 10)
        y = PLANT.simulate(u, DT)
        before, record = known(u, y + 0.1 * y.std() * np.random.default_rng([seed, 1]).standard_normal(SAMPLES))
        found.append(before.dispersion(record, length)[0])
        assert found[-1] >= 1.0
    # cut off at 1 from below: the mean of max(chi-square / n, 1) with n = 2 K / length has half of its deviation more
    deviation = np.sqrt(2.0 / (2.0 * SAMPLES / length))
    assert np.mean(found) < 1.0 + deviation


def test_of_a_plant_whose_gain_wanders_stretches_differ() -> None:
    u = binary(0, SAMPLES, 10)
    gain = 1.0 + 0.2 * np.sin(2.0 * np.pi * np.arange(SAMPLES) / 600.0)
    y = PLANT.simulate(gain * u, DT)
    before, record = known(u, y + 0.02 * y.std() * np.random.default_rng(1).standard_normal(SAMPLES))
    assert before.dispersion(record, 100)[0] > 10.0


def test_too_few_samples_before_tell_no_dispersion() -> None:
    u = binary(0, SAMPLES, 10)
    y = PLANT.simulate(u, DT) + 0.1 * np.random.default_rng(1).standard_normal(SAMPLES)
    before, record = known(u, y)
    assert before.dispersion(record, 1) == (1.0, math.inf)
    unknown = replace(before, information=np.zeros_like(before.information))  # beyond the range of float64
    assert unknown.dispersion(record, 100) == (1.0, math.inf)
    record = record.first(60)
    few = Known.before(STRUCTURE, record, 40, before.mean, before.information, before.variance)
    assert few is not None
    assert few.dispersion(record, 20) == (1.0, math.inf)


@pytest.mark.parametrize("pole", [-800.0, math.nan])
def test_a_model_that_cannot_be_run_over_the_record_tells_nothing(pole: float) -> None:
    """Its output leaves float64, of which a test that failed would warn."""
    u = binary(0, SAMPLES, 10)
    y = PLANT.simulate(u, DT) + 0.1 * np.random.default_rng(1).standard_normal(SAMPLES)
    before, record = known(u, y)
    mean = before.mean.copy()
    mean[0] = pole
    assert Known.before(STRUCTURE, record, SAMPLES // 2, mean, before.information, before.variance) is None
    beyond = np.full_like(before.information, math.inf)
    assert Known.before(STRUCTURE, record, SAMPLES // 2, before.mean, beyond, before.variance) is None
