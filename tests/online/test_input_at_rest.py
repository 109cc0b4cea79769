"""An input that rests: nothing is forgotten, nothing grows, however long it takes."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.numerics.linear_algebra import compose
from replant.verdict.reasons import BEFORE
from support.builders import DT, identifier, is_finite, record, true_parameters, two_modes
from support.cases import every

STRUCTURE, PLANT = rp.Structure(2, 1), rp.TransferFunction([1.0, 4.0], two_modes(2.0, 0.5))
TRUE = true_parameters(PLANT, 1)
CHUNK = 100_000

OPTIMIZERS = {
    "default": rp.RecursiveLeastSquares(),
    "forgetting": rp.RecursiveLeastSquares(forgetting_factor=0.99),
    "tracking": rp.KalmanTracking(1e-3),
}


def factors(ident: rp.Identifier) -> tuple[np.ndarray, np.ndarray]:
    size = ident._state.entries
    memory = ident._state.memory[: size * size + size]
    return memory[: size * size].reshape(size, size).copy(), memory[size * size :].copy()


@functools.cache
def learned(optimizer: Any, samples: int) -> rp.Identifier:
    u, y = record(PLANT, seed=1, samples=samples, dt=DT, hold=8, noise=0.02)
    ident = rp.Identifier(STRUCTURE, DT, optimizer=optimizer)
    ident.update_many(u, y)
    return ident


def converged(optimizer: Any, samples: int = 20_000) -> rp.Identifier:
    return learned(optimizer, samples).clone()


def idle(ident: rp.Identifier, samples: int, level: float, noise: float = 0.02, past: Any = ()) -> None:
    """A constant input and the plant's answer to it, noise going on; first the plant's transient from a past input."""
    settling = PLANT.simulate(np.append(past, np.full(2000, level)), DT)[-2000:]
    generator = np.random.default_rng(2)
    y = level + noise * generator.standard_normal(CHUNK)  # the static gain is one
    u = np.full(CHUNK, level)
    ident.update_many(np.full(2000, level), settling + noise * generator.standard_normal(2000))
    for _ in range(-(-samples // CHUNK)):
        ident.update_many(u, y)


def assert_positive_definite(ident: rp.Identifier) -> None:
    U, D = factors(ident)
    assert np.isfinite(U).all()
    assert np.isfinite(D).all()
    assert (D > 0).all()
    covariance = compose(U, D)
    std = np.sqrt(np.diag(covariance))
    assert np.linalg.eigvalsh(covariance / np.outer(std, std)).min() > -1e-12


def rest(name: str, samples: int) -> None:
    """What idle time may not do, whichever optimizer.

    The moving variance of the input takes some 14 memories of it to fall to the millionth at which it rests: up to
    110 000 samples, in which noise is still learned.
    """
    taken = 20_000 if name == "default" else 5000
    ident = converged(OPTIMIZERS[name], taken)
    start = ident.parameters
    np.testing.assert_allclose(start, TRUE, rtol=0.1)
    idle(ident, 200_000, 1.0, past=record(PLANT, seed=1, samples=taken, dt=DT, hold=8)[0])
    if name == "default":  # what remembers everything does not lose it to noise meanwhile
        np.testing.assert_allclose(ident.parameters, start, rtol=1e-3)
    before, (U, D) = ident.parameters, factors(ident)
    sizes = [array.nbytes for array in (ident._state.reals, ident._state.recent)]
    rested = ident._state.rested
    u, y = np.full(CHUNK, 1.0), 1.0 + 0.02 * np.random.default_rng(3).standard_normal(CHUNK)
    for _ in range(samples // CHUNK):
        ident.update_many(u, y)
    assert ident._state.rested - rested == samples
    np.testing.assert_array_equal(ident.parameters, before)
    np.testing.assert_array_equal(factors(ident)[0], U)
    np.testing.assert_array_equal(factors(ident)[1], D)
    assert_positive_definite(ident)
    assert ident.status == "running"
    assert [array.nbytes for array in (ident._state.reals, ident._state.recent)] == sizes
    assert is_finite(ident._state)


@pytest.mark.slow
def test_without_noise_idle_time_changes_nothing_from_the_first_sample_on() -> None:
    """Within 1e-6: also while the input's variance has not yet fallen."""
    u, y = record(PLANT, seed=1, samples=12_000, dt=DT, hold=8)
    idle_u = np.full(300_000, 1.0)
    whole_u = np.concatenate([u, idle_u])
    whole_y = PLANT.simulate(whole_u, DT)
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u, y)
    before = ident.parameters
    trace = ident.update_many(idle_u, whole_y[12_000:])
    np.testing.assert_allclose(trace.parameters[::1000], np.tile(before, (300, 1)), rtol=1e-6)
    assert_positive_definite(ident)
    assert ident._state.rested > 150_000


@every("name", [*OPTIMIZERS][::-1], quick=1)
def test_idle_samples_change_nothing(name: str) -> None:
    rest(name, 100_000)


@pytest.mark.slow
@pytest.mark.parametrize("name", OPTIMIZERS)
def test_millions_of_idle_samples_change_nothing(name: str) -> None:
    """Until the variance of the input, which falls by e in 8,000 samples, is nought: after 745 * 8,000 of them."""
    rest(name, 6_200_000)


@pytest.mark.slow
def test_when_the_input_moves_again_learning_goes_on() -> None:
    ident = converged(rp.RecursiveLeastSquares(time_constant=50.0))
    idle(ident, 100_000, 1.0)
    rested, before = ident._state.rested, ident.parameters
    u, y = record(PLANT, seed=4, samples=20_000, dt=DT, hold=8, noise=0.02)
    u, y = u + 1.0, y + 1.0
    ident.update_many(u, y)
    assert ident._state.rested - rested < 50
    assert (ident.parameters != before).all()
    np.testing.assert_allclose(ident.parameters, TRUE, rtol=0.05)


@pytest.mark.slow
def test_an_input_that_moves_a_little_does_not_rest() -> None:
    """A thousandth of the amplitude is a millionth of the variance: where rest begins, once the past has faded."""
    for amplitude, rests in ((0.01, False), (1e-4, True)):
        ident = converged(rp.RecursiveLeastSquares())
        before = ident._state.rested
        u, y = record(PLANT, seed=5, samples=130_000, dt=DT, hold=8)
        ident.update_many(amplitude * u, amplitude * y)
        assert (ident._state.rested - before > 1000) == rests


# --- without the guard: no instruments, nothing that says whether the input rests


@every("forgetting", [0.9, 0.99, 0.9999])
@every("level", [0.0, 1.0])
def test_forgetting_stops_at_its_cap(forgetting: float, level: float) -> None:
    """Unbounded, P would have left float64 after 70 000 samples at 0.99.  U stays tame too."""
    optimizer = rp.RecursiveLeastSquares(forgetting, initial_covariance=1e4)
    ident = identifier(optimizer, structure=STRUCTURE, dt=DT, filter=rp.StateVariableFilter(3.0))
    ident.update_many(*record(PLANT, seed=1, samples=5000, dt=DT, hold=8, noise=0.02))
    before = ident.parameters
    idle(ident, 300_000, level)
    assert_positive_definite(ident)
    U, D = factors(ident)
    assert (D <= 1e4).all()
    assert np.abs(U).max() < 1e6
    assert ident.status == "running"
    assert np.isfinite(ident.parameters).all()
    assert np.isfinite(before).all()


@pytest.mark.parametrize("level", [0.0, 1.0])
def test_tracking_walks_on_but_does_not_break(level: float) -> None:
    """What is not seen walks at random: P grows in proportion to time, and no faster."""
    noise, seconds = 1e-3, 300_000 * DT
    ident = identifier(rp.KalmanTracking(noise), structure=STRUCTURE, dt=DT, filter=rp.StateVariableFilter(3.0))
    ident.update_many(*record(PLANT, seed=1, samples=5000, dt=DT, hold=8, noise=0.02))
    idle(ident, 300_000, level)
    assert_positive_definite(ident)
    assert np.diag(compose(*factors(ident))).max() < 2 * noise * seconds
    assert ident.status == "running"
    ident.update_many(*record(PLANT, seed=2, samples=5000, dt=DT, hold=8, noise=0.02))
    assert ident.status == "running"
    np.testing.assert_allclose(ident.parameters, TRUE, rtol=0.3)


def test_a_dead_sensor_and_a_dead_input_leave_no_noise_to_divide_by() -> None:
    """Zeros for so long that the tracked variance of the residual reaches the smallest number there is."""
    optimizer = rp.KalmanTracking(1e-3, noise_time_constant=0.5)
    ident = identifier(optimizer, structure=STRUCTURE, dt=DT, filter=rp.StateVariableFilter(3.0))
    ident.update_many(np.zeros(20_000), np.zeros(20_000))
    assert is_finite(ident._state)
    ident.update_many(*record(PLANT, seed=2, samples=5000, dt=DT, hold=8, noise=0.02))
    assert ident.status == "running"
    assert is_finite(ident._state)
    assert_positive_definite(ident)


# --- the verdict: whether the model is right, and whether anything can be learned now

MOVES, RESTS = 12_000, 40_000
VERDICTS: dict[str, Any] = {
    "default": "auto", "forgetting": rp.RecursiveLeastSquares(0.999), "tracking": rp.KalmanTracking(1e-6),
}  # fmt: skip


def resting(moves: int = MOVES, load: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """An input that moves, rests and moves again; a load steps where half of the rest is over."""
    u = record(PLANT, seed=1, samples=2 * moves + RESTS, dt=DT, hold=8)[0]
    u[moves : moves + RESTS] = 1.0
    y = PLANT.simulate(u, DT) + 0.02 * np.random.default_rng(2).standard_normal(u.size)
    y[moves + RESTS // 2 :] += load
    return u, y


@pytest.mark.slow
@every("optimizer", VERDICTS, quick=1)
def test_a_model_that_was_trusted_stays_so_and_the_rest_is_said(optimizer: str) -> None:
    """Also after the samples that showed it are no longer kept, and when the plant moves again."""
    u, y = resting()
    ident = rp.Identifier(STRUCTURE, DT, optimizer=VERDICTS[optimizer])
    ident.update_many(u[:MOVES], y[:MOVES])
    assert (ident.assess().status, ident.assess().excited) == ("trusted", True)
    for k in range(MOVES, MOVES + RESTS, 1000):
        ident.update_many(u[k : k + 1000], y[k : k + 1000])
        verdict = ident.assess()
        assert verdict.status == "trusted", verdict.reasons
        if k >= MOVES + 5000:
            assert not verdict.excited
            assert "input" in verdict.reasons[-1]
    assert rp.Identifier.from_bytes(ident.to_bytes()).assess() == verdict
    ident.update_many(u[MOVES + RESTS :], y[MOVES + RESTS :])
    assert (ident.assess().status, ident.assess().excited) == ("trusted", True)


def test_what_is_noticed_while_the_input_rests_ends_the_trust() -> None:
    """The output moves though the input does not: whatever it is, the model is no longer known to be right."""
    u, y = resting(load=0.5)
    ident = rp.Identifier(STRUCTURE, DT)
    noticed = MOVES + RESTS // 2 + 500
    ident.update_many(u[:noticed], y[:noticed])
    assert ident.assess().status != "trusted"
    ident.update_many(u[noticed : MOVES + RESTS], y[noticed : MOVES + RESTS])
    assert (ident.assess().status, ident.assess().excited) == ("not excited", False)


def test_an_input_that_moved_for_less_than_a_start_up_tells_nothing() -> None:
    u, y = resting(moves=400)
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u[:4000], y[:4000])
    assert (ident.assess().status, ident.assess().excited) == ("not excited", False)


@pytest.mark.slow
def test_what_was_trusted_before_a_short_movement_is_not_said_of_the_rest_after_it() -> None:
    """The gain changes at rest, the input moves for 700 samples, and rests again: only the new gain is trusted then."""
    u, _ = resting()
    burst = MOVES + RESTS // 2 + 300  # early between two reviews
    u[burst : burst + 700] = np.repeat(np.random.default_rng(4).choice([-1.0, 1.0], 100), 7)
    y = PLANT.simulate(u, DT)
    y[burst - 100 :] += 0.3 * PLANT.simulate(u, DT)[burst - 100 :]
    y += 0.3 * np.random.default_rng(5).standard_normal(u.size)
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u[: burst - 200], y[: burst - 200])
    assert (ident.assess().status, ident.assess().excited) == ("trusted", False)
    for k in range(burst - 200, burst + 6000, 200):
        ident.update_many(u[k : k + 200], y[k : k + 200])
        if k > burst + 700:
            verdict = ident.assess()
            is_right = ident.transfer_function.dc_gain == pytest.approx(1.3, rel=0.1)
            assert verdict.reasons[0] != BEFORE or verdict.status != "trusted" or is_right, k - burst
