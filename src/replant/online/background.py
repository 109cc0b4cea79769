"""Background: what is due between samples is computed by a second Python, and taken up at a later sample fixed before.

At a count n the numbers of the state are copied, and the raw samples, oldest first, some with each later update:
into memory that both processes share, so that none waits for the other.  At the count m = n + `lag` the result is
taken up; where it is a new state, this learns the samples n + 1 to m.  n and m follow from the samples alone, and who
computes does not matter, so the bits do not depend on how fast the machine is, or whether the second Python lives.

A ring that is full loses its oldest samples meanwhile, m - n of them: the second Python does not get these.  All that
it gets is then still kept at m, and the copy of the numbers at n is all that a checkpoint has to hold beside.
"""

from __future__ import annotations

import contextlib
import importlib
import math
import pickle
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from replant.estimation.engine.state import NOTHING, REGULAR, State, step_kernels
from replant.estimation.settings import Settings
from replant.kernels.schema import BELIEVED, INPUT, OUTPUT, REFERENCE, STATE_ARRAYS, STEP, Alarm, Doubt
from replant.numerics.arguments import FloatArray
from replant.online import second_process
from replant.online.change_response import first_look
from replant.online.revision import revise
from replant.online.second_process import DONE, FAILED, PENDING, Place, Worker, fits, read, views, write

PART = 0.05  # of the record: what comes later by so much hardly adds to the delay that a growing record has [ratio]
LEAST = 20  # samples until a result is taken up, at least: at 1 kHz what a short record takes to solve [samples]
SLICE = 1024  # raw samples copied in one update: some 10 us [samples]
LOOK = 2e-4  # time between two looks whether the result is there, where it is waited for [s]

#: What a look into the record may write without that the estimate changes.
PLANNED = State.look_at, State.trusted_at, State.undecided
#: What a new state has from the one that took the samples meanwhile: what these left beside the ring.
MEANWHILE = (
    *(State.not_finite, State.too_large, State.not_later, State.too_dense, State.time_leaps, State.too_coarse),
    *(State.input_leaps, State.no_reference, State.last_time, State.earlier_stamps, State.earlier_time),
    *(State.held_at, State.held_input, State.held_output, State.held_time, State.held_reference),
)

NUMBERS = STATE_ARRAYS[:-1]  # the arrays of a state but for the raw samples


def lag(state: State) -> int:
    """Return how many samples later what is due now is taken up."""
    rows = len(state.recent)
    record = min(state.samples - state.record_began, rows)
    return max(min(max(math.ceil(PART * record), LEAST), rows // 2), 1)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What `revise` has led to."""

    state: State  # with the raw samples that there were, oldest first
    only_planned: bool  # whether only what `PLANNED` lists has changed
    due: int


def outcome(state: State, settings: Settings, due: int, most: int) -> Outcome:
    """Return where `revise` leads to; the ring of ``state`` has no room for more than there is."""
    state.attention_at, state.attention = 0, False
    before, count = state.copy(), min(state.samples, len(state.recent))
    after, due = revise(state, settings, due, most)
    for slot in PLANNED:
        setattr(before, slot.name, getattr(after, slot.name))
    same = all(one.tobytes() == other.tobytes() for one, other in zip(before.arrays, after.arrays, strict=True))
    kept = after.recent[np.arange(after.samples - count, after.samples) % len(after.recent)]
    return Outcome(State(after.ints, after.reals, after.banks, after.buffer, kept), same, due)


class Job:
    """What is due at a count of samples, and where it stands.

    Attributes
    ----------
    numbers : State
        As it was, without raw samples.
    until : int
        Accepted samples at which the result is taken up.
    """

    def __init__(self, numbers: State, rows: int) -> None:
        self.numbers = numbers
        self._sent: tuple[Worker, Place] | None = None
        self._copied, self._written, self._rows = 0, False, rows
        ahead = lag(state_of(numbers.arrays[:-1], np.empty((rows, 0))))
        self.begun, self.until = numbers.samples, numbers.samples + ahead
        self.room = rows - ahead  # rows that nothing is written to meanwhile
        self.kept = min(self.begun, self.room)
        self._slice = max(SLICE, -(-self.kept // max(ahead // 2, 1)))
        self._steps = -(-self.kept // self._slice) + 2  # slices, then what goes with them, then the word to begin

    @classmethod
    def of(cls, state: State) -> Job:
        """Return what is due now."""
        numbers = [array.copy() for array in state.arrays[:-1]]
        return cls(state_of(numbers, np.empty((0, state.recent.shape[1]))), len(state.recent))

    def __reduce__(self) -> tuple[Any, ...]:
        return Job, (self.numbers.copy(), self._rows)

    def next_stop(self, now: int) -> int:
        """Return at how many samples there is something to do for it: a slice to copy, or the result to take up."""
        return min(now + 1, self.until) if now - self.begun < self._steps else self.until

    def go_on(
        self, state: State, settings: Settings, due: int, most: int, place: Place, *, whole: bool = False
    ) -> None:
        """Copy the raw samples whose turn it is, ``whole`` all of them; after the last let the second Python begin."""
        worker, shapes = second_process.worker(), self._shapes
        if self._sent is not None or worker is None or not fits(place.buffer, shapes):
            return
        step = self._steps if whole else state.samples - self.begun
        rows, *numbers = views(place.buffer, shapes)
        until = min(step * self._slice, self.kept)
        if until > self._copied:
            rows[self._copied : until] = self._raw(state, self._copied, until)
            self._copied = until
        if step >= self._steps - 1 and not self._written:
            for view, array in zip(numbers, self.numbers.arrays[:-1], strict=True):
                view[:] = array
            self._written = write(place.buffer, shapes, _text(shapes, settings, due, most))
        if step >= self._steps and self._written:
            place.buffer[0] = PENDING
            worker.send(place)
            self._sent = worker, place

    def wait(self) -> bool:
        """Wait for the result, if it is coming; return whether it was not there."""
        if self._sent is None or not self._sent[1].is_mine:
            self._sent = None
            return True
        worker, place = self._sent
        is_late = place.buffer[0] == PENDING
        while place.buffer[0] == PENDING and worker.lives():
            time.sleep(LOOK)
        return is_late

    def outcome(self, state: State, settings: Settings, due: int, most: int) -> Outcome:
        """Return the result, from the second Python or computed here; ``state``: as it is at ``until``."""
        if self._sent is not None and self._sent[1].buffer[0] == DONE:
            buffer = self._sent[1].buffer
            rows, *numbers = (view.copy() for view in views(buffer, self._shapes))
            same, due = pickle.loads(read(buffer))
            return Outcome(state_of(numbers, rows), same, due)
        return outcome(self._whole(self._raw(state, 0, self.kept)), settings, due, most)

    @property
    def _shapes(self) -> list[tuple[int, ...]]:
        columns = self.numbers.recent.shape[1]
        return [(self.kept, columns), *(array.shape for array in self.numbers.arrays[:-1])]

    def _raw(self, state: State, begin: int, end: int) -> FloatArray:
        """Return some of the raw samples kept for it, from a later state."""
        first = self.begun - self.kept
        return np.take(state.recent, np.arange(first + begin, first + end) % len(state.recent), axis=0)

    def _whole(self, rows: FloatArray) -> State:
        return _whole(self.numbers.copy().arrays[:-1], rows, self.room)


def _text(shapes: list[tuple[int, ...]], settings: Settings, due: int, most: int) -> bytes:
    """Return what goes with the arrays; nothing, which is refused, where only the user's script knows what to make."""
    if callable(settings.preprocess.input_map):  # maps samples alone, and might not be understood there
        settings = replace(settings, preprocess=replace(settings.preprocess, input_map="identity"))
    with contextlib.suppress(Exception):
        return pickle.dumps((shapes, settings, due, most))
    return b""


def state_of(numbers: Sequence[Any], ring: FloatArray) -> State:
    """Return a state of its numbers and its raw samples."""
    ints, reals, banks, buffer = numbers
    return State(ints, reals, banks, buffer, ring)


def _whole(numbers: Sequence[Any], rows: FloatArray, room: int) -> State:
    """Return a state with a ring of these raw samples, oldest first."""
    state = state_of(numbers, np.zeros((room, rows.shape[1])))
    state.recent[np.arange(state.samples - len(rows), state.samples) % room] = rows
    state.recent_size, state.recent_head = room, state.samples % room
    return state


def caught_up(job: Job, found: State, old: State, settings: Settings, *, regular: bool) -> State:
    """Return the state found, with the raw samples of ``old``, after it has learned those that came meanwhile."""
    ring, size = old.recent.copy(), len(old.recent)
    again = ring[np.arange(job.begun, old.samples) % size]
    ring[np.arange(job.begun - job.kept, job.begun) % size] = found.recent
    new = State(found.ints, found.reals, found.banks, found.buffer, ring)
    new.recent_size, new.recent_head, new.square_input = size, job.begun % size, old.square_input
    u, y = again[:, INPUT].copy(), again[:, OUTPUT].copy()
    if old.examines_output:
        y[again[:, -2 if old.has_reference else -1] == Doubt.MISSING] = math.nan
    stamps = REGULAR if regular else old.last_time - (again[:, STEP].sum() - np.cumsum(again[:, STEP]))
    r = again[:, REFERENCE].copy() if old.has_reference else NOTHING
    _, steps = step_kernels(new, regular=regular)
    taken, errors = 0, np.empty(u.size)
    new.attention_at = 0
    with new.without_preprocessing():
        while taken < u.size:
            new.attention, new.held_at = False, BELIEVED  # leaps among them have been judged
            rest = u[taken:], y[taken:], stamps[taken:], r[taken:]
            taken += steps(*new.arrays, *rest, errors[taken:], np.empty((u.size - taken, 0)))
            note_alarm(new, settings)
    new.take_over(old, *MEANWHILE)
    return new


def note_alarm(state: State, settings: Settings) -> None:
    """Plan when an alarm that was raised is looked into; until then nothing is learned."""
    if state.alarm != Alarm.RAISED:
        return
    draft = State(state.ints.copy(), *state.arrays[1:])
    state.look_at, state.trusted_at = first_look(draft, settings), 0
    state.alarm = Alarm.RESTS  # last: interrupted, this is done again


def prepare() -> None:
    """Import what a solution does when it is made first: at 1 kHz SciPy takes more than a hundred samples."""
    importlib.import_module("scipy.special")


def serve() -> None:
    """Do what is asked for, in the second Python."""
    prepare()
    second_process.serve(_answer)


def _answer(buffer: memoryview) -> int:
    """Compute what is asked for and write the result; return whether that went well."""
    try:
        shapes, settings, due, most = pickle.loads(read(buffer))
        shared = views(buffer, shapes)
        rows, *numbers = (view.copy() for view in shared)
        size = state_of(numbers, NOTHING).recent_size
        room = size - lag(state_of(numbers, np.empty((size, 0))))
        found = outcome(_whole(numbers, rows, room), settings, due, most)
        for view, result in zip(shared, (found.state.recent, *found.state.arrays[:-1]), strict=True):
            view[:] = result
        write(buffer, shapes, pickle.dumps((found.only_planned, found.due)))
    except Exception:  # whatever it is: who asks computes it, and meets it
        return FAILED
    return DONE
