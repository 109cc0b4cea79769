"""Background: a second Python does the work due between samples; its result is used at a later sample, fixed before.

At a count n the numbers of the state are copied to shared memory, and the raw samples, oldest first, some at each later
update, so that neither process waits for the other.  The result is used at the count m = n + `lag`; a new state has
then learned the samples n + 1 to m.  n and m follow from the samples alone, and both processes compute the same, so
that the bits do not depend on the speed of the machine, or on whether the second Python is alive.

A full ring loses its oldest m - n samples meanwhile: the second Python does not get these.  All samples that it gets
are then still kept at m, and a checkpoint needs only the copy of the numbers at n in addition.

No step of this may take longer than a tenth of a sample at 1 kHz.  Python code that has not run for a while takes
several times longer, and so does allocating or freeing large memory.  So each step has an update of its own, and the
new state is prepared beside the one in use (`CatchUp`), which it replaces at m.
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

from replant.estimation.engine.state import NOTHING, REGULAR, State, Step, bound, check, step_kernels
from replant.estimation.settings import Settings
from replant.kernels.native import Kernel, library
from replant.kernels.schema import BELIEVED, INPUT, OUTPUT, REFERENCE, STATE_ARRAYS, STEP, Doubt
from replant.kernels.slot_tables import Real, Slot
from replant.numerics.arguments import FloatArray, IntArray
from replant.online import second_process
from replant.online.begin_recursion import REJECTED
from replant.online.change_response import note_alarm
from replant.online.revision import revise

PART = 0.05  # delay of a result: small beside that by which a growing record is solved again [part of the record]
LEAST = 20  # least samples until a result is used: the time to solve a short record at 1 kHz [samples]
SLICE = 512  # raw samples copied in one update: some 10 us [samples]
LEARNED = 9  # samples learned again in one update: some 10 us [samples]
LOOK = 2e-4  # time between two checks for a result that is waited for [s]

#: Slots that a new state copies from the one that took the samples meanwhile: counters and clock, and the
#: preprocessing, which is not applied again to samples from the ring.
MEANWHILE: tuple[Slot[Any], ...] = (
    *REJECTED, State.last_time, State.earlier_stamps, State.earlier_time, State.held_at, State.held_input,
    State.held_output, State.held_time, State.held_reference, State.square_input, State.input_offset,
    State.output_offset,
)  # fmt: skip
IN_REALS = [slot.index for slot in MEANWHILE if isinstance(slot, Real)]
IN_INTS = [slot.index for slot in MEANWHILE if not isinstance(slot, Real)]
#: Slots that `revise` may write without a change of the estimate.
PLANNED = State.look_at, State.trusted_at, State.undecided
NUMBERS = STATE_ARRAYS[:-1]  # the arrays of a state except the raw samples


def lag(state: State, rows: int) -> int:
    """Return the delay in samples of the result of work that is due now; ``rows``: raw samples kept."""
    record = min(state.samples - state.record_began, rows)
    return max(min(max(math.ceil(PART * record), LEAST), rows // 2), 1)


@dataclass(frozen=True, eq=False)
class Outcome:
    """The result of `revise`."""

    state: State  # with its raw samples, oldest first; without them if they are in shared memory
    only_planned: bool  # whether only the slots in `PLANNED` have changed
    due: int  # accepted samples at which the record is next examined


def outcome(state: State, settings: Settings, due: int, most: int) -> Outcome:
    """Return the result of `revise` for a state whose ring may be smaller than ``most``."""
    state.attention_at, state.attention = 0, False
    before, count = state.copy(), min(state.samples, len(state.recent))
    after, due = revise(state, settings, due, most)
    for slot in PLANNED:
        setattr(before, slot.name, getattr(after, slot.name))
    same = all(one.tobytes() == other.tobytes() for one, other in zip(before.arrays, after.arrays, strict=True))
    kept = after.recent[np.arange(after.samples - count, after.samples) % len(after.recent)]
    return Outcome(state_of(after.arrays[:-1], kept), same, due)


class Schedule:
    """The sample counts of the steps of a job; they follow from the samples alone."""

    def __init__(self, numbers: State, rows: int) -> None:
        ahead = lag(numbers, rows)
        self.begun = numbers.samples  # accepted samples at which it was due
        self.until = self.begun + ahead  # accepted samples at which the result is used
        self.room = rows - ahead  # rows of the ring that are not overwritten meanwhile
        self.kept = min(self.begun, self.room)  # raw samples that the job gets
        self.shapes = [(self.kept, numbers.recent.shape[1]), *(array.shape for array in numbers.arrays[:-1])]
        self.slice = max(SLICE, -(-self.kept // max(ahead // 2, 1)))  # raw samples copied in one update
        # updates until the second Python has all; five for steps other than copying raw samples
        self.steps = -(-self.kept // self.slice) + 5
        # from then on each update checks for the result: code that runs often runs fast
        self.looks_from = min(self.begun + max(ahead // 3, self.steps), self.until - 1)

    def next_stop(self, now: int) -> int:
        """Return the accepted samples at which there is the next step, or the result is used."""
        rests = self.begun + self.steps <= now < self.looks_from
        return self.looks_from if rests else min(now + 1, self.until)


class Job:
    """Work that became due at a count of samples, and its progress."""

    def __init__(self, numbers: State, rows: int) -> None:
        self.numbers = numbers  # the state at that count, without raw samples
        self.place: second_process.Place | None = None  # the memory shared with the second Python
        self._rows, self._fits, self._written = rows, False, 0
        self._sent: second_process.Worker | None = None  # the second Python, once it has it
        self._numbers: list[Any] = []
        self._found: Outcome | None = None
        self._ahead: CatchUp | None = None

    @classmethod
    def of(cls, state: State) -> Job:
        """Return a job for the work that is due now."""
        numbers = [array.copy() for array in state.arrays[:-1]]
        return cls(state_of(numbers, np.empty((0, state.recent.shape[1]))), len(state.recent))

    def __reduce__(self) -> tuple[Any, ...]:
        return Job, (self.numbers.copy(), self._rows)

    @cached_property
    def schedule(self) -> Schedule:
        """The counts of its steps; made in an update of its own."""
        return Schedule(self.numbers, self._rows)

    def take_place(self, place: second_process.Place) -> None:
        """Use shared memory for the job; if it is too small, nothing will be sent."""
        self.place, self._fits = place, second_process.end_of(self.schedule.shapes) <= len(place.buffer)

    def go_on(self, state: State, settings: Settings, due: int, most: int) -> bool:
        """Do the next step before the second Python can begin; return whether there was one."""
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
            self._sent = worker
            return False
        self._written += 1  # last, so that an interrupted step is repeated
        return True

    def look(self, state: State, settings: Settings, spare: FloatArray, *, regular: bool) -> None:
        """If the result has arrived, receive it, or let its state learn some of the samples that have come since."""
        found, ahead = self._found, self._ahead
        if found is None:
            if self._is_there and state.samples > self.schedule.looks_from + 1:
                self._receive()
        elif ahead is None or ahead.regular != regular:
            if self.needs_new(found, state):
                self._ahead = CatchUp(found.state, spare, regular=regular)
        else:
            self._ahead = None  # so that an interrupted step begins again
            ahead.go_on(self._raw_of(found), state, settings, self.schedule.slice, LEARNED)
            self._ahead = ahead

    def needs_new(self, found: Outcome, state: State) -> bool:
        """Return whether the result is more than a plan for the state in use."""
        return not found.only_planned or state.alarm != self.numbers.alarm

    def caught_up(self, found: Outcome, old: State, settings: Settings, *, regular: bool) -> CatchUp:
        """Return the state found, after it has learned the samples since, to replace ``old``."""
        ahead, self._ahead = self._ahead, None
        if ahead is None or ahead.regular != regular:
            ahead = CatchUp(found.state, NOTHING, regular=regular)
        ahead.finish(self._raw_of(found), old, settings)
        return ahead

    def wait(self) -> bool:
        """Wait for the result if the second Python computes it; return whether it was late, or will not come."""
        if self._found is not None:
            return False
        if self._sent is None or self.place is None or not self.place.is_mine:
            self._sent = None
            return True
        is_late = self.place.is_busy
        while self.place.is_busy and self._sent.lives():
            time.sleep(LOOK)
        return is_late

    def outcome(self, state: State, settings: Settings, due: int, most: int) -> Outcome:
        """Return the result, from the second Python or computed here; ``state``: the present one, at ``until``."""
        while self._found is None and self._is_there:
            self._receive()
        if self._found is not None:
            return self._found
        whole = _whole(self.numbers.copy().arrays[:-1], self._raw(state, 0, self.schedule.kept), self.schedule.room)
        return outcome(whole, settings, due, most)

    @property
    def _is_there(self) -> bool:
        place = None if self._sent is None else self.place
        return place is not None and place.is_mine and place.buffer[0] == second_process.DONE

    def _receive(self) -> None:
        """Read the next part of the result: an array of its numbers, or last the two numbers that go with them."""
        assert self.place is not None
        buffer, shapes, there = self.place.buffer, self.schedule.shapes, len(self._numbers)
        if there + 1 < len(shapes):
            self._numbers.append(second_process.view_of(buffer, shapes, there + 1).copy())
        else:
            only_planned, due = second_process.noted(buffer).tolist()
            self._found = Outcome(state_of(self._numbers, self.numbers.recent), bool(only_planned), due)

    def _raw_of(self, found: Outcome) -> FloatArray:
        """Return the raw samples of a result; a view of shared memory must be dropped soon, so that this can close."""
        if found is not self._found:
            return found.state.recent
        assert self.place is not None
        rows: FloatArray = second_process.view_of(self.place.buffer, self.schedule.shapes, 0)
        return rows

    def _raw(self, state: State, begin: int, end: int) -> FloatArray:
        """Return rows ``begin`` to ``end`` of the raw samples kept for the job, from a later state."""
        first = self.schedule.begun - self.schedule.kept
        return np.take(state.recent, np.arange(first + begin, first + end), axis=0, mode="wrap")


def text_of(settings: Settings) -> bytes:
    """Return settings as bytes; empty, which `_answer` refuses, if they cannot be pickled."""
    if callable(settings.preprocess.input_map):  # not needed there, as samples are mapped, and perhaps not importable
        settings = replace(settings, preprocess=replace(settings.preprocess, input_map="identity"))
    with contextlib.suppress(Exception):
        return pickle.dumps(settings)
    return b""


def state_of(numbers: Sequence[Any], ring: FloatArray) -> State:
    """Return a state with these numbers and raw samples."""
    ints, reals, banks, buffer = numbers
    return State(ints, reals, banks, buffer, ring)


def _whole(numbers: Sequence[Any], rows: FloatArray, room: int) -> State:
    """Return a state with a ring of ``room`` rows that holds these raw samples, oldest first."""
    state = state_of(numbers, np.zeros((room, rows.shape[1])))
    state.recent[np.arange(state.samples - len(rows), state.samples) % room] = rows
    state.recent_size, state.recent_head = room, state.samples % room
    return state


class CatchUp:
    """A new state that learns the samples since it was found, some in each update; its ring is ``spare`` if it fits.

    The arithmetic is sequential: the bits do not depend on how many samples are learned at once, and when.
    """

    def __init__(self, found: State, spare: FloatArray, *, regular: bool) -> None:
        self.regular, self._spare = regular, spare  # regular: without time stamps
        self.kernels: tuple[Kernel, Kernel] | None = None  # for single samples and for many; None: not chosen yet
        self.bound: tuple[Step, IntArray] | None = None  # kernel for single samples, bound to the state, and its gate
        self._begun, self._copied, self._learned = found.samples, 0, 0
        self._table, self._is_awake = bytearray(), False
        self.state = state_of([array.copy() for array in found.arrays[:-1]], NOTHING)

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
        stamps = REGULAR if self.regular else np.cumsum(np.append(new.last_time, again[STEP]))[1:]
        r = again[REFERENCE] if old.has_reference else NOTHING
        _, steps = self.kernels or step_kernels(new, regular=self.regular)
        # without stamps, samples that were rejected before a sample have lengthened its interval
        ends = [*(np.flatnonzero(again[STEP] != new.interval).tolist() if self.regular else ()), u.size]
        taken, errors = 0, np.empty(u.size)
        while taken < u.size:
            new.attention, new.held_at = False, BELIEVED  # leaps among them have been accepted before
            if self.regular:
                new.earlier_stamps = round(again[STEP][taken] / new.interval) - 1
            some = slice(taken, next(end for end in ends if end > taken))
            rest = u[some], y[some], stamps[some], r[some]
            taken += steps(*new.arrays, *rest, errors[some], np.empty((rest[0].size, 0)))
            note_alarm(new, settings)
        self._learned += taken


def prepare() -> None:
    """Import what the first solution would import: at 1 kHz SciPy takes more than a hundred samples."""
    importlib.import_module("scipy.special")


def serve() -> None:
    """Compute jobs in the second Python."""
    prepare()
    second_process.serve(_answer)


def _answer(buffer: memoryview) -> int:
    """Compute a job and write its result to shared memory; return `DONE` or `FAILED`."""
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
    except Exception:  # the first process then computes the job, and meets the same error
        return second_process.FAILED
    return second_process.DONE
