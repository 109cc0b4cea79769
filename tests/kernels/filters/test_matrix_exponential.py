"""The matrix exponential against SciPy's and against answers known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from replant.kernels.filters.bank import exponential
from support.cases import every

EPSILON = np.finfo(float).eps


def computed(matrix: np.ndarray) -> np.ndarray:
    size = matrix.shape[0]
    result = np.empty(size * size)
    exponential(matrix.ravel().copy(), result, np.empty(size * size), size)
    return result.reshape(size, size)


def norm(matrix: np.ndarray) -> float:
    """Largest sum of a row's magnitudes, which the kernel scales by."""
    return float(np.abs(matrix).sum(axis=1).max())


@every("order", range(1, 13))
@every("size", [1e-6, 1e-3, 0.2, 1.0, 10.0, 100.0, 1000.0])
def test_it_equals_scipys(order: int, size: float) -> None:
    """Of stable matrices of any norm.

    Scaling and squaring squares log2(4 norm) times and at most doubles the rounding error each time, so that the
    relative error stays within a few roundings times norm times order; SciPy's has the like.
    """
    for seed in range(3):
        matrix = np.random.default_rng([seed, order]).standard_normal((order, order))
        matrix -= (np.linalg.eigvals(matrix).real.max() + 0.1) * np.eye(order)
        matrix *= size / norm(matrix)
        expected = expm(matrix)
        error = np.abs(computed(matrix) - expected).max()
        assert error <= 20 * EPSILON * order * max(1.0, size) * np.abs(expected).max()


@pytest.mark.parametrize("size", [1e-6, 0.3, 20.0])
def test_a_nilpotent_matrix_gives_a_finite_sum(size: float) -> None:
    """One over the diagonal: 1, x, x^2/2, x^3/6, .. on the diagonals."""
    order = 6
    series = size ** np.arange(order) / np.cumprod([1.0, *range(1, order)])
    expected = sum(np.diag(np.full(order - k, series[k]), k) for k in range(order))
    np.testing.assert_allclose(computed(np.diag(np.full(order - 1, size), 1)), expected, rtol=1e-13)


@pytest.mark.parametrize("angle", [1e-8, 1.0, 100.0])
def test_a_rotation_stays_one(angle: float) -> None:
    c, s = np.cos(angle), np.sin(angle)
    rotation = computed(np.array([[0.0, -angle], [angle, 0.0]]))
    np.testing.assert_allclose(rotation, [[c, -s], [s, c]], atol=20 * EPSILON * max(1.0, angle))


def test_zero_gives_the_identity() -> None:
    np.testing.assert_array_equal(computed(np.zeros((3, 3))), np.eye(3))


@pytest.mark.parametrize("stiffness", [1.0, 1e4, 1e7])
def test_a_companion_matrix_of_poles_far_apart(stiffness: float) -> None:
    """(s + 1)(s + stiffness) over one second: both poles' exponentials by Lagrange's interpolation."""
    A = np.array([[-1.0 - stiffness, -stiffness], [1.0, 0.0]])
    if stiffness == 1.0:
        expected = np.exp(-1.0) * (np.eye(2) + A + np.eye(2))
    else:
        slow, fast = np.exp(-1.0), np.exp(-stiffness)
        expected = (slow * (A + stiffness * np.eye(2)) - fast * (A + np.eye(2))) / (stiffness - 1.0)
    error = np.abs(computed(A) - expected).max() / np.abs(expected).max()
    assert error < 20 * EPSILON * stiffness


def test_beside_the_diagonal_of_a_diagonal_matrix_nothing_is_left() -> None:
    """Whatever the result held before, and where the series begins."""
    exponents = np.array([-0.25, 0.2, 0.0, 3.0])
    found = computed(np.diag(exponents))
    np.testing.assert_array_equal(found - np.diag(found.diagonal()), np.zeros((4, 4)))
    np.testing.assert_allclose(found.diagonal(), np.exp(exponents), rtol=1e-14)
