"""The search finds the structure that made the data, and says why not the others."""

import numpy as np
import pytest

import replant as rp
from replant.offline.structure_search import search
from replant.signals import prbs, white_noise

U = prbs(2000, hold=8)


@pytest.mark.parametrize(
    ("num", "den", "delay"),
    [
        ([2.0], [1.0, 4.0, 3.0], 0.0),
        pytest.param([3.0, 2.0], [1.0, 2.0, 10.0], 0.0, marks=pytest.mark.slow),
        ([2.0], [1.0, 1.0], 0.4),
    ],
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
    assert bad.held_out < 60.0
    assert (bad.stretches[:3] > good.stretches[:3] + 4.0).all()  # of the end, by a model of what came before


def test_either_end_is_held_out() -> None:
    """A plant that differs in the first 30 % is as bad for a structure as one that differs in the last."""
    parts = [rp.TransferFunction([gain], [1.0, 1.0]).simulate(U, 0.05) for gain in (2.0, 3.0)]
    late, early = np.where(np.arange(U.size) < 1400, *parts), np.where(np.arange(U.size) < 600, *parts[::-1])
    fits = [search(U, y, 0.05, poles=(1,)).candidates[0].held_out for y in (late, early)]
    assert max(fits) < 80.0
    assert fits[0] == pytest.approx(fits[1], abs=10.0)


def test_a_structure_with_a_coefficient_that_is_not_known_is_not_chosen() -> None:
    """Of a lag with noise, a second pole far away fits as well, and nobody knows where it is."""
    y = rp.TransferFunction([2.0], [1.0, 1.0]).simulate(U, 0.05)
    y = y + white_noise(U.size, 0.3, seed=6)
    found = search(U, y, 0.05, poles=(1, 2, 3))
    assert found.chosen.structure == rp.Structure(1)
    assert found.chosen.is_known
    assert any(not candidate.is_known for candidate in found.candidates)
    alone = search(U, y, 0.05, poles=(3,), zeros=(2,))  # nothing else to choose
    assert alone.best.structure == rp.Structure(3, 2)


@pytest.mark.parametrize("delay", [0.13, 0.31])
def test_a_dead_time_is_found_between_the_points_of_the_grid(delay: float) -> None:
    y = rp.TransferFunction([2.0], [1.0, 1.0], delay).simulate(U, 0.05) + white_noise(U.size, 0.05, seed=7)
    found = search(U, y, 0.05, poles=(1,), delays=(0.0, 0.1, 0.2, 0.3, 0.4))
    assert abs(found.chosen.structure.delay - delay) < 0.1
    assert found.best.structure.delay == pytest.approx(delay, abs=0.01)


def test_an_integrator_is_kept() -> None:
    y = rp.TransferFunction([0.5], [1.0, 0.0]).simulate(U, 0.05)
    y = y + white_noise(U.size, 0.02, seed=8)
    found = search(U, y, 0.05, poles=(1, 2))
    assert found.best.structure == rp.Structure(1)
    assert abs(found.best.parameters[0]) < 0.01


def test_progress_begins_before_the_first_structure() -> None:
    seen: list[tuple[int, int]] = []
    y = rp.TransferFunction([2.0], [1.0, 1.0]).simulate(U, 0.05) + white_noise(U.size, 0.05, seed=9)
    search(U, y, 0.05, poles=(1, 2), progress=lambda done, of: seen.append((done, of)))
    assert seen == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_an_impossible_grid_and_a_dead_record_are_refused() -> None:
    with pytest.raises(rp.InvalidArgumentError, match="fewer than poles"):
        search(U, U, 0.05, poles=(1, 2), zeros=(2, 3))
    with pytest.raises(rp.InvalidArgumentError, match="does the input move"):
        search(np.ones(500), white_noise(500, 1.0), 0.05, poles=(1, 2))


def test_a_dead_time_costs_no_fit_behind_a_gap_of_the_part_held_out() -> None:
    """The record begins in motion, far from zero; behind the gap the input of the dead time is not known."""
    plant = rp.TransferFunction([3.0], [1.0, 2.0], delay=0.1)
    u = 20.0 + np.repeat(np.random.default_rng(3).choice([-1.0, 1.0], 260), 10)
    y = plant.simulate(np.concatenate([np.full(500, 20.0), u]), 0.02)[500:]
    kept = np.concatenate([np.arange(1900), np.arange(2050, u.size)])
    t = 0.02 * np.arange(u.size)
    found = rp.search(u[kept], y[kept], 0.02, poles=[1], zeros=[0], delays=[0.1], t=t[kept])
    assert found.chosen.held_out > 99.9
    assert found.best.simulation.fit > 99.9
    error = y[kept] - found.best.simulation.output
    assert np.abs(error[1900 + 5 :]).max() < 1e-6
    assert np.abs(error).max() < 2.0  # where nothing is known the simulation stays near, too


def test_gross_outliers_cost_no_held_out_fit() -> None:
    u = prbs(3000, hold=10, bits=9)
    y = rp.TransferFunction([3.0], [1.0, 2.0]).simulate(u, 0.02) + white_noise(3000, 0.05)
    clean = search(u, y, 0.02, poles=[1], zeros=[0])
    y[[300, 1500, 2700]] = 9999.0
    found = search(u, y, 0.02, poles=[1], zeros=[0])
    assert found.chosen.held_out == pytest.approx(clean.chosen.held_out, abs=0.2)
