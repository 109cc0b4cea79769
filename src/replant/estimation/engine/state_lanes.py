"""Lanes: states that keep a covariance, side by side in SIMD vectors; each keeps its own arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from replant.estimation.engine.state import State
from replant.kernels.optimizers.covariance import RECURSIVE_LEAST_SQUARES
from replant.kernels.schema import LINE, StateSlots
from replant.numerics.arguments import FloatArray, IntArray

STRETCH = 8
"""Samples that members take between two looks at whether one of them met with something out of the ordinary [samples].
Origin: with two poles at 50 Hz, 4 and 32 take 1.25 times as long a sample, 16 as long: looks cost time, and so does a
member that takes a whole stretch by itself, as where its model is renewed.
Sensitivity: changes no bit of any result.
"""

#: What a state must have to be stepped in a lane.
FIT = {
    StateSlots.examines_output: 1, StateSlots.refined: 1, StateSlots.algorithm: RECURSIVE_LEAST_SQUARES,
    StateSlots.collects: 0, StateSlots.has_reference: 0,
}  # fmt: skip
VALUES = list(FIT.values())

#: The places of these, and of what members side by side have in common.
ALIKE = np.array([
    slot.index
    for slot in (
        *FIT, StateSlots.path_size, StateSlots.order, StateSlots.entries, StateSlots.input_entries,
        StateSlots.square_input, StateSlots.straight_input, StateSlots.has_constant, StateSlots.has_noise_model,
        StateSlots.coloured, StateSlots.memory_size, StateSlots.settings_size, StateSlots.ring_size,
        StateSlots.rests_with_input, StateSlots.rest_after, StateSlots.settings,
    )
])  # fmt: skip


def kind(state: State) -> tuple[int, ...] | None:
    """Return what the states in the lanes of one vector must have in common; None where a state fits into none."""
    try:
        return state.lane_kind
    except AttributeError:
        state.lane_kind = found = _kind(state)  # it does not change once a state has learned
        return found


def _kind(state: State) -> tuple[int, ...] | None:
    numbers = state.ints[ALIKE].tolist()
    values, path, common = numbers[: len(FIT)], numbers[len(FIT)], numbers[len(FIT) :]
    if values != VALUES or not path or state.delay != 0.0 or len(state.buffer) != 1:
        return None
    *common, rest_after, settings = common
    forgets = bool(state.reals[settings] < 1.0)
    return (*common, rest_after > 0, forgets, len(state.reals))


def aligned(shape: tuple[int, ...]) -> FloatArray:
    """Return an array of zeros that begins on a cache line, so that no vector lies across two lines."""
    size = int(np.prod(shape))
    room = np.zeros(size + LINE // 8)
    skip = -room.ctypes.data % LINE // 8
    return room[skip : skip + size].reshape(shape)


class Lanes:
    """Work space for the states of one kind, and of one thread."""

    def __init__(self, state: State, size: int) -> None:
        from replant.kernels.lanes import LANES
        from replant.kernels.step.ensemble_exchange import width_of
        from replant.kernels.step.ensemble_ordinary import BESIDE

        entries, width = state.entries, width_of(state)
        self.kind, self.size = kind(state), size
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
        """Take samples from row ``start`` on; return where one needs attention, and up to which each has taken them."""
        from replant.kernels.lanes import LANES
        from replant.kernels.step import ensemble_covariance

        left, count = LANES - len(states), len(states)
        arrays = [array for state in (*states, *[states[0]] * left) for array in state.arrays]
        rows = np.array([*numbers, *[numbers[0]] * left])
        live, taken = self._live[:count], self._taken[:count]
        reached = ensemble_covariance.steps(*arrays, rows, live, taken, *self._work, start, u, y, errors, parameters)
        return reached, taken
