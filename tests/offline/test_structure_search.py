"""The search finds the structure that made the data, and says why not the others."""

import numpy as np
import pytest

import replant as rp
from replant.offline.structure_search import search
from replant.signals import prbs, white_noise

U = prbs(2000, hold=8)


@pytest.mark.parametrize(
    ("num", "den", "delay"),
    [([2.0], [1.0, 4.0, 3.0], 0.0), ([3.0, 2.0], [1.0, 2.0, 10.0], 0.0), ([2.0], [1.0, 1.0], 0.4)],
)
def test_the_true_structure_is_chosen(num, den, delay) -> None:
    true = rp.TransferFunction(num, den, delay)
    x = true.simulate(U, 0.05)
    y = x + white_noise(U.size, 0.1 * float(x.std()), seed=3)
    found = search(U, y, 0.05, poles=(1, 2, 3), delays=(0.0, 0.2, 0.4))
    structure = found.best.structure
    assert (structure.poles, structure.zeros, structure.delay) == (len(den) - 1, len(num) - 1, delay)
    assert len(found.candidates) == 3 * (1 + 2 + 3)
    # what noise leaves of the fit; over 600 samples its power is known to 6 %, a third of a point
    possible = 100 * (1 - 0.1 * x.std() / y[1400:].std())
    best = max(candidate.held_out for candidate in found.candidates)
    assert best == pytest.approx(possible, abs=1.0)


def test_held_out_samples_are_not_fitted() -> None:
    """What happens in the last 30 % changes the held-out fit and not the criterion of the part that was fitted."""
    x = rp.TransferFunction([2.0], [1.0, 1.0]).simulate(U, 0.05)
    y = x + white_noise(U.size, 0.05, seed=4)
    broken = y.copy()
    broken[1400:] = white_noise(600, 1.0, seed=5)
    (good,) = search(U, y, 0.05, poles=(1,)).candidates
    (bad,) = search(U, broken, 0.05, poles=(1,)).candidates
    assert good.criterion == bad.criterion
    assert good.held_out > 90.0
    assert bad.held_out < 10.0


def test_an_impossible_grid_and_a_dead_record_are_refused() -> None:
    with pytest.raises(rp.InvalidArgumentError, match="fewer than poles"):
        search(U, U, 0.05, poles=(1, 2), zeros=(2, 3))
    with pytest.raises(rp.InvalidArgumentError, match="does the input move"):
        search(np.ones(500), white_noise(500, 1.0), 0.05, poles=(1, 2))
