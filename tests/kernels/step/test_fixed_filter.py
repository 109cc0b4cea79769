"""The lean kernels of the article's method beside the general ones: the same bits in every array."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import replant as rp
from replant.estimation.engine.state import State, step_kernels
from replant.estimation.engine.vector_blocks import is_under_way
from replant.estimation.optimizers import OPTIMIZERS
from replant.kernels.step import fixed_filter, single
from support.cases import every

Kernel = Callable[..., Any]

DT, SAMPLES, REGULAR = 0.1, 600, np.zeros(0)
FILTERS = {
    "held": rp.StateVariableFilter(cutoff=2.0),
    "straight": rp.StateVariableFilter(cutoff=2.0, input_hold="foh"),
    "gbt": rp.StateVariableFilter(cutoff=2.0, method="gbt"),
}
GRADIENTS = [name for name in OPTIMIZERS if not OPTIMIZERS[name].keeps_covariance]


def state_of(structure: rp.Structure, optimizer: str, which: str = "held", replay: rp.Replay | None = None) -> State:
    ident = rp.Identifier(
        structure, DT, filter=FILTERS[which], scaling=None, optimizer=OPTIMIZERS[optimizer].suggested(DT, 5),
        replay=replay, instruments=False, preprocess=rp.Preprocess("square", 0.3, -0.2),
    )  # fmt: skip
    assert ident.settings is not None
    return State.of_settings(ident.settings, recent=50)


def arrays(state: State) -> tuple[np.ndarray, ...]:
    return state.arrays


def run(state: State, one: Kernel, many: Kernel) -> tuple[np.ndarray, np.ndarray]:
    """Take a record with rejected samples: its beginning and its end one by one, the rest at once."""
    generator = np.random.default_rng(1)
    u = generator.choice([-1.0, 0.5], SAMPLES // 10).repeat(10)
    y = generator.standard_normal(SAMPLES)
    u[[0, 40]], y[[7, 300]] = np.nan, (np.inf, 1e200)
    errors, parameters = np.zeros(SAMPLES), np.zeros((SAMPLES, state.entries))
    middle = slice(5, SAMPLES - 5)
    for k in range(5):
        errors[k] = one(*arrays(state), u[k], y[k], np.nan, np.nan)
    many(*arrays(state), u[middle], y[middle], REGULAR, REGULAR, errors[middle], parameters[middle])
    state.adapt = 0
    for k in range(SAMPLES - 5, SAMPLES):
        errors[k] = one(*arrays(state), u[k], y[k], np.nan, np.nan)
    state.work[:] = 0.0  # no part of the state
    return errors, parameters


@every("replay", [None, rp.Replay(capacity=40, batch_size=5, warmup=3)], ids=["alone", "replay"])
@every("which", FILTERS)
@every("structure", [(1, 0, False), (2, 1, False), (3, 0, True), (4, 2, True)], ids=str)
@every("optimizer", GRADIENTS)
def test_same_bits_as_the_general_kernels(
    optimizer: str, structure: tuple[int, int, bool], which: str, replay: rp.Replay | None
) -> None:
    poles, zeros, bias = structure
    ours, general = (state_of(rp.Structure(poles, zeros, bias=bias), optimizer, which, replay) for _ in range(2))
    results = run(ours, fixed_filter.step, fixed_filter.steps), run(general, *single.by_gradient)
    for a, b in zip(*results, strict=True):
        assert a.tobytes() == b.tobytes()
    for a, b in zip(arrays(ours), arrays(general), strict=True):
        assert a.tobytes() == b.tobytes()
    assert np.isfinite(results[0][1]).all()
    assert np.abs(results[0][1][-10:]).max() > 0


def test_a_rejected_sample_changes_its_count_alone() -> None:
    state = state_of(rp.Structure(2, 1), "amsgrad")
    for before in (0, 7):
        for k in range(before):
            fixed_filter.step(*arrays(state), np.cos(k), np.sin(k), np.nan, np.nan)
        expected, others = state.ints.copy(), [array.tobytes() for array in arrays(state)[1:]]
        expected[State.not_finite.index] += 1
        assert np.isnan(fixed_filter.step(*arrays(state), np.nan, 1.0, np.nan, np.nan))
        np.testing.assert_array_equal(state.ints, expected)
        assert [array.tobytes() for array in arrays(state)[1:]] == others


def chosen(structure: rp.Structure, optimizer: str, *, regular: bool, **slots: int) -> object:
    state = state_of(structure, optimizer)
    for name, value in slots.items():
        setattr(state, name, value)
    return step_kernels(state, regular=regular)


def test_each_identifier_gets_the_leanest_kernels_that_suit_it() -> None:
    lean, general = (fixed_filter.step, fixed_filter.steps), single.by_gradient
    assert chosen(rp.Structure(2, 1), "amsgrad", regular=True) == lean
    assert chosen(rp.Structure(2, 1), "amsgrad", regular=False) == general
    assert chosen(rp.Structure(2, 2, feedthrough=True), "amsgrad", regular=True) == general
    assert chosen(rp.Structure(2, 1, delay=0.05), "amsgrad", regular=True) == general
    assert chosen(rp.Structure(2, 1), "amsgrad", regular=True, instruments=1) == general
    assert chosen(rp.Structure(2, 1), "recursive-least-squares", regular=True) == single.by_covariance


def test_with_the_first_stamp_the_general_kernels_go_on_where_the_lean_ones_stopped() -> None:
    ident = rp.Identifier(
        rp.Structure(1), DT, filter=FILTERS["held"], scaling=None, optimizer="amsgrad", instruments=False, replay=None
    )
    twin = ident.clone()
    generator = np.random.default_rng(2)
    u, y = generator.standard_normal((2, 60))
    t = DT * np.arange(60.0)
    ident.update_many(u[:30], y[:30])
    twin._work_on(twin._state, regular=False)
    twin.update_many(u[:30], y[:30])
    for each in (ident, twin):
        each._state.last_time = t[29]
        each.update(u[30], y[30], t[30])
        each.update_many(u[31:], y[31:], t[31:])
    assert ident._steps is single.by_gradient[1]
    np.testing.assert_array_equal(ident.parameters, twin.parameters)


def test_the_lean_kernels_go_on_where_other_intervals_took_the_place_of_the_regular_one() -> None:
    ours, general = (state_of(rp.Structure(2, 1), "amsgrad") for _ in range(2))
    generator = np.random.default_rng(3)
    for state in (ours, general):
        for k, t in enumerate(np.cumsum([0.0, 1.1, 0.9, 1.2, 0.8, 1.3]) * DT):
            single.by_gradient[0](*arrays(state), np.cos(k), np.sin(k), t, np.nan)
        assert not is_under_way(state)
    u, y = generator.standard_normal((2, 50))
    room = [(np.empty(50), np.empty((50, 4))) for _ in range(2)]
    fixed_filter.steps(*arrays(ours), u, y, REGULAR, REGULAR, *room[0])
    single.by_gradient[1](*arrays(general), u, y, REGULAR, REGULAR, *room[1])
    assert all(a.tobytes() == b.tobytes() for a, b in zip(*room, strict=True))
    assert all(a.tobytes() == b.tobytes() for a, b in zip(arrays(ours)[2:], arrays(general)[2:], strict=True))
