"""A signal may be a list, a vector, or a single column: all of them give the result of the vector."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.errors import InvalidArgumentError
from replant.signals import prbs, white_noise

K, DT = 600, 0.1
U = np.column_stack([prbs(K, hold=8), prbs(K, hold=13)])
FIRST, SECOND = rp.TransferFunction([2.0], [1.0, 1.0]), rp.TransferFunction([1.0], [1.0, 2.0])
Y = FIRST.simulate(U[:, 0], DT) + white_noise(K, 0.02)
BOTH = Y + SECOND.simulate(U[:, 1], DT)
T = DT * np.arange(K)


def coefficients(found: Any) -> list[float]:
    best = getattr(found, "best", found)
    return best.model.parameters.tolist()


@pytest.mark.parametrize("way", [rp.fit, rp.run, rp.search])
def test_a_column_of_one_signal_is_that_signal(way: Any) -> None:
    """A column (K, 1), as tables and scikit-learn have it, counts as one signal: input, output, time, reference."""
    expected = coefficients(way(U[:, 0], Y, DT, poles=1, t=T, reference=U[:, 0]))
    columns = {"t": T[:, None], "reference": U[:, :1]}
    assert coefficients(way(U[:, :1], Y[:, None], DT, poles=1, **columns)) == expected


@pytest.mark.parametrize("way", [rp.fit, rp.run, rp.search])
def test_lists_of_rows_are_several_signals(way: Any) -> None:
    """Lists of rows count as arrays of that shape, and a list of poles as a tuple."""
    expected = coefficients(way(U, BOTH, DT, poles=(1, 1)))
    assert coefficients(way(U.tolist(), BOTH.tolist(), DT, poles=[1, 1])) == expected
    both = way(U.tolist(), np.column_stack([BOTH, Y]).tolist(), DT, poles=(1, 1))
    assert coefficients(getattr(both, "outputs", getattr(both, "rows", None))[0]) == expected


@pytest.mark.parametrize("way", [rp.fit, rp.run])
def test_a_vector_is_the_input_of_a_row_of_one(way: Any) -> None:
    expected = coefficients(way(U[:, :1], Y, DT, poles=(1,)))
    assert coefficients(way(U[:, 0], Y, DT, poles=(1,))) == expected


@pytest.mark.parametrize("way", [rp.fit, rp.run])
def test_rows_in_place_of_columns_are_told_by_their_number(way: Any) -> None:
    """Signals as rows, as MATLAB writes them, are told as that, and not as 600 inputs without poles."""
    with pytest.raises(InvalidArgumentError, match="u has 2 rows and y 600 samples"):
        way(U.T, BOTH, DT, poles=(1, 1))


def test_poles_of_more_inputs_than_there_are_is_told() -> None:
    with pytest.raises(InvalidArgumentError, match="poles has 2 entries and u 1 input: give one entry for each"):
        rp.fit(U[:, 0], Y, DT, poles=(1, 1))


def test_models_take_columns_too() -> None:
    model, row = rp.fit(U[:, 0], Y, DT, poles=1).model, rp.fit(U[:, 0], Y, DT, poles=(1,)).model
    assert model.score(U[:, :1], Y[:, None]) == model.score(U[:, 0], Y)
    assert row.score(U[:, 0], Y[:, None]) == row.score(U[:, :1], Y)
    assert model.simulate(U[:, :1]).shape == row.simulate(U[:, 0]).shape == (K,)


def test_identifiers_take_columns_too() -> None:
    columns, vectors = (rp.Identifier(poles=1, dt=DT) for _ in range(2))
    columns.update_many(U[:, :1], Y[:, None])
    vectors.update_many(U[:, 0], Y)
    assert columns.parameters.tolist() == vectors.parameters.tolist()
    one, other = (rp.Identifier(poles=(1,), dt=DT) for _ in range(2))
    one.update_many(U[:, 0], Y)
    other.update_many(U[:, :1], Y)
    assert one.parameters.tolist() == other.parameters.tolist()
