"""The border between Python and the compiled kernels: what does not fit is an error in one line, and nothing runs."""

from __future__ import annotations

import inspect
import pickle
from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.state import State
from replant.kernels import native
from replant.kernels.filters import bank, simulate
from replant.kernels.filters.autoregressions import fill_all_pole, nested_models
from replant.kernels.native import KERNELS, Kernel
from replant.kernels.optimizers import covariance, gradient
from replant.kernels.schema import Attention, ColourSlots, NoiseSlots, PathSlots
from replant.kernels.step import fixed_filter, single, soundness
from replant.model.transfer_function import TransferFunction
from support.cases import every

Call = tuple[Kernel, tuple[Any, ...]]
#: Numbers of a state's blocks that serve as an index.
PLACES = (
    (State.noise, NoiseSlots.order), (State.noise, NoiseSlots.known), (State.noise, NoiseSlots.position),
    (State.colour, ColourSlots.position), (State.path, PathSlots.kept),
)  # fmt: skip


def copied(arguments: Iterable[Any]) -> list[Any]:
    """Return arguments of which each array is another one."""
    return [each.copy() if isinstance(each, np.ndarray) else each for each in arguments]


@pytest.fixture(scope="module")
def calls() -> list[Call]:
    """Return one good call of many kernels, as they are called at work."""
    found: dict[str, Call] = {}
    call = Kernel.__call__

    def noted(kernel: Kernel, *arguments: Any) -> Any:
        if kernel.name not in found:  # a copy of each call would take most of the time
            found[kernel.name] = kernel, tuple(copied(arguments))
        return call(kernel, *arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Kernel, "__call__", noted)
        generator = np.random.default_rng(0)
        u = np.repeat(generator.choice([-1.0, 1.0], 60), 10)
        y = TransferFunction([8.0, 40.0], [1.0, 3.0, 25.0]).simulate(u, 0.02) + 0.01 * generator.standard_normal(600)
        default = rp.Identifier(rp.Structure(2, 1), 0.02)
        default.update_many(u, y)
        default.update(u[-1], y[-1])
        default.finish()
        rp.Ensemble(default, members=3).update_many(u[:100], y[:100])
        rp.Identifier(rp.Structure(2, 1), 0.02, optimizer="amsgrad", instruments=True).update_many(u, y)
        fixed = rp.Identifier(
            rp.Structure(2, 1), 0.02, filter=rp.StateVariableFilter(10.0), scaling=None, optimizer=rp.AMSGrad(0.01),
            instruments=False, replay=rp.Replay(capacity=40, batch_size=5),
        )  # fmt: skip
        fixed.clone().update_many(u, y)
        rp.Ensemble(fixed, members=8).update_many(u, y)
        two = np.column_stack([u, u[::-1]])
        rp.Identifier(poles=(1, 1), dt=0.02, startup=200).update_many(two[:240], y[:240], r=u[:240])
        bank = rp.Identifier(structure=[rp.Structure(1), rp.Structure(2)], dt=0.02)
        bank.update_many(u, y)
        assert bank.weights.size == 2  # asked for, they are weighed
        fill_all_pole(np.array([1.0, -0.5]), np.ones((2, 5)), np.zeros((2, 5)), np.zeros(2))
    return list(found.values())


def wrong(arguments: tuple[Any, ...], chance: np.random.Generator) -> list[Any]:
    """Return arguments of which one array is not as it was: shorter, longer, of another type, read-only, in steps."""
    own = copied(arguments)
    place = chance.choice([number for number, each in enumerate(own) if isinstance(each, np.ndarray)])
    array = own[place]
    axis = int(chance.integers(array.ndim))
    keep: list[Any] = [slice(None)] * array.ndim
    keep[axis] = slice(int(chance.integers(array.shape[axis] + 1)))
    changes = [
        array[tuple(keep)].copy(),
        np.concatenate([array, array], axis),
        array.astype(np.float32),
        array.astype(complex),
        array.astype(">f8"),
        np.asarray(array.tolist(), dtype=object),
        array[..., None],
        array.ravel()[:0],
        np.broadcast_to(array, array.shape),
        np.repeat(array, 2, axis)[tuple(slice(None, None, 2) if i == axis else slice(None) for i in range(array.ndim))],
        np.asfortranarray(array),
        memoryview(b"abc"),
        None,
        3.5,
        "words",
        list(array.ravel()[:3]),
    ]
    own[place] = changes[chance.integers(len(changes))]
    return own


def test_the_calls_are_of_most_kernels(calls: list[Call]) -> None:
    names = {kernel.name for kernel in KERNELS if kernel.python.__module__.startswith("replant.")}
    assert len(calls) >= 0.6 * len(names)


@every("seed", range(3), quick=1)
def test_whatever_comes_is_taken_or_refused_in_one_line(calls: list[Call], seed: int) -> None:
    chance = np.random.default_rng(seed)
    refused = []
    for _ in range(400):
        kernel, arguments = calls[chance.integers(len(calls))]
        try:
            kernel(*wrong(arguments, chance))
        except (TypeError, ValueError) as error:
            refused.append((kernel.name, str(error)))
    assert len(refused) > 300
    assert all(reason.startswith(name) and "\n" not in reason for name, reason in refused)


def test_numbers_of_the_state_that_point_beyond_its_arrays_are_refused(calls: list[Call]) -> None:
    chance, tried, refused = np.random.default_rng(1), 0, 0
    for kernel, arguments in calls:
        if isinstance(arguments[0], np.ndarray) and arguments[0].dtype == np.int64:
            for _ in range(100):
                own = copied(arguments)
                slot = chance.integers(own[0].shape[-1])
                own[0][..., slot] = chance.choice([-1, 10**6, 2**40, -(2**62)])
                tried += 1
                try:
                    kernel(*own)
                except ValueError:
                    refused += 1
    assert refused > tried / 4  # sizes and places; some numbers may be any


def test_the_weights_of_a_bank_take_models_of_their_own_order_alone(calls: list[Call]) -> None:
    weigh, given = next((kernel, own) for kernel, own in calls if kernel.name == "step.bank.weigh")
    names = list(inspect.signature(weigh.python).parameters)
    longer = copied(given)
    longer[names.index("variances")] = np.tile(longer[names.index("variances")], 2)
    with pytest.raises(ValueError, match="variances"):  # every model would be as long, and written beyond its room
        weigh(*longer)
    found = []
    for order in (0, -(2**62)):  # a negative order counts as the lowest
        own = copied(given)
        own[names.index("orders")][:] = order
        weigh(*own)
        found.append(own[names.index("logs")])
    np.testing.assert_array_equal(*found)


def running(**settings: Any) -> rp.Identifier:
    """An identifier that has taken some samples one by one."""
    u = np.where(np.random.default_rng(0).random(700) < 0.5, 1.0, -1.0)
    identifier = rp.Identifier(rp.Structure(1), 0.1, **settings)
    identifier.update_many(u, rp.TransferFunction([1.0], [1.0, 1.0]).simulate(u, 0.1))
    identifier.update(1.0, 1.0)
    return identifier


def damaged(identifier: rp.Identifier, array: str, place: Any, value: float) -> rp.Identifier:
    """Return what a pickle that has been tampered with gives."""
    again: rp.Identifier = pickle.loads(pickle.dumps(identifier))
    getattr(again._state, array)[place] = value
    return again


@pytest.mark.parametrize(
    "settings", [{}, {"filter": rp.StateVariableFilter(1.0), "optimizer": "adam", "scaling": None}]
)
def test_neither_one_sample_nor_many_are_taken_by_a_state_that_points_beyond_its_arrays(settings: dict) -> None:
    identifier = running(**settings)
    ints, state = identifier._state.ints, identifier._state
    wrong = [
        ("ints", slot, 2**40) for slot in (State.ring_head.index, State.buffer_head.index, State.recent_head.index)
    ]
    places = PLACES if not settings else ()
    wrong += [("reals", ints[part.index] + slot.index, bad) for part, slot in places for bad in (1e12, -1.0, np.nan)]
    wrong += [("banks", (0, bank.NEXT), bad) for bad in (1e12, np.nan)]
    assert state.arrays[0] is ints
    for array, place, value in wrong:
        for take in (lambda own: own.update(1.0, 1.0), lambda own: own.update_many([1.0, 1.0], [1.0, 1.0])):
            with pytest.raises(ValueError, match=r"the state is damaged|it must hold that is_sound"):
                take(damaged(identifier, array, place, value))


def test_a_state_that_says_that_it_collects_is_not_taken_for_one_that_learns() -> None:
    state = running()._state
    state.collects, state.ring_head = 1, 2**40
    one = np.ones(1)
    with pytest.raises(ValueError, match="collects"):
        single.by_covariance[1](*state.arrays, one, one, np.empty(0), np.empty(0), one.copy(), np.empty((1, 0)))


def test_a_truth_that_is_none_is_refused() -> None:
    state, one = running()._state, np.ones(1)
    state.ints[State.instruments.index] = 7
    with pytest.raises(ValueError, match="is_sound"):
        single.by_covariance[1](*state.arrays, one, one, np.empty(0), np.empty(0), one.copy(), np.empty((1, 0)))


@pytest.mark.parametrize(("refined", "most"), [(True, 5), (False, 4)])
def test_more_entries_than_the_work_arrays_have_room_for_are_refused(refined: bool, most: int) -> None:
    own = running()._state.fields
    names = ("noise", "colour", "path", "path_size", "banks", "order")
    for entries in (most, most + 1):
        s = SimpleNamespace(**{name: getattr(own, name) for name in names}, refined=refined, entries=entries)
        assert soundness.are_within(s) == (entries == most)


def test_an_optimizer_whose_memory_is_too_small_is_refused(calls: list[Call]) -> None:
    kernel, arguments = next(call for call in calls if call[0].name == "step.fixed_filter.steps")
    ints = arguments[0].copy()
    for code in gradient.MEMORY.keys() | covariance.MEMORY.keys():
        ints[State.algorithm.index] = code
        if gradient.MEMORY.get(code, gradient.INTEGRALS).size(4) > ints[State.memory_size.index]:
            with pytest.raises(ValueError, match="it must hold that is_sound"):
                kernel(ints, *arguments[1:])


def test_a_row_is_learned_with_a_diagonal_of_its_size(calls: list[Call]) -> None:
    kernel, arguments = next(call for call in calls if call[0].name == "step.miso.learn")
    place = 10
    assert arguments[place].size == arguments[8].size  # diagonal and delta
    longer = np.concatenate([arguments[place], arguments[place]])
    with pytest.raises(ValueError, match=r"step\.miso\.learn: it must hold that .*diagonal\.size == delta\.size"):
        kernel(*arguments[:place], longer, *arguments[place + 1 :])


def test_a_simulation_with_intervals_below_nought_stays_within_its_inputs() -> None:
    n, size = 1, 50
    for intervals in (np.full(size, -0.1), np.zeros(size), np.linspace(1.0, -1.0, size), np.full(size, np.nan)):
        made = np.ones(bank.size(n, 0))
        made[bank.NEXT], lengths = 0.0, np.concatenate([[0.1, 0.1], intervals])
        lengths[3] = 1e9  # which holds all inputs
        arguments = made, np.zeros(2), np.zeros(27), np.ones(1), 0.0, np.zeros(simulate.PROGRESS), np.ones(size + 2)
        rest = lengths, 0.1, False, np.zeros(size), np.zeros((0, n))
        front, _, _ = simulate.simulate(*arguments, *rest)
        assert front <= size + 2
        made[bank.NEXT] = 1e12
        with pytest.raises(ValueError, match="NEXT"):
            simulate.simulate(*arguments, *rest)


def test_the_reason_names_kernel_and_argument() -> None:
    good = [np.zeros((5, 5)), 1.0, np.zeros((5, 5)), np.zeros(5), np.zeros(30)]
    for place, bad, reason in (
        (0, np.zeros((5, 5), np.float32), "sums is not of float64"),
        (0, np.zeros(25), "sums has another number of dimensions"),
        (2, np.zeros((5, 10))[:, ::2], "models is not contiguous, in C order"),
        (2, np.broadcast_to(np.zeros((5, 5)), (5, 5)), "models is read-only"),
        (3, 7, "variances is no array"),
    ):
        with pytest.raises(TypeError, match=f"nested_models: {reason}"):
            nested_models(*good[:place], bad, *good[place + 1 :])
    with pytest.raises(ValueError, match=r"nested_models: it must hold that work\.size >= "):
        nested_models(*good[:4], np.zeros(29))
    with pytest.raises(TypeError, match="takes 5 arguments, not 4"):
        nested_models(*good[:4])
    with pytest.raises(TypeError, match="real number"):
        nested_models(good[0], "one", *good[2:])


def test_what_is_only_read_may_lie_in_steps() -> None:
    signals = np.random.default_rng(0).standard_normal((50, 2))
    result, same = np.zeros((2, 50)), np.zeros((2, 50))
    fill_all_pole(np.array([1.0, -0.5]), signals.T, result, np.zeros(2))
    fill_all_pole(np.array([1.0, -0.5]), signals.T.copy(), same, np.zeros(2))
    np.testing.assert_array_equal(result, same)


def test_a_step_takes_four_numbers_once_its_gate_is_open() -> None:
    identifier = rp.Identifier(rp.Structure(1), 0.1, filter=rp.StateVariableFilter(1.0), scaling=None, optimizer="adam")
    state: State = identifier._state.copy()
    library = native.library()
    step, gate = library.step(library.table(fixed_filter.step.name, state.arrays), state.arrays)
    with pytest.raises(Attention):
        step(1.0, 1.0, np.nan, np.nan)
    gate[0] = native.OPEN
    with pytest.raises(TypeError, match="four numbers"):
        step(1.0, 1.0)
    with pytest.raises(TypeError, match="real number"):
        step(1.0, "one", np.nan, np.nan)
    assert step(1, np.float64(1.0), np.nan, np.nan) == 1.0
    assert state.samples == 1
