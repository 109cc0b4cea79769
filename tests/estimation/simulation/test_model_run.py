"""A model's run for judging: its output, its slopes, offset and initial state taken out."""

from __future__ import annotations

import math

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.simulation.model_run import ModelRun, run_model
from replant.numerics.autoregression import whiteness
from replant.numerics.linear_algebra import products
from replant.numerics.projections import without
from replant.verdict.sensor_and_excitation import WORST_CONDITION, excitation
from support.builders import AWKWARD, DT, binary, irregular_record, true_parameters
from support.cases import every
from support.loops import DT as STEP
from support.loops import coloured, controlled, steps

every_plant = every("name", AWKWARD)


def run_of(name: str, u: np.ndarray, y: np.ndarray) -> ModelRun:
    structure, plant = AWKWARD[name]
    run = run_model(structure, true_parameters(plant, structure.zeros), Record(u, y, np.array([DT])), DT)
    assert run is not None
    return run


@every_plant
def test_its_output_is_that_of_the_transfer_function(name: str) -> None:
    u = binary(1, 600, 5)
    y = AWKWARD[name][1].simulate(u, DT)
    run = run_of(name, u, y)
    np.testing.assert_allclose(run.forced, y, atol=1e-9 * np.abs(y).max())
    assert np.abs(run.error).max() < 1e-9 * np.abs(y).max()


@every("name", [name for name, (structure, _) in AWKWARD.items() if not structure.delay])
def test_offset_and_initial_state_are_none_of_its_error(name: str) -> None:
    """A record that begins in the midst of motion, about another working point.

    Without dead time: what the input was before the record is no initial state.
    """
    u = binary(1, 900, 5)
    y = AWKWARD[name][1].simulate(u, DT)
    spread = np.abs(y).max()
    run = run_of(name, u[300:], y[300:] + 7.0 * spread)
    assert np.abs(run.error).max() < 1e-6 * spread


@every_plant
def test_its_slopes_are_those_of_the_output(name: str) -> None:
    """Against central differences, of the output less offset and initial state, which the step may trade for.

    The slopes take the output to run straight between samples: where it jumps they are a tenth off, else a percent.
    """
    structure, plant = AWKWARD[name]
    tolerance = 0.15 if structure.is_biproper else 0.01
    u, true = binary(2, 600, 5), true_parameters(plant, structure.zeros)
    run = run_of(name, u, plant.simulate(u, DT))
    for i in range(true.size):
        step = 1e-5 * max(abs(true[i]), 0.1)
        ends = []
        for sign in (1.0, -1.0):
            moved = true.copy()
            moved[i] += sign * step
            ends.append(structure.transfer_function(moved).simulate(u, DT))
        slope = (ends[0] - ends[1]) / (2.0 * step)
        difference = without((slope - run.zeta[:, i])[:, None], run.nuisances)[:, 0]
        assert np.linalg.norm(difference) < tolerance * np.linalg.norm(slope)


def test_irregular_intervals_are_taken_exactly() -> None:
    plant = rp.TransferFunction([2.0], [1.0, 4.0, 3.0])
    u, y, t = irregular_record(plant, seed=1, samples=600, dt=DT)
    run = run_model(rp.Structure(2), np.array([4.0, 3.0, 2.0]), Record(u, y, np.diff(t, prepend=t[0] - DT)), DT)
    assert run is not None
    np.testing.assert_allclose(run.error, 0.0, atol=1e-6)


@pytest.mark.parametrize("delay", [0.3 * DT, 7.0 * DT])
def test_stamps_that_repeat_their_intervals_are_taken_exactly_behind_a_dead_time(delay: float) -> None:
    """A record that begins in the midst of motion, on a clock of few different intervals, as whole milliseconds make.

    The discretisations of the pieces into which a dead time cuts an interval must not take the place of its own.
    """
    plant = rp.TransferFunction([2.0], [1.0, 0.5], delay)
    u, y, t = irregular_record(plant, seed=4, samples=600, dt=DT, jitter=0.4)
    late = Record(u[100:], y[100:] + 7.0, np.diff(t[100:], prepend=t[100] - DT))
    run = run_model(rp.Structure(1, delay=delay), np.array([0.5, 2.0]), late, DT)
    assert run is not None
    np.testing.assert_allclose(run.error[late.unknown(delay) :], 0.0, atol=1e-10)


def test_the_residual_of_an_unstable_model_is_as_white_as_the_noise() -> None:
    """What the output of 1/(s - 1) would grow to in 300 s is no concern of its."""
    noise = coloured(1, 3000, 0.0)
    loop = controlled(rp.TransferFunction([1.0], [1.0, -1.0]), steps(1, 3000), noise, gain=3.0)
    run = run_model(rp.Structure(1), np.array([-1.0, 1.0]), Record(loop.u, loop.y, np.array([STEP])), STEP)
    assert run is not None
    assert whiteness(run.error) < 1.2
    assert run.error.std() == pytest.approx(noise.std(), rel=0.05)
    assert all(np.isfinite(signals).all() for signals in (run.forced, run.states, run.zeta, run.nuisances))


def test_a_model_whose_signals_leave_float64_has_no_run() -> None:
    u = binary(1, 600, 5)
    assert run_model(rp.Structure(1), np.array([1.0, 1e308]), Record(u, u, np.array([DT])), DT) is None


# --- excitation


def test_excitation_of_an_input_that_stops() -> None:
    u = binary(1, 2000, 5)
    u[1000:] = u[999]
    run = run_model(rp.Structure(1), np.array([0.5, 1.0]), Record(u, np.zeros(2000), np.array([DT])), DT)
    assert run is not None
    lively, resting = excitation(run, slice(0, 1000)), excitation(run, slice(1500, 2000))
    assert lively.condition == resting.condition < 10.0
    assert lively.share > 0.5
    assert not lively.findings
    assert resting.share < 1e-6
    assert [finding.status for finding in resting.findings] == ["not excited"]


@pytest.mark.parametrize("zeros", [0, 3])
def test_one_sine_tells_two_coefficients_and_no_more(zeros: int) -> None:
    u = np.sin(0.2 * np.arange(4000))
    structure = rp.Structure(4 if zeros else 1, zeros)
    parameters = np.concatenate([np.poly(np.full(structure.poles, -1.0))[1:], np.ones(zeros + 1)])
    run = run_model(structure, parameters, Record(u, np.zeros(4000), np.array([DT])), DT)
    assert run is not None
    found = excitation(run, slice(2000, 4000))
    assert (found.condition < WORST_CONDITION) == (zeros == 0)
    assert bool(found.findings) == (zeros == 3)


def test_no_motion_at_all_has_no_excitation() -> None:
    run = run_model(rp.Structure(1), np.array([0.5, 1.0]), Record(np.zeros(200), np.zeros(200), np.array([DT])), DT)
    assert run is not None
    assert excitation(run, slice(0, 200)).condition == math.inf


# --- sums


def test_sums_in_blocks_are_sums() -> None:
    a, b = np.random.default_rng(0).standard_normal((2, 30_001, 7))
    np.testing.assert_allclose(products(a, b), a.T @ b, rtol=1e-9, atol=1e-9)


def test_taking_out_nuisances_is_least_squares_whatever_their_scale_and_rank() -> None:
    generator = np.random.default_rng(0)
    columns, nuisances = generator.standard_normal((500, 2)), generator.standard_normal((500, 3))
    nuisances = np.column_stack([1e9 * nuisances, nuisances[:, 0] + nuisances[:, 1], np.zeros(500)])
    weights, *_ = np.linalg.lstsq(nuisances, columns, rcond=None)
    np.testing.assert_allclose(without(columns, nuisances), columns - nuisances @ weights, atol=1e-9)


@every("poles", [[1.0], [0.0], [1.0, 0.0]])
def test_its_slopes_depend_on_no_choice_of_the_zero_of_the_input(poles: list[float]) -> None:
    """What another zero adds is an offset, or a ramp behind a pole at 0, and free responses."""
    denominator, u = np.poly(-np.array(poles)), binary(1, 600, 5)
    y = rp.TransferFunction([2.0], denominator).simulate(u, DT) + 0.1 * np.random.default_rng(0).standard_normal(600)
    structure, slopes = rp.Structure(len(poles)), []
    for zero in (0.0, 3.0):
        record = Record(u - zero, y, np.array([DT]))
        run = run_model(structure, np.array([*denominator[1:] + 0.01, 2.0]), record, DT)
        assert run is not None
        slopes.append(without(run.slopes, run.nuisances))
    np.testing.assert_allclose(*slopes, atol=1e-6 * np.abs(slopes[0]).max())
