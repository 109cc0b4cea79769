"""An output that is a copy of the input, whatever their size."""

from __future__ import annotations

import warnings

import numpy as np

from replant.verdict.evidence import is_copy
from support.cases import every

U = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 20), 5)


@every("size", [1e-300, 1e-170, 1.0, 1e150, 1e300])
def test_a_copy_is_one_in_any_unit_and_about_any_zero(size: float) -> None:
    assert is_copy(size * U, size * U)
    assert is_copy(U, -3.0 * size * U + size)
    assert not is_copy(size * U, size * np.roll(U, 1))


@every("far", [np.inf, np.nan, 1.7e308])
def test_what_leaves_float64_is_no_copy_and_no_error(far: float) -> None:
    u = U.copy()
    u[3], u[4] = far, -far
    with warnings.catch_warnings(action="error"):
        assert not is_copy(u, U)
        assert not is_copy(np.zeros(100), U)
        assert not is_copy(U, np.zeros(100))
