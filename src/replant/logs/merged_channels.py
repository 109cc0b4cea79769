"""Tables of channels with their own time stamps, and their exact merge.

Nothing is resampled.  The input holds its newest value, u(t) = u_k for t_k <= t < t_(k+1), as an actuator does; the
reference likewise.  The output is known only at its own stamps.

If the input changes only at stamps of the output, the rows are the stamps of the output, and nothing is lost.
Otherwise a change between two outputs would appear up to one interval late, as dead time.  The rows then are the stamps
of output and input together, and the output is NaN at the stamps without a measurement.  Nested rasters, such as 10 ms
and 100 ms, give the finer one, with a regular clock.  During a pause of the output, the rows are the stamps of the
input: a gap there would mean that the input is unknown.

A table may hold channels of this kind, too: one row for each value of each signal, or an input that is written only
when it changes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from replant.errors import LogError, shown
from replant.logs.columns import LOST
from replant.logs.sampling_time import checked_unit
from replant.logs.table import Table, listed
from replant.numerics.arguments import FloatArray
from replant.numerics.robust import last_known

ROUNDING = 4.0  # largest difference of equal stamps, as 3 * 0.1 and 0.3 [spacings of float64 at the latest stamp]


@dataclass(frozen=True, eq=False)
class Signal:
    """A signal with its own time stamps."""

    t: FloatArray
    values: FloatArray


@dataclass(frozen=True, eq=False)
class Merged:
    """Signals at common stamps."""

    t: FloatArray
    output: FloatArray
    held: tuple[FloatArray, ...]


def merge(output: Signal, held: Sequence[Signal]) -> Merged:
    """Merge an output with inputs and references over the time in which all are known; each has at least one sample."""
    for signal in (output, *held):
        if not np.all(np.isfinite(signal.t)) or np.any(np.diff(signal.t) < 0.0):
            raise ValueError("the time stamps of a signal must be finite and never decrease")
    tolerance = ROUNDING * float(np.spacing(max(np.abs(signal.t).max() for signal in (output, *held))))
    held = [Signal(_snapped(signal.t, output.t, tolerance), signal.values) for signal in held]
    inside = np.ones(output.t.size, np.bool_)
    for signal in held:
        # the last value is held for at most the longest interval, as the logger may have lost the signal then; a signal
        # with a single value is held for ever
        until = float(signal.t[-1] + np.diff(signal.t).max()) if signal.t.size > 1 else np.inf
        inside &= (output.t >= signal.t[0]) & (output.t < until - tolerance)
    t, y = output.t[inside], output.values[inside]
    for signal in held:
        added = signal.t[(signal.t > t[0]) & (signal.t < t[-1])] if t.size else signal.t[:0]
        now, before = signal.values[1:], signal.values[:-1]
        changes = signal.t[1:][~((now == before) | (np.isnan(now) & np.isnan(before)))]
        if np.isin(changes, output.t).all():
            added = added[_in_a_pause(added, t)]
        added = np.setdiff1d(added, t)
        t, y = np.concatenate([t, added]), np.concatenate([y, np.full(added.size, np.nan)])
        order = np.argsort(t, kind="stable")
        t, y = t[order], y[order]
    newest = [np.searchsorted(signal.t, t, side="right") - 1 for signal in held]
    return Merged(t, y, tuple(signal.values[at] for signal, at in zip(held, newest, strict=True)))


def _snapped(t: FloatArray, grid: FloatArray, tolerance: float) -> FloatArray:
    """Return stamps; one that equals a stamp of the grid apart from rounding is replaced by it."""
    right = np.clip(np.searchsorted(grid, t), 0, grid.size - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(np.abs(grid[left] - t) < np.abs(grid[right] - t), grid[left], grid[right])
    return np.where(np.abs(nearest - t) <= tolerance, nearest, t)


def _in_a_pause(t: FloatArray, output: FloatArray) -> NDArray[np.bool_]:
    """Return which stamps lie in a pause of the output, whose stamps are ``output`` (K,)."""
    steps = np.diff(output)
    if not steps.size:
        return np.zeros(t.size, np.bool_)
    return np.asarray(steps[np.searchsorted(output, t) - 1] > LOST * np.median(steps))


_KEPT = 4  # channels of a table held in memory [count]
TIME = "time"  # name of the column of merged stamps


def channel_table(path: Path, channels: Sequence[tuple[str, Callable[[], Signal]]]) -> Table:
    """Make a table of channels; each is a name and a function that reads the channel on request."""
    if not channels:
        raise LogError(f"{path}: no channel of numbers with time stamps in the file; choose another file")

    @lru_cache(maxsize=_KEPT)  # values and stamps are requested separately
    def signal(number: int) -> Signal:
        _, read = channels[number]
        return read()

    return Table(
        path,
        tuple(name for name, _ in channels),
        lambda numbers: iter([[signal(number).values for number in numbers]]),
        stamps=lambda number: signal(number).t,
    )


def on_one_clock(table: Table, roles: dict[str, int], *, is_timed: bool) -> tuple[Table, dict[str, int]]:
    """Return a table on one clock: columns with their own stamps are merged, or must have equal ones if timed."""
    if table.stamps is None:
        return table, roles
    if not is_timed:
        return merged(table, roles), {**{role: number for number, role in enumerate(roles, 1)}, "time": 0}
    first, *others = (table.stamps(number) for number in roles.values())
    if not all(np.array_equal(first, other) for other in others):
        names = listed([shown(table.names[number]) for number in roles.values()])
        raise LogError(
            f"{table.path}: columns {names} have different time stamps; leave out the time (time, --time) and the "
            "sampling time (dt, --dt) to merge them"
        )
    return table, roles


def written_apart(table: Table, roles: Mapping[str, int], dt: float | None) -> tuple[Table, dict[str, int]] | None:
    """Return the merged table if inputs and output are mostly written in separate rows, else None.

    Without a time column the rows are ``dt`` apart, in s.
    """
    numbers = list(roles.values())
    if table.stamps is not None or not _some_apart(roles, table.head(numbers, 1)):
        return None
    read = table.columns(numbers)
    empty = _some_apart(roles, read)
    if not empty:
        return None
    columns = dict(zip(numbers, read, strict=True))
    if "time" in roles:
        stamps = columns[roles["time"]]
        t = stamps * checked_unit(table, roles["time"], stamps).seconds
    else:
        assert dt is not None
        t = np.asarray(dt * np.arange(columns[roles["output"]].size), np.float64)
    notes = [
        f"{table.path}: column {shown(table.names[number])} is empty in {rows:,} of {t.size:,} rows; each value is "
        "held until the next"
        for number, rows in empty.items()
    ]
    columns |= {number: last_known(columns[number]) for number in empty}
    apart = replace(
        table,
        blocks=lambda keys: iter([[columns[key][np.isfinite(columns[key])] for key in keys]]),
        stamps=lambda key: t[np.isfinite(columns[key])],
        notes=(*table.notes, *notes),
    )
    return on_one_clock(apart, {role: number for role, number in roles.items() if role != "time"}, is_timed=False)


def _some_apart(roles: Mapping[str, int], columns: Sequence[FloatArray]) -> dict[int, int]:
    """Return the inputs and references written in rows without an output, with the number of their empty rows."""
    each = dict(zip(roles, columns, strict=True))
    y, found = np.isfinite(each["output"]), {}
    for role, column in each.items():
        known = np.isfinite(column)
        if role in ("time", "output") or known.size != y.size:
            continue
        if _stand_alone(known) and 2 * np.count_nonzero(y & ~known) >= max(y.sum(), 1):
            found[roles[role]] = int(np.count_nonzero(~known))
    return found


def _stand_alone(known: NDArray[np.bool_]) -> bool:
    """Return whether most values (K,) follow an empty row; a sensor with dropouts gives runs of values instead."""
    return bool(2 * np.count_nonzero(known & ~np.append(False, known[:-1])) > np.count_nonzero(known))


def held_where_empty(values: FloatArray) -> FloatArray:
    """Return a column for inspection: if at most half of its rows hold a number, each is held until the next."""
    known = np.isfinite(values)
    return last_known(values) if 0 < 2 * np.count_nonzero(known) <= known.size and _stand_alone(known) else values


def merged(table: Table, roles: Mapping[str, int]) -> Table:
    """Return a table of the time and the columns of ``roles`` at common stamps; see `merge`."""
    assert table.stamps is not None
    columns = table.columns(list(roles.values()))
    signals = {}
    for (role, number), values in zip(roles.items(), columns, strict=True):
        signals[role] = Signal(_checked(table, number, table.stamps(number)), values)
    held = [role for role in roles if role != "output"]
    found = merge(signals["output"], [signals[role] for role in held])
    if found.t.size == 0:
        names = " and ".join(shown(table.names[roles[role]]) for role in roles)
        raise LogError(f"{table.path}: columns {names} have no time in common; choose others")
    arrays = {"output": found.output, **dict(zip(held, found.held, strict=True))}
    ordered = [found.t, *(arrays[role] for role in roles)]
    return Table(
        table.path,
        (TIME, *(table.names[number] for number in roles.values())),
        lambda numbers: iter([[ordered[number] for number in numbers]]),
        lambda row: f"row {row + 1} of the merged signals",
        in_seconds=frozenset({0}),
        approximate_rows=found.t.size,
        notes=table.notes,
    )


def side_by_side(table: Table) -> Table:
    """Return a table for inspection: every channel at the stamps of the channel with the most samples."""
    if table.stamps is None:
        return table
    stamps, problems = {}, []
    for number in range(len(table.names)):
        try:
            stamps[number] = table.stamps(number)
        except LogError as problem:
            problems.append(problem)
    if not stamps:
        raise problems[0]
    time, stamps_of = max(stamps.values(), key=len), table.stamps

    def column(number: int) -> FloatArray:
        if number == len(table.names):
            return time - time[:1]
        values, t = table.column(number), stamps_of(number)
        newest = np.searchsorted(np.maximum.accumulate(t), time, "right") - 1
        return np.where(newest < 0, np.nan, values[newest]) if t.size else np.full(time.size, np.nan)

    return replace(
        table,
        names=(*table.names, TIME),
        blocks=lambda numbers: iter([[column(number) for number in numbers]]),
        stamps=None,
        in_seconds=frozenset({len(table.names)}),
    )


def _checked(table: Table, number: int, t: FloatArray) -> FloatArray:
    place = f"{table.path}: column {shown(table.names[number])}"
    if t.size == 0:
        raise LogError(f"{place} has no sample; choose another column")
    if not np.isfinite(t).all():
        raise LogError(f"{place}, sample {int(np.argmin(np.isfinite(t))) + 1}: the time stamp is not finite; repair it")
    back = np.diff(t) < 0.0
    if back.any():
        at = int(np.argmax(back)) + 1
        raise LogError(
            f"{place}, sample {at + 1}: the time stamp {t[at]:.9g} goes back from the one before ({t[at - 1]:.9g}); "
            "repair it, or give the sampling time (dt, --dt)"
        )
    return t
