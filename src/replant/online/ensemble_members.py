"""The members of an ensemble: blocks for gradient optimizers, lanes for those that keep a covariance, and threads.

Members that keep a covariance are stepped in lanes while they are alike.  Start-ups, solutions and looks at an alarm
are done member by member, as in a single identifier.
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

LEAST = 5  # members from which lanes are faster: they take about the time of five [count]
LEAST_ALIKE = 4  # members with one random stream from which a block is faster: it takes the time of three [count]
LEAST_APART = 7  # members with random streams of their own from which a block is faster: the time of six [count]
# entering and leaving lanes takes as long as some ten samples
FEWEST = 32  # rows of a chunk from which lanes are faster [samples]
# so that no thread waits long for the last one, and that lanes are formed anew, say after a start-up
PORTION = 2048  # samples after which a thread may continue with other members [samples]

ATTENTION = StateSlots.attention.index  # read directly, as it is read for each member and chunk

Take = Callable[..., None]  # takes the samples from a row on: (room, row, u, y, errors, parameters)
Alone = Callable[..., None]  # takes a member's samples: (number, room, row, u, y, errors, parameters)


def may_join(member: Identifier) -> bool:
    """Return whether a member can be stepped in a block, now or, by its settings, perhaps after its start-up."""
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
    """Return blocks of ready members that are alike, each with its first row; ``reached``: rows taken by each."""
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
    """Return the key that members in lanes must have in common, () during start-up; None: the member runs alone."""
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
        self.all_together = False  # whether all ran in the same lanes in the last piece

    def take(self, room: Room, start: int, *chunk: FloatArray) -> None:
        """Take the samples from row ``start`` on: members that are ready and alike in lanes, the others alone."""
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
            if row > start and any(kind(state) != one for state in states):  # changed by work that was due
                for number in numbers:
                    self._alone(number, room, row, *chunk)
                return
            lanes = room.lanes(one, states[0], chunk[3].shape[2])
            row, taken = lanes.take(states, numbers, row, *chunk)
            for number, reached in zip(numbers, taken.tolist(), strict=True):
                self._catch_up(number, room, reached, row, *chunk)

    def _catch_up(self, number: int, room: Room, reached: int, row: int, *chunk: FloatArray) -> None:
        """Do the work due for a member, and let it take the samples that the others have taken meanwhile."""
        member = self._members[number]
        if member._state.ints[ATTENTION]:
            reached = member._attend_after(reached, chunk[3][number])
        if reached < row:
            u, y, *results = chunk
            self._alone(number, room, reached, u[:row], y[:row], *results)

    def _kind(self, number: int) -> tuple[int, ...] | None:
        """Return the kind of lane that a member fits into now; None during its start-up, or if there is none."""
        member = self._members[number]
        if member._state.ints[ATTENTION]:
            member._enter()
        return None if member._settings is None else kind(member._state)


class Helper:
    """A thread that helps with one chunk after the other: starting a new one takes as long as a hundred samples."""

    def __init__(self) -> None:
        self.room = Room()
        self._process = 0  # id of the process in which the thread runs: a fork has none
        self._works: SimpleQueue[Callable[[], None] | None] = SimpleQueue()

    def __reduce__(self) -> tuple[Any, ...]:
        return Helper, ()  # a copy has a thread of its own

    def do(self, work: Callable[[], None]) -> None:
        """Queue some work for the thread, which ends with the helper."""
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
        del work  # frees what it holds before the wait for the next


class Chunk:
    """The samples of a call, and the means to stop the threads that take them."""

    def __init__(self, u: FloatArray, y: FloatArray, helpers: int) -> None:
        self.u, self.y = u, y
        self.stopped = False
        self.locks = [threading.Lock() for _ in range(helpers)]  # each is held while a thread helps

    def wait(self) -> None:
        """Wait until no other thread takes samples; threads that have not begun yet will not begin."""
        with ExitStack() as held:
            for lock in self.locks:
                held.enter_context(lock)
            self.stopped = True

    def stop(self) -> None:
        """Stop other threads after their present portions, and wait for them."""
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
                # from the other end: in short chunks members stay in one thread, and in the cache of its processor
                work(room, waiting.pop, waiting.appendleft)
            except BaseException as error:  # raised to the caller, as errors in the caller's thread are
                failed.append(error)
                chunk.stopped = True

    for helper, lock in zip(helpers[: max(len(waiting) - 1, 0)], chunk.locks, strict=False):
        helper.do(partial(help_in, helper.room, lock))
    work(room, waiting.popleft, waiting.append)  # after an error others may be at work: `Chunk.stop` waits for them
    chunk.wait()
    if failed:
        raise failed[0]
