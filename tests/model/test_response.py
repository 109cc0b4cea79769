"""A run that goes on batch by batch is the run over the whole input."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from replant.model.response import Response
from replant.model.transfer_function import TransferFunction

DT = 0.1
MODELS = {
    "first order": TransferFunction([2.0], [1.0, 0.5]),
    "third order": TransferFunction([1.0, 3.0], [1.0, 2.0, 5.0, 4.0]),
    "unstable": TransferFunction([1.0], [1.0, -0.3]),
    "at once": TransferFunction([2.0, 1.0], [1.0, 1.0]),
    "a constant": TransferFunction([3.0], [1.0]),
    "late by whole samples": TransferFunction([2.0], [1.0, 0.5], 0.7),
    "late by a fraction": TransferFunction([2.0, 1.0], [1.0, 0.5], 0.325),
}
CUTS = [(200,), (1,) * 200, (3, 0, 150, 47), (199, 1)]


@pytest.mark.parametrize("cuts", CUTS, ids=map(len, CUTS))
@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("name", MODELS)
def test_batches_join_to_the_whole(name: str, hold: str, cuts: tuple[int, ...]) -> None:
    model, u = MODELS[name], np.random.default_rng(0).standard_normal(200)
    response = Response(model, DT, hold)
    ends = np.cumsum([0, *cuts])
    found = np.concatenate([response.output(u[a:b]) for a, b in pairwise(ends)])
    np.testing.assert_allclose(found, model.simulate(u, DT, input_hold=hold), rtol=1e-11, atol=1e-12)
    free = np.concatenate([response.free(cut) for cut in cuts])
    np.testing.assert_allclose(free, model.free_responses(200, DT), rtol=1e-9, atol=1e-13)


def test_a_response_that_has_died_out_stays_zero() -> None:
    """Numbers near the end of float64's range would be slow ones."""
    response = Response(TransferFunction([1.0], [1.0, 50.0]), DT)
    assert response.free(100)[0, 0] != 0.0  # e^-500 by its end
    assert (response.free(100) == 0.0).all()
