"""The clock of a record: from the number of a sample to its time, on a regular clock and on an irregular one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from replant.arguments import FloatArray, IntArray
from replant.engine.record import gaps_of

KNOTS = 36_000  # stamps kept of a record that is too long for memory: as many as its overview has points [count]


@dataclass(frozen=True, eq=False)
class Clock:
    """When each sample of a record was taken, in s since the first one.

    Attributes
    ----------
    dt : float
        Sampling time in s; of an irregular clock the usual interval.
    places, times : (V,) arrays or None
        Numbers of samples, ascending, and their times in s; None for a regular clock.
    shortest, longest : float
        Least and greatest interval of an irregular clock in s; NaN for a regular one.

    Examples
    --------
    >>> Clock(0.5).at(np.array([0.0, 3.0])), Clock.of(0.5, np.array([7.0, 7.5, 9.5])).at(np.array([0.0, 2.0]))
    (array([0. , 1.5]), array([0. , 2.5]))
    """

    dt: float
    places: FloatArray | None = None
    times: FloatArray | None = None
    shortest: float = math.nan
    longest: float = math.nan

    @classmethod
    def of(cls, dt: float, stamps: FloatArray | None) -> Clock:
        """Return the clock of a record in memory; ``stamps`` (K,) in s, None for a regular clock."""
        if stamps is None or not stamps.size:
            return cls(dt)
        recorder = ClockRecorder(dt, stamps.size, stamps.size)
        recorder.take(stamps)
        return recorder.clock

    @property
    def gaps(self) -> FloatArray:
        """Begin and end of the gaps in s, (G, 2), see `gaps_of`."""
        if self.times is None:
            return np.zeros((0, 2))
        ends = self._ends_of_gaps
        return np.column_stack([self.times[ends - 1], self.times[ends]])

    @cached_property
    def _ends_of_gaps(self) -> IntArray:
        """Which of the knots are the first ones behind a gap, (G,)."""
        if self.places is None or self.times is None:
            return np.zeros(0, np.int64)
        between = np.diff(self.times) - self.dt * (np.diff(self.places) - 1.0)
        return gaps_of(np.append(self.dt, between), self.dt)

    @property
    def irregular(self) -> bool:
        """Whether the clock is irregular."""
        return self.times is not None

    def at(self, samples: npt.ArrayLike) -> FloatArray:
        """Return the time in s of samples (V,), numbered from 0; fractions lie between two samples."""
        samples = np.asarray(samples, np.float64)
        if self.places is None or self.times is None:
            return np.asarray(self.dt * samples)
        beyond = self.dt * (np.minimum(samples, 0.0) + np.maximum(samples - self.places[-1], 0.0))
        found = np.interp(samples, self.places, self.times) + beyond
        ends = self._ends_of_gaps
        if not ends.size:
            return np.asarray(found)
        after = np.searchsorted(self.places, samples)  # no fraction of a sample lies within a gap
        before = np.maximum(after - 1, 0)
        held = self.times[before] + self.dt * (samples - self.places[before])
        inside = np.isin(after, ends) & (samples < self.places[np.minimum(after, self.places.size - 1)])
        return np.where(inside, held, found)

    def after(self, counts: npt.ArrayLike) -> FloatArray:
        """Return the time in s at which so many samples (V,) had been taken, the last of them for one sampling time."""
        counts = np.asarray(counts, np.float64)
        if not self.irregular:
            return np.asarray(counts * self.dt)
        return np.asarray(self.at(counts - 1.0) + self.dt)

    def duration(self, samples: int) -> float:
        """Return how long a record of so many samples lasts, in s."""
        return float(self.after(samples)) if samples else 0.0


class ClockRecorder:
    """Collects the clock of a record whose stamps come batch by batch.

    >>> recorder = ClockRecorder(dt=1.0, length=4)
    >>> recorder.take(np.array([5.0, 6.0]))
    >>> recorder.take(np.array([7.0, 10.0]))
    >>> recorder.clock.times, recorder.clock.longest
    (array([0., 1., 2., 5.]), 3.0)
    """

    def __init__(self, dt: float, length: int, knots: int = KNOTS) -> None:
        self._dt, self._stride = dt, max(1, -(-length // max(knots, 1)))
        self._seen, self._first, self._last = 0, math.nan, math.nan
        self._shortest, self._longest = math.inf, 0.0
        self._kept: list[FloatArray] = []

    def take(self, stamps: FloatArray) -> None:
        """Take the stamps (K,) of the next samples, in s."""
        if not stamps.size:
            return
        if self._seen == 0:
            self._first = self._last = float(stamps[0])
            steps = np.diff(stamps)
        else:
            steps = np.diff(stamps, prepend=self._last)
        if steps.size:
            self._shortest = min(self._shortest, float(steps.min()))
            self._longest = max(self._longest, float(steps.max()))
        self._kept.append(stamps[-self._seen % self._stride :: self._stride] - self._first)
        self._seen += stamps.size
        self._last = float(stamps[-1])

    @property
    def clock(self) -> Clock:
        """The clock so far; a regular one before the first stamp."""
        if self._seen == 0:
            return Clock(self._dt)
        times = np.concatenate(self._kept)
        places = self._stride * np.arange(times.size, dtype=np.float64)
        if places[-1] != self._seen - 1:
            places, times = np.append(places, self._seen - 1.0), np.append(times, self._last - self._first)
        return Clock(self._dt, places, times, self._shortest, self._longest)
