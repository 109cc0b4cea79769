"""Scaling: root mean squares, their invariances, and the scalings that cannot be."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import replant as rp
from support.cases import every

GENERATOR = np.random.default_rng(0)
Y, PHI = GENERATOR.standard_normal(500), GENERATOR.standard_normal((500, 3)) * [1.0, 1e-3, 1e5]


def test_a_record_gives_its_root_mean_squares() -> None:
    scaling = rp.Scaling.from_record(Y, PHI)
    assert scaling.output == pytest.approx(np.sqrt(np.mean(Y**2)), rel=1e-14)
    np.testing.assert_allclose(scaling.regressor, np.sqrt(np.mean(PHI**2, axis=0)), rtol=1e-14)


@every("factor", [1e-300, 1e-160, 1e150, 1e300])
def test_the_unit_does_not_matter_at_the_ends_of_float64(factor: float) -> None:
    """Squares of such signals leave float64; their root mean square does not."""
    plain, scaled = rp.Scaling.from_record(Y, PHI[:, :1]), rp.Scaling.from_record(factor * Y, factor * PHI[:, :1])
    assert scaled.output == pytest.approx(factor * plain.output, rel=1e-12)
    assert scaled.regressor[0] == pytest.approx(factor * plain.regressor[0], rel=1e-12)


def test_rows_that_are_not_finite_do_not_count() -> None:
    y, phi = Y.copy(), PHI.copy()
    y[3], phi[7, 1], phi[9, 0] = np.nan, np.inf, np.nan
    scaling = rp.Scaling.from_record(y, phi)
    kept = np.delete(np.arange(500), [3, 7, 9])
    assert scaling.output == pytest.approx(np.sqrt(np.mean(Y[kept] ** 2)), rel=1e-14)
    np.testing.assert_allclose(scaling.regressor, np.sqrt(np.mean(PHI[kept] ** 2, axis=0)), rtol=1e-14)


@pytest.mark.parametrize("rows", [0, 1, 50])
def test_a_silent_signal_is_left_as_it_is(rows: int) -> None:
    scaling = rp.Scaling.from_record(np.zeros(rows), np.zeros((rows, 2)))
    assert scaling == rp.Scaling(1.0, (1.0, 1.0))


def test_none_changes_nothing() -> None:
    structure = rp.Structure(3, 1, bias=True)
    scaling = rp.Scaling.none(structure)
    assert scaling.output == 1.0
    np.testing.assert_array_equal(scaling.sigmas(structure), np.ones(6))


@every(
    ("output", "regressor", "named"),
    [
        (0.0, [1.0], "scaling output"),
        (-1.0, [1.0], "scaling output"),
        (math.nan, [1.0], "scaling output"),
        (math.inf, [1.0], "scaling output"),
        ("a", [1.0], "scaling output"),
        (None, [1.0], "scaling output"),
        (1j, [1.0], "scaling output"),
        (1.0, [1.0, 0.0], "scaling regressor"),
        (1.0, [1.0, -2.0], "scaling regressor"),
        (1.0, [math.nan, 1.0], "scaling regressor"),
        (1.0, [math.inf, 1.0], "scaling regressor"),
        (1.0, [], "scaling regressor"),
        (1.0, -1.0, "scaling regressor"),
        (1.0, "ab", "scaling regressor"),
        (1.0, None, "scaling regressor"),
        (1.0, [1.0, None], "scaling regressor"),
        (1.0, [1.0, 1j], "scaling regressor"),
        (1.0, [[1.0], [1.0]], "scaling regressor"),
        (1.0, [[1.0], [1.0, 2.0]], "scaling regressor"),
    ],
    ids=repr,
)
def test_a_bad_sigma_is_refused_by_name(output: Any, regressor: Any, named: str) -> None:
    with pytest.raises((rp.InvalidArgumentError, rp.ArgumentTypeError), match=named) as caught:
        rp.Scaling(output, regressor)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("count", [1, 3, 5])
def test_a_wrong_number_of_sigmas_is_refused_with_the_names_that_need_one(count: int) -> None:
    with pytest.raises(rp.InvalidArgumentError, match=r"4 entries \(a1, a0, b1, b0\), got"):
        rp.Identifier(rp.Structure(2, 1), 0.1, scaling=rp.Scaling(1.0, [1.0] * count))
