"""Sums over a residual that comes batch by batch are those of the whole of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

from replant.numerics.residuals import LAGS, ErrorSums, OutputSums, correlation_lags
from support.cases import every

CUTS = [[], [1], [LAGS], [LAGS + 1, LAGS + 2], [7, 100, 101, 399]]


def residual(seed: int, lost: float, samples: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """An autoregression with a pole at 0.9 and a mean, zero where it is not known; and where it is known."""
    generator = np.random.default_rng(seed)
    error = 0.7 + lfilter([1.0], [1.0, -0.9], generator.standard_normal(samples))
    known = generator.random(samples) >= lost
    return np.where(known, error, 0.0), known


def taken(error: np.ndarray, known: np.ndarray, cuts: list[int]) -> ErrorSums:
    sums = ErrorSums()
    for begin, end in zip([0, *cuts], [*cuts, error.size], strict=True):
        sums.take(error[begin:end], known[begin:end])
    return sums


@every("cuts", CUTS, ids=str)
@every("lost", [0.0, 0.1, 0.7])
def test_mean_and_power_are_those_of_what_is_known(lost: float, cuts: list[int]) -> None:
    error, known = residual(1, lost)
    sums = taken(error, known, cuts)
    mean = float(error[known].mean())
    assert sums.mean == pytest.approx(mean, rel=1e-12)
    for off in (mean, 0.0, -2.0):
        assert sums.power(off) == pytest.approx(float(((error[known] - off) ** 2).sum()), rel=1e-9)


@every("cuts", CUTS[2:], ids=str)  # the first batch has the past of the second
@every("lost", [0.0, 0.1])
def test_the_innovation_does_not_depend_on_the_batches(lost: float, cuts: list[int]) -> None:
    error, known = residual(2, lost)
    whole = taken(error, known, [])
    assert taken(error, known, cuts).innovation(whole.mean) == pytest.approx(whole.innovation(whole.mean), rel=1e-9)


def test_the_innovation_is_what_the_past_does_not_tell() -> None:
    """Of white noise of power one; its sum over K has a standard deviation of sqrt(2 K), five of it are allowed."""
    error, known = residual(3, 0.0, 4000)
    sums = taken(error, known, [])
    assert sums.innovation(sums.mean) == pytest.approx(4000.0, abs=5.0 * math.sqrt(2.0 * 4000.0))
    assert sums.power(sums.mean) > 3.0 * 4000.0  # 1 / (1 - 0.81) for each


def test_a_short_residual_is_its_own_innovation() -> None:
    error, known = residual(4, 0.0, LAGS)
    sums = taken(error, known, [2])
    assert sums.innovation(0.1) == sums.power(0.1)


@every("cuts", [[], [1], [3, 50]], ids=str)
def test_outputs_far_from_zero_keep_their_spread(cuts: list[int]) -> None:
    y = 1e8 + np.random.default_rng(5).standard_normal(100)
    sums = OutputSums()
    sums.take(y[:0])
    for begin, end in zip([0, *cuts], [*cuts, 100], strict=True):
        sums.take(y[begin:end])
    assert sums.count == 100
    assert sums.spread == pytest.approx(float(((y - y.mean()) ** 2).sum()), rel=1e-6)


def test_a_constant_output_has_no_spread() -> None:
    sums = OutputSums()
    for _ in range(3):
        sums.take(np.full(7, 0.1))
    assert (sums.count, sums.spread) == (21, 0.0)


@every(
    ("time_constants", "samples", "lags"),
    [
        ([], 1000, 25),
        ([0.1, 2.0], 1000, 100),
        ([0.61], 1000, 31),
        ([math.inf, -3.0, 0.0], 1000, 25),
        ([1e300], 1000, 250),
        ([2.0], 399, 99),
        ([], 99, 24),
        ([], 3, 1),
    ],
)
def test_lags_reach_over_five_time_constants(time_constants: list[float], samples: int, lags: int) -> None:
    assert correlation_lags(time_constants, samples, 0.1) == lags
