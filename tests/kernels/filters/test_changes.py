"""The score statistic since each of some samples, beside inverses."""

from __future__ import annotations

import numpy as np
import pytest

from replant.kernels.filters.sums import since_each
from replant.numerics.linear_algebra import sums_of_products
from support.cases import every

BEGINS = np.array([40, 90, 150])


def statistics_of(columns: np.ndarray, size: int) -> np.ndarray:
    """Return those of columns (K, T + 1), by the kernel."""
    found, twice = np.empty(BEGINS.size), 2 * (columns.shape[1] - 1)
    sums = np.cumsum(sums_of_products(columns, BEGINS)[::-1], axis=0)[::-1].copy()
    since_each(sums, size, found, np.empty((twice, twice + 1)))
    return found


def plain(columns: np.ndarray, size: int, begin: int) -> float:
    """Return the same by the equations, of columns that do not depend on each other."""
    zeta, rest = columns[:, :-1], columns[:, -1]
    whole, since = zeta.T @ zeta, zeta[begin:].T @ zeta[begin:]
    left = since - since @ np.linalg.solve(whole, since)
    told = zeta[begin:].T @ rest[begin:] - since @ np.linalg.solve(whole, zeta.T @ rest)
    own, others = slice(None, size), slice(size, None)
    taken = np.linalg.solve(left[others, others], np.column_stack([left[others, own], told[others]]))
    covariance = left[own, own] - left[own, others] @ taken[:, :-1]
    score = told[own] - left[own, others] @ taken[:, -1]
    return float(score @ np.linalg.solve(covariance, score))


@every("size", [1, 2, 5])
def test_they_are_those_of_the_equations(size: int) -> None:
    units = np.array([1e-6, 1.0, 1e3, 1.0, 1e8, 1.0])
    columns = units * np.random.default_rng(size).standard_normal((200, 6))
    np.testing.assert_allclose(
        statistics_of(columns, size), [plain(columns, size, begin) for begin in BEGINS], rtol=1e-9
    )


def test_columns_that_are_sums_of_others_and_columns_of_zeros_tell_nothing_more() -> None:
    columns = np.random.default_rng(0).standard_normal((200, 6))
    expected = statistics_of(columns[:, [0, 2, 3, 5]], 1)
    columns[:, 1], columns[:, 4] = 3.0 * columns[:, 0], 0.0
    np.testing.assert_allclose(statistics_of(columns, 2), expected, rtol=1e-9)
    columns[:, 0] = columns[:, 1] = columns[:, 2] - columns[:, 3]
    assert statistics_of(columns, 2) == pytest.approx(0.0, abs=1e-20)
