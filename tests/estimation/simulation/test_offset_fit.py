"""Fit percent, and the free run with offset and initial state."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy import signal

import replant as rp
from replant.estimation.simulation.fitted_run import FittedRun
from replant.verdict import simulate
from support.builders import G1, G2, binary, random_plant
from support.cases import every

Y = np.random.default_rng(0).standard_normal(300)


# --- fit percent


def test_the_anchors_of_fit_percent() -> None:
    assert rp.fit_percent(Y, Y) == 100.0
    assert rp.fit_percent(Y, np.full(300, Y.mean())) == pytest.approx(0.0, abs=1e-12)
    assert rp.fit_percent(Y, 2 * Y.mean() - Y) == pytest.approx(-100.0)


def test_fit_percent_falls_with_the_size_of_the_error_and_not_with_the_unit() -> None:
    error = np.random.default_rng(1).standard_normal(300)
    spread = np.linalg.norm(Y - Y.mean())
    for size in (1e-9, 0.1, 3.0):
        expected = 100 * (1 - size * np.linalg.norm(error) / spread)
        assert rp.fit_percent(Y, Y + size * error) == pytest.approx(expected, rel=1e-6)
        assert rp.fit_percent(1e6 * Y + 5, 1e6 * (Y + size * error) + 5) == pytest.approx(expected, rel=1e-6)


def test_samples_that_are_not_finite_are_left_out() -> None:
    model = Y + 0.1 * np.random.default_rng(1).standard_normal(300)
    holes_y, holes_model = Y.copy(), model.copy()
    holes_y[5], holes_y[6], holes_model[7] = np.nan, np.inf, np.nan
    kept = np.delete(np.arange(300), [5, 6, 7])
    assert rp.fit_percent(holes_y, holes_model) == rp.fit_percent(Y[kept], model[kept])


@every("measured", [*(np.full(1000, constant) for constant in (0.0, 0.1, -1e300, 1e-300)), [], [np.nan, np.inf]])
def test_a_constant_output_or_none_has_no_fit(measured: Any) -> None:
    """Also where its mean is not exactly its value: 1000 times 0.1."""
    assert math.isnan(rp.fit_percent(measured, np.zeros(len(measured))))


def test_a_model_that_left_float64_fits_infinitely_badly() -> None:
    assert rp.fit_percent(Y, np.full(300, np.inf)) == -math.inf
    assert rp.fit_percent(Y, np.full(300, 1e300)) < -1e100


@every(
    ("measured", "modelled", "named"),
    [
        ([1.0, 2.0], [1.0], "measured and modelled must have the same length, got 2 and 1 samples"),
        ("ab", [1.0, 2.0], "measured"),
        ([1.0, 2.0], [1j, 1.0], "modelled"),
        ([[1.0], [2.0]], [1.0, 2.0], "measured"),
        (None, None, "measured"),
    ],
    ids=repr,
)
def test_bad_arguments_are_refused_by_name(measured: Any, modelled: Any, named: str) -> None:
    with pytest.raises((rp.InvalidArgumentError, rp.ArgumentTypeError), match=named):
        rp.fit_percent(measured, modelled)


# --- the free run


@every("plant", [G1, G2, random_plant(1, 4, 2), rp.TransferFunction([1.0], [1.0, 0.3, 0.0])])
@every("offset", [0.0, -7.0])
def test_offset_and_initial_state_are_found_exactly(plant: rp.TransferFunction, offset: float) -> None:
    """SciPy's run from a random state, plus a constant: the model explains it all."""
    dt, u = 0.05, binary(2, 400, 7)
    states = signal.StateSpace(*signal.tf2ss(plant.num, plant.den))
    start = np.random.default_rng(3).standard_normal(plant.den.size - 1)
    _, y, _ = signal.lsim(states, u, dt * np.arange(400), X0=start, interp=False)
    simulation = simulate(plant, u, y + offset, dt)
    np.testing.assert_allclose(simulation.output, y + offset, atol=1e-7 * abs(y).max())
    assert simulation.fit > 99.9999
    if plant.den[-1] != 0:  # an integrator's state and an offset are the same thing
        assert simulation.offset == pytest.approx(offset, abs=1e-6 * abs(y).max())


def test_the_offset_of_a_plant_without_states_is_the_mean_misfit() -> None:
    plant, u = rp.TransferFunction([2.0], [1.0]), binary(1, 100)
    noise = np.random.default_rng(0).standard_normal(100)
    assert simulate(plant, u, 2 * u + noise, 0.1).offset == pytest.approx(noise.mean(), rel=1e-9)


def test_holes_in_the_output_do_not_matter_to_a_true_model() -> None:
    u = binary(4, 300, 5)
    y = G1.simulate(u, 0.1) + 3.0
    y[[0, 50, 51, 299]] = np.nan
    simulation = simulate(G1, u, y, 0.1)
    assert np.isfinite(simulation.output).all()
    assert simulation.fit > 99.9999
    assert simulation.offset == pytest.approx(3.0)


def test_a_hole_in_the_input_is_bridged_by_the_last_value() -> None:
    u = binary(4, 300, 5)
    holes = u.copy()
    holes[[1, 2, 102]] = np.nan, np.inf, -np.inf  # within bits: the last value is the true one
    np.testing.assert_array_equal(simulate(G1, holes, Y, 0.1).output, simulate(G1, u, Y, 0.1).output)
    first = u.copy()
    first[0] = np.nan  # before the first value the input is at rest, which it is
    np.testing.assert_array_equal(simulate(G1, first, Y, 0.1).output, simulate(G1, u, Y, 0.1).output)


@pytest.mark.parametrize("cuts", [[], [120], [101, 105, 160]])
def test_a_longer_hole_in_the_input_is_a_gap(cuts: list[int]) -> None:
    """Its outputs say nothing, and the state behind it is another one; the same of all batches."""
    u = binary(4, 300, 5)
    u[95:102] = 1.0  # the first two samples of the hole have the last value
    y = G1.simulate(u, 0.1) + 3.0
    u[100:130], y[103:130] = np.nan, 1e3
    run, ends = FittedRun(G1, 0.1), [0, *cuts, u.size]
    outputs, known = zip(*[run.take(u[a:b], y[a:b]) for a, b in pairwise(ends)], strict=True)
    assert np.flatnonzero(np.isnan(np.concatenate(known))).tolist() == list(range(102, 130))
    np.testing.assert_allclose(np.concatenate(outputs)[130:], y[130:], rtol=1e-9)


def test_a_model_that_explodes_and_no_output_at_all_are_told_and_do_not_crash() -> None:
    simulation = simulate(rp.TransferFunction([1.0], [1.0, -1e4]), binary(1, 300), Y, 0.1)
    assert simulation.fit == -math.inf
    assert np.isnan(simulation.output).all()
    assert simulate(G1, binary(1, 300), np.full(300, np.nan), 0.1).fit == -math.inf


def with_gaps(plant: rp.TransferFunction, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Input, output and stamps of a record that begins in motion, with two gaps, the input moving meanwhile."""
    u = binary(5, 900, 7)
    kept = np.concatenate([np.arange(100, 300), np.arange(340, 600), np.arange(650, 900)])
    return u[kept], plant.simulate(u, dt)[kept], dt * kept


@every("plant", [G1, G2, random_plant(1, 4, 2), rp.TransferFunction([1.0, 2.0], [1.0, 0.7], 0.23)])
def test_behind_each_gap_the_state_is_found_anew_and_the_offset_is_common(plant: rp.TransferFunction) -> None:
    u, y, t = with_gaps(plant, 0.1)
    simulation = simulate(plant, u, y + 3.0, 0.1, t=t)
    assert simulation.fit > 99.99999
    assert simulation.offset == pytest.approx(3.0, abs=1e-7 * max(1.0, abs(y).max()))


def test_the_offset_of_an_integrator_is_that_of_its_states() -> None:
    """Nothing tells the two apart: it is 0, whether there are gaps or not."""
    plant = rp.TransferFunction([1.0], [1.0, 0.3, 0.0])
    u, y, t = with_gaps(plant, 0.1)
    for stamps in (None, 0.1 * np.arange(200)):
        simulation = simulate(plant, u[:200], y[:200] + 40.0, 0.1, t=stamps)
        assert simulation.offset == 0.0
        assert simulation.fit > 99.99999
    simulation = simulate(plant, u, y + 40.0, 0.1, t=t)
    assert simulation.offset == 0.0
    assert simulation.fit > 99.99999


@every("delay", [0.0, 0.3, 0.32])
@every("hold", ["zoh", "foh"])
def test_a_regular_clock_given_as_stamps_is_the_regular_clock(delay: float, hold: str) -> None:
    plant = rp.TransferFunction([2.0, 1.0], [1.0, 0.5], delay)
    u = np.random.default_rng(0).standard_normal(300)
    y = plant.simulate(u, 0.1, input_hold=hold) + 0.1 * Y
    y[[4, 50]], u[7] = np.nan, np.nan
    one = simulate(plant, u[50:], y[50:], 0.1, input_hold=hold)
    other = simulate(plant, u[50:], y[50:], 0.1, input_hold=hold, t=3.0 + 0.1 * np.arange(250))
    np.testing.assert_allclose(other.output, one.output, atol=1e-10)
    assert (other.fit, other.offset) == pytest.approx((one.fit, one.offset), abs=1e-9)
