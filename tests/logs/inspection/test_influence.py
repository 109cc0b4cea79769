"""Influence and delay between signals for which both are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from replant.logs.column_roles import CEILING, MOST_SAMPLES, SPREAD, influence, memory, prepared, response
from support.cases import every


def walk(seed: int, samples: int = 20_000) -> np.ndarray:
    """A random walk: its samples are steps, so that a plant's response to it shows the step response."""
    return np.cumsum(np.random.default_rng(seed).standard_normal(samples))


def ramped(u: np.ndarray, delay: int, width: int) -> np.ndarray:
    """The output of a plant whose step response is a ramp of ``width`` samples after a dead time."""
    late = np.concatenate([np.full(delay + 1, u[0]), u])[: u.size]
    mean = np.convolve(np.concatenate([np.full(width - 1, u[0]), late]), np.full(width, 1.0 / width), "valid")
    return np.asarray(mean)


@every("delay", [0, 1, 5, 30])
@every("width", [1, 20])
@every("gain", [1.0, -4.0])
def test_a_response_begins_after_the_dead_time_and_reaches_half_at_half_its_width(
    delay: int, width: int, gain: float
) -> None:
    """The ramp reaches the part x of its end ``x width`` samples after the dead time; it is linear between samples.

    With 20,000 moves of the input the error by chance is 0.7 % of the response; a tenth of its width is far more.
    """
    u = walk(1)
    found = response(prepared(u), prepared(3.0 + gain * ramped(u, delay, width)))
    assert found is not None
    assert found.delay == pytest.approx(max(0.0, delay - 1.0), abs=0.1 + 0.1 * width)
    assert found.half == pytest.approx(delay + 0.5 * width, abs=1.0)
    assert found.peak == pytest.approx(delay + width, abs=2.0)
    assert found.correlation * gain > 0.0
    if width == 1:  # of the moves of the output over so many samples one is the answer
        assert abs(found.correlation) == pytest.approx(1.0 / math.sqrt(delay + 2), rel=0.1)


def test_what_is_independent_has_no_response() -> None:
    noise = prepared(np.random.default_rng(2).standard_normal(20_000))
    assert response(prepared(walk(1)), noise) is None
    assert response(prepared(np.ones(20_000)), noise) is None


def test_influence_is_the_logarithm_of_a_ratio_of_residual_powers() -> None:
    """b is the previous sample of a plus half as much noise: the prediction reduces its power from 1.25 to 0.25."""
    a, noise = np.random.default_rng(3).standard_normal((2, 20_000))
    b = np.concatenate([[0.0], a[:-1]]) + 0.5 * noise
    assert influence(prepared(a), prepared(b)) == pytest.approx(math.log(1.25 / 0.25), abs=0.05)
    assert influence(prepared(b), prepared(a)) < 0.01
    assert influence(prepared(a), prepared(noise)) < 0.01
    exact = np.concatenate([[0.0], a[:-1]])
    assert influence(prepared(a), prepared(exact)) == pytest.approx(CEILING, abs=0.1)


@every("period", [40, 400])
def test_the_memory_of_a_sine_ends_where_its_cosine_is_one_over_e(period: int) -> None:
    wave = prepared(np.sin(2.0 * np.pi * np.arange(50 * period) / period))
    assert memory(wave) == math.ceil(period * math.acos(1.0 / math.e) / (2.0 * math.pi))


def test_a_memory_longer_than_the_record_is_the_record() -> None:
    assert memory(np.zeros(9)) == 0
    assert memory(np.ones(9)) == 6  # 9 - lag of 9 products are left: a third at six


def test_a_prepared_signal_has_unit_power_and_no_gap_and_no_spike() -> None:
    values = 1e3 + np.random.default_rng(4).standard_normal(5_000)
    values[100:103] = np.nan
    values[200] = 1e9
    found = prepared(values)
    assert (found.mean(), found.std()) == pytest.approx((0.0, 1.0), abs=1e-6)
    np.testing.assert_allclose(np.diff(found[99:104]), (found[103] - found[99]) / 4.0, rtol=1e-6)
    usual = np.quantile(np.delete(found, 200), [0.05, 0.5, 0.95])
    assert found[200] == pytest.approx(usual[1] + SPREAD * (usual[2] - usual[0]), rel=0.02)
    assert prepared(np.arange(MOST_SAMPLES + 5.0)).size == MOST_SAMPLES
    assert not prepared(np.full(5, np.nan)).any()
    assert not prepared(np.full(5, 7.0)).any()
