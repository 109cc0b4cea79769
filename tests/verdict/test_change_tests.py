"""The power of a residual over its newest block, beside that of the blocks before."""

from __future__ import annotations

import math

import numpy as np
import pytest

import replant as rp
from replant.verdict.sensor_and_excitation import _powers
from support.cases import every


@every("count", [5, 20, 32])
@every("offset", [0.0, -40.0])
def test_powers_are_those_of_whole_blocks_that_end_with_the_record(count: int, offset: float) -> None:
    """About the median of the whole; what is left over lies at the beginning, and counts in no block."""
    error = np.random.default_rng(0).standard_normal(203) * np.linspace(1.0, 3.0, 203)
    about = error - np.median(error)
    powers = [float(np.mean(np.square(about[end - count : end]))) for end in range(203, count - 1, -count)]
    last, largest, usual = _powers(error + offset, count)
    np.testing.assert_allclose(last, powers[0], rtol=1e-9)
    np.testing.assert_allclose(largest, max(powers[1:]), rtol=1e-9)
    np.testing.assert_allclose(usual, np.median(powers), rtol=1e-9)


def test_an_offset_that_stays_is_no_power() -> None:
    assert _powers(np.full(100, 7.0), 10) == (0.0, 0.0, 0.0)


def test_samples_without_an_error_count_for_nothing_and_a_block_of_few_others_has_no_power() -> None:
    generator = np.random.default_rng(1)
    error = generator.standard_normal(90)
    lost = error.copy()
    lost[[3, 40, 41, 42, 88]] = math.nan
    kept = lost[np.isfinite(lost)]
    powers = [np.mean((lost[k : k + 30][np.isfinite(lost[k : k + 30])] - np.median(kept)) ** 2) for k in (0, 30, 60)]
    np.testing.assert_allclose(_powers(lost, 30), (powers[2], max(powers[:2]), np.median(powers)), rtol=1e-9)
    lost[64:] = math.nan
    assert _powers(lost, 30)[0] == 0.0


def test_outputs_that_are_nearly_all_in_the_newest_block_make_no_burst() -> None:
    generator, samples = np.random.default_rng(1), 800
    u = np.repeat(generator.choice([-1.0, 1.0], samples // 5), 5)
    y = rp.TransferFunction([3.0], [1.0, 0.8]).simulate(u, 0.1) + generator.standard_normal(samples)
    y[1:-15] = math.nan
    reasons = rp.fit(u, y, 0.1, poles=1).verdict.reasons
    assert not any("largest power" in reason for reason in reasons), reasons


@pytest.mark.slow
@every("seed", [1, 0, *range(2, 8)], quick=1)
def test_outputs_that_are_missing_make_no_burst_of_a_drift(seed: int) -> None:
    """A drift is predicted by its past; where that is missing, nothing is known of an error one step ahead."""
    generator, samples, dt = np.random.default_rng(seed), 600, 0.05
    u = np.repeat(generator.choice([-1.0, 1.0], samples // 15), 15)
    drift = 3.0 * (np.arange(samples) / samples) ** 6
    y = rp.TransferFunction([3.0], [1.0, 0.8, 3.0]).simulate(u, dt) + drift + 0.02 * generator.standard_normal(samples)
    y[generator.random(samples) < 0.15] = math.nan
    reasons = rp.fit(u, y, dt, poles=2, zeros=0).verdict.reasons
    assert not any("largest power" in reason for reason in reasons), reasons
