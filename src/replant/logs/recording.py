"""A recorded log of any length, read block by block; a time range of it; several logs joined; the file's digest."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from replant.errors import InvalidArgumentError, LogError, shown
from replant.logs.log import Log
from replant.logs.sampling_time import FIRST, unit_of_column
from replant.logs.table import Arrays, Blocks, Table, in_parts, nth_row
from replant.numerics.arguments import FloatArray, number

MOST_HELD = 1 << 20  # longest log held in memory: 24 MB [samples]


@dataclass(frozen=True, eq=False)
class Recording:
    """A log of input, output and an optional reference; all its rows have been checked."""

    table: Table
    columns: tuple[int, ...]
    arrays: Sequence[FloatArray]  # the columns, then the time stamps if there are any
    dt: float
    clock: int | None  # the column of the time stamps
    samples: int
    complete: bool
    held: Log | None
    begin: float | None = None
    end: float | None = None
    irregularity: str = ""
    unit: float = 1.0  # one unit of the stamps in s
    doubt: str = ""  # why the unit may be wrong; empty if it is stated

    def of_log(self, log: Log) -> Recording:
        """Return a recording with the samples of a log in memory."""
        irregularity = self.irregularity if log.stamps is not None else ""
        complete = bool(np.isfinite(log.input).all() and np.isfinite(log.output).all())
        return replace(
            self, arrays=(), dt=log.dt, samples=len(log), complete=complete, held=log, irregularity=irregularity
        )

    @property
    def stamped(self) -> bool:
        """Whether the log has time stamps that are used."""
        return self.clock is not None

    @property
    def irregular(self) -> bool:
        """Whether the clock is irregular, so that the batches hold its time stamps."""
        return bool(self.irregularity)

    @property
    def path(self) -> Path:
        """The file."""
        return self.table.path

    def batches(self) -> Iterator[tuple[FloatArray, ...]]:
        """Yield input, output, the reference if there is one, and stamps in s of an irregular clock, block by block."""
        if self.held is not None:
            log = self.held
            every = log.input, log.output, log.reference, log.stamps
            yield tuple(signal for signal in every if signal is not None)
            return
        for *signals, last in in_parts(self.arrays[: len(self.columns) + self.irregular]):
            yield *signals, last * self.unit if self.irregular else last

    def newest(self, u: FloatArray, y: FloatArray, since_begin: FloatArray | None = None) -> Log:
        """Return the log if it is in memory, else a log of its newest samples; with the reference if these are all."""
        if self.held is not None:
            return self.held
        earlier, time = self.samples - u.size, since_begin if self.irregular else None
        if self.stamped and not earlier:
            time = self.arrays[-1] if self.unit == 1.0 else self.arrays[-1] * self.unit
        elif self.stamped and not self.irregular:
            time = np.asarray(self.dt * np.arange(earlier, self.samples), np.float64)
        of_input, of_output, *of_reference = (self.table.names[column] for column in self.columns)
        reference = self.arrays[2] if of_reference and not earlier else None
        return Log(
            u, y, self.dt, time, of_input, of_output, self.path, earlier, reference, "".join(of_reference),
            self.begin, self.end, irregular=self.irregular,
        )  # fmt: skip


def digest(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal; empty if the file cannot be read."""
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return ""


ROUND_OFF = 1e-6  # distance before an end of the range at which a stamp counts as at that end [part of an interval]


def part_of(table: Table, begin: float | None, end: float | None, *, dt: float | None, time: int | None) -> Table:
    """Return the table of the rows from ``begin`` to before ``end``, in s; None is the begin or the end of the log."""
    begin, end = 0.0 if begin is None else number("begin", begin), math.inf if end is None else number("end", end)
    if not (0.0 <= begin < math.inf and begin < end):
        raise InvalidArgumentError(
            f"the time range must begin at 0 or later and end after that, in s from the log's first sample: "
            f"got {begin:g} (begin, --from) to {end:g} (end, --to)"
        )
    if time is None:
        assert dt is not None
        first = math.ceil(begin / dt - ROUND_OFF)
        stop = math.inf if math.isinf(end) else math.ceil(end / dt - ROUND_OFF)
    else:
        unit = unit_of_column(table, time, table.head([time], 1)[0][:FIRST]).seconds
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


def _rows_between(blocks: Iterator[FloatArray], begin: float, end: float) -> tuple[int, int]:
    """Return the first row at or after ``begin``, and that at or after ``end`` (the number of rows if none is)."""
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
        beyond = np.flatnonzero(since >= end - slack)
        if beyond.size:
            return (first if first >= 0 else row), row + int(beyond[0])
        row += stamps.size
    return (first if first >= 0 else row), row


def _cut(blocks: Blocks, numbers: Sequence[int], first: int, stop: float) -> Iterator[Arrays]:
    """Yield the rows [first, stop) of the blocks."""
    row = 0
    for block in blocks(numbers):
        size = max(map(len, block))
        low, high = max(0, first - row), min(size, stop - row)
        if low < high:
            yield [column[low : int(high)] for column in block]
        row += size
        if row >= stop:
            return


def joined(tables: Sequence[Table]) -> Table:
    """Join tables with equal columns, in the order given."""
    first = tables[0]
    for table in tables:
        if set(table.names) != set(first.names):
            raise LogError(
                f"{table.path}: other columns than in {first.path.name}; the files of a rig must have equal columns"
            )
        dated = {table.names[number] for number in table.in_seconds} ^ {first.names[at] for at in first.in_seconds}
        if table.stamps is not None or dated or len(table.origins) < len(table.in_seconds):
            raise LogError(
                f"{table.path}: its dates or time stamps are counted from its own first row, so it cannot be joined "
                f"with {first.path.name}; write the files as Parquet, with whole dates (year-month-day, clock time), "
                "or with a time in s that continues from file to file"
            )

    def blocks(numbers: Sequence[int]) -> Iterator[Arrays]:
        for table in tables:
            own = [table.names.index(first.names[number]) for number in numbers]
            later = [  # the dates of every table are counted from the first row of the first one
                (table.origins[here] - first.origins[number]) / 1e9 if here in table.origins else 0.0
                for here, number in zip(own, numbers, strict=True)
            ]
            for block in table.blocks(own):
                yield [column + off if off else column for column, off in zip(block, later, strict=True)]

    return Table(
        first.path,
        first.names,
        blocks,
        in_seconds=first.in_seconds,
        parts=first.parts,
        origins=first.origins,
        describe_row=lambda row: f"{nth_row(row)} of the {len(tables)} files joined in the order of time",
        approximate_rows=sum(table.approximate_rows for table in tables),
        notes=tuple(note for table in tables for note in table.notes),
    )
