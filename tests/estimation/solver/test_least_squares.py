"""Least squares on regressors: optimality, invariance, and regressors that do not tell parameters apart."""

from __future__ import annotations

import numpy as np
import pytest

from replant.estimation.solver.least_squares import least_squares

GENERATOR = np.random.default_rng(0)
PHI = GENERATOR.standard_normal((200, 4)) @ GENERATOR.standard_normal((4, 4))
TARGET = GENERATOR.standard_normal(200)


def test_it_equals_numpy_and_leaves_an_orthogonal_residual() -> None:
    solution = least_squares(PHI, TARGET)
    np.testing.assert_allclose(solution.parameters, np.linalg.lstsq(PHI, TARGET, rcond=None)[0], rtol=1e-11)
    residual = TARGET - PHI @ solution.parameters
    assert (abs(PHI.T @ residual) < 1e-12 * np.linalg.norm(PHI) * np.linalg.norm(TARGET)).all()
    assert solution.rank == 4


@pytest.mark.parametrize("scale", [[1e-12, 1.0, 1e12, 1e3], [1e-200, 1e200, 1.0, 1.0], [1e-300, 1e-300, 1e150, 1e-10]])
def test_units_of_the_regressor_matter_neither_to_rank_nor_to_condition(scale: list[float]) -> None:
    plain, scaled = least_squares(PHI, TARGET), least_squares(PHI * scale, TARGET)
    np.testing.assert_allclose(scaled.parameters * scale, plain.parameters, rtol=1e-9)
    assert scaled.rank == 4
    assert scaled.condition == pytest.approx(plain.condition, rel=1e-9)


def test_the_condition_is_that_of_columns_of_length_one() -> None:
    expected = np.linalg.cond(PHI / np.linalg.norm(PHI, axis=0))
    assert least_squares(PHI, TARGET).condition == pytest.approx(expected, rel=1e-10)
    orthogonal, _ = np.linalg.qr(PHI)
    assert least_squares(orthogonal * [1.0, 10.0, 1e5, 1e-5], TARGET).condition == pytest.approx(1.0, rel=1e-10)


def test_rows_that_are_not_finite_are_left_out() -> None:
    phi, target = PHI.copy(), TARGET.copy()
    phi[3, 0], phi[17, 2], target[50] = np.nan, np.inf, -np.inf
    kept = np.delete(np.arange(200), [3, 17, 50])
    expected = least_squares(PHI[kept], TARGET[kept])
    np.testing.assert_array_equal(least_squares(phi, target).parameters, expected.parameters)


def test_columns_that_depend_on_each_other_lower_the_rank_and_share() -> None:
    """Twice the same column: of all solutions that with the two equal shares has the least norm."""
    phi = np.column_stack([PHI[:, :2], PHI[:, 0]])
    solution = least_squares(phi, TARGET)
    single = least_squares(PHI[:, :2], TARGET)
    assert solution.rank == 2
    assert solution.condition > 1e10
    assert solution.parameters[0] == pytest.approx(solution.parameters[2], rel=1e-9)
    assert solution.parameters[0] + solution.parameters[2] == pytest.approx(single.parameters[0], rel=1e-9)


def test_a_silent_column_gets_nothing() -> None:
    solution = least_squares(np.column_stack([PHI[:, 0], np.zeros(200)]), TARGET)
    assert (solution.rank, solution.condition, solution.parameters[1]) == (1, np.inf, 0.0)


@pytest.mark.parametrize("rows", [0, 1, 3])
def test_too_few_rows_give_an_infinite_condition(rows: int) -> None:
    solution = least_squares(PHI[:rows], TARGET[:rows])
    assert solution.condition == np.inf
    assert solution.rank == rows
    assert np.isfinite(solution.parameters).all()
    np.testing.assert_allclose(PHI[:rows] @ solution.parameters, TARGET[:rows], rtol=1e-9)
