"""Factors of a covariance: round trips, units, and information that tells nothing of some direction."""

from __future__ import annotations

import numpy as np
import pytest

from replant.numerics.linear_algebra import LEAST_PIVOT, compose, factor_covariance, factor_information, larger
from support.cases import every

SIZES = [1, 2, 3, 5, 8, 13]


def positive(seed: int, size: int, condition: float = 1e4) -> np.ndarray:
    """A random symmetric positive definite matrix with this condition number."""
    vectors, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((size, size)))
    return (vectors * np.geomspace(1.0, condition, size)) @ vectors.T


def assert_factors(upper: np.ndarray, diagonal: np.ndarray) -> None:
    np.testing.assert_array_equal(np.tril(upper), np.eye(diagonal.size))
    assert (diagonal > 0).all()


@every("size", SIZES)
def test_a_covariance_comes_back(size: int) -> None:
    covariance = positive(size, size)
    upper, diagonal = factor_covariance(covariance)
    assert_factors(upper, diagonal)
    np.testing.assert_allclose(compose(upper, diagonal), covariance, rtol=1e-10, atol=1e-11 * covariance.max())
    again_upper, again_diagonal = factor_covariance(compose(upper, diagonal))
    np.testing.assert_allclose(again_diagonal, diagonal, rtol=1e-8)
    np.testing.assert_allclose(again_upper, upper, atol=1e-8 * np.abs(upper).max())


@every("size", SIZES)
def test_an_information_matrix_is_inverted(size: int) -> None:
    information = positive(size, size)
    upper, diagonal = factor_information(information)
    assert_factors(upper, diagonal)
    np.testing.assert_allclose(compose(upper, diagonal) @ information, np.eye(size), atol=1e-9)


@pytest.mark.parametrize("factorize", [factor_covariance, factor_information])
def test_units_of_the_parameters_do_not_matter(factorize: object) -> None:
    """In powers of two, to the bit but for the roots of the diagonal: U follows the units of rows and columns."""
    matrix, units = positive(0, 4), 2.0 ** np.array([-80.0, 0.0, 33.0, 120.0])
    scaled = matrix * np.outer(units, units)
    if factorize is factor_information:
        units = 1.0 / units
    upper, diagonal = factorize(matrix)
    scaled_upper, scaled_diagonal = factorize(scaled)
    np.testing.assert_allclose(scaled_diagonal, diagonal * units**2, rtol=1e-13)
    np.testing.assert_allclose(scaled_upper, upper * units[:, None] / units[None, :], rtol=1e-9)


@pytest.mark.parametrize("size", [2, 4])
def test_what_the_data_do_not_tell_gets_a_large_variance_and_not_an_infinite_one(size: int) -> None:
    """A direction without information: its variance is bounded by 1/LEAST_PIVOT, the others stay right."""
    generator = np.random.default_rng(size)
    phi = generator.standard_normal((100, size))
    phi[:, -1] = phi[:, 0]
    upper, diagonal = factor_information(phi.T @ phi)
    assert_factors(upper, diagonal)
    covariance = compose(upper, diagonal)
    assert np.isfinite(covariance).all()
    unknown = np.zeros(size)
    unknown[[0, -1]] = 1.0, -1.0
    assert unknown @ covariance @ unknown > 0.01 / LEAST_PIVOT / np.trace(phi.T @ phi)
    known = np.zeros(size)
    known[[0, -1]] = 1.0, 1.0
    kept = phi[:, :-1]
    one = np.eye(size - 1)[0]
    assert known @ covariance @ known / 4 <= one @ np.linalg.inv(kept.T @ kept) @ one * (1 + 1e-3) + 1e3 * LEAST_PIVOT


def test_no_information_at_all() -> None:
    upper, diagonal = factor_information(np.zeros((3, 3)))
    assert_factors(upper, diagonal)
    assert np.isfinite(compose(upper, diagonal)).all()


@every("seed", range(5))
def test_the_larger_of_two_covariances_has_the_larger_variances(seed: int) -> None:
    """And the first one's correlations; where the first is larger in every variance it is left as it is."""
    one, other = positive(seed, 4), positive(seed + 100, 4, 10.0)
    result = larger(one, other)
    np.testing.assert_allclose(np.diag(result), np.maximum(np.diag(one), np.diag(other)), rtol=1e-12)
    correlation, expected = (m / np.sqrt(np.outer(np.diag(m), np.diag(m))) for m in (result, one))
    np.testing.assert_allclose(correlation, expected, rtol=1e-12)
    assert np.linalg.eigvalsh(result).min() > 0
    np.testing.assert_array_equal(larger(one, 1e-9 * other), one)


@pytest.mark.parametrize("nothing", [0.0, 1e-320, 1e-40])
def test_a_covariance_that_vanishes_yields_to_the_other(nothing: float) -> None:
    """A residual that its own past explains to rounding has no innovation: no overflow, the plain one."""
    white = positive(0, 3)
    np.testing.assert_array_equal(larger(nothing * np.eye(3), white), white)
    vanishing = np.diag([1.0, nothing, 1.0])
    np.testing.assert_array_equal(larger(vanishing, white), white)


@every("seed", range(40))
def test_information_of_any_rank_has_factors(seed: int) -> None:
    """Directions that are told by rounding alone, entries beside a floored pivot that are not zero."""
    generator = np.random.default_rng(seed)
    size = int(generator.integers(2, 14))
    rank = int(generator.integers(1, size + 1))
    columns = generator.standard_normal((40, rank)) @ generator.standard_normal((rank, size))
    columns *= 10.0 ** generator.uniform(-6.0, 6.0, size)
    information = columns.T @ columns
    information += 1e-9 * np.sqrt(np.outer(np.diag(information), np.diag(information))) * generator.standard_normal()
    upper, diagonal = factor_information(information)
    assert_factors(upper, diagonal)
    assert np.isfinite(upper).all()
    assert np.isfinite(diagonal).all()


def test_a_direction_that_is_not_told_leaves_the_others_alone() -> None:
    """What stands below a floored pivot is rounding: divided by the floor it was 1e4 and more, and ran away."""
    information = np.eye(4)
    information[1, 1] = 1.0
    information[0, 1] = information[1, 0] = 1.0  # entries alike: the second pivot is zero,
    information[1, 2] = information[2, 1] = 1e-6  # ... and this is left below it
    upper, diagonal = factor_information(information)
    covariance = compose(upper, diagonal)
    assert covariance[2, 2] == pytest.approx(1.0, rel=1e-3)
    assert covariance[3, 3] == pytest.approx(1.0)
    assert covariance[1, 1] >= 0.9 / LEAST_PIVOT


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_information_that_is_no_number_gives_factors_that_are_none(value: float) -> None:
    information = np.eye(3)
    information[2, 2] = value
    upper, diagonal = factor_information(information)
    assert not (np.isfinite(upper).all() and np.isfinite(1.0 / diagonal).all() and (1.0 / diagonal > 0.0).all())
