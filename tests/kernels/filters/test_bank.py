"""A bank's filters: their discretisation, what is kept of it, and the time scale that states carry."""

from __future__ import annotations

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.state import State
from replant.kernels.filters import bank as bk
from replant.model import state_space
from support.builders import random_plant
from support.cases import every

DENOMINATORS = {
    "first order": np.array([1.0, 2.0]),
    "integrator": np.array([1.0, 0.0]),
    "pole at zero": np.array([1.0, 3.0, 2.0, 0.0]),
    "hardly damped": np.array([1.0, 0.002, 1.0]),
    "slow and fast": np.array([1.0, 1000.1, 100.0]),
    "fast": np.poly(np.full(4, -5e3)),
    "tenfold": np.poly(np.full(10, -2.0)),
    "random": random_plant(1, 6).den,
}
every_denominator = every("denominator", DENOMINATORS.values(), ids=DENOMINATORS)


def made(denominator: np.ndarray) -> tuple[State, np.ndarray, int, int]:
    """A state of the refined filter, one of its banks with this denominator, n and T."""
    n = denominator.size - 1
    state = State.build(rp.Structure(n, n - 1), 0.1, rp.RefinedFilter())
    T = state.entries
    bank = state.banks[1]
    bk.set_denominator(bank, n, T, n, True, True, False, denominator[1:], np.ones(T))
    return state, bank, n, T


def work_of(state: State) -> np.ndarray:
    return state.work


def discretization(state: State, bank: np.ndarray, n: int, T: int, interval: float) -> tuple[np.ndarray, ...]:
    """Ad (n, n), constant (n,), ramp (n,)."""
    start = bk.discretization(bank, n, T, interval, work_of(state))
    assert bank[start] == pytest.approx(interval, rel=1e-9)
    matrices = bank[start + 1 : start + 1 + n * n + 2 * n].copy()
    return matrices[: n * n].reshape(n, n), matrices[n * n : n * n + n], matrices[n * n + n :]


@every_denominator
@every("interval", [1e-9, 1e-3, 0.1, 2.0])
def test_it_discretises_as_the_realization_does(denominator: np.ndarray, interval: float) -> None:
    """The same companion form through another exponential: straight lines are constant and ramp."""
    state, bank, n, T = made(denominator)
    model = state_space.companion(denominator)
    Ad, constant, ramp = discretization(state, bank, n, T, interval)
    transition, before, after = state_space.exact(model.matrix, model.column, interval, "foh")
    tolerance = 1e-12 * max(1.0, float(np.abs(model.matrix).sum(axis=1).max()) * interval)
    np.testing.assert_allclose(Ad, transition, atol=tolerance)
    np.testing.assert_allclose(ramp, after, atol=tolerance)
    np.testing.assert_allclose(constant, before + after, atol=tolerance)


def test_discretisations_are_kept_and_the_oldest_makes_room() -> None:
    state, bank, n, T = made(np.array([1.0, 3.0, 2.0]))
    intervals = [0.1 * (k + 1) for k in range(bk.KEPT)]
    places = [bk.discretization(bank, n, T, h, work_of(state)) for h in intervals]
    assert len(set(places)) == bk.KEPT
    before = bank.copy()
    assert [bk.discretization(bank, n, T, h * (1 + 1e-12), work_of(state)) for h in intervals] == places
    np.testing.assert_array_equal(bank, before)
    assert bk.discretization(bank, n, T, 9.0, work_of(state)) == places[0]
    assert bk.discretization(bank, n, T, intervals[1], work_of(state)) == places[1]
    assert bk.discretization(bank, n, T, intervals[0], work_of(state)) == places[1]


def test_a_new_denominator_forgets_every_discretisation() -> None:
    state, bank, n, T = made(np.array([1.0, 3.0, 2.0]))
    old, _, _ = discretization(state, bank, n, T, 0.1)
    bk.set_denominator(bank, n, T, n, True, True, False, np.array([1.0, 4.0]), np.ones(T))
    new, _, _ = discretization(state, bank, n, T, 0.1)
    model = state_space.companion(np.array([1.0, 1.0, 4.0]))
    np.testing.assert_allclose(new, state_space.exact(model.matrix, model.column, 0.1, "zoh")[0], atol=1e-13)
    assert not np.allclose(old, new)


@every_denominator
def test_an_impulse_gives_the_free_response(denominator: np.ndarray) -> None:
    """The IMPULSE states begin at c e_1 and run free: s^i/D of a Dirac impulse."""
    state, bank, n, T = made(denominator)
    bk.begin(bank, n, T)
    start = bk.discretization(bank, n, T, 0.05, work_of(state))
    model = state_space.companion(denominator)
    Ad = state_space.exact(model.matrix, model.column, 0.05, "zoh")[0]
    expected = model.column.copy()
    for _ in range(20):
        bk.advance_channel(bank, n, T, bk.IMPULSE, start, 0.0, 0.0, work_of(state))
        expected = Ad @ expected
    states = bk.at_states(n, T) + bk.IMPULSE * n
    np.testing.assert_allclose(bank[states : states + n], expected, atol=1e-11 * model.column[0])


def test_states_of_another_bank_mean_the_same_derivatives() -> None:
    """w_i = c^(n-i) s^i/D x: copied into another time scale, s^i/D x stays what it was."""
    state, first, n, T = made(np.array([1.0, 3.0, 2.0, 5.0]))
    second = state.banks[2]
    bk.set_denominator(second, n, T, n, True, True, False, np.array([30.0, 200.0, 4000.0]), np.ones(T))
    states = slice(bk.at_states(n, T), bk.at_states(n, T) + bk.CHANNELS * n)
    first[states] = np.random.default_rng(0).standard_normal(bk.CHANNELS * n)
    first[bk.MODEL_OUTPUT] = 0.7
    bk.take_states(second, first, n, T)
    scales = [bank[bk.SCALE] ** np.arange(1.0, n + 1) for bank in (first, second)]
    plain = [bank[states].reshape(bk.CHANNELS, n) / c for bank, c in zip((first, second), scales, strict=True)]
    np.testing.assert_allclose(plain[1], plain[0], rtol=1e-13)
    assert second[bk.MODEL_OUTPUT] == 0.7
