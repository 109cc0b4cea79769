"""Replay: a recorded log as a live source, in real time, faster, or as fast as the session takes samples."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from replant.arguments import FloatArray
from replant.data.logs import Table, read_columns
from replant.data.logs.rasters import on_one_clock
from replant.data.logs.sampling_time import time_candidates, unit_in_seconds
from replant.data.streams.opening import Address
from replant.data.streams.reader import Reader, StopRequest
from replant.data.streams.source import Batch
from replant.errors import InvalidArgumentError

BLOCK = 1 << 12  # samples handed over at once at the most [samples]


class ReplaySource(Reader):
    """A log as a stream, ``log.csv?input=u&output=y&reference=r&speed=10``; its rows are numbered from 0."""

    def __init__(self, name: str, record: Batch, elapsed: FloatArray, speed: float = math.inf) -> None:
        super().__init__(name, waits=True, capacity=4 * BLOCK)
        self._record = record
        self._elapsed = elapsed
        self._pace = Pace(speed)

    def _read(self) -> None:
        self._connected(again=False)
        last = self._numbering.last
        assert self._record.sequence is not None
        at = 0 if last is None else int(np.searchsorted(self._record.sequence, last, side="right"))
        start = float(self._elapsed[at]) if at < len(self._record) else 0.0
        while at < len(self._record) and not self._stop.requested:
            due = int(np.searchsorted(self._elapsed, start + self._pace.elapsed(), side="right"))
            end = min(due, at + BLOCK)
            if end > at:
                self._deliver(replace(self._record.select(slice(at, end)), arrived=time.monotonic()))
                at = end
            else:
                self._pace.wait(self._stop, float(self._elapsed[at]) - start)


def open_replay(address: Address, columns: tuple[str, ...] | None) -> ReplaySource:
    """Return the source of a recorded log, whose path and options are in the address."""
    address.allow("input", "output", "reference", "time", "dt", "speed")
    options = address.options
    table = read_columns(Path(address.path))
    speed, dt = speed_of(address, math.inf), address.positive("dt")
    if dt is not None and "time" in options:
        raise InvalidArgumentError(f"{address.name}: give one of time and dt")
    stamps = None if dt is not None else time_column(table, options.get("time"))
    keys: list[str | int] = [options.get("input", "u"), options.get("output", "y")]
    referenced = "reference" in options
    if referenced:
        keys.append(options["reference"])
    if table.stamps is not None:
        roles = dict(zip(("input", "output", "reference"), map(table.find, keys), strict=False))
        table, roles = on_one_clock(table, roles, is_timed=dt is not None or "time" in options)
        stamps = roles.pop("time", stamps)
        keys = list(roles.values())
    if stamps is not None:
        keys.append(stamps)
    columns_read = table.columns(keys)
    rows = min(column.size for column in columns_read)
    u, y, *others = (column[:rows] for column in columns_read)
    record = Batch(u, y, None, np.arange(rows), 0.0, others[0] if referenced else None)
    if stamps is None:
        if dt is None and not math.isinf(speed):
            raise InvalidArgumentError(f"{address.name}: no column is the time; add &time=COLUMN or &dt=SECONDS")
        return ReplaySource(address.name, record, np.arange(rows, dtype=np.float64) * (dt or 0.0), speed)
    unit = 1.0 if stamps in table.in_seconds else unit_in_seconds(table.names[stamps])
    return stamped_source(address.name, record, others[-1] * unit, speed)


def time_column(table: Table, named: str | None) -> int | None:
    """Return the index of the column of time stamps.

    >>> time_column(Table(Path("log.csv"), ("time", "u", "y"), lambda columns: iter([])), None)
    0
    """
    if named is not None:
        return table.find(named)
    candidates = time_candidates(table.names)
    return candidates[0] if len(candidates) == 1 else None


def stamped_source(name: str, record: Batch, t: FloatArray, speed: float) -> ReplaySource:
    """Return the source of a record with time stamps; rows without a finite stamp are left out and counted.

    >>> record = Batch(np.zeros(3), np.zeros(3), None, np.arange(3), arrived=0.0)
    >>> source = stamped_source("log.csv", record, np.array([0.0, np.nan, 0.2]), speed=math.inf)
    >>> source.counters
    {'time not finite': 1}
    """
    kept = np.isfinite(t)
    record = replace(record, t=t).select(kept)
    elapsed = np.maximum.accumulate(t[kept]) - t[kept][:1]
    source = ReplaySource(name, record, elapsed, speed)
    source.count_refused("time not finite", int(kept.size - kept.sum()))
    return source


LONGEST_PAUSE = 3600.0  # the longest single pause: the system's timers may refuse a longer one [s]


class Pace:
    """A clock that runs ``speed`` times as fast as real time, and starts when it is first read.

    >>> Pace(math.inf).elapsed()
    inf
    """

    def __init__(self, speed: float) -> None:
        self._speed = speed
        self._start: float | None = None

    def elapsed(self) -> float:
        """Return the time of the record that has passed, in s."""
        now = time.monotonic()
        self._start = now if self._start is None else self._start
        return math.inf if math.isinf(self._speed) else (now - self._start) * self._speed

    def wait(self, stop: StopRequest, until: float) -> None:
        """Wait until ``until`` s of the record have passed, or a stop is requested."""
        stop.wait(min(max(until - self.elapsed(), 0.0) / self._speed, LONGEST_PAUSE))


def speed_of(address: Address, default: float) -> float:
    """Return the option ``speed`` of a URL: a positive number, or infinity for ``max``.

    >>> speed_of(Address("demo?speed=max", "", options={"speed": "max"}), 1.0)
    inf
    """
    if address.options.get("speed") == "max":
        return math.inf
    return address.positive("speed") or default
