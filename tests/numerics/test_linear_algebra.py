"""Linear algebra without exceptions: what has no answer is NaN or None."""

from __future__ import annotations

import numpy as np
import pytest

from replant.model.transfer_function import TransferFunction
from replant.numerics.linear_algebra import eigenvalues, least_norm, pseudo_inverse, roots, solve
from replant.numerics.projections import Equations
from support.cases import every

NOT_NUMBERS = [np.nan, np.inf, -np.inf]


@every("value", NOT_NUMBERS)
@every("place", range(3))
def test_numbers_that_are_none_give_no_answer(value: float, place: int) -> None:
    matrix = np.diag([3.0, 2.0, 1.0])
    matrix[place, place] = value
    ones = np.ones(3)
    assert not np.isfinite(eigenvalues(matrix)).any()
    assert not np.isfinite(pseudo_inverse(matrix, 1e-14)).any()
    assert solve(matrix, ones) is None
    assert solve(np.eye(3), np.where(np.arange(3) == place, value, 1.0)) is None
    assert least_norm(matrix, ones, 1e-10)[1] == 0
    assert roots(np.array([1.0, *np.where(np.arange(3) == place, value, 1.0)])).shape == (3,)


@every("size", [1, 2, 5, 20])
def test_singular_matrices_and_all_scales_are_answered(size: int) -> None:
    generator = np.random.default_rng(size)
    for scale in (1e-300, 1e-160, 1.0, 1e160, 1e300):
        column = generator.standard_normal((size, 1))
        singular = scale * (column @ column.T)
        assert solve(np.zeros((size, size)), np.ones(size)) is None
        found = solve(singular, np.ones(size))
        assert found is None or np.isfinite(found).all()
        assert eigenvalues(singular).shape == (size,)
        found, rank, _ = least_norm(singular, np.ones(size), 1e-10)
        assert np.isfinite(found).all()
        assert rank <= 1


def test_roots_beyond_float64_are_not_a_number() -> None:
    model = TransferFunction([1e-300, 1e10], [1.0, 1e300, 1.0])
    assert np.isnan(model.zeros).all()
    assert model.poles.shape == (2,)


@pytest.mark.parametrize("samples", [2047, 2049, 4096, 30000])
@pytest.mark.parametrize("targets", [(), (2,)])
def test_least_squares_in_blocks_are_those_of_all_rows(samples: int, targets: tuple[int, ...]) -> None:
    rng = np.random.default_rng(samples)
    columns = rng.normal(size=(samples, 4)) @ np.diag([1.0, 1e6, 1e-6, 1.0])
    columns[:, 3] = columns[:, 0]  # one direction is not there
    target = rng.normal(size=(samples, *targets))
    found, rank, singular = least_norm(columns, target, 1e-14)
    wanted, _, wanted_rank, wanted_singular = np.linalg.lstsq(columns, target, rcond=1e-14)
    assert rank == wanted_rank == 3
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-9 * np.abs(wanted).max())
    np.testing.assert_allclose(singular[:3], wanted_singular[:3], rtol=1e-9)


@every("damping", [0.0, 1e-6, 1e-3, 10.0])
def test_one_decomposition_serves_each_damping(damping: float) -> None:
    """In any units; a direction without information does not move, nor does anything without a number."""
    columns = np.random.default_rng(1).standard_normal((20, 4)) * [1e-6, 1.0, 1e3, 1e8]
    matrix, vector = columns.T @ columns, columns[0]
    exact = np.linalg.solve(matrix + damping * np.diag(np.diag(matrix)), vector)
    assert Equations.of(matrix).solved(vector, damping) == pytest.approx(exact, rel=1e-9)
    wider = np.pad(matrix, (0, 1))
    assert Equations.of(wider).solved(np.append(vector, 0.0), damping) == pytest.approx([*exact, 0.0], rel=1e-9)
    assert not Equations.of(np.full((4, 4), np.nan)).solved(vector, damping).any()
