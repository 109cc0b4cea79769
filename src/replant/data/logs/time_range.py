"""A part of a log: the rows between two times, counted from its first row."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from replant.arguments import number
from replant.data.logs.table import Table
from replant.errors import InvalidArgumentError, LogError, shown

ROUND_OFF = 1e-6
"""Distance beyond an end up to which a stamp still belongs to it, besides round-off [part of an interval]."""


def check_range(begin: float | None, end: float | None) -> tuple[float, float]:
    """Return the ends of a time range in s, open ones as 0 and infinity.

    >>> check_range(2, None)
    (2.0, inf)
    """
    first, last = 0.0 if begin is None else number("begin", begin), math.inf if end is None else number("end", end)
    if not (0.0 <= first < math.inf and first < last):
        raise InvalidArgumentError(
            f"the time range must begin at 0 or later and end after that, in s from the log's first sample: "
            f"got {first:g} (begin, --from) to {last:g} (end, --to)"
        )
    return first, last


def part_of(table: Table, begin: float, end: float, *, dt: float | None, time: int | None, unit: float) -> Table:
    """Return the table of those rows that lie between two times in s, both included.

    >>> from pathlib import Path
    >>> data = [np.arange(10.0), np.arange(10.0) ** 2]
    >>> table = Table(Path("log.npz"), ("t", "y"), lambda numbers: iter([[data[n] for n in numbers]]))
    >>> part_of(table, 2.0, 4.0, dt=None, time=0, unit=1.0).column("y")
    array([ 4.,  9., 16.])
    """
    if time is None:
        assert dt is not None
        first = math.ceil(begin / dt - ROUND_OFF)
        stop = math.inf if math.isinf(end) else math.floor(end / dt + ROUND_OFF) + 1
    else:
        first, stop = _rows_between((block for (block,) in table.stream([time])), begin / unit, end / unit)
        if stop <= first:
            until = f"to {end:g} s" if math.isfinite(end) else "on"
            raise LogError(
                f"{table.path}: column {shown(table.names[time])} has no row from {begin:g} s {until} after its first "
                "one; choose another time range (begin, end, --from, --to)"
            )
    rows = min(float(table.approximate_rows), stop) - first
    return replace(
        table,
        blocks=lambda numbers: _cut(table.blocks, numbers, first, stop),
        describe_row=lambda row: table.describe_row(first + row),
        approximate_rows=max(0, int(rows)),
    )


def _rows_between(blocks: Iterator[NDArray[np.float64]], begin: float, end: float) -> tuple[int, int]:
    """Return the first row at or after ``begin``, and the row behind the last one before a stamp beyond ``end``."""
    origin, slack, row, first = math.nan, 0.0, 0, -1
    for stamps in blocks:
        if math.isnan(origin) and stamps.size:
            origin = float(stamps[0])
            with np.errstate(invalid="ignore", over="ignore"):
                usual = abs(float(np.median(np.diff(stamps)))) if stamps.size > 1 else 0.0
            slack = ROUND_OFF * usual + 2.0 * float(np.spacing(abs(origin)))
        since = stamps - origin
        if first < 0 and (reached := np.flatnonzero(since >= begin - slack)).size:
            first = row + int(reached[0])
        beyond = np.flatnonzero(since > end + slack)
        if beyond.size:
            return (first if first >= 0 else row), row + int(beyond[0])
        row += stamps.size
    return (first if first >= 0 else row), row


def _cut(
    blocks: Callable[[Sequence[int]], Iterator[list[NDArray[np.float64]]]],
    numbers: Sequence[int],
    first: int,
    stop: float,
) -> Iterator[list[NDArray[np.float64]]]:
    """Yield those rows of the blocks that lie in [first, stop)."""
    row = 0
    for block in blocks(numbers):
        size = max(map(len, block))
        low, high = max(0, first - row), min(size, stop - row)
        if low < high:
            yield [column[low : int(high)] for column in block]
        row += size
        if row >= stop:
            return
