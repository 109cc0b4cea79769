"""Replay: a recorded log as if its rig were running, in real time, faster, or as fast as it can be taken."""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np

from replant.arguments import FloatArray
from replant.data.logs import Table, read_columns
from replant.data.logs.time import time_candidates, unit_in_seconds
from replant.data.streams.address import Address
from replant.data.streams.batch import Batch
from replant.data.streams.numbering import take
from replant.data.streams.pace import Pace, speed_of
from replant.data.streams.reader import Reader
from replant.errors import InvalidArgumentError

BLOCK = 1 << 12
"""Samples handed over at once at the most [samples]."""


class ReplaySource(Reader):
    """A log as a stream, ``log.csv?input=u&output=y&speed=10``; its rows are numbered from 0.

    Parameters
    ----------
    name : str
    record : Batch
        All its samples, numbered.
    elapsed : (K,) array
        When each is due, in s after the first; never decreasing.
    speed : float
        Times as fast as recorded; infinite for as fast as possible.
    """

    def __init__(self, name: str, record: Batch, elapsed: FloatArray, speed: float = math.inf) -> None:
        super().__init__(name, waits=True, capacity=4 * BLOCK)
        self._record = record
        self._elapsed = elapsed
        self._pace = Pace(speed)

    def _read(self) -> None:
        self._connected(again=False)
        last = self._numbering.last
        at = 0 if last is None else int(np.searchsorted(numbers(self._record), last, side="right"))
        begun = float(self._elapsed[at]) if at < len(self._record) else 0.0
        while at < len(self._record) and not self._alarm.rung:
            due = int(np.searchsorted(self._elapsed, begun + self._pace.gone(), side="right"))
            end = min(due, at + BLOCK)
            if end > at:
                self._deliver(part(self._record, at, end))
                at = end
            else:
                self._pace.wait(self._alarm, float(self._elapsed[at]) - begun)


def numbers(record: Batch) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return the sequence numbers of a record that has them."""
    assert record.sequence is not None
    return record.sequence


def part(record: Batch, first: int, end: int) -> Batch:
    """Return consecutive samples of a record, come in now."""
    time_stamps = None if record.t is None else record.t[first:end]
    return Batch(record.u[first:end], record.y[first:end], time_stamps, numbers(record)[first:end], time.monotonic())


def open_replay(address: Address, columns: tuple[str, ...] | None) -> ReplaySource:
    """Return the source that a file's path names."""
    address.allow("input", "output", "time", "dt", "speed")
    options = address.options
    table = read_columns(Path(address.path))
    speed, dt = speed_of(address, math.inf), address.positive("dt")
    if dt is not None and "time" in options:
        raise InvalidArgumentError(f"{address.name}: give one of time and dt")
    stamps = None if dt is not None else time_column(table, options.get("time"))
    keys: list[str | int] = [options.get("input", "u"), options.get("output", "y")]
    if stamps is not None:
        keys.append(stamps)
    u, y, *clock = table.columns(keys)
    rows = min(u.size, y.size, *(column.size for column in clock))
    record = Batch(u[:rows], y[:rows], None, np.arange(rows), 0.0)
    if stamps is None:
        if dt is None and not math.isinf(speed):
            raise InvalidArgumentError(f"{address.name}: no column is the time; add &time=COLUMN or &dt=SECONDS")
        return ReplaySource(address.name, record, np.arange(rows, dtype=np.float64) * (dt or 0.0), speed)
    unit = 1.0 if stamps in table.in_seconds else unit_in_seconds(table.names[stamps])
    return timed(address.name, record, clock[0][:rows] * unit, speed)


def time_column(table: Table, named: str | None) -> int | None:
    """Return the column of time stamps: the one that is named, else the only one that is called so."""
    if named is not None:
        return table.find(named)
    candidates = time_candidates(table.names)
    return candidates[0] if len(candidates) == 1 else None


def timed(name: str, record: Batch, t: FloatArray, speed: float) -> ReplaySource:
    """Return the source of a record with time stamps; a row without one is passed over and counted."""
    kept = np.isfinite(t)
    record = take(Batch(record.u, record.y, t, record.sequence, 0.0), kept)
    elapsed = np.maximum.accumulate(t[kept]) - t[kept][:1]
    source = ReplaySource(name, record, elapsed, speed)
    source.refuse("time not finite", int(kept.size - kept.sum()))
    return source
