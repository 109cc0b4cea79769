"""Catching up: a state found from the samples up to n learns those that have come since, some at a time.

The arithmetic is sequential, so that the bits do not depend on how many samples are learned at once, and when.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from replant.estimation.engine.state import NOTHING, REGULAR, State, Step, bound, check, step_kernels
from replant.kernels.native import Kernel, library
from replant.kernels.schema import BELIEVED, INPUT, OUTPUT, REFERENCE, STEP, Alarm, Doubt
from replant.kernels.slot_tables import Real
from replant.online.change_response import first_look

if TYPE_CHECKING:
    from replant.estimation.settings import Settings
    from replant.numerics.arguments import FloatArray, IntArray

#: Slots that a new state copies from the one that took the samples meanwhile: counters and clock, and the
#: preprocessing, which is not applied again to samples from the ring.
MEANWHILE = (
    *(State.not_finite, State.too_large, State.not_later, State.too_dense, State.time_leaps, State.too_coarse),
    *(State.input_leaps, State.no_reference, State.last_time, State.earlier_stamps, State.earlier_time),
    *(State.held_at, State.held_input, State.held_output, State.held_time, State.held_reference),
    *(State.square_input, State.input_offset, State.output_offset),
)
IN_REALS = [slot.index for slot in MEANWHILE if isinstance(slot, Real)]
IN_INTS = [slot.index for slot in MEANWHILE if not isinstance(slot, Real)]


class CatchUp:
    """A new state that learns the samples since it was found, some in each update; its ring is ``spare`` if it fits."""

    def __init__(self, found: State, spare: FloatArray, *, regular: bool) -> None:
        self.regular, self._spare = regular, spare  # regular: without time stamps
        self.kernels: tuple[Kernel, Kernel] | None = None  # for single samples and for many; None: not chosen yet
        self.bound: tuple[Step, IntArray] | None = None  # kernel for single samples, bound to the state, and its gate
        self._begun, self._copied, self._learned = found.samples, 0, 0
        self._table, self._is_awake = bytearray(), False
        self.state = State(found.ints.copy(), found.reals.copy(), found.banks.copy(), found.buffer.copy(), NOTHING)

    def go_on(self, kept: FloatArray, old: State, settings: Settings, rows: int, samples: int) -> None:
        """Do the next step: copy some of the raw samples ``kept``, bind the kernel, or learn some samples since."""
        new = self.state
        if new.recent is NOTHING:
            self._make_ring(old)
        elif self._copied < len(kept):
            some, first = kept[self._copied : self._copied + rows], self._begun - len(kept) + self._copied
            new.recent[np.arange(first, first + len(some)) % len(new.recent)] = some
            self._copied += len(some)
        elif self.kernels is None:
            check(new)
            self.kernels = step_kernels(new, regular=self.regular)
        elif not self._table:
            self._table = library().table(self.kernels[0].name, new.arrays)
        elif self.bound is None:
            self.bound = bound(new, self._table, settings.preprocess)
        else:
            self._learn(old, settings, samples if self._is_awake else 0)
            self._is_awake = True

    def finish(self, kept: FloatArray, old: State, settings: Settings) -> None:
        """Learn all samples that ``old``, which this state replaces, has taken."""
        while self.state.recent is NOTHING or self._copied < len(kept):
            self.go_on(kept, old, settings, len(kept), 0)
        self._learn(old, settings, old.samples)
        self.state.reals[IN_REALS], self.state.ints[IN_INTS] = old.reals[IN_REALS], old.ints[IN_INTS]

    def _make_ring(self, old: State) -> None:
        # allocating or freeing a large ring takes longer than a sample at 1 kHz; the older samples in the spare one are
        # overwritten by newer ones
        new, ring = self.state, self._spare if self._spare.shape == old.recent.shape else np.zeros(old.recent.shape)
        new.recent, new.recent_size, new.recent_head = ring, len(ring), self._begun % len(ring)
        new.attention_at, new.square_input, new.input_offset, new.output_offset = 0, False, 0.0, 0.0

    def _learn(self, old: State, settings: Settings, samples: int) -> None:
        new, first = self.state, self._begun + self._learned
        again = np.take(old.recent, np.arange(first, min(first + samples, old.samples)), axis=0, mode="wrap").T.copy()
        u, y = again[INPUT], again[OUTPUT]
        if old.examines_output:
            y[again[-2 if old.has_reference else -1] == Doubt.MISSING] = math.nan
        stamps = REGULAR if self.regular else _sums(new.last_time, again[STEP])
        r = again[REFERENCE] if old.has_reference else NOTHING
        _, steps = self.kernels or step_kernels(new, regular=self.regular)
        taken, errors = 0, np.empty(u.size)
        while taken < u.size:
            new.attention, new.held_at = False, BELIEVED  # leaps among them have been accepted before
            rest = u[taken:], y[taken:], stamps[taken:], r[taken:]
            taken += steps(*new.arrays, *rest, errors[taken:], np.empty((u.size - taken, 0)))
            note_alarm(new, settings)
        self._learned += taken


def _sums(begin: float, steps: FloatArray) -> FloatArray:
    """Return the time stamps after ``begin`` of samples with these intervals."""
    return np.cumsum(np.concatenate([[begin], steps]))[1:]


def note_alarm(state: State, settings: Settings) -> None:
    """Plan the first look into an alarm that was raised; until then nothing is learned."""
    if state.alarm != Alarm.RAISED:
        return
    draft = State(state.ints.copy(), *state.arrays[1:])
    state.look_at, state.trusted_at = first_look(draft, settings), 0
    state.alarm = Alarm.RESTS  # last, so that an interrupted call is repeated
