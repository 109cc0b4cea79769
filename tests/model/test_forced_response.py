"""The response of a transfer function: that of the differential equation, on any clock and in any batches."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy import signal

import replant as rp
from replant.model.state_space import Response
from replant.model.transfer_function import TransferFunction
from support.builders import irregular_record
from support.cases import every

DT = 0.1
MODELS = {
    "first order": TransferFunction([2.0], [1.0, 0.5]),
    "third order": TransferFunction([1.0, 3.0], [1.0, 2.0, 5.0, 4.0]),
    "an integrator": TransferFunction([1.0], [1.0, 0.3, 0.0]),
    "unstable": TransferFunction([1.0], [1.0, -0.3]),
    "at once": TransferFunction([2.0, 1.0], [1.0, 1.0]),
    "a constant": TransferFunction([3.0], [1.0]),
    "a late constant": TransferFunction([3.0], [1.0], 0.14),
    "late by whole samples": TransferFunction([2.0], [1.0, 0.5], 0.7),
    "late by a fraction": TransferFunction([2.0, 3.0], [1.0, 0.5], 0.324),
    "late by less than a sample": TransferFunction([2.0], [1.0, 3.0, 4.0], 0.03),
}
CUTS = [(200,), (1,) * 200, (3, 0, 150, 47), (199, 1)]
every_model = every("name", MODELS)
every_hold = every("hold", ["zoh", "foh"])


def jittering(seed: int = 3, samples: int = 200) -> np.ndarray:
    """Intervals, some of which repeat, some are short and some are lost samples; none is a whole number of pieces."""
    return np.random.default_rng(seed).choice([0.02, 0.06, 0.1, 0.1, 0.13, 0.31], samples)


def in_batches(response: Response, u: np.ndarray, intervals: np.ndarray | None, cuts: tuple[int, ...]) -> tuple:
    """Output, free responses filled up with zeros, and unknown outputs, joined."""
    found = []
    for a, b in pairwise(np.cumsum([0, *cuts])):
        stretch = response.take(u[a:b], None if intervals is None else intervals[a:b])
        free = np.zeros((b - a, stretch.free.shape[1]))
        free[: len(stretch.free)] = stretch.free
        found.append((stretch.output, free, stretch.unknown))
    outputs, frees, unknown = zip(*found, strict=True)
    return np.concatenate(outputs), np.concatenate(frees), sum(unknown)


@every_model
@every_hold
def test_batches_are_the_whole_to_the_bit(name: str, hold: str) -> None:
    u = np.random.default_rng(0).standard_normal(200)
    for intervals in (None, jittering()):
        for at_rest in (True, False):
            whole = in_batches(Response(MODELS[name], DT, hold, at_rest=at_rest), u, intervals, CUTS[0])
            for cuts in CUTS[1:]:
                parts = in_batches(Response(MODELS[name], DT, hold, at_rest=at_rest), u, intervals, cuts)
                for one, other in zip(whole, parts, strict=True):
                    np.testing.assert_array_equal(one, other, err_msg=f"{cuts}, at rest: {at_rest}")


@every_model
@every_hold
def test_a_regular_clock_given_as_intervals_is_the_regular_clock(name: str, hold: str) -> None:
    u, t = np.random.default_rng(0).standard_normal(300), DT * np.arange(300)
    for at_rest in (True, False):
        one = Response(MODELS[name], DT, hold, at_rest=at_rest).take(u)
        other = Response(MODELS[name], DT, hold, at_rest=at_rest).take(u, np.diff(t, prepend=-DT))
        assert one.unknown == other.unknown
        scale = np.abs(one.output).max()
        np.testing.assert_allclose(other.output, one.output, rtol=0.0, atol=1e-12 * scale)
        np.testing.assert_allclose(other.free, one.free, rtol=1e-11, atol=1e-13)


@every_model
@every_hold
def test_an_irregular_clock_is_a_choice_of_the_samples_of_a_fine_one(name: str, hold: str) -> None:
    """The delays are whole numbers of the fine clock's samples; no interval is so long that u might have moved."""
    model, fine = MODELS[name], 50
    at = np.cumsum(np.random.default_rng(1).integers(20, 70, 300))
    at -= at[0]
    t, grid = at * DT / fine, np.arange(at[-1] + 1)
    u = np.random.default_rng(2).standard_normal(300)
    between = u[np.searchsorted(at, grid, side="right") - 1] if hold == "zoh" else np.interp(grid, at, u)
    expected = model.simulate(between, DT / fine, input_hold=hold)[at]
    found = Response(model, DT, hold).take(u, np.diff(t, prepend=-DT)).output
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-11 * np.abs(expected).max())


@every_model
@every_hold
def test_on_a_regular_clock_it_is_the_solution_by_scipy(name: str, hold: str) -> None:
    """`scipy.signal.lsim` on a clock so fine that the dead time is a whole number of its samples."""
    model, fine, samples = MODELS[name], 50, 120
    u = np.random.default_rng(4).standard_normal(samples)
    grid = np.arange((samples - 1) * fine + 1)
    between = np.repeat(u, fine)[: grid.size] if hold == "zoh" else np.interp(grid / fine, np.arange(samples), u)
    lag = round(model.delay / DT * fine)
    late = np.concatenate([np.zeros(lag), between])[: grid.size]
    if hold == "foh":  # a step from zero to the first sample: lsim runs straight between samples
        late = late - np.where(grid >= lag, u[0], 0.0)
    states = signal.StateSpace(*signal.tf2ss(model.num, model.den))
    time = grid * DT / fine
    expected = signal.lsim(states, late, time, interp=hold == "foh")[1]
    if hold == "foh":
        step = signal.lsim(states, np.where(grid >= lag, u[0], 0.0), time, interp=False)[1]
        expected = expected + step
    found = Response(model, DT, hold).take(u).output
    np.testing.assert_allclose(found, expected[::fine], rtol=0.0, atol=1e-9 * np.abs(expected).max())


@every_model
def test_free_responses_are_what_a_state_adds(name: str) -> None:
    """A record that begins in the midst of motion is output by its inputs, and these."""
    model = MODELS[name]
    u = np.random.default_rng(5).standard_normal(300)
    intervals = jittering(6, 300)
    for clock in (None, intervals):
        y = Response(model, 5 * DT).take(u, clock).output if clock is not None else model.simulate(u, DT)
        rest = slice(150, None)
        dt = DT if clock is None else 5 * DT  # of which none of the intervals has lost samples
        found = Response(model, dt, at_rest=False).take(u[rest], None if clock is None else clock[rest])
        left = (y[rest] - found.output)[found.unknown :]
        free = np.zeros((150, model.den.size - 1))
        free[: len(found.free)] = found.free
        free = free[found.unknown :]
        weights = np.linalg.lstsq(free, left, rcond=None)[0] if free.size else np.zeros(0)
        np.testing.assert_allclose(free @ weights, left, atol=1e-9 * np.abs(y).max())


def test_until_inputs_of_the_record_act_all_stands_still() -> None:
    found = Response(TransferFunction([2.0, 3.0], [1.0, 0.5], 0.324), DT, at_rest=False).take(np.full(9, 3.0))
    assert found.unknown == 4
    np.testing.assert_array_equal(found.output[:5], 6.0)
    np.testing.assert_array_equal(found.free[:5, 0], found.free[0, 0])


def test_a_held_input_may_have_moved_where_samples_are_lost() -> None:
    """Known for the usual interval, half the way for the rest, unless the clock was as slow before."""
    slow = TransferFunction([1.0], [1.0, 0.0])
    u, intervals = np.array([0.0, 0.0, 0.0, 1.0, 1.0]), np.array([1.0, 1.0, 1.0, 4.0, 1.0])
    moved = Response(slow, 1.0).take(u, intervals).output
    np.testing.assert_allclose(moved, [0.0, 0.0, 0.0, 1.5, 2.5])  # 4 s of a half of three quarters
    stood = Response(slow, 1.0).take(u, np.full(5, 4.0)).output
    np.testing.assert_allclose(stood[:3], 0.0)
    assert stood[4] - stood[3] == pytest.approx(4.0)


def test_a_response_that_has_died_out_has_no_more_rows() -> None:
    """Numbers near the end of float64's range would be slow ones."""
    response = Response(TransferFunction([1.0], [1.0, 50.0]), DT, at_rest=False)
    assert 90 < len(response.take(np.zeros(100)).free) < 95  # e^-5 for each sample, 1e-200 at the end
    assert len(response.take(np.zeros(100)).free) == 0
    assert (TransferFunction([1.0], [1.0, 50.0]).free_responses(200, DT)[100:] == 0.0).all()


def test_a_record_and_its_builder_agree() -> None:
    plant = TransferFunction([1.0, 4.0], [1.0, 2.0, 5.0], 0.12)
    u, y, t = irregular_record(plant, 7, 600, 0.05, jitter=0.4)
    simulated = rp.verdict.simulate(plant, u[100:], y[100:] + 3.0, 0.05, t=t[100:])
    assert simulated.offset == pytest.approx(3.0, abs=1e-9)
    assert simulated.fit > 99.999999


@every_hold
def test_the_unit_of_time_does_not_matter(hold: str) -> None:
    """An interval of 1 is one as any other, the first as well."""
    u = np.random.default_rng(5).standard_normal(50)
    expected = Response(TransferFunction([2.0], [1.0, 0.5]), 0.1, hold).take(u).output
    for unit in (0.1, 1e-3, 60.0):
        model = TransferFunction([2.0 * unit], [1.0, 0.5 * unit])
        found = Response(model, 0.1 / unit, hold).take(u).output
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)
