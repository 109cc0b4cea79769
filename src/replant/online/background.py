"""Background: what is due between samples is computed by a second Python, and taken up at a later sample fixed before.

At a count n the numbers of the state are copied, and the raw samples, oldest first, some with each later update:
into memory that both processes share, so that none waits for the other.  At the count m = n + `lag` the result is
taken up; where it is a new state, this has learned the samples n + 1 to m.  n and m follow from the samples alone, and
who computes does not matter, so the bits do not depend on how fast the machine is, or whether the second Python lives.

A ring that is full loses its oldest samples meanwhile, m - n of them: the second Python does not get these.  All that
it gets is then still kept at m, and the copy of the numbers at n is all that a checkpoint has to hold beside.

Nothing of this may take longer than a tenth of a sample at 1 kHz, where Python that has not run for a while takes
several times as long as at once, and large memory is given and taken back in as long.  So each step has an update of
its own, and the new state is made ready beside the one in use (`CatchUp`), so that at m one takes the other's place.
"""

from __future__ import annotations

import contextlib
import importlib
import math
import pickle
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from replant.estimation.engine.state import NOTHING, State
from replant.estimation.settings import Settings
from replant.kernels.schema import STATE_ARRAYS
from replant.numerics.arguments import FloatArray
from replant.online import second_process
from replant.online.catch_up import CatchUp
from replant.online.revision import revise

PART = 0.05  # of the record: what comes later by so much hardly adds to the delay that a growing record has [ratio]
LEAST = 20  # samples until a result is taken up, at least: at 1 kHz what a short record takes to solve [samples]
SLICE = 512  # raw samples copied in one update: some 10 us [samples]
LEARNED = 9  # samples learned again in one update: some 10 us [samples]
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


class Schedule:
    """When what is done for a job, of the numbers as they were; it follows from the samples alone."""

    def __init__(self, numbers: State, rows: int) -> None:
        ahead = lag(numbers, rows)
        self.begun = numbers.samples  # accepted samples at which it was due
        self.until = self.begun + ahead  # at which the result is taken up
        self.room = rows - ahead  # rows of the ring that nothing is written to meanwhile
        self.kept = min(self.begun, self.room)  # raw samples that it gets
        self.shapes = [(self.kept, numbers.recent.shape[1]), *(array.shape for array in numbers.arrays[:-1])]
        self.slice = max(SLICE, -(-self.kept // max(ahead // 2, 1)))  # raw samples copied in one update
        # updates until the second Python has all; five are for what is no slice of the raw samples
        self.steps = -(-self.kept // self.slice) + 5
        # from then on it is looked at each sample whether the result is there: what runs often runs fast
        self.looks_from = min(self.begun + max(ahead // 3, self.steps), self.until - 1)

    def next_stop(self, now: int) -> int:
        """Return at how many samples there is something to do, or the result is to be taken up."""
        rests = self.begun + self.steps <= now < self.looks_from
        return self.looks_from if rests else min(now + 1, self.until)


class Job:
    """What is due at a count of samples, and where it stands."""

    def __init__(self, numbers: State, rows: int) -> None:
        self.numbers = numbers  # the state as it was, without raw samples
        self.place: second_process.Place | None = None  # the memory shared with the second Python
        self._rows, self._fits, self._written = rows, False, 0
        self._sent: tuple[second_process.Worker, second_process.Place] | None = None
        self._numbers: list[Any] = []
        self._found: Outcome | None = None
        self._ahead: CatchUp | None = None

    @classmethod
    def of(cls, state: State) -> Job:
        """Return what is due now."""
        numbers = [array.copy() for array in state.arrays[:-1]]
        return cls(state_of(numbers, np.empty((0, state.recent.shape[1]))), len(state.recent))

    def __reduce__(self) -> tuple[Any, ...]:
        return Job, (self.numbers.copy(), self._rows)

    @cached_property
    def schedule(self) -> Schedule:
        """When what is done for it; made in an update of its own."""
        return Schedule(self.numbers, self._rows)

    def take_place(self, place: second_process.Place) -> None:
        """Take memory for what is sent; where it has no room for that, nothing is."""
        self.place, self._fits = place, second_process.end_of(self.schedule.shapes) <= len(place.buffer)

    def go_on(self, state: State, settings: Settings, due: int, most: int) -> bool:
        """Do what is next for the second Python to begin; return whether there was something left."""
        if self._sent is not None:
            return False
        worker, when = second_process.worker(), self.schedule
        if worker is None or self.place is None or not self._fits:
            return False
        buffer, copies = self.place.buffer, -(-when.kept // when.slice)
        if self._written < copies:
            begin = self._written * when.slice
            until = min(begin + when.slice, when.kept)
            second_process.view_of(buffer, when.shapes, 0)[begin:until] = self._raw(state, begin, until)
        elif self._written == copies:
            _, *numbers = second_process.views(buffer, when.shapes)
            for view, array in zip(numbers, self.numbers.arrays[:-1], strict=True):
                view[:] = array
        elif self._written == copies + 1:
            text = pickle.dumps((when.shapes, self.place.told(settings, text_of), due, most))
            if not second_process.write(buffer, when.shapes, text):
                return False
        else:
            buffer[0] = second_process.PENDING
            worker.send(self.place)
            self._sent = worker, self.place
            return False
        self._written += 1  # last: interrupted, this is done again
        return True

    def look(self, state: State, settings: Settings, spare: FloatArray, *, regular: bool) -> None:
        """Where the result is there, let a new state catch up with some of the samples that have come since."""
        found, ahead = self._found, self._ahead
        if found is None:
            if self._is_there and state.samples > self.schedule.looks_from + 1:
                self._receive()
        elif ahead is None or ahead.regular != regular:
            if self.needs_new(found, state):
                self._ahead = CatchUp(found.state, spare, regular=regular)
        else:
            self._ahead = None  # interrupted: begun again
            ahead.go_on(self._raw_of(found), state, settings, self.schedule.slice, LEARNED)
            self._ahead = ahead

    def needs_new(self, found: Outcome, state: State) -> bool:
        """Return whether the result is more than a plan for the state in use."""
        return not found.only_planned or state.alarm != self.numbers.alarm

    def caught_up(self, found: Outcome, old: State, settings: Settings, *, regular: bool) -> CatchUp:
        """Return the state found, after it has learned what came meanwhile, to take the place of ``old``."""
        ahead, self._ahead = self._ahead, None
        if ahead is None or ahead.regular != regular:
            ahead = CatchUp(found.state, NOTHING, regular=regular)
        ahead.finish(self._raw_of(found), old, settings)
        return ahead

    def wait(self) -> bool:
        """Wait for the result, if it is coming; return whether it was not there."""
        if self._found is not None:
            return False
        if self._sent is None or not self._sent[1].is_mine:
            self._sent = None
            return True
        worker, place = self._sent
        is_late = place.buffer[0] == second_process.PENDING
        while place.buffer[0] == second_process.PENDING and worker.lives():
            time.sleep(LOOK)
        return is_late

    def outcome(self, state: State, settings: Settings, due: int, most: int) -> Outcome:
        """Return the result, from the second Python or computed here; ``state``: as it is at ``until``."""
        while self._found is None and self._is_there:
            self._receive()
        if self._found is not None:
            return self._found
        whole = _whole(self.numbers.copy().arrays[:-1], self._raw(state, 0, self.schedule.kept), self.schedule.room)
        return outcome(whole, settings, due, most)

    @property
    def _is_there(self) -> bool:
        return self._sent is not None and self._sent[1].is_mine and self._sent[1].buffer[0] == second_process.DONE

    def _receive(self) -> None:
        """Read a part of the result that is there: an array of its numbers, or what goes with them."""
        assert self._sent is not None
        buffer, shapes, there = self._sent[1].buffer, self.schedule.shapes, len(self._numbers)
        if there + 1 < len(shapes):
            self._numbers.append(second_process.view_of(buffer, shapes, there + 1).copy())
        else:
            only_planned, due = second_process.noted(buffer).tolist()
            self._found = Outcome(state_of(self._numbers, self.numbers.recent), bool(only_planned), due)

    def _raw_of(self, found: Outcome) -> FloatArray:
        """Return the raw samples of a result; those in shared memory for a moment, so that this can be closed."""
        if found is not self._found:
            return found.state.recent
        assert self._sent is not None
        rows: FloatArray = second_process.view_of(self._sent[1].buffer, self.schedule.shapes, 0)
        return rows

    def _raw(self, state: State, begin: int, end: int) -> FloatArray:
        """Return some of the raw samples kept for it, from a later state."""
        first = self.schedule.begun - self.schedule.kept
        return np.take(state.recent, np.arange(first + begin, first + end), axis=0, mode="wrap")


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
        shapes, text, due, most = pickle.loads(second_process.read(buffer))
        settings = pickle.loads(text)
        shared = second_process.views(buffer, shapes)
        rows, *numbers = (view.copy() for view in shared)
        given = state_of(numbers, NOTHING)
        room = given.recent_size - lag(given, given.recent_size)
        found = outcome(_whole(numbers, rows, room), settings, due, most)
        for view, result in zip(shared, (found.state.recent, *found.state.arrays[:-1]), strict=True):
            view[:] = result
        second_process.noted(buffer)[:] = found.only_planned, found.due
    except Exception:  # whatever it is: who asks computes it, and meets it
        return second_process.FAILED
    return second_process.DONE
