"""State: the arrays of the kernels, with a property for each number, and the choice of the step kernel.

The regression behind every estimator, with Lambda moved to the left of (4), reads

    s^n/Lambda y = phi' theta,   phi = [-s^(n-1)/Lambda y ... -1/Lambda y, s^m/Lambda u ... 1/Lambda u (, 1)],

so the estimate has the plant's own parameters for any Lambda; the prediction error is that of (8).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from replant.errors import SystemRefusedError
from replant.estimation.engine.dimensions import Dimensions, collects_at_most, entries_of, ring_of, room_for
from replant.estimation.filters import Filter
from replant.estimation.settings import Request, Settings
from replant.kernels.native import Kernel, library
from replant.kernels.schema import StateSlots
from replant.kernels.slot_tables import Slot
from replant.model.preprocess import Preprocess
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray, IntArray

NOTHING = np.zeros(0)
REGULAR = np.zeros(0)  # the time stamps of a regular clock

# twice MOST_EARLIER, so that a repeated packet, whose samples are rejected, is no interruption; on sixteen random
# plants with holes of up to a hundred samples all estimates are good at 20 and at 10, and trusted at 18 and 19 of 48
# looks; at 10 fewer samples after a hole, 7 instead of 206, are treated as outliers
GAP = 20.0  # time without a sample after which the filters restart [sampling times]

#: The purpose of an array that the user can make large, and what to ask for instead.
LARGE = {"buffer": ("a replay buffer", "a smaller capacity"), "recent": ("a start-up", "a shorter startup")}

# then at most half of the RECENT newest samples are held out from the oldest of the PAST estimates
LONGEST_STEP = 1250  # most samples between two past estimates kept [samples]

# the least power of two that a test needs
SHORTEST_STEP = 128  # the same if the estimate tracks a changing plant, so that it is soon out of date [samples]


class State(StateSlots):
    """The kernels' arrays, with a property for each of their slots: see `replant.kernels.schema`."""

    __slots__ = ("lane_kind",)
    lane_kind: tuple[int, ...] | None  # cache of `vector_blocks.kind_of_lane`

    @property
    def arrays(self) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """All arrays, in the order of the kernels' arguments."""
        return self.ints, self.reals, self.banks, self.buffer, self.recent

    def copy(self, *, buffer: bool = True, recent: bool = True) -> State:
        """Return a state with its own arrays; it shares ``buffer`` or ``recent``, which may be large, if False."""
        kept = self.buffer.copy() if buffer else self.buffer
        raw = self.recent.copy() if recent else self.recent
        return State(self.ints.copy(), self.reals.copy(), self.banks.copy(), kept, raw)

    def make_room(self, most: int) -> None:
        """Lengthen the ring of raw samples if all rows are in use and there may be more, up to ``most``."""
        rows = len(self.recent)
        if self.samples != rows or rows >= most:
            return
        longer = np.zeros((room_for(rows, most), self.recent.shape[1]))
        longer[:rows] = self.recent
        self.recent, self.recent_size, self.recent_head = longer, len(longer), rows

    def room_until(self, most: int) -> int:
        """Return the number of samples at which the ring of raw samples must grow; 0 if it has its ``most`` rows."""
        return len(self.recent) if self.samples <= len(self.recent) < most else 0

    def take_over(self, old: State, *slots: Slot[Any]) -> None:
        """Copy the values of these slots from another state."""
        for slot in slots:
            setattr(self, slot.name, getattr(old, slot.name))

    @classmethod
    def empty(cls, sizes: Dimensions) -> State:
        """Return arrays of zeros of these sizes, with the begin of each block filled in."""
        shapes = sizes.shapes
        ints = np.zeros(shapes["ints"], np.int64)
        for block, begin in sizes.begins.items():
            ints[block.index] = begin
        try:
            state = cls(ints, *(np.zeros(shapes[name]) for name in ("reals", "banks", "buffer", "recent")))
        except MemoryError as error:
            name = max(("buffer", "recent"), key=lambda each: math.prod(shapes[each]))
            what, remedy = LARGE[name]
            rows, columns = shapes[name]
            raise SystemRefusedError(
                f"the system grants no memory for {what} of {rows:,} rows of {columns} numbers: ask for {remedy}"
            ) from error
        for name, value in vars(sizes).items():
            setattr(state, name, value)
        return state

    @classmethod
    def build(
        cls, structure: Structure, dt: float, chosen: Filter, *, instruments: bool = False, reference: bool = False
    ) -> State:
        """Return unscaled arrays without an optimizer; a fixed filter is filled in."""
        refined = chosen.follows_estimate
        entries, ring = entries_of(structure, refined=refined), ring_of(structure, dt)
        instruments = instruments or refined
        sizes = Dimensions(structure.poles, entries, ring, instruments=instruments, has_reference=reference)
        state = cls.empty(sizes)
        state.describe(structure, dt, chosen, np.ones(entries), 1.0)
        state.fix_filter(structure, dt, chosen)
        return state

    def describe(self, structure: Structure, dt: float, chosen: Filter, sigma: FloatArray, output_scale: float) -> None:
        """Fill in structure, kind of filter and scales (T,) without running compiled code, see `fix_filter`."""
        self.parameter_count, self.input_entries = structure.size, structure.zeros + 1
        self.straight_input = chosen.input_hold == "foh"
        self.refined = chosen.follows_estimate
        self.has_constant = self.refined or structure.bias
        self.bilinear = chosen.regular_only
        self.adapt, self.serving_bank = True, 1
        self.delay, self.interval = structure.delay, dt
        self.ready_at = self.longest_gap = math.inf
        self.output_scale = output_scale
        self.sigma[:], self.unit[:] = sigma, output_scale / sigma

    @classmethod
    def of_settings(cls, settings: Settings, recent: int, path: int | None = None) -> State:
        """Return the arrays of an identifier with these settings, before its first sample."""
        state = cls.laid_out(settings, recent, path)
        state.fix_filter(settings.structure, settings.dt, settings.filter)
        return state

    @classmethod
    def laid_out(cls, settings: Settings, recent: int, path: int | None = None) -> State:
        """Return the same without the fixed filter's numbers, without running compiled code."""
        structure, replay, optimizer = settings.structure, settings.replay, settings.optimizer
        state = cls.empty(Dimensions.of_settings(settings, recent, path))
        sigma = np.ones(state.entries)
        sigma[: structure.size] = settings.scaling.sigmas(structure)
        state.describe(structure, settings.dt, settings.filter, sigma, settings.scaling.output)
        state.memory[:] = optimizer.memory(state.entries)
        state.settings[:] = optimizer.settings(settings.dt, state.unit)
        state.algorithm, state.normalize = optimizer.code, settings.normalize
        state.warmup = min(replay.warmup, replay.capacity - 1) if replay else 0  # a full buffer is warm
        state.seed = replay.seed if replay else 0
        state.square_input = settings.preprocess.input_map == "square"
        state.coloured = optimizer.keeps_covariance and optimizer.keeps_colour
        state.has_noise_model = state.coloured and state.refined
        state.noise.gain = 1.0
        follows = optimizer.keeps_covariance and not (optimizer.keeps_colour and state.settings[0] == 1.0)
        state.past_step = SHORTEST_STEP if follows else LONGEST_STEP
        state.input_offset = float(settings.preprocess.input_offset)
        state.output_offset = float(settings.preprocess.output_offset)
        state.longest_gap = GAP * settings.dt
        return state

    @classmethod
    def collecting(cls, request: Request, samples: int = 0, *, reference: bool) -> State:
        """Return the arrays that collect the samples of a start-up, raw except for the input map."""
        room = room_for(samples, collects_at_most(request))
        state = cls.empty(Dimensions.of_request(request, room, reference=reference))
        state.collects, state.adapt, state.serving_bank = True, True, 1
        state.square_input = request.preprocess.input_map == "square"
        state.delay, state.interval, state.longest_gap = request.structure.delay, request.dt, GAP * request.dt
        state.forget_input = 1.0 / max(request.first_hold, 1)
        return state

    @property
    def factors(self) -> tuple[FloatArray, FloatArray]:
        """Views of U (T, T) and D (T,), the covariance U D U' that the optimizer keeps."""
        size, memory = self.entries, self.memory
        return memory[: size * size].reshape(size, size), memory[size * size : size * size + size]

    @property
    def physical(self) -> FloatArray:
        """The estimate (T,) in physical units."""
        return np.asarray(self.theta * self.unit)

    @property
    def noise_has_grown(self) -> bool:
        """Whether an alarm has ended without a change of the plant: the residual of that time is usual since."""
        from replant.kernels.monitoring.outliers import LIMIT

        return bool(self.cusum_limit > LIMIT)

    @property
    def serves_reflected(self) -> bool:
        """Whether the auxiliary model in use is unstable: its bank's denominator has the poles reflected."""
        from replant.kernels.filters.bank import REFLECTED

        return bool(self.banks[self.serving_bank, REFLECTED])

    def install(self, theta: FloatArray) -> None:
        """Make ``theta`` (T,), in physical units, the auxiliary model in use, with its filters at rest."""
        from replant.kernels.filters.chain import install_model

        self.serving_bank, self.warming = 1, False
        install_model(*self.arrays, 1, theta / self.unit)

    @contextmanager
    def without_preprocessing(self) -> Iterator[None]:
        """Take samples as they are kept in ``recent``: mapped, working point subtracted."""
        kept = self.square_input, self.input_offset, self.output_offset
        self.square_input, self.input_offset, self.output_offset = False, 0.0, 0.0
        try:
            yield
        finally:
            self.square_input, self.input_offset, self.output_offset = kept

    def fix_filter(self, structure: Structure, dt: float, chosen: Filter) -> None:
        """Set the denominator in the bank of a fixed filter, and the one discretisation of a bilinear filter."""
        from replant.kernels.filters import bank as bk

        state_filter = chosen.fixed
        if state_filter is None:
            return
        n, entries, fixed = structure.poles, self.entries, self.banks[0]
        bk.set_denominator(
            fixed, n, entries, self.input_entries, self.has_constant, False, True,
            state_filter.polynomial(n)[1:], self.sigma,
        )  # fmt: skip
        if state_filter.regular_only:
            discrete = state_filter.discretize(n, dt)
            kept = fixed[bk.at_kept(n, entries) :]
            kept[0] = dt
            kept[1 : 1 + n * n] = discrete.transition.ravel()
            kept[1 + n * n : 1 + n * n + n] = discrete.output_taps[0]
            fixed[bk.NEXT] = 1.0


#: Why a sample is not learned, and the slot that counts it.  Outliers, outputs of a stuck sensor and missing outputs
#: are bridged.  A sample without a reference, if others have one, is learned with the previous reference.
REASONS = {
    "not finite": State.not_finite, "too large": State.too_large, "not later": State.not_later,
    "too dense": State.too_dense, "time leap": State.time_leaps, "time too coarse": State.too_coarse,
    "input leap": State.input_leaps, "outlier": State.outliers, "stuck": State.stuck, "no output": State.no_output,
    "no reference": State.no_reference,
}  # fmt: skip


Step = Callable[[float, float, float, float], float]  # takes a sample (u, y, t, r) and returns its error


def step_kernels(state: State, *, regular: bool) -> tuple[Kernel, Kernel]:
    """Return the step kernels for one sample and for many, which use the same arrays; see `kernels.step`."""
    from replant.kernels.step import fixed_filter, single

    if state.collects:
        return single.collecting
    if state.examines_output:
        return single.by_covariance
    without_model = not (state.instruments or state.rests_with_input)
    strictly_proper = state.input_entries <= state.order
    if regular and without_model and strictly_proper and state.delay == 0.0:
        return fixed_filter.step, fixed_filter.steps
    return single.by_gradient


def bound_step(state: State, kernel: Kernel, preprocess: Preprocess) -> tuple[Step, IntArray]:
    """Return a function of (u, y, t, r) that takes one sample of this state with ``kernel``, and its gate (1,)."""
    check(state)  # a single step checks nothing; kernels for many samples check each time
    # an input map in Python is called first; while the gate is shut, as initially, the function raises Attention
    return bound(state, library().table(kernel.name, state.arrays), preprocess)


def check(state: State) -> None:
    """Raise ValueError if the arrays are not as long as the state's own numbers state."""
    from replant.kernels.step.soundness import is_sound

    if not is_sound(*state.arrays):
        raise ValueError("the state is damaged: its arrays are not as long as its own numbers say")


def bound(state: State, table: bytearray, preprocess: Preprocess) -> tuple[Step, IntArray]:
    """Return the result of `bound_step` for a checked state and the table of its arrays."""
    call, gate = library().step(table, state.arrays)
    if callable(preprocess.input_map):
        return lambda u, y, t, r: call(float(preprocess.call_map(np.array([u]))[0]), y, t, r), gate
    return call, gate
