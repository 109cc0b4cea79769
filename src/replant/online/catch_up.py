"""Catching up: a state that was found of the samples up to n learns those that have come since, some at a time.

The arithmetic is sequential, so that the bits do not depend on how many it learns at once, and when.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from replant.estimation.engine.state import NOTHING, REGULAR, State, Step, bound_step, step_kernels
from replant.kernels.schema import BELIEVED, INPUT, OUTPUT, REFERENCE, STEP, Alarm, Doubt
from replant.online.change_response import first_look

if TYPE_CHECKING:
    from replant.estimation.settings import Settings
    from replant.numerics.arguments import FloatArray, IntArray

#: What a new state has from the one that took the samples meanwhile: what these left beside the ring.
MEANWHILE = (
    *(State.not_finite, State.too_large, State.not_later, State.too_dense, State.time_leaps, State.too_coarse),
    *(State.input_leaps, State.no_reference, State.last_time, State.earlier_stamps, State.earlier_time),
    *(State.held_at, State.held_input, State.held_output, State.held_time, State.held_reference),
)


class CatchUp:
    """A new state with a ring of its own, that follows the one in use.

    Attributes
    ----------
    state : State
        The new one.
    bound : tuple or None
        Its kernel for single samples and the gate of that, when it has come so far.
    regular : bool
        Whether the samples have no time stamps.
    """

    def __init__(self, found: State, old: State, *, regular: bool) -> None:
        self.regular = regular
        self.bound: tuple[Step, IntArray] | None = None
        self._begun, self._copied, self._learned = found.samples, 0, 0
        ring = np.zeros(old.recent.shape)  # not `zeros_like`, which would have the system give every page at once
        self.state = State(found.ints.copy(), found.reals.copy(), found.banks.copy(), found.buffer.copy(), ring)
        self.state.recent_size, self.state.recent_head = len(ring), found.samples % len(ring)
        self.state.square_input, self.state.attention_at = old.square_input, 0

    def go_on(self, kept: FloatArray, old: State, settings: Settings, rows: int, samples: int) -> None:
        """Copy some of the raw samples that were looked into, ``kept``; then learn some of those since."""
        if self._copied == len(kept) and self.bound is None:
            self.bound = bound_step(self.state, step_kernels(self.state, regular=self.regular)[0], settings.preprocess)
            return
        if self._copied == len(kept):
            self._learn(old, settings, samples)
            return
        some, ring = kept[self._copied : self._copied + rows], self.state.recent
        first = self._begun - len(kept) + self._copied
        ring[np.arange(first, first + len(some)) % len(ring)] = some
        self._copied += len(some)

    def finish(self, kept: FloatArray, old: State, settings: Settings) -> None:
        """Learn all samples that the other state, whose place this one takes, has taken."""
        if self._copied < len(kept):
            self.go_on(kept, old, settings, len(kept), 0)
        self._learn(old, settings, old.samples)
        self.state.take_over(old, *MEANWHILE)

    def _learn(self, old: State, settings: Settings, samples: int) -> None:
        new, first = self.state, self._begun + self._learned
        again = old.recent[np.arange(first, min(first + samples, old.samples)) % len(old.recent)]
        u, y = again[:, INPUT].copy(), again[:, OUTPUT].copy()
        if old.examines_output:
            y[again[:, -2 if old.has_reference else -1] == Doubt.MISSING] = math.nan
        stamps = REGULAR if self.regular else _sums(new.last_time, again[:, STEP])
        r = again[:, REFERENCE].copy() if old.has_reference else NOTHING
        _, steps = step_kernels(new, regular=self.regular)
        taken, errors = 0, np.empty(u.size)
        with new.without_preprocessing():
            while taken < u.size:
                new.attention, new.held_at = False, BELIEVED  # leaps among them have been judged
                rest = u[taken:], y[taken:], stamps[taken:], r[taken:]
                taken += steps(*new.arrays, *rest, errors[taken:], np.empty((u.size - taken, 0)))
                note_alarm(new, settings)
        self._learned += taken


def _sums(begin: float, steps: FloatArray) -> FloatArray:
    """Return the stamps of samples so far apart."""
    return np.cumsum(np.concatenate([[begin], steps]))[1:]


def note_alarm(state: State, settings: Settings) -> None:
    """Plan when an alarm that was raised is looked into; until then nothing is learned."""
    if state.alarm != Alarm.RAISED:
        return
    draft = State(state.ints.copy(), *state.arrays[1:])
    state.look_at, state.trusted_at = first_look(draft, settings), 0
    state.alarm = Alarm.RESTS  # last: interrupted, this is done again
