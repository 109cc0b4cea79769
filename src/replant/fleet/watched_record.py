"""Watched record: notes, as it is read, how far input and output move and how long the output stands still."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.data.logs import Recording
from replant.runs.batches import Batch


@dataclass(frozen=True)
class Movement:
    """How far the signals of a record move.

    Attributes
    ----------
    input_std, output_std : float
        Standard deviations of the raw signals; NaN without a sample.
    output_held : float
        Longest stretch over which the output is constant to the bit [part of the record].
    """

    input_std: float = math.nan
    output_std: float = math.nan
    output_held: float = math.nan


UNKNOWN = Movement()


class Watched:
    """A recording as a source for `run_source`, which notes its `Movement` in the first whole pass."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.movement = UNKNOWN
        self._done = False

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.recording.samples

    @property
    def complete(self) -> bool:
        """Whether every sample is finite."""
        return self.recording.complete

    def batches(self) -> Iterator[Batch]:
        """Yield the batches of the recording."""
        if self._done:
            yield from self.recording.batches()
            return
        moments, held = (_Moments(), _Moments()), _Held()
        for batch in self.recording.batches():
            for signal, of in zip(batch, moments, strict=False):
                of.take(signal)
            held.take(batch[1])
            yield batch
        self._done = True
        self.movement = Movement(moments[0].std, moments[1].std, held.part)


class _Moments:
    """Mean and standard deviation of a signal that comes batch by batch, combined as Chan, Golub and LeVeque do."""

    def __init__(self) -> None:
        self._count, self._mean, self._sum = 0, 0.0, 0.0

    def take(self, signal: FloatArray) -> None:
        known = signal[np.isfinite(signal)]
        if not known.size:
            return
        mean = float(known.mean())
        off, count = mean - self._mean, self._count + known.size
        self._sum += float(np.square(known - mean).sum()) + off * off * self._count * known.size / count
        self._mean += off * known.size / count
        self._count = count

    @property
    def std(self) -> float:
        return math.sqrt(self._sum / self._count) if self._count else math.nan


class _Held:
    """The longest stretch of equal values."""

    def __init__(self) -> None:
        self._count, self._longest, self._now, self._last = 0, 0, 0, math.nan

    def take(self, signal: FloatArray) -> None:
        if not signal.size:
            return
        changes = np.flatnonzero(np.diff(signal, prepend=self._last) != 0.0)  # NaN is a change
        first = int(changes[0]) if changes.size else signal.size
        inner = int(np.diff(changes).max()) if changes.size > 1 else 0
        self._longest = max(self._longest, self._now + first, inner)
        self._now = int(signal.size - changes[-1]) if changes.size else self._now + signal.size
        self._longest = max(self._longest, self._now)
        self._last = float(signal[-1])
        self._count += signal.size

    @property
    def part(self) -> float:
        return self._longest / self._count if self._count else math.nan
