"""Numbering: sequence numbers followed over a stream, so that no sample is taken twice and each lost one is counted."""

from __future__ import annotations

from collections import Counter

import numpy as np

from replant.data.streams.batch import Batch

#: A number back by more than this, with its successor after it, is a device that started anew, where nothing is sent
#: again: the rule of RFC 3550, appendix A.1, with more room for packets that overtake.
MISORDER = 1000


class Numbering:
    """What the sequence numbers of one stream say.

    Parameters
    ----------
    counters : Counter
        Gets "duplicate" (a number already passed: sent twice, or late), "lost" and "restarts".
    replays : bool
        Whether the other side may send again what it sent before: every number not above the last is dropped then.
        Else a device that was reset and counts from zero again is believed after two samples.

    Examples
    --------
    >>> counters = Counter()
    >>> numbering = Numbering(counters, replays=True)
    >>> batch = Batch(np.zeros(4), np.zeros(4), None, np.array([1, 2, 2, 5]), arrived=0.0)
    >>> numbering.screen(batch).sequence
    array([1, 2, 5])
    >>> dict(counters), numbering.last
    ({'duplicate': 1, 'lost': 2}, 5)
    """

    def __init__(self, counters: Counter[str], *, replays: bool) -> None:
        self.last: int | None = None
        self._counters = counters
        self._replays = replays
        self._candidate: int | None = None  # would confirm that the device started anew

    def screen(self, batch: Batch) -> Batch:
        """Return the samples of ``batch`` whose numbers go on."""
        numbers = batch.sequence
        if numbers is None or not numbers.size:
            return batch
        before = int(numbers[0]) - 1 if self.last is None else self.last
        if numbers[0] > before and bool((numbers[1:] > numbers[:-1]).all()):
            self._advance(before, int(numbers[-1]), numbers.size)
            return batch
        if self._replays:
            highest = np.maximum.accumulate(np.concatenate(([before], numbers[:-1])))
            kept = numbers > highest
            self._counters["duplicate"] += int(numbers.size - kept.sum())
            if kept.any():
                self._advance(before, int(numbers[kept][-1]), int(kept.sum()))
        else:
            kept = np.array([self._follow(number) for number in numbers.tolist()])
        return take(batch, kept)

    def _advance(self, before: int, last: int, samples: int) -> None:
        if last - before > samples:
            self._counters["lost"] += last - before - samples
        self.last, self._candidate = last, None

    def _follow(self, number: int) -> bool:
        """Take one number; tell whether its sample is kept."""
        before = number - 1 if self.last is None else self.last
        if number > before:
            self._advance(before, number, 1)
            return True
        if number == self._candidate:
            self._counters["restarts"] += 1
            self._advance(number - 1, number, 1)
            return True
        self._candidate = number + 1 if number < before - MISORDER else None
        self._counters["duplicate"] += 1
        return False


def take(batch: Batch, kept: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Batch:
    """Return the samples of ``batch`` where ``kept``."""
    return Batch(
        batch.u[kept],
        batch.y[kept],
        None if batch.t is None else batch.t[kept],
        None if batch.sequence is None else batch.sequence[kept],
        batch.arrived,
    )
