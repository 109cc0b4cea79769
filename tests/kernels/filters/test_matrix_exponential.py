"""The exponential of a companion matrix with a constant and a ramp beside it, against SciPy's and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from replant.kernels.filters.bank import exponential
from support.cases import every

EPSILON = np.finfo(float).eps


def matrix_of(characteristic: np.ndarray, rate: float) -> np.ndarray:
    """The matrix as its docstring has it: states, the constant that drives them, the slope of that."""
    n = characteristic.size
    matrix = np.zeros((n + 2, n + 2))
    matrix[0, :n], matrix[0, n] = -rate * characteristic, rate
    matrix[range(1, n), range(n - 1)] = rate
    matrix[n, n + 1] = 1.0
    return matrix


def computed(characteristic: np.ndarray, rate: float) -> np.ndarray:
    n = characteristic.size
    result = np.full((n + 2) ** 2, np.nan)  # whatever it held before
    exponential(n, rate, characteristic, result, np.empty((n + 2) ** 2))
    return result.reshape(n + 2, n + 2)


def states_of(characteristic: np.ndarray, rate: float) -> np.ndarray:
    n = characteristic.size
    return computed(characteristic, rate)[:n, :n]


@every("order", range(1, 13))
@every("rate", [1e-6, 1e-3, 0.2, 1.0, 10.0, 100.0])
def test_it_equals_scipys(order: int, rate: float) -> None:
    """Of stable denominators, as a bank scales them: the geometric mean of the poles is one.

    Scaling and squaring squares log2(4 norm) times and at most doubles the rounding error each time, so that the
    relative error stays within a few roundings times norm times order; SciPy's has the like.
    """
    for seed in range(3):
        poles = -np.random.default_rng([seed, order]).uniform(0.5, 2.0, order)
        characteristic = np.poly(poles / np.exp(np.log(-poles).mean()))[1:]
        matrix = matrix_of(characteristic, rate)
        expected, norm = expm(matrix), float(np.abs(matrix).sum(axis=1).max())
        error = np.abs(computed(characteristic, rate) - expected).max()
        assert error <= 20 * EPSILON * order * max(1.0, norm) * np.abs(expected).max()


@pytest.mark.parametrize("rate", [1e-6, 0.3, 20.0])
def test_integrators_in_a_row_give_a_finite_sum(rate: float) -> None:
    """1, x, x^2/2, x^3/6, .. below the diagonal; a constant is one integral more, a ramp from 0 to 1 two."""
    order = 6
    series = rate ** np.arange(order + 1) / np.cumprod([1.0, *range(1, order + 1)])
    found = computed(np.zeros(order), rate)
    expected = sum(np.diag(np.full(order - k, series[k]), -k) for k in range(order))
    np.testing.assert_allclose(found[:order, :order], expected, rtol=1e-13)
    np.testing.assert_allclose(found[:order, order], series[1:], rtol=1e-13)
    np.testing.assert_allclose(found[:order, order + 1], series[1:] / np.arange(2, order + 2), rtol=1e-13)


@pytest.mark.parametrize("angle", [1e-8, 1.0, 100.0])
def test_a_rotation_stays_one(angle: float) -> None:
    c, s = np.cos(angle), np.sin(angle)
    np.testing.assert_allclose(
        states_of(np.array([0.0, 1.0]), angle), [[c, -s], [s, c]], atol=20 * EPSILON * max(1.0, angle)
    )


def test_over_no_time_the_states_stay_and_the_ramp_has_risen() -> None:
    expected = np.eye(5)
    expected[3, 4] = 1.0
    np.testing.assert_array_equal(computed(np.array([3.0, 3.0, 1.0]), 0.0), expected)


@pytest.mark.parametrize("stiffness", [1.0, 1e4, 1e7])
def test_poles_far_apart(stiffness: float) -> None:
    """(s + 1)(s + stiffness) over one second: both poles' exponentials by Lagrange's interpolation."""
    A = np.array([[-1.0 - stiffness, -stiffness], [1.0, 0.0]])
    if stiffness == 1.0:
        expected = np.exp(-1.0) * (np.eye(2) + A + np.eye(2))
    else:
        slow, fast = np.exp(-1.0), np.exp(-stiffness)
        expected = (slow * (A + stiffness * np.eye(2)) - fast * (A + np.eye(2))) / (stiffness - 1.0)
    error = np.abs(states_of(-A[0], 1.0) - expected).max() / np.abs(expected).max()
    assert error < 20 * EPSILON * stiffness


def test_of_numbers_that_leave_float64_it_ends() -> None:
    """The halvings have an end where no halving makes the norm finite."""
    with np.errstate(all="ignore"):
        assert not np.isfinite(computed(np.array([np.inf, 1.0]), 1.0)[0]).all()
