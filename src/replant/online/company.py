"""Company: members of an ensemble that keep a covariance, stepped side by side as long as they are alike.

What is due is done member by member, as a single identifier does it: the start-up, a solution, a look at an alarm.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from replant.arguments import FloatArray
from replant.engine.state_lanes import fits, kind
from replant.engine.vector_blocks import Room
from replant.online.identifier import Identifier

LEAST = 3  # members that lanes pay for: they take about the time of three [count]
FEWEST = 32
"""Rows of a chunk that lanes pay for: to go into them and to leave takes as long as some ten samples [samples]."""
PIECE = 2048
"""Rows after which it is looked at again who may go together: whose start-up has ended, say [samples]."""

Alone = Callable[..., None]  # takes a member's samples: (number, room, row, u, y, errors, parameters)


def may_go_together(member: Identifier) -> bool:
    """Return whether a member can be stepped in a lane, now or, by its settings, after its start-up."""
    request = member._request
    if member._mapped or request.structure.delay > 0.0 or not member._regular:
        return False
    return request.keeps_covariance if member.settings is None else fits(member._state)


class Company:
    """Some members, by their numbers in the ensemble; ``alone`` steps one of them by itself."""

    def __init__(self, numbers: Sequence[int], members: Sequence[Identifier], alone: Alone) -> None:
        self.numbers, self._members, self._alone = list(numbers), members, alone

    def take(self, room: Room, start: int, *chunk: FloatArray) -> None:
        """Take the samples from row ``start`` on."""
        end = len(chunk[0])
        piece = PIECE if end - start >= FEWEST else end
        for first in range(start, end, piece):
            self._take_piece(room, first, *_up_to(min(first + piece, end), *chunk))

    def _take_piece(self, room: Room, start: int, *chunk: FloatArray) -> None:
        """Take the samples up to the end of the chunk, each member in the company of those that are ready and alike."""
        alike: dict[tuple[int, ...], list[int]] = {}
        if len(chunk[0]) - start >= FEWEST:
            for number in self.numbers:
                if self._is_ready(number):
                    alike.setdefault(kind(self._members[number]._state), []).append(number)
        together = {one: numbers for one, numbers in alike.items() if len(numbers) >= LEAST}
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
        if member._state.attention:
            reached = member._attend_after(reached, chunk[3][number])
        if reached < row:
            self._alone(number, room, reached, *_up_to(row, *chunk))

    def _is_ready(self, number: int) -> bool:
        member = self._members[number]
        if member._state.attention:
            member._enter()
        return member.settings is not None and fits(member._state)


def _up_to(row: int, *chunk: FloatArray) -> tuple[FloatArray, ...]:
    """Return the chunk without the samples from a row on; results stay as they are."""
    u, y, *results = chunk
    return u[:row], y[:row], *results
