"""Background: what is due between samples is computed by a second Python, and taken up at a later sample fixed before.

At a count n the numbers of the state are copied, and the raw samples, oldest first, some with each later update:
into memory that both processes share, so that none waits for the other.  At the count m = n + `lag` the result is
taken up; where it is a new state, this has learned the samples n + 1 to m.  n and m follow from the samples alone, and
who computes does not matter, so the bits do not depend on how fast the machine is, or whether the second Python lives.

A ring that is full loses its oldest samples meanwhile, m - n of them: the second Python does not get these.  All that
it gets is then still kept at m, and the copy of the numbers at n is all that a checkpoint has to hold beside.

Nothing of this may take longer than a part of a sample at 1 kHz, so each step has an update of its own.  From half of
the lag on it is looked whether the result is there: the new state is then made ready beside the one in use (`CatchUp`),
so that at m one takes the place of the other.
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

from replant.estimation.engine.state import NOTHING, State
from replant.estimation.settings import Settings
from replant.kernels.schema import STATE_ARRAYS
from replant.numerics.arguments import FloatArray
from replant.online import second_process
from replant.online.catch_up import CatchUp
from replant.online.revision import revise
from replant.online.second_process import DONE, FAILED, PENDING, Place, Worker, fits, read, rows_of, views, write

PART = 0.05  # of the record: what comes later by so much hardly adds to the delay that a growing record has [ratio]
LEAST = 20  # samples until a result is taken up, at least: at 1 kHz what a short record takes to solve [samples]
SLICE = 512  # raw samples copied in one update: some 10 us [samples]
LOOKS = 256  # looks whether the result is there, in twice the time that they are spread over, at the most [count]
LEARNED = 8  # samples learned again in one update, but for those that have come since the last: some 10 us [samples]
LOOK = 2e-4  # time between two looks whether the result is there, where it is waited for [s]

#: What a look into the record may write without that the estimate changes.
PLANNED = State.look_at, State.trusted_at, State.undecided
NUMBERS = STATE_ARRAYS[:-1]  # the arrays of a state but for the raw samples


def lag(state: State, rows: int) -> int:
    """Return how many samples later what is due now is taken up, where ``rows`` raw ones are kept."""
    record = min(state.samples - state.record_began, rows)
    return max(min(max(math.ceil(PART * record), LEAST), rows // 2), 1)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What `revise` has led to."""

    state: State  # with the raw samples that there were, oldest first; without, where these lie in shared memory
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
    place : Place or None
        The memory shared with the second Python.
    """

    def __init__(self, numbers: State, rows: int) -> None:
        self.numbers = numbers
        self.place: Place | None = None
        self._sent: tuple[Worker, Place] | None = None
        self._copied, self._written, self._rows = 0, False, rows
        self._numbers: list[Any] | None = None
        self._found: Outcome | None = None
        self._ahead: CatchUp | None = None
        ahead = lag(numbers, rows)
        self.begun, self.until = numbers.samples, numbers.samples + ahead
        self.room = rows - ahead  # rows that nothing is written to meanwhile
        self.kept = min(self.begun, self.room)
        self._slice = max(SLICE, -(-self.kept // max(ahead // 2, 1)))
        self._steps = -(-self.kept // self._slice) + 3  # the memory, slices, the numbers, the word to begin
        self._half, self._pace = self.begun + ahead // 2, max(ahead // LOOKS, 1)
        self._learned = self._pace + ahead // LOOKS + LEARNED

    @classmethod
    def of(cls, state: State) -> Job:
        """Return what is due now."""
        numbers = [array.copy() for array in state.arrays[:-1]]
        return cls(state_of(numbers, np.empty((0, state.recent.shape[1]))), len(state.recent))

    def __reduce__(self) -> tuple[Any, ...]:
        return Job, (self.numbers.copy(), self._rows)

    def next_stop(self, now: int) -> int:
        """Return at how many samples there is something to do for it, or the result is to be taken up."""
        if now - self.begun < self._steps:
            return min(now + 1, self.until)
        passed = max(now - self._half, -1) // self._pace  # in the second half of the time the result may be there
        return min(self._half + (passed + 1) * self._pace, self.until)

    def go_on(self, state: State, settings: Settings, due: int, most: int) -> bool:
        """Do what is next for the second Python to begin; return whether there was something left."""
        worker, shapes = second_process.worker(), self._shapes
        if self._sent is not None or worker is None or self.place is None or not fits(self.place.buffer, shapes):
            return False
        if self._copied < self.kept:
            until = min(self._copied + self._slice, self.kept)
            rows_of(self.place.buffer, shapes[0])[self._copied : until] = self._raw(state, self._copied, until)
            self._copied = until
            return True
        if not self._written:
            for view, array in zip(views(self.place.buffer, shapes)[1:], self.numbers.arrays[:-1], strict=True):
                view[:] = array
            text = pickle.dumps((shapes, self.place.told(settings, text_of), due, most))
            self._written = write(self.place.buffer, shapes, text)
            return self._written
        self.place.buffer[0] = PENDING
        worker.send(self.place)
        self._sent = worker, self.place
        return False

    def look(self, state: State, settings: Settings, *, regular: bool) -> None:
        """Where the result is there, let a new state catch up with some of the samples that have come since."""
        if self._found is None:
            if self._is_there:
                self._receive()
        elif self.needs_new(self._found, state):
            ahead, self._ahead = self._ahead_of(self._found, state, regular=regular), None  # interrupted: begun again
            ahead.go_on(self._raw_of(self._found), state, settings, self._slice, self._learned)
            self._ahead = ahead

    def needs_new(self, found: Outcome, state: State) -> bool:
        """Return whether the result is more than a plan for the state in use."""
        return not found.only_planned or state.alarm != self.numbers.alarm

    def caught_up(self, found: Outcome, old: State, settings: Settings, *, regular: bool) -> CatchUp:
        """Return the state found, after it has learned what came meanwhile, to take the place of ``old``."""
        ahead, self._ahead = self._ahead_of(found, old, regular=regular), None
        ahead.finish(self._raw_of(found), old, settings)
        return ahead

    def _ahead_of(self, found: Outcome, old: State, *, regular: bool) -> CatchUp:
        ahead = self._ahead
        return CatchUp(found.state, old, regular=regular) if ahead is None or ahead.regular != regular else ahead

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
        while self._found is None and self._is_there:
            self._receive()
        return self._found or outcome(self._whole(self._raw(state, 0, self.kept)), settings, due, most)

    @property
    def _is_there(self) -> bool:
        return self._sent is not None and self._sent[1].is_mine and self._sent[1].buffer[0] == DONE

    def _receive(self) -> None:
        """Read a part of the result that is there: its numbers, then the rest."""
        assert self._sent is not None
        buffer = self._sent[1].buffer
        if self._numbers is None:
            self._numbers = [view.copy() for view in views(buffer, self._shapes)[1:]]
        else:
            self._found = Outcome(state_of(self._numbers, self.numbers.recent), *pickle.loads(read(buffer)))

    def _raw_of(self, found: Outcome) -> FloatArray:
        """Return the raw samples of a result; those in shared memory for a moment, so that this can be closed."""
        if found is not self._found:
            return found.state.recent
        assert self._sent is not None
        return rows_of(self._sent[1].buffer, self._shapes[0])

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


def text_of(settings: Settings) -> bytes:
    """Return settings as bytes; none, which is refused, where only the user's script knows what to make of them."""
    if callable(settings.preprocess.input_map):  # maps samples alone, and might not be understood there
        settings = replace(settings, preprocess=replace(settings.preprocess, input_map="identity"))
    with contextlib.suppress(Exception):
        return pickle.dumps(settings)
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
        shapes, text, due, most = pickle.loads(read(buffer))
        settings = pickle.loads(text)
        shared = views(buffer, shapes)
        rows, *numbers = (view.copy() for view in shared)
        given = state_of(numbers, NOTHING)
        room = given.recent_size - lag(given, given.recent_size)
        found = outcome(_whole(numbers, rows, room), settings, due, most)
        for view, result in zip(shared, (found.state.recent, *found.state.arrays[:-1]), strict=True):
            view[:] = result
        write(buffer, shapes, pickle.dumps((found.only_planned, found.due)))
    except Exception:  # whatever it is: who asks computes it, and meets it
        return FAILED
    return DONE
