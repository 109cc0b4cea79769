"""The search finds the structure that made the data, and says why not the others."""

import numpy as np
import pytest

import replant as rp
from replant.fitting.search_result import top_of_parabola
from replant.fitting.structure_search import search
from replant.signals import prbs, white_noise

U = prbs(2000, hold=8)


@pytest.mark.parametrize(
    ("num", "den", "delay"),
    [
        pytest.param([2.0], [1.0, 4.0, 3.0], 0.0, marks=pytest.mark.slow),
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
    # what noise leaves of the fit; over 2,000 samples its power is known to 3 %, a third of a point of fit
    assert found.chosen.fit == pytest.approx(100 * (1 - 0.1 * x.std() / y.std()), abs=1.0)


def step_test(plant: rp.TransferFunction, samples: int, noise: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A step from rest at a tenth of the record; the noise as a part of the step's answer."""
    u = np.where(np.arange(samples) < samples // 10, 1.0, 3.0)
    y = plant.simulate(u - 1.0, 0.5) + 20.0
    return u, y + white_noise(samples, noise * 2.0 * abs(plant.dc_gain), seed=seed)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("samples", "grid"),
    [(120, 1.0), pytest.param(120, 0.5, marks=pytest.mark.slow), pytest.param(300, 0.5, marks=pytest.mark.slow)],
)
def test_a_step_test_tells_order_and_dead_time(samples: int, grid: float) -> None:
    """The input is constant but for one step, and the dead times of the grid are longer than the rest before it."""
    for num, den in (([0.4], [1.0, 0.2]), ([0.5], [1.0, 0.3, 0.25])):
        plant = rp.TransferFunction(num, den, 2.5)
        delays = np.arange(0.0, 8.0, grid)
        found = search(*step_test(plant, samples, 0.01, 3), 0.5, poles=(1, 2), zeros=0, delays=delays)
        assert found.best.structure.poles == len(den) - 1, den
        assert abs(found.best.structure.delay - 2.5) < 2 * 0.5, den


def test_a_first_output_that_is_bad_makes_no_pole() -> None:
    """A sensor that gives 0 when it is read for the first time; a fast pole with an initial state would explain it."""
    y = rp.TransferFunction([2.0], [1.0, 2.0]).simulate(U, 0.05) + 5.0 + white_noise(U.size, 0.02, seed=4)
    y[0] = 0.0
    assert search(U, y, 0.05, poles=(2, 1)).chosen.structure == rp.Structure(1)


@pytest.mark.slow
def test_of_structures_alike_the_simpler_one_is_chosen() -> None:
    """Of a lag with noise, a second pole far away fits as well: it costs ln(K) / 2 for itself and for its state."""
    y = rp.TransferFunction([2.0], [1.0, 1.0]).simulate(U, 0.05)
    y = y + white_noise(U.size, 0.3, seed=6)
    found = search(U, y, 0.05, poles=(1, 2, 3))
    assert found.chosen.structure == rp.Structure(1)
    (larger,) = [each for each in found.candidates if each.structure == rp.Structure(2, 1)]
    assert larger.likelihood > found.chosen.likelihood - 0.1  # it holds the smaller one
    assert larger.criterion > found.chosen.criterion
    alone = search(U, y, 0.05, poles=3, zeros=2)  # nothing else to choose
    assert alone.best.structure == rp.Structure(3, 2)


def test_the_criterion_is_the_likelihood_and_a_price() -> None:
    """White noise of known power: the log-likelihood is that of the normal distribution at its own variance."""
    noise = white_noise(U.size, 0.05, seed=4)
    y = rp.TransferFunction([2.0], [1.0, 1.0]).simulate(U, 0.05) + noise
    (only,) = search(U, y, 0.05, poles=1).candidates
    expected = -0.5 * U.size * (1.0 + np.log(2.0 * np.pi * np.mean(noise**2)))
    # two coefficients, an offset and a state take half a chi-square of four degrees off: below 12 but for 1e-4
    assert 0.0 < only.likelihood - expected < 12.0
    assert only.criterion == pytest.approx(3.0 * np.log(U.size) - 2.0 * only.likelihood)


def test_what_the_autoregression_explains_is_paid() -> None:
    """Noise with a pole near one takes no pole of the plant's away, and adds none."""
    noise = np.convolve(white_noise(U.size, 0.05, seed=5), 0.9 ** np.arange(100))[: U.size]
    for num, den in (([2.0], [1.0, 1.0]), ([2.0], [1.0, 4.0, 3.0])):
        y = rp.TransferFunction(num, den).simulate(U, 0.05) + noise
        assert search(U, y, 0.05, poles=(1, 2, 3), zeros=0).best.structure.poles == len(den) - 1


@pytest.mark.slow
def test_single_numbers_are_a_grid() -> None:
    y = rp.TransferFunction([2.0], [1.0, 1.0]).simulate(U, 0.05) + white_noise(U.size, 0.05, seed=9)
    found = search(U, y, 0.05, poles=2, zeros=0, delays=0.1)
    assert [each.structure for each in found.candidates] == [rp.Structure(2, 0, 0.1)]


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


@pytest.mark.parametrize(
    ("u", "y", "grid", "message"),
    [
        *((U, U, {"poles": [1], name: []}, f"{name} is empty: give the values to try")
          for name in ("poles", "zeros", "delays")),
        (U, U, {"poles": (1, 2), "zeros": (2, 3)}, "fewer than poles"),
        (np.ones(500), white_noise(500, 1.0), {"poles": (1, 2)}, "does the input move"),
    ],
    ids=["no poles", "no zeros", "no delays", "too many zeros", "a dead record"],
)  # fmt: skip
def test_nothing_to_try_or_nothing_to_try_it_on_is_named(u, y, grid, message) -> None:
    with pytest.raises(rp.InvalidArgumentError, match=message):
        rp.search(u, y, 0.05, **grid)


def test_a_dead_time_costs_no_fit_behind_a_gap() -> None:
    """The record begins in motion, far from zero; behind the gap the input of the dead time is not known."""
    plant = rp.TransferFunction([3.0], [1.0, 2.0], delay=0.1)
    u = 20.0 + np.repeat(np.random.default_rng(3).choice([-1.0, 1.0], 260), 10)
    y = plant.simulate(np.concatenate([np.full(500, 20.0), u]), 0.02)[500:]
    kept = np.concatenate([np.arange(1900), np.arange(2050, u.size)])
    t = 0.02 * np.arange(u.size)
    found = rp.search(u[kept], y[kept], 0.02, poles=[1], zeros=[0], delays=[0.1], t=t[kept])
    assert found.chosen.fit > 99.9
    assert found.best.simulation.fit > 99.9
    error = y[kept] - found.best.simulation.output
    assert np.abs(error[1900 + 5 :]).max() < 1e-6
    assert np.abs(error).max() < 2.0  # where nothing is known the simulation stays near, too


def test_gross_outliers_cost_no_fit() -> None:
    u = prbs(3000, hold=10, bits=9)
    y = rp.TransferFunction([3.0], [1.0, 2.0]).simulate(u, 0.02) + white_noise(3000, 0.05)
    clean = search(u, y, 0.02, poles=[1], zeros=[0])
    y[[300, 1500, 2700]] = 9999.0
    found = search(u, y, 0.02, poles=[1], zeros=[0])
    assert found.chosen.fit == pytest.approx(clean.chosen.fit, abs=0.2)


def test_the_top_of_a_parabola_lies_between_the_best_value_and_its_neighbours() -> None:
    assert top_of_parabola({0.0: 1.0, 1.0: 3.0, 2.0: 1.0}, 0.0, 2.0) == (1.0, 0.0)
    assert top_of_parabola({1.0: 1.0, 2.0: 3.0, 3.0: 3.0}, 1.0, 3.0) == (2.5, 0.25)
    assert top_of_parabola({1.0: 1.0, 2.0: 3.0}, 1.0, 3.0) == (1.5, np.inf)
