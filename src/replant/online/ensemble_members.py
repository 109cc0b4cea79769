"""Company: members of an ensemble go together: in blocks, those that follow the gradient, or in lanes, by threads.

Members that keep a covariance are stepped side by side as long as they are alike.  What is due is done member by
member, as a single identifier does it: the start-up, a solution, a look at an alarm.
"""

from __future__ import annotations

import _thread
import os
import threading
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from functools import partial
from itertools import groupby
from queue import SimpleQueue
from typing import Any

from replant.estimation.engine.vector_blocks import Block, Room, are_apart, is_under_way, kind_of_block, order
from replant.estimation.engine.vector_blocks import kind_of_lane as kind
from replant.kernels.schema import StateSlots
from replant.numerics.arguments import FloatArray
from replant.online.identifier import Identifier

LEAST = 5  # members that lanes pay for: they take about the time of five [count]
LEAST_ALIKE = 4  # members with one random stream that a block pays for: it takes the time of three [count]
LEAST_APART = 7  # members with streams of their own that a block pays for: it takes the time of six [count]
# to go into lanes and to leave them takes as long as some ten samples
FEWEST = 32  # rows of a chunk that lanes pay for [samples]
# so that no thread waits long for the last one; and it is looked at again whose start-up has ended, say
PORTION = 2048  # samples after which a thread may go on with other members [samples]

ATTENTION = StateSlots.attention.index  # read in place, as it is read of each member of each chunk

Take = Callable[..., None]  # takes the samples from a row on: (room, row, u, y, errors, parameters)
Alone = Callable[..., None]  # takes a member's samples: (number, room, row, u, y, errors, parameters)


def may_join(member: Identifier) -> bool:
    """Return whether a member can be stepped in a block, now or, by its settings, after its start-up."""
    if member._settings is None:
        return not member._request.wants_instruments
    if member._state.refined:
        return False
    from replant.kernels.step import fixed_filter

    return member._steps is fixed_filter.steps and not member._mapped


def is_ready(member: Identifier) -> bool:
    """Return whether a member's start-up is over and its filters run."""
    return member._settings is not None and is_under_way(member._state)


def form_blocks(members: Sequence[Identifier], reached: dict[int, int]) -> list[tuple[Block, int]]:
    """Return blocks of ready members that are alike, each with its first row; ``reached``: samples each has taken."""
    from replant.kernels.lanes import LANES

    ready = [n for n in reached if may_join(members[n]) and is_ready(members[n])]
    states = {n: members[n]._state for n in ready}
    alike = {n: (reached[n], kind_of_block(states[n])) for n in ready}
    ready.sort(key=lambda n: (alike[n], order(states[n])))
    formed = []
    for (start, _), group in groupby(ready, key=lambda n: alike[n]):
        numbers = list(group)
        for first in range(0, len(numbers), LANES):
            some = numbers[first : first + LANES]
            own = [states[n] for n in some]
            if len(some) >= (LEAST_APART if are_apart(own) else LEAST_ALIKE):
                formed.append((Block.of_states(some, own), start))
    return formed


def lane_of(member: Identifier) -> tuple[int, ...] | None:
    """Return what members side by side must have in common, () while a start-up lasts; None: a member goes alone."""
    request = member._request
    if member._mapped or request.structure.delay > 0.0 or not member._regular:
        return None
    if member._settings is None:
        return () if request.keeps_covariance else None
    return kind(member._state)


class Company:
    """Some members, by their numbers in the ensemble; ``alone`` steps one of them by itself."""

    def __init__(self, numbers: Sequence[int], members: Sequence[Identifier], alone: Alone) -> None:
        self.numbers, self._members, self._alone = list(numbers), members, alone
        self.all_together = False  # in the last piece

    def take(self, room: Room, start: int, *chunk: FloatArray) -> None:
        """Take the samples from row ``start`` on, each member in the company of those that are ready and alike."""
        alike: dict[tuple[int, ...], list[int]] = {}
        if len(chunk[0]) - start >= FEWEST:
            for number in self.numbers:
                one = self._kind(number)
                if one is not None:
                    alike.setdefault(one, []).append(number)
        together = {one: numbers for one, numbers in alike.items() if len(numbers) >= LEAST}
        self.all_together = any(len(numbers) == len(self.numbers) for numbers in together.values())
        for one, numbers in together.items():
            self._take_together(one, numbers, room, start, *chunk)
        inside = {number for numbers in together.values() for number in numbers}
        for number in self.numbers:
            if number not in inside:
                self._alone(number, room, start, *chunk)

    def _take_together(
        self, one: tuple[int, ...], numbers: list[int], room: Room, start: int, *chunk: FloatArray
    ) -> None:
        row, end = start, len(chunk[0])
        while row < end:
            states = [self._members[number]._state for number in numbers]
            if row > start and any(kind(state) != one for state in states):  # what was due has changed it
                for number in numbers:
                    self._alone(number, room, row, *chunk)
                return
            lanes = room.lanes(one, states[0], chunk[3].shape[2])
            row, taken = lanes.take(states, numbers, row, *chunk)
            for number, reached in zip(numbers, taken.tolist(), strict=True):
                self._catch_up(number, room, reached, row, *chunk)

    def _catch_up(self, number: int, room: Room, reached: int, row: int, *chunk: FloatArray) -> None:
        """Do what is due to a member, and let it take the samples that the others have taken meanwhile."""
        member = self._members[number]
        if member._state.ints[ATTENTION]:
            reached = member._attend_after(reached, chunk[3][number])
        if reached < row:
            u, y, *results = chunk
            self._alone(number, room, reached, u[:row], y[:row], *results)

    def _kind(self, number: int) -> tuple[int, ...] | None:
        """Return the kind of lane that a member fits into now; None while its start-up lasts, or for good."""
        member = self._members[number]
        if member._state.ints[ATTENTION]:
            member._enter()
        return None if member._settings is None else kind(member._state)


class Helper:
    """A thread that helps with chunks, one after the other: to begin one anew takes as long as a hundred samples."""

    def __init__(self) -> None:
        self.room = Room()
        self._process = 0  # in which the thread runs: a fork has none
        self._works: SimpleQueue[Callable[[], None] | None] = SimpleQueue()

    def __reduce__(self) -> tuple[Any, ...]:
        return Helper, ()  # a copy has a thread of its own

    def do(self, work: Callable[[], None]) -> None:
        """Let the thread do some work after that given before; it ends with the helper."""
        if self._process != os.getpid():
            self._works = SimpleQueue()
            _thread.start_new_thread(_do_all, (self._works,))  # threading.Thread would wait until it runs
            weakref.finalize(self, self._works.put, None)
            self._process = os.getpid()
        self._works.put(work)


def _do_all(works: SimpleQueue[Callable[[], None] | None]) -> None:
    """Do work as it comes, up to None."""
    while (work := works.get()) is not None:
        work()
        del work  # and all that it holds, before the next is waited for


class Chunk:
    """The samples of a call, and what stops the threads that take them."""

    def __init__(self, u: FloatArray, y: FloatArray, helpers: int) -> None:
        self.u, self.y = u, y
        self.stopped = False
        self.locks = [threading.Lock() for _ in range(helpers)]  # each is taken while a thread helps

    def wait(self) -> None:
        """Wait until no other thread takes samples any more; one that has not begun yet will not."""
        with ExitStack() as held:
            for lock in self.locks:
                held.enter_context(lock)
            self.stopped = True

    def stop(self) -> None:
        """Wait likewise, but for the portions alone that other threads are at."""
        self.stopped = True
        self.wait()


def carry_out(
    tasks: Iterable[tuple[Take, int]], room: Room, helpers: Sequence[Helper], chunk: Chunk, *results: FloatArray
) -> None:
    """Run all tasks over a chunk, each from its start row on, in this thread and those of the helpers."""
    u, y = chunk.u, chunk.y
    waiting = deque(task for task in tasks if task[1] < len(u))

    def work(room: Room, first: Callable[[], tuple[Take, int]], last: Callable[[tuple[Take, int]], None]) -> None:
        while not chunk.stopped:
            try:
                take, start = first()  # the task that has waited longest
            except IndexError:  # the other threads work on the last portions
                return
            end = start + PORTION
            take(room, start, u[:end], y[:end], *results)
            if end < len(u):
                last((take, end))

    failed: list[BaseException] = []

    def help_in(room: Room, lock: threading.Lock) -> None:
        with lock:
            try:
                # from the other end: in short chunks members stay with one thread, and in its processor's cache
                work(room, waiting.pop, waiting.appendleft)
            except BaseException as error:  # it is the caller's, as are those of the caller's own thread
                failed.append(error)
                chunk.stopped = True

    for helper, lock in zip(helpers[: max(len(waiting) - 1, 0)], chunk.locks, strict=False):
        helper.do(partial(help_in, helper.room, lock))
    work(room, waiting.popleft, waiting.append)  # after an error others may be at work: `Chunk.stop` waits for them
    chunk.wait()
    if failed:
        raise failed[0]
