"""The samples of a log for drawing, and stretches that the user may want to leave out.

A column is written to a file as it is read, so that a log of any length takes little memory.  The minimum and maximum
of each `BUCKET` samples are kept, too; a curve over a long part of the log is made of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import LogError
from replant.estimation.solver.bad_samples import suspicious
from replant.kernels.schema import Doubt as Suspect
from replant.logs import read_columns
from replant.logs.merged_channels import side_by_side
from replant.numerics.arguments import FloatArray
from replant.numerics.robust import stretches_of
from replant.plotting.numbers import rounded

SHOWN = 12  # most stretches that are listed, the longest ones [count]
MOVES = 2  # fewest moves of the input in a stretch that make a constant output suspicious [count]
GAP = 3.0  # distance of two time stamps that is a gap [usual intervals]
MISSING = 10  # fewest missing outputs in a row that are listed [count]


@dataclass(frozen=True)
class Doubt:
    """A stretch of time in s from the first sample, and its problem."""

    begin: float
    end: float
    what: str


def doubts(t: FloatArray, u: FloatArray | None, y: FloatArray | None) -> list[Doubt]:
    """Return suspicious stretches in the order of time; ``t`` (K,) is in s from the first sample."""
    found = _gaps(t)
    if y is not None:
        found += _missing(t, y)
        if u is not None and u.size == y.size:
            found += _stuck(t, u, y)
    found = sorted(found, key=lambda each: each.begin - each.end)[:SHOWN]
    return sorted(found, key=lambda each: each.begin)


def _gaps(t: FloatArray) -> list[Doubt]:
    steps = np.diff(t)
    usual = float(np.median(steps)) if steps.size else 0.0
    places = np.flatnonzero(steps > GAP * usual) if usual > 0.0 else np.zeros(0, np.int64)
    return [Doubt(float(t[k]), float(t[k + 1]), f"no samples for {steps[k]:.4g} s") for k in places[: 10 * SHOWN]]


def _missing(t: FloatArray, y: FloatArray) -> list[Doubt]:
    rows = stretches_of(~np.isfinite(y)).tolist()
    return [Doubt(float(t[a]), _end(t, b), f"{b - a:,} outputs are missing") for a, b in rows if b - a >= MISSING]


def _stuck(t: FloatArray, u: FloatArray, y: FloatArray) -> list[Doubt]:
    """Return the stretches in which the solver would reject the output as stuck while the input moves."""
    moved = np.concatenate([[0], np.cumsum(u[1:] != u[:-1])])
    return [
        Doubt(float(t[a]), _end(t, b), f"the output stays at {y[a]:.4g} while the input moves")
        for a, b in stretches_of(suspicious(u, y) == Suspect.STUCK).tolist()
        if moved[b - 1] - moved[a] >= MOVES
    ]


def _end(t: FloatArray, row: int) -> float:
    """Return the time of the sample after a stretch; after the last sample, one step later."""
    return float(t[row]) if row < t.size else float(2.0 * t[-1] - t[-2]) if t.size > 1 else float(t[-1])


BUCKET = 64  # samples in a bucket, of which minimum and maximum are kept [count]
FEWEST = 4  # fewest buckets per point of a curve; with fewer the samples themselves are used [count]
CHUNK = 1 << 20  # samples processed at once to make buckets [count]

Extremes = tuple[FloatArray, FloatArray]


class CancelledError(Exception):
    """The reading of a log was stopped."""


@dataclass(frozen=True, eq=False)
class Column:
    """One column: a file of float64, and the minimum and maximum of each bucket of its samples."""

    values: FloatArray
    buckets: Extremes

    def between(self, first: int, last: int, points: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return positions, minima and maxima (N,) of the samples [first, last), with N at most ``points``."""
        size = BUCKET if last - first >= FEWEST * BUCKET * points else 1
        rows = slice(first // size, -(-last // size))
        low = self.values[rows] if size == 1 else self.buckets[0][rows]
        high = low if size == 1 else self.buckets[1][rows]
        joined = max(1, -(-low.size // points))
        low, high = joined_extremes(low, high, joined)
        places = first // size * size + size * joined * np.arange(low.size, dtype=np.float64)
        if size * joined > 1:
            places = np.minimum(places + 0.5 * size * joined, float(last))
        return places, low, high


def joined_extremes(low: FloatArray, high: FloatArray, count: int) -> Extremes:
    """Return the minima and maxima of each ``count`` entries; NaN only if all of them are."""
    if count == 1 or not low.size:
        return low, high
    edges = np.arange(0, low.size, count)
    return np.fmin.reduceat(low, edges), np.fmax.reduceat(high, edges)


def thinned(t: FloatArray, signal: FloatArray, rows: slice, points: int) -> dict[str, Any]:
    """Return a signal as times, minima and maxima of stretches; ``high`` is None if every sample is shown."""
    time, values = t[rows], signal[rows]
    every = max(1, -(-values.size // points))
    low, high = joined_extremes(values, values, every)
    return {"t": rounded(time[::every], 12), "low": rounded(low), "high": None if every == 1 else rounded(high)}


def buckets_of(values: FloatArray) -> Extremes:
    """Return the minimum and maximum of each bucket of a column (K,)."""
    parts = [(np.empty(0), np.empty(0))]
    for first in range(0, values.size, CHUNK):
        chunk = np.asarray(values[first : first + CHUNK])
        chunk = np.where(np.isfinite(chunk), chunk, np.nan)
        parts.append(joined_extremes(chunk, chunk, BUCKET))
    low, high = (np.concatenate(each) for each in zip(*parts, strict=True))
    return low, high


class Samples:
    """The columns of one log that are drawn, read from its file on request."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.columns: dict[int, Column] = {}
        self.rows = 0

    def close(self) -> None:
        """Discard the columns; their files have no name and vanish with them."""
        self.columns.clear()

    def read(self, numbers: Sequence[int], progress: Callable[[int, int], bool]) -> None:
        """Read further columns in one pass; ``progress`` gets the rows so far and in all, and returns False to stop."""
        wanted = [number for number in numbers if number not in self.columns]
        if not wanted:
            return
        table = side_by_side(read_columns(self.path))

        def told(rows: int, about: int) -> None:
            if not progress(rows, about):
                raise CancelledError

        arrays = table.columns(wanted, 0, told)
        if not any(values.size for values in arrays):
            raise LogError(f"{self.path}: there are no rows; record the log again")
        for number, values in zip(wanted, arrays, strict=True):
            self.columns[number] = Column(values, buckets_of(values))
        self.rows = max(column.values.size for column in self.columns.values())

    def drawn(
        self, shown: Sequence[int], clock: Clock, between: tuple[float, float] | None, points: int
    ) -> dict[str, Any]:
        """Return the columns ``shown`` between two times in s, or whole, with at most ``points`` points each."""
        times = self.columns.get(clock.number) if clock.number is not None else None
        ends = clock.ends(times, self.rows)
        first, last = clock.rows(times, self.rows, between or (0.0, ends[1]))
        found: dict[str, Any] = {"columns": {}, "rows": self.rows, "all": ends}
        for number in shown:
            column = self.columns.get(number)
            if column is None:
                continue
            places, low, high = column.between(first, min(last, column.values.size), points)
            found["t"] = rounded(clock.at(times, places), 12)
            found["columns"][str(number)] = [rounded(low), None if low is high else rounded(high)]
        return found


@dataclass(frozen=True)
class Clock:
    """The times of a log's rows: from a column in units of ``unit`` s, or ``dt`` s apart."""

    number: int | None
    unit: float
    dt: float

    def rows(self, times: Column | None, rows: int, between: tuple[float, float]) -> tuple[int, int]:
        """Return the range of rows between two times, extended by one row at either end."""
        if times is None:
            low, high = (min(max(t / self.dt, 0.0), rows) for t in between)
            return max(0, math.floor(low) - 1), min(rows, math.ceil(high) + 2)
        origin = float(times.values[0])
        low, high = np.searchsorted(times.values, [origin + t / self.unit for t in between]).tolist()
        return max(0, int(low) - 1), min(times.values.size, int(high) + 2)

    def at(self, times: Column | None, places: FloatArray) -> FloatArray:
        """Return the times of positions (N,) between rows, in s from the first row."""
        if times is None:
            return places * self.dt
        last = times.values.size - 1
        rows = np.minimum(places.astype(np.int64), last)
        stamps, after = (np.asarray(times.values[each]) for each in (rows, np.minimum(rows + 1, last)))
        return np.asarray((stamps + (places - rows) * (after - stamps) - float(times.values[0])) * self.unit)

    def ends(self, times: Column | None, rows: int) -> list[float]:
        """Return the times of the first and the last row, in s from the first."""
        return [float(t) for t in self.at(times, np.array([0.0, max(rows - 1, 1)]))]
