"""Numbering: sequence numbers followed over a stream, so that no sample is taken twice and each lost one is counted."""

from __future__ import annotations

from collections import Counter

import numpy as np

from replant.data.streams.batch import Batch

LEAP = 50
"""Numbers ahead of the last one beyond which a number leaps, and within which the next one confirms it [samples].
Derivation: a misread number that is less ahead costs the samples up to it, as duplicates: twice as many would be more
than learning may stand still for; half as many, and losses in bursts are leaps more often, which costs no sample.
"""

MISORDER = 1000
"""Numbers back beyond which a number, with its successor after it, is a device that started anew, where nothing is
sent again [samples].
Derivation: the rule of RFC 3550, appendix A.1, with more room for packets that overtake.
"""

WRAPS = 1 << 16, 1 << 32
"""What counters of devices wrap at [count]."""
LEAPS_KEPT = 8
"""Leaps remembered, for the numbers to come back from [count]."""


class Numbering:
    """What the sequence numbers of one stream say.

    A number goes on if it is at most `LEAP` ahead of the last one.  One that leaps further is held back with its
    sample until the next one tells: its successor confirms it, both are taken, and what is between is lost; any other
    shows that it was misread.  Where nothing is sent again a number far back is confirmed so, too: a device that was
    reset.  Where things may be sent again, only what was never used is believed: after a counter has wrapped at 2^16 or
    2^32, or between where the numbers leapt from and where they leapt to, all over one connection.

    Parameters
    ----------
    counters : Counter
        Gets "duplicate" (a number already passed: sent twice, or late), "number leap" (held, or misread), "lost" and
        "restarts".
    replays : bool
        Whether the other side may send again what it sent before: every number not above the last is dropped then.
        Else a device that was reset and counts from zero again is believed after two samples.

    Examples
    --------
    >>> counters = Counter()
    >>> numbering = Numbering(counters, replays=True)
    >>> batch = Batch(np.zeros(6), np.zeros(6), None, np.array([1, 2, 2, 5, 4294967296, 6]), arrived=0.0)
    >>> numbering.screen(batch).sequence
    array([1, 2, 5, 6])
    >>> dict(counters), numbering.last
    ({'duplicate': 1, 'lost': 2, 'number leap': 1}, 6)
    """

    def __init__(self, counters: Counter[str], *, replays: bool) -> None:
        self.last: int | None = None
        self._counters = counters
        self._replays = replays
        self._candidate: int | None = None  # did not go on; its successor would confirm it
        self._held: Batch | None = None  # its sample, where its number leapt ahead
        self._unused: list[tuple[int, int]] = []  # leaps of this connection, from and to
        self._heard = False  # a number over this connection
        self._alone = False  # the last number is the first one, and none has confirmed it

    def connect(self) -> None:
        """Note that a connection begins: what comes may have been sent before."""
        self._unused, self._heard = [], False
        self._candidate = self._held = None

    def screen(self, batch: Batch) -> Batch:
        """Return the samples of ``batch`` whose numbers go on, behind one held back that they confirm."""
        numbers = batch.sequence
        if numbers is None or not numbers.size:
            return batch
        if self.last is not None and not self._alone:
            steps = np.diff(numbers, prepend=self.last)
            if steps.min() > 0 and steps.max() <= LEAP:
                self._advance(self.last, int(numbers[-1]), numbers.size)
                return batch
        return self._one_by_one(batch, numbers.tolist())

    def _one_by_one(self, batch: Batch, numbers: list[int]) -> Batch:
        """Screen samples by ``numbers``, theirs."""
        kept: list[int] = []
        held = None  # where the sample of the candidate lies
        if self._held is not None:
            batch, held = joined(self._held, batch), 0
        for at, number in enumerate(numbers, start=len(batch) - len(numbers)):
            candidate = self._candidate
            if candidate is not None and not self._goes_on(number) and self._believes(candidate, number):
                kept += [] if held is None else [held]
            if self._goes_on(number):
                kept.append(at)
                self._advance(number - 1 if self.last is None else self.last, number, 1)
                held = None
            else:
                ahead = self.last is not None and number > self.last
                self._candidate, held = number, at if ahead else None
                self._counters["number leap" if ahead else "duplicate"] += 1
        self._held = None if held is None else take(batch, slice(held, held + 1))
        return take(batch, np.array(kept, np.int64))

    def _advance(self, before: int, last: int, samples: int) -> None:
        if last - before > samples:
            self._counters["lost"] += last - before - samples
        self._alone = self.last is None
        self.last, self._candidate, self._held, self._heard = last, None, None, True

    def _goes_on(self, number: int) -> bool:
        return self.last is None or 0 < number - self.last <= LEAP

    def _believes(self, candidate: int, number: int) -> bool:
        """Take the candidate for the last number if ``number`` confirms it; tell whether it does."""
        last = self.last or 0
        # soon after it, or hardly further than it had leapt: some devices count in steps
        if not 0 < number - candidate <= max(LEAP, 2 * (candidate - last)):
            return False
        left = next((leap for leap in self._unused if leap[0] < candidate < leap[1]), None)
        if candidate > last:
            self._unused = [*self._unused, (last, candidate)][-LEAPS_KEPT:]
            self._counters["number leap"] -= 1
            self._advance(last, candidate, 1)
        elif left is not None:  # what led away was misread more than once
            self._unused.remove(left)
            self._counters["restarts"] += 1
            self._counters["lost"] -= left[1] - left[0] - 1
            self._advance(left[0], candidate, 1)
        elif self._began_anew(last, candidate):
            self._counters["restarts"] += 1
            self._advance(candidate - 1, candidate, 1)
        else:
            return False
        return True

    def _began_anew(self, last: int, number: int) -> bool:
        """Tell whether the device has: it was reset, its counter wrapped, or the first number was misread."""
        if self._alone:
            return number < last - LEAP
        if not self._replays:
            return number < last - MISORDER
        return self._heard and number < MISORDER and any(0 < wrap - last <= MISORDER for wrap in WRAPS)


def take(batch: Batch, kept: slice | np.ndarray[tuple[int], np.dtype[np.bool_ | np.int64]]) -> Batch:
    """Return the samples of ``batch`` that are ``kept``."""
    return Batch(
        batch.u[kept],
        batch.y[kept],
        None if batch.t is None else batch.t[kept],
        None if batch.sequence is None else batch.sequence[kept],
        batch.arrived,
    )


def joined(first: Batch, then: Batch) -> Batch:
    """Return two batches of the same fields as one that arrived with the second."""
    return Batch(
        np.concatenate([first.u, then.u]),
        np.concatenate([first.y, then.y]),
        None if first.t is None or then.t is None else np.concatenate([first.t, then.t]),
        None if first.sequence is None or then.sequence is None else np.concatenate([first.sequence, then.sequence]),
        then.arrived,
    )
