"""The clock of a log: its time column and unit, known or guessed, its interval, jitter and gaps."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.data.inspection.columns import Column, Contents, Kind
from replant.data.logs.sampling_time import SamplingTime, StampUnit, time_candidates, unit_of_stamps
from replant.data.logs.table import Table, listed
from replant.errors import LogError

GAP = 1.5  # interval of a steady clock from which on a sample is lost [usual intervals]
LOST = 3.5
"""The same of a clock that jitters: samples are lost for certain [usual intervals].
Derivation: GAP of `replant.engine.record`, from which on a fit takes the state for unknown.
"""
STEADY = 0.2
"""Deviation of an interval up to which a rising column without a telling name may be a time [part of the median]."""
MOSTLY = 0.95  # part of its intervals that must be steady [part]
FEWEST = 20  # rows from which on a rising column without a telling name may be a time [rows]


@dataclass(frozen=True)
class Clock:
    """The time column of a log.

    Attributes
    ----------
    column : Column
    guess : str
        Why the column may not be the time; empty if it is the only one called t, time or timestamp, or was given.
    unit : float
        One unit of its stamps in s.
    doubt : str
        Why the unit may be another one; empty if it is stated.
    dt : float
        The usual (median) interval in s; NaN without a rising step.
    jitter : float
        Standard deviation of the intervals that are no gaps, in s.
    gaps : int
        Number of intervals above `GAP` usual ones.
    longest : float
        The longest interval in s.
    backward : int
        Number of stamps that repeat, go back, or are missing.
    duration : float
        From the first stamp to the last, in s.
    problem : str
        Why `replant run` would refuse these stamps; empty if it takes them.
    """

    column: Column
    guess: str
    unit: float
    doubt: str
    dt: float
    jitter: float
    gaps: int
    longest: float
    backward: int
    duration: float
    problem: str


def find_clock(
    table: Table, contents: Contents, given: int | None = None, others: Collection[int] = ()
) -> Clock | None:
    """Return the clock of a log; None without a column that is or seems to be its time."""
    if given is not None:
        return _clock(table, contents, contents.columns[given], "") if given in contents.values else None
    named = [number for number in time_candidates(table.names) if number in contents.values and number not in others]
    fitting = [number for number in named if contents.values[number].size == contents.usual_length] or named
    if fitting:
        guess = f"{listed([table.names[number] for number in fitting])} could be it" if len(fitting) > 1 else ""
        return _clock(table, contents, contents.columns[fitting[0]], guess)
    free = [column for column in contents.columns if column.number not in others]
    rising = next((column for column in free if _seems_time(column, contents)), None)
    guess = "no column is called t, time or timestamp, and this one rises in equal steps"
    return None if rising is None else _clock(table, contents, rising, guess)


def _seems_time(column: Column, contents: Contents) -> bool:
    """Return whether a column without a telling name rises in nearly equal steps."""
    if column.kind not in (Kind.WHOLE, Kind.REAL) or column.missing or column.rows < FEWEST:
        return False
    steps = np.diff(contents.values[column.number])
    usual = float(np.median(steps))
    return usual > 0.0 and float((np.abs(steps - usual) <= STEADY * usual).mean()) >= MOSTLY


def _clock(table: Table, contents: Contents, column: Column, guess: str) -> Clock:
    stamps = contents.values[column.number]
    unit = StampUnit(1.0) if column.number in table.in_seconds else unit_of_stamps(column.name, stamps)
    with np.errstate(invalid="ignore", over="ignore"):
        steps = np.diff(stamps)
    rising = steps[steps > 0.0]
    usual = float(np.median(rising)) if rising.size else np.nan
    regular = rising[rising <= GAP * usual]
    if regular.size and regular.std() > STEADY * usual:
        regular = rising[rising <= LOST * usual]
    known = stamps[np.isfinite(stamps)]
    return Clock(
        column=column,
        guess=guess,
        unit=unit.seconds,
        doubt=unit.doubt,
        dt=float(f"{usual * unit.seconds:.9g}"),
        jitter=float(regular.std()) * unit.seconds if regular.size else np.nan,
        gaps=int(rising.size - regular.size),
        longest=float(rising.max()) * unit.seconds if rising.size else np.nan,
        backward=int(steps.size - rising.size),
        duration=float(known.max() - known.min()) * unit.seconds if known.size else np.nan,
        problem=unit.doubt if unit.refused else _refusal(table, column.name, stamps),
    )


def _refusal(table: Table, name: str, stamps: FloatArray) -> str:
    """Return why these stamps give no sampling time; empty if they give one."""
    if stamps.size < 2:
        return "fewer than two stamps"
    judged = SamplingTime(table.path, name, table.describe_row)
    try:
        judged.add(stamps)
        judged.clock(lambda: iter([stamps]))
    except LogError as problem:
        return str(problem).removeprefix(f"{table.path}: ")
    return ""
