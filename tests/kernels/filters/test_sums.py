"""Sums of products, beside those of NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from replant.kernels.filters.sums import WIDTH
from replant.kernels.schema import LAGS
from replant.numerics.autoregression import sums_of
from replant.numerics.linear_algebra import sums_of_products


@given(
    rows=st.integers(0, 3 * WIDTH + 1), size=st.integers(1, 6), edges=st.lists(st.integers(0, 60), max_size=4),
    seed=st.integers(0, 99),
)  # fmt: skip
def test_sums_between_edges_are_those_of_the_rows_there(rows: int, size: int, edges: list[int], seed: int) -> None:
    columns = np.random.default_rng(seed).standard_normal((rows, size))
    places = np.array(sorted(edges), np.int64)
    found = sums_of_products(columns, places)
    for part, sums in zip(np.split(columns, places), found, strict=True):
        np.testing.assert_allclose(sums, part.T @ part, atol=1e-12)


@given(length=st.integers(0, 3 * WIDTH), lost=st.sets(st.integers(0, 50), max_size=3), seed=st.integers(0, 99))
def test_sums_of_a_residual_are_of_samples_with_a_whole_past(length: int, lost: set[int], seed: int) -> None:
    error = np.random.default_rng(seed).standard_normal(length)
    known = np.array([min(k - max([at for at in lost if at <= k], default=0), LAGS + 3) for k in range(length)], int)
    whole = [k for k in range(LAGS, length) if known[k] >= LAGS]
    windows = np.array([error[k - LAGS : k + 1][::-1] for k in whole]).reshape(len(whole), LAGS + 1)
    sums, count = sums_of(error, known)
    assert count == len(whole)
    np.testing.assert_allclose(sums, windows.T @ windows, atol=1e-12)


def test_what_is_no_number_stays_where_it_is() -> None:
    columns = np.ones((40, 2))
    columns[20, 1] = np.nan
    sums = sums_of_products(columns, np.array([10, 30]))
    assert np.isfinite(sums[[0, 2]]).all()
    assert sums[1, 0, 0] == pytest.approx(20.0)
    assert np.isnan(sums[1, 1]).all()
