"""Advice about the time of a log: a column that seems to be it, and a sampling time that the stamps contradict."""

from __future__ import annotations

import math
import os
from collections.abc import Collection

import numpy as np

from replant.errors import LogError, shown
from replant.logs.columns import find_clock, read_contents
from replant.logs.file_formats import read_columns
from replant.logs.sampling_time import time_columns, unit_of_column
from replant.logs.table import Table, listed

MOST_OFF = 0.1  # difference of the usual interval from the given one that jitter makes [part of the sampling time]
GIVE_TIME = "name the time column (time, --time) or give the sampling time (dt, --dt)"


def time_advice(table: Table, taken: Collection[int]) -> str:
    """Return what to do without a column with a name of time; one that rises as a clock does is named."""
    found, there = find_clock(table, read_contents(table), others=taken), f"there are: {listed(table.names)}"
    if found is None or found.column is None:
        return f"{GIVE_TIME}; {there}"
    name = shown(found.column.name)
    return f"name the time column (time, --time), perhaps {name}, or give the sampling time (dt, --dt); {there}"


def contradicted(table: Table, dt: float | None) -> str:
    """Return a note on a ``--dt`` in s that a table's time column contradicts; empty if none does."""
    interval = None if dt is None else stamped_interval(table)
    if dt is None or interval is None or abs(interval[1] / dt - 1.0) <= MOST_OFF:
        return ""
    column, usual = interval
    return f"{table.path}: column {column!r} steps by {usual:.4g} s, but --dt is {dt:.4g} s; --dt is used"


def stamped_interval(log: str | os.PathLike[str] | Table) -> tuple[str, float] | None:
    """Return the time column's name and the median interval of its first block in s; None if no column is certain."""
    table = log if isinstance(log, Table) else read_columns(log)
    candidates = time_columns(table)
    if len(candidates) != 1:
        return None
    try:
        (stamps,) = table.head(candidates, 1)
    except LogError:  # it holds no numbers
        return None
    name = table.names[candidates[0]]
    unit = unit_of_column(table, candidates[0], stamps).seconds
    with np.errstate(invalid="ignore", over="ignore"):
        interval = float(np.median(np.diff(stamps))) * unit if stamps.size > 1 else math.nan
    return (name, interval) if interval > 0.0 else None
