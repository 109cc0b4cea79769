"""Read a log: select input, output, reference and time among the columns of a file of any format."""

from __future__ import annotations

import inspect
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError, LogError, ReplantError, shown
from replant.logs.arrays import Frame
from replant.logs.columns import GIVE_TIME, contradicted, time_advice
from replant.logs.file_formats import read_columns
from replant.logs.log import Log
from replant.logs.merged_channels import on_one_clock, written_apart
from replant.logs.recording import MOST_HELD, Recording, digest, part_of
from replant.logs.sampling_time import (
    StampUnit,
    check_dt,
    checked_unit,
    interval_of,
    time_columns,
)
from replant.logs.table import Arrays, Table, in_parts, listed, repeated_rows
from replant.numerics.arguments import is_frame, iterable
from replant.numerics.limits import file_path

_ROLES = {"input": "an input", "output": "the output", "reference": "a reference"}
_NAMED = re.compile(r"\((\w+(?:, \w+)*)(?:, --\w+)+\)")  # arguments with their options, as above


@contextmanager
def in_python(clock: str = "time") -> Iterator[None]:
    """Remove the command line's options from errors; the argument ``time`` is named ``clock``."""
    try:
        yield
    except ReplantError as error:
        called = _NAMED.sub(lambda found: f"({found[1].replace(',', '=...,')}=...)", str(error))
        error.args = (called.replace("(time=...)", f"({clock}=...)"),)
        raise


def read_log(
    path: str | os.PathLike[str] | Any,
    *,
    input: str | int | Sequence[str | int] | None = None,  # noqa: A002 - the field's word
    output: str | int | None = None,
    time: str | int | None = None,
    dt: float | None = None,
    reference: str | int | Sequence[str | int] | None = None,
    begin: float | None = None,
    end: float | None = None,
) -> Log:
    """Read the inputs, the output and optional references of a plant from a recorded log.

    Without `time` and `dt`, the sampling time comes from a column called t, time or timestamp (in any case, also with a
    unit as in ``time [s]``; T only if it increases and is the only one), else from the only column of dates, clock
    times, or whole seconds beside their nanoseconds (``stamp.sec``, ``stamp.nanosec``), else from a number called Ts in
    a .mat, .npz or HDF5 file.  A warning reports parts that are left out, such as a last line that was cut off.

    Parameters
    ----------
    path : path or table
        A file of text, .jsonl, .parquet, .feather, .xlsx, .h5, .mat, .npz, .tdms, .mf4, .ulg, .mcap, perhaps compressed
        (.gz, .zip, .zst); a folder of Parquet files, which are the parts of one log in the order of their names; the
        folder of a ROS 2 bag; ``-``, standard input; or a table of pandas, polars or pyarrow, whose index may be the
        time.
    input, output : str or int
        The columns, by name (a unit at its end may be omitted) or 0-based number; a list for several inputs.  In .mat
        and .npz files also ``udat[:,0]`` and ``logs.udat[:,0]``.  Columns with their own time stamps are merged.
    time : str or int, optional
        The column of time stamps: dates, clock times, or numbers in seconds or in the unit that its name states
        (``t [ms]``).  They must increase.  The stamps of an irregular clock are used, see `Log.stamps`.
    dt : float, optional
        The sampling time in seconds, instead of `time`.
    reference : str or int, optional
        The column of the reference: a controller's set-point or a dither, applied from outside; with several inputs,
        perhaps a list.
    begin, end : float, optional
        Read only the rows from `begin` to before `end`, in s from the first row of the log.

    Returns
    -------
    Log
        The samples as float64; a missing one is NaN.

    Raises
    ------
    LogError
        If the file or a column cannot be read, or a time stamp repeats or goes back: one line with place and remedy.
    InvalidArgumentError
        If `time` and `dt` are both given, `dt` is not finite and positive, or the time range is empty.
    MissingDependencyError
        If the package that reads the format is not installed.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "log.npz")
    ...     np.savez(file, t=[0.0, 0.1, 0.2], u=[1.0, 1.0, 1.0], y=[0.0, 0.5, 0.75])
    ...     log = read_log(file, input="u", output="y")
    >>> log.dt, log.output
    (0.1, array([0.  , 0.5 , 0.75]))
    """
    columns: dict[str, Any] = {"input": input, "output": output, "time": time, "reference": reference, "dt": dt}
    columns |= {"begin": begin, "end": end}
    with in_python():
        if is_frame(path):
            return log_of_frame(path, **columns)
        path = file_path("path", path)
        if input is None or output is None:
            there = f"there are {listed(read_columns(path).names)}"
            raise ArgumentTypeError(f"name columns of the log, input=... and output=...; {there}")
        log = _held(open_recording(path, **columns, most_held=sys.maxsize))
    return replace(log, sha256=digest(log.path))


def log_of_frame(
    frame: Any, *, dt: float | None, begin: float | None = None, end: float | None = None, **keys: Any
) -> Log:
    """Return the log of a table in memory, with its other columns of numbers; see `read_log`."""
    given = Frame(frame)
    if keys["input"] is None or keys["output"] is None:
        there = f"there are {listed(given.names)}"
        raise ArgumentTypeError(f"name columns of the table, input=... and output=...; {there}")
    columns = {role: given.find("the time (time, --time)" if role == "time" else role, keys[role]) for role in keys}
    each = [number for found in columns.values() for number in (found if isinstance(found, list) else [found])]
    if keys["time"] is None and dt is None:
        columns["time"] = given.clock
    table = given.table
    if keys["time"] is None and (contradiction := contradicted(table, dt)):
        table = replace(table, notes=(*table.notes, contradiction.replace("--dt", "dt")))
    log = _held(open_recording(table, **columns, dt=dt, begin=begin, end=end, most_held=sys.maxsize))
    beside = given.beside({*each, *time_columns(given.table), *given.table.parts}, len(log))
    hold = getattr(frame, "attrs", {}).get("input_hold", log.input_hold)  # of `Log.to_pandas`
    return replace(log, path=Path(), others={**beside, **log.others}, input_hold=hold)


def _held(recording: Recording) -> Log:
    """Return the log of a recording in memory; its notes become warnings at the line that called the package."""
    ours, level, depth, place = str(Path(__file__).parents[1]), 1, 1, inspect.currentframe()
    while recording.table.notes and place is not None:
        level = depth + 1 if place.f_code.co_filename.startswith(ours) else level
        depth, place = depth + 1, place.f_back
    for note in recording.table.notes:
        warnings.warn(note, stacklevel=level)
    assert recording.held is not None
    return recording.held


def open_recording(
    path: str | os.PathLike[str] | Table,
    *,
    input: str | int | Sequence[str | int],  # noqa: A002 - the field's word
    output: str | int,
    time: str | int | None = None,
    dt: float | None = None,
    reference: str | int | Sequence[str | int] | None = None,
    begin: float | None = None,
    end: float | None = None,
    most_held: int = MOST_HELD,
    progress: Callable[[int, int], None] = lambda rows, about: None,
) -> Recording:
    """Check all rows of a recorded log, and open it; a log with several inputs or references is held in memory."""
    if time is not None and dt is not None:
        raise InvalidArgumentError("give either the time column (time, --time) or the sampling time (dt, --dt)")
    step = None if dt is None else check_dt(dt)
    keys = columns_by_role(input, output, reference)
    table, roles, step = _on_its_clock(path if isinstance(path, Table) else read_columns(path), keys, time, step)
    if begin is not None or end is not None:
        table = part_of(table, begin, end, dt=step, time=roles.get("time"))
    table, arrays = _checked_columns(table, roles, most_held, progress)
    irregularity, unit, doubt = "", StampUnit(1.0), ""
    if "time" in roles:
        stamps = arrays[-1]
        unit = checked_unit(table, roles["time"], stamps)
        interval, irregularity = interval_of(table, roles["time"], stamps)
        doubt = f"column {table.names[roles['time']]!r}: {unit.doubt}; {unit.remedy}" if unit.doubt else ""
        step = float(f"{interval * unit.seconds:.12g}")
    assert step is not None
    columns = tuple(roles[role] for role in keys if role in _ROLES)
    further = {role: table.names[roles[role]] for role in keys if role not in _ROLES}
    others = dict(zip(further.values(), arrays[len(columns) : len(keys)], strict=True))
    arrays, rows = [*arrays[: len(columns)], *arrays[len(keys) :]], arrays[0].size
    complete = all(np.isfinite(part).all() for parts in in_parts(arrays[: len(columns)]) for part in parts)
    recording = Recording(
        table, columns, arrays, step, roles.get("time"), rows, complete, None, begin, end, irregularity, unit.seconds,
        doubt,
    )  # fmt: skip
    if rows > most_held and not others:
        return recording
    log = replace(
        recording.newest(*arrays[:2]),
        others=others,
        more_inputs=tuple(name for role, name in further.items() if role.startswith("input")),
        more_references=tuple(name for role, name in further.items() if role.startswith("reference")),
    )
    return replace(recording, held=log)


def _on_its_clock(
    table: Table, keys: dict[str, Any], time: str | int | None, step: float | None
) -> tuple[Table, dict[str, int], float | None]:
    """Return the table of columns on one clock, their numbers by role, and the sampling time if it is no column."""
    roles = {role: table.find(key) for role, key in keys.items()}
    if time is not None:
        roles["time"] = table.find(time)
    _check_distinct(table, roles)
    table, roles = on_one_clock(table, roles, is_timed=time is not None or step is not None)
    if "time" not in roles and step is None:
        if table.dt is not None and not time_columns(table):
            step = table.dt
        else:
            roles["time"] = _find_time(table, roles)
    merged = written_apart(table, roles, step)
    return (table, roles, step) if merged is None else (*merged, None)


def _checked_columns(
    table: Table, roles: dict[str, int], most_held: int, progress: Callable[[int, int], None]
) -> tuple[Table, Arrays]:
    """Read columns of one length, without rows that repeat the previous one; each signal must have a number."""
    arrays = table.columns(list(roles.values()), most_held, progress)
    (first, *_), rows = roles.values(), arrays[0].size
    for number, column in zip(roles.values(), arrays, strict=True):
        if column.size != rows:
            other = f"{shown(table.names[number])} has {column.size}"
            raise table.error(first, f" has {rows} samples but {other}; choose columns of one length")
    if rows < 2:
        counted = "1 row" if rows == 1 else f"{rows} rows"
        raise LogError(f"{table.path}: {counted} of data, at least 2 are needed; record more samples")
    if "time" in roles and (repeated := repeated_rows(arrays[-1], arrays[:-1])).size:
        table, arrays = with_repeats_noted(table, repeated.size), [np.delete(each, repeated) for each in arrays]
    for (role, number), column in zip(roles.items(), arrays, strict=True):
        if role != "time" and not any(np.isfinite(part).any() for (part,) in in_parts([column])):
            raise table.error(
                number,
                f" has no number in {column.size:,} rows; choose another column as the {role.split()[0]}, or record "
                "the log again",
            )
    return table, arrays


def columns_by_role(inputs: Any, output: str | int, references: Any) -> dict[str, Any]:
    """Return the column of each role; further inputs and references, "input 2" and so on, come last."""
    keys: dict[str, Any] = {"input": None, "output": output}
    further: dict[str, Any] = {}
    for role, given in (("input", inputs), ("reference", references)):
        if given is None and role == "reference":
            continue
        several = [given] if isinstance(given, str | int) or not iterable(given) else list(given)
        if not several:
            raise InvalidArgumentError(f"{role} must name a column, got an empty list")
        keys[role] = several[0]
        further |= {f"{role} {place}": key for place, key in enumerate(several[1:], 2)}
    return keys | further


def with_repeats_noted(table: Table, count: int) -> Table:
    """Return a table with a note on the rows that repeat the previous one."""
    what = "a row repeats" if count == 1 else f"{count:,} rows repeat"
    note = f"{table.path}: {what} the previous one, with the same time stamp; repetitions are left out"
    return replace(table, notes=(*table.notes, note))


def _check_distinct(table: Table, roles: dict[str, int]) -> None:
    for kind in ("input", "reference"):
        places = list(dict.fromkeys(number for role, number in roles.items() if role.split()[0] == kind))
        names = [table.names[number] for number in places]
        if len(set(names)) < len(places):
            raise LogError(
                f"{table.path}: {kind}s must have different names, but columns {', '.join(map(str, places))} are "
                f"called {', '.join(map(shown, names))}: rename them"
            )
    chosen: dict[int, str] = {}
    for role, number in roles.items():
        kind, before = role.split()[0], chosen.setdefault(number, role)
        if before != role and {before, role} <= {*_ROLES, "time"}:
            name = shown(table.names[number])
            raise LogError(
                f"{table.path}: {before} and {role} are the same column {name}; choose two different columns"
            )
        if before != role:
            was, is_now = (_ROLES.get(each.split()[0], each) for each in (before, role))
            both = f"{was} twice" if was == is_now else f"{was} and {is_now}"
            raise table.error(number, f" is {both}: name each column once")
        if role != "time" and number in table.in_seconds:
            raise table.error(number, f" holds dates or times, not samples; choose another column as the {kind}")


def _find_time(table: Table, roles: dict[str, int]) -> int:
    candidates = [number for number in time_columns(table) if number not in roles.values()]
    if len(candidates) > 1:  # a file may hold several structs, each with its own time
        samples, *stamps = table.head([roles["input"], *candidates], 1)
        candidates = [number for number, column in zip(candidates, stamps, strict=True) if len(column) == len(samples)]
    if len(candidates) == 1:
        return candidates[0]
    if not candidates:
        times = time_columns(table)
        taken = next((role for role, number in roles.items() if number in times), None)
        if taken is not None:
            kind = taken.split()[0]
            remedy = f"{GIVE_TIME}, or choose another column as the {kind}"
            is_time = f" is a time by its name, and no other column is called t, time or timestamp; {remedy}"
            raise table.error(roles[taken], is_time)
        raise LogError(f"{table.path}: no column is called t, time or timestamp; {time_advice(table, roles.values())}")
    names = listed([shown(table.names[number]) for number in candidates])
    raise LogError(f"{table.path}: several columns could be the time: {names}; {GIVE_TIME}")
