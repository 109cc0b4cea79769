"""Record: samples made ready for an estimator, mapped, usable, working point taken off."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from replant.arguments import FloatArray
from replant.model.dead_time import unknown_outputs
from replant.model.structure import Structure
from replant.regressor.preprocess import Preprocess, centre, screen
from replant.statistics.linear_algebra import quiet

SAME = 1e-9
"""Part of an interval that is rounding [ratio].
Derivation: some million times the precision of float64.
"""


@dataclass(frozen=True, eq=False)
class Record:
    """A record made ready: mapped input and output, working point taken off, unusable samples dropped.

    Attributes
    ----------
    u, y : (K,) arrays
    intervals : (1,) or (K,) array
        Time since the sample before, in s: one for all, or one each.
    input_hold : str
    r : (K,) array, optional
        Reference; None where there is none.
    before : Record, optional
        The samples before it, whose inputs still act on it because of a dead time.
    """

    u: FloatArray
    y: FloatArray
    intervals: FloatArray
    input_hold: str = "zoh"
    r: FloatArray | None = None
    before: Record | None = None

    def first(self, samples: int) -> Record:
        """Return the record's beginning."""
        intervals = self.intervals if self.intervals.size == 1 else self.intervals[:samples]
        r = None if self.r is None else self.r[:samples]
        return Record(self.u[:samples], self.y[:samples], intervals, self.input_hold, r)

    def last(self, samples: int) -> Record:
        """Return the record's end."""
        rest = slice(max(self.u.size - samples, 0), None)
        intervals = self.intervals if self.intervals.size == 1 else self.intervals[rest]
        r = None if self.r is None else self.r[rest]
        return Record(self.u[rest], self.y[rest], intervals, self.input_hold, r)

    def answering(self, delay: float) -> Record:
        """Return the samples that answer to inputs of the record, those before them as `before`; at least the newest.

        Parameters
        ----------
        delay : float
            Dead time in s.
        """
        unknown = min(self.unknown(delay), self.u.size - 1)
        if unknown <= 0:
            return self
        return replace(self.last(self.u.size - unknown), before=self.first(unknown))

    @property
    def joined(self) -> Record:
        """The record with the samples before it."""
        if self.before is None:
            return self
        parts = self.before, self
        u, y = (np.concatenate([getattr(part, name) for part in parts]) for name in ("u", "y"))
        regular = self.intervals.size == 1 and self.u.size > 1
        intervals = self.intervals if regular else np.concatenate([part.intervals for part in parts])
        r = None if self.r is None or self.before.r is None else np.concatenate([self.before.r, self.r])
        return Record(u, y, intervals, self.input_hold, r)

    def unknown(self, delay: float) -> int:
        """Return how many samples at the beginning answer to inputs before the record, with a dead time in s.

        Examples
        --------
        >>> record = Record(np.zeros(9), np.zeros(9), np.array([0.1]))
        >>> [record.unknown(delay) for delay in (0.0, 0.3, 0.32, 5.0)]
        [0, 3, 4, 9]
        """
        if self.intervals.size == 1:
            return min(unknown_outputs(delay, float(self.intervals[0])), self.u.size)
        since = np.cumsum(self.intervals) - self.intervals[0]
        return int(np.count_nonzero(delay - since > SAME * self.intervals))

    @property
    def span(self) -> float:
        """Time from first to last sample, in s."""
        if self.intervals.size == 1:
            return float(self.intervals[0]) * (self.u.size - 1)
        return float(self.intervals[1:].sum())

    @property
    def dt(self) -> float:
        """Mean interval in s."""
        return self.span / (self.u.size - 1)


@quiet
def ready_record(
    structure: Structure,
    dt: float,
    preprocess: Preprocess,
    u: FloatArray,
    y: FloatArray,
    stamps: FloatArray | None = None,
    input_hold: str = "zoh",
    r: FloatArray | None = None,
) -> Record:
    """Return a raw record made ready: mapped, unusable samples dropped, working point taken off.

    Without a bias in the structure the mean is subtracted too; the constant beside G(s) takes up the remainder.  Where
    samples are dropped the intervals grow: the filters are exact for the time that passed.

    Parameters
    ----------
    structure : Structure
    dt : float
        Sampling time in s.
    preprocess : Preprocess
        Input map, and working point in the units of u and y.
    u, y : (K,) arrays
        Raw input and output.
    stamps : (K,) array, optional
        Time stamps in s; None for a regular clock.
    input_hold : {"zoh", "foh"}
    r : (K,) array, optional
        Reference.
    """
    mapped = preprocess.map_input(u)
    accepted, _ = screen(mapped, y)
    if not structure.bias:
        preprocess = centre(preprocess, u, y)
    regular = stamps is None and bool(accepted.all())
    clock = np.arange(u.size) * dt if stamps is None else stamps
    intervals = np.array([dt]) if regular else np.diff(clock[accepted], prepend=clock[accepted][:1] - dt)
    u, y = mapped[accepted] - float(preprocess.input_offset), y[accepted] - float(preprocess.output_offset)
    return Record(u, y, intervals, input_hold, None if r is None else r[accepted])
