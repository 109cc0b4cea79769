"""The samples of a log as the page draws them, and stretches of it that may be left out.

A column is written to a file as it is read, so that a log of any length takes little memory.  Beside it stand the
least and the greatest value of each `BUCKET` samples, of which a curve over much of the log is made.
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

SHOWN = 12  # stretches that are listed, the longest [count]
MOVES = 2  # moves of the input within it, without which the output may well rest [count]
GAP = 3.0  # distance of two time stamps from which on samples are missing between them [usual intervals]
MISSING = 10  # missing outputs in a row that are worth a line [count]


@dataclass(frozen=True)
class Doubt:
    """A stretch of time in s from the first sample, and what is the matter with it."""

    begin: float
    end: float
    what: str


def doubts(t: FloatArray, u: FloatArray | None, y: FloatArray | None) -> list[Doubt]:
    """Return what may be wrong, in the order of time; ``t`` (K,) in s from the first sample."""
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
    """Return where a solution leaves the output out as that of a stuck sensor, and the input moves."""
    moved = np.concatenate([[0], np.cumsum(u[1:] != u[:-1])])
    return [
        Doubt(float(t[a]), _end(t, b), f"the output stays at {y[a]:.4g} while the input moves")
        for a, b in stretches_of(suspicious(u, y) == Suspect.STUCK).tolist()
        if moved[b - 1] - moved[a] >= MOVES
    ]


def _end(t: FloatArray, row: int) -> float:
    """Return when the sample behind a stretch was taken; of the last one, a step after it."""
    return float(t[row]) if row < t.size else float(2.0 * t[-1] - t[-2]) if t.size > 1 else float(t[-1])


BUCKET = 64  # samples of which least and greatest value are kept [count]
FEWEST = 4  # buckets for each point of a curve, below which the samples themselves are joined [count]
CHUNK = 1 << 20  # samples of which the buckets are made at once [count]

Extremes = tuple[FloatArray, FloatArray]


class CancelledError(Exception):
    """The reading of a log was stopped."""


@dataclass(frozen=True, eq=False)
class Column:
    """One column: a file of float64, and least and greatest value of each `BUCKET` of its samples."""

    values: FloatArray
    buckets: Extremes

    def between(self, first: int, last: int, points: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return places (N,) and least and greatest values (N,) of the samples [first, last), at most ``points``."""
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
    """Return least and greatest values of each ``count`` entries; NaN where all of them are."""
    if count == 1 or not low.size:
        return low, high
    edges = np.arange(0, low.size, count)
    return np.fmin.reduceat(low, edges), np.fmax.reduceat(high, edges)


def buckets_of(values: FloatArray) -> Extremes:
    """Return least and greatest value of each `BUCKET` samples of a column (K,)."""
    parts = [(np.empty(0), np.empty(0))]
    for first in range(0, values.size, CHUNK):
        chunk = np.asarray(values[first : first + CHUNK])
        chunk = np.where(np.isfinite(chunk), chunk, np.nan)
        parts.append(joined_extremes(chunk, chunk, BUCKET))
    low, high = (np.concatenate(each) for each in zip(*parts, strict=True))
    return low, high


class Samples:
    """The columns of one log that are drawn, read from its file when they are asked for."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.columns: dict[int, Column] = {}
        self.rows = 0

    def close(self) -> None:
        """Forget them: their files, which have no name, go with them."""
        self.columns.clear()

    def read(self, numbers: Sequence[int], progress: Callable[[int, int], bool]) -> None:
        """Read further columns in one pass; ``progress`` gets rows and about how many there are, and may stop it."""
        wanted = [number for number in numbers if number not in self.columns]
        if not wanted:
            return
        table = side_by_side(read_columns(self.path))

        def told(rows: int, about: int) -> None:
            if not progress(rows, about):
                raise CancelledError

        arrays = table.arrays(wanted, 0, told)
        if not any(values.size for values in arrays):
            raise LogError(f"{self.path}: there are no rows; record the log again")
        for number, values in zip(wanted, arrays, strict=True):
            self.columns[number] = Column(values, buckets_of(values))
        self.rows = max(column.values.size for column in self.columns.values())

    def drawn(
        self, shown: Sequence[int], clock: Clock, between: tuple[float, float] | None, points: int
    ) -> dict[str, Any]:
        """Return the columns ``shown`` between two times in s, or all; ``points`` is the most of each."""
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
    """When the rows of a log were taken: by a column in units of ``unit`` s, or ``dt`` s apart."""

    number: int | None
    unit: float
    dt: float

    def rows(self, times: Column | None, rows: int, between: tuple[float, float]) -> tuple[int, int]:
        """Return the first row and that behind the last between two times, and one more at either end."""
        if times is None:
            low, high = (min(max(t / self.dt, 0.0), rows) for t in between)
            return max(0, math.floor(low) - 1), min(rows, math.ceil(high) + 2)
        origin = float(times.values[0])
        low, high = np.searchsorted(times.values, [origin + t / self.unit for t in between]).tolist()
        return max(0, int(low) - 1), min(times.values.size, int(high) + 2)

    def at(self, times: Column | None, places: FloatArray) -> FloatArray:
        """Return when places (N,) between the rows are, in s from the first row."""
        if times is None:
            return places * self.dt
        last = times.values.size - 1
        rows = np.minimum(places.astype(np.int64), last)
        stamps, after = (np.asarray(times.values[each]) for each in (rows, np.minimum(rows + 1, last)))
        return np.asarray((stamps + (places - rows) * (after - stamps) - float(times.values[0])) * self.unit)

    def ends(self, times: Column | None, rows: int) -> list[float]:
        """Return when the first and the last row were taken, in s from the first."""
        return [float(t) for t in self.at(times, np.array([0.0, max(rows - 1, 1)]))]
