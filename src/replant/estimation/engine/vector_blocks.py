"""Several identifiers in SIMD vectors: arrays stacked in blocks, or, with a covariance, copied into lanes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from replant.estimation.engine.state import State
from replant.kernels.optimizers.covariance import RECURSIVE_LEAST_SQUARES
from replant.kernels.schema import LINE, StateSlots
from replant.kernels.slot_tables import Slot
from replant.numerics.arguments import FloatArray, IntArray

TILE = 256  # samples that a block takes at once: with their results they stay in the processor's cache [samples]
#: The slots that are equal in all members of a block: all settings in `ints` but the random seed.
ALIKE_IN_BLOCKS = [slot.index for slot in StateSlots.integers if slot.laid_out and slot is not StateSlots.seed]
ALIKE_IN_BLOCKS += [StateSlots.rests_with_input.index, StateSlots.adapt.index]
#: The slots by which members are sorted into blocks: members equal in all of them draw the same rows of their buffers.
IN_STEP = [slot.index for slot in (State.seed, State.drawn, State.buffer_filled, State.buffer_head)]

STRETCH = 8
"""Samples that members take between two checks whether one of them had a sample that was not ordinary [samples].
Origin: with two poles at 50 Hz, 4 and 32 take 1.25 times as long a sample, 16 as long: checks cost time, and so does a
member that takes a whole stretch alone, for instance when its model is renewed.
Sensitivity: changes no bit of any result.
"""

#: The values that a state must have to be stepped in a lane.
FIT: dict[Slot[Any], int] = {
    StateSlots.examines_output: 1, StateSlots.refined: 1, StateSlots.algorithm: RECURSIVE_LEAST_SQUARES,
    StateSlots.collects: 0, StateSlots.has_reference: 0,
}  # fmt: skip
VALUES = list(FIT.values())

#: The places of these slots, and of the others that must be equal in members side by side.
ALIKE_IN_LANES = np.array([
    slot.index
    for slot in (
        *FIT, StateSlots.path_size, StateSlots.order, StateSlots.entries, StateSlots.input_entries,
        StateSlots.square_input, StateSlots.straight_input, StateSlots.has_constant, StateSlots.has_noise_model,
        StateSlots.coloured, StateSlots.memory_size, StateSlots.settings_size, StateSlots.ring_size,
        StateSlots.rests_with_input, StateSlots.rest_after, StateSlots.settings,
    )
])  # fmt: skip


def is_under_way(state: State) -> bool:
    """Return whether the fixed-filter kernel has taken its first sample and computed its discretisation."""
    from replant.kernels.filters import bank as bk

    kept = state.banks[0, bk.at_kept(state.order, state.entries)]
    interval = state.interval
    return state.started and bool(abs(kept - interval) <= bk.SAME_INTERVAL * interval)


def kind_of_block(state: State) -> tuple[int, ...]:
    """Return the values that must be equal in the members of one block."""
    return tuple(state.ints[ALIKE_IN_BLOCKS].tolist())


def order(state: State) -> tuple[int, ...]:
    """Return the key by which members are sorted into blocks."""
    return tuple(state.ints[IN_STEP].tolist())


def are_apart(states: Sequence[State]) -> bool:
    """Return whether the random streams of some states differ."""
    return len({state.seed for state in states}) > 1


def kind_of_lane(state: State) -> tuple[int, ...] | None:
    """Return the values that must be equal in the lanes of one vector; None if a state cannot be in a lane."""
    try:
        return state.lane_kind
    except AttributeError:
        state.lane_kind = found = _kind_of_lane(state)  # constant once a state has learned
        return found


def _kind_of_lane(state: State) -> tuple[int, ...] | None:
    numbers = state.ints[ALIKE_IN_LANES].tolist()
    values, path, common = numbers[: len(FIT)], numbers[len(FIT)], numbers[len(FIT) :]
    if values != VALUES or not path or state.delay != 0.0 or len(state.buffer) != 1:
        return None
    *common, rest_after, settings = common
    forgets = bool(state.reals[settings] < 1.0)
    return (*common, rest_after > 0, forgets, len(state.reals))


def aligned(shape: tuple[int, ...], new: Callable[[int], FloatArray] = np.zeros) -> FloatArray:
    """Return a new array that begins on a cache line, so that no vector lies across two lines."""
    size = math.prod(shape)
    room = new(size + LINE // 8)
    skip = -int(room.__array_interface__["data"][0]) % LINE // 8
    return room[skip : skip + size].reshape(shape)


@dataclass(frozen=True, eq=False)
class Block:
    """The stacked arrays of up to `kernels.lanes.LANES` members; see `replant.kernels.step.ensemble`."""

    numbers: IntArray  # (LANES,): places of the members in the ensemble; unused lanes repeat the first
    members: int  # number of members
    # arrays as in `State`; the member axis is the first of ``ints`` and the last of the others
    arrays: tuple[IntArray, FloatArray, FloatArray, FloatArray, FloatArray]
    apart: bool  # whether the random streams differ; then the member axis of ``buffer`` is the first
    work: tuple[np.ndarray, ...] = field(repr=False)

    @classmethod
    def of_states(cls, numbers: Sequence[int], states: Sequence[State]) -> Block:
        """Stack the arrays of these members."""
        from replant.kernels.lanes import LANES

        lanes = [*states, *[states[0]] * (LANES - len(states))]
        rows = [*numbers, *[numbers[0]] * (LANES - len(numbers))]
        first, apart = states[0], are_apart(states)
        work = (
            np.ones(LANES, np.int64),
            aligned((first.batch_size, first.buffer.shape[1], LANES)),
            np.arange(first.batch_size),
            np.zeros(LANES, np.int64),
            aligned((first.entries + first.memory_size, LANES)),
        )
        ints, reals, banks, buffers, recent = zip(*(state.arrays for state in lanes), strict=True)
        buffer = np.stack(buffers) if apart else side_by_side(buffers)
        arrays = np.stack(ints), side_by_side(reals), side_by_side(banks), buffer, side_by_side(recent)
        return cls(np.array(rows), len(states), arrays, apart, work)

    def state(self, lane: int) -> State:
        """Return the arrays of one member as views."""
        ints, reals, banks, buffers, recent = self.arrays
        buffer = buffers[lane] if self.apart else buffers[..., lane]
        return State(ints[lane], reals[..., lane], banks[..., lane], buffer, recent[..., lane])

    def take(
        self, room: Room, start: int, u: FloatArray, y: FloatArray, errors: FloatArray, parameters: FloatArray
    ) -> None:
        """Take the samples from row ``start`` on."""
        from replant.kernels.step import ensemble

        spaces = room.of(len(u) - start, parameters.shape[2])
        ensemble.steps(
            *self.arrays, self.apart, *self.work, *spaces, self.numbers, self.members, start, u, y, errors, parameters
        )


class Lanes:
    """Work space for the states of one kind, and of one thread."""

    def __init__(self, state: State, size: int) -> None:
        from replant.kernels.lanes import LANES
        from replant.kernels.step.ensemble_exchange import width_of
        from replant.kernels.step.ensemble_ordinary import BESIDE

        entries, width = state.entries, width_of(state)
        self.kind, self.size = kind_of_lane(state), size
        self._live, self._taken = np.zeros(LANES, np.int64), np.zeros(LANES, np.int64)
        shapes = (
            (state.reals.size,), (state.reals.size,), (2, width), (2, width), (BESIDE,), (entries + 1,), (3, STRETCH),
            (STRETCH, size),
        )  # fmt: skip
        self._work = (np.zeros((LANES, state.ints.size), np.int64), *(aligned((*shape, LANES)) for shape in shapes))

    def take(
        self, states: Sequence[State], numbers: Sequence[int], start: int, u: FloatArray, y: FloatArray,
        errors: FloatArray, parameters: FloatArray,
    ) -> tuple[int, IntArray]:  # fmt: skip
        """Take samples from row ``start`` on until one needs attention; return the rows reached by all and by each."""
        from replant.kernels.lanes import LANES
        from replant.kernels.step import ensemble_covariance

        left, count = LANES - len(states), len(states)
        arrays = [array for state in (*states, *[states[0]] * left) for array in state.arrays]
        rows = np.array([*numbers, *[numbers[0]] * left])
        live, taken = self._live[:count], self._taken[:count]
        reached = ensemble_covariance.steps(*arrays, rows, live, taken, *self._work, start, u, y, errors, parameters)
        return reached, taken


class Room:
    """Work space of one thread, reused while it is large enough: its allocation takes as long as a hundred samples."""

    def __init__(self) -> None:
        self._arrays = aligned((0, 0, 0)), aligned((0, 0, 0))
        self._lanes: Lanes | None = None

    def of(self, samples: int, size: int) -> tuple[FloatArray, FloatArray]:
        """Return room for a tile of samples: inputs, outputs and errors; the first ``size`` parameters."""
        from replant.kernels.lanes import LANES

        rows = min(TILE, max(samples, 1))
        tile, estimates = self._arrays
        if tile.shape[1] < rows or estimates.shape[1] != size:
            self._arrays = aligned((3, rows, LANES)), aligned((rows, size, LANES))
        return self._arrays

    def lanes(self, kind: tuple[int, ...], state: State, size: int) -> Lanes:
        """Return room for states of a kind, such as ``state``, and for the first ``size`` parameters."""
        if self._lanes is None or (self._lanes.kind, self._lanes.size) != (kind, size):
            self._lanes = Lanes(state, size)
        return self._lanes


def side_by_side(arrays: Sequence[FloatArray]) -> FloatArray:
    """Return the arrays stacked along a new last axis, so that each vector begins on a cache line."""
    result = aligned((*arrays[0].shape, len(arrays)))
    return np.stack(arrays, axis=-1, out=result)
