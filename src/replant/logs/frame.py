"""Tables in memory, as pandas and polars have them, read as a file of the same columns is."""

from __future__ import annotations

import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError, shown
from replant.logs.log import Log
from replant.logs.read import open_recording
from replant.logs.sampling_time import time_columns
from replant.logs.table import Table
from replant.numerics.arguments import FloatArray

NAME = Path("the table")  # in messages


def is_frame(value: Any) -> bool:
    """Return whether a value is a table with named columns."""
    return hasattr(value, "columns") and hasattr(value, "__getitem__") and not isinstance(value, np.ndarray)


def log_of_frame(frame: Any, input: Any, output: Any, time: Any, dt: float | None, reference: Any) -> Log:  # noqa: A002
    """Return the log of a table's columns; its clock is ``dt``, ``time``, a column that may be it, or the index."""
    names = [str(name) for name in frame.columns]
    if input is None or output is None:
        raise ArgumentTypeError(f"name columns of the table, input=... and output=...; there are {', '.join(names)}")
    asked: list[str] = []
    for role, given in {"input": input, "output": output, "t": time, "reference": reference}.items():
        for name in given if isinstance(given, list | tuple) and given else [given]:
            if name is not None and (not isinstance(name, str) or name not in names):
                where = f"there are {', '.join(names)}"
                raise InvalidArgumentError(f"{role} must name a column, got {shown(name)}; {where}")
            asked += [name] if name is not None else []
    if len(set(asked)) < len(asked):
        raise InvalidArgumentError(f"name each column once, got {', '.join(map(shown, asked))}")
    values = [np.asarray(frame[name]) for name in frame.columns]
    table = _table(names, values)
    clocks = time_columns(table)
    if time is None and dt is None and len(clocks) != 1:
        index = getattr(frame, "index", None)
        if index is None or not _is_clock(index):
            raise InvalidArgumentError(
                "the table has no column t, time or timestamp: give dt, or t, the name of its clock"
            )
        values.append(np.asarray(index))
        table, time = _table([*names, str(index.name or "index")], values), len(names)
    recording = open_recording(
        table, input=input, output=output, time=time, dt=dt, reference=reference, most_held=sys.maxsize
    )
    for note in recording.table.notes:
        warnings.warn(note, stacklevel=2)
    log = recording.held
    assert log is not None
    used = {*log.input_names, log.output_name, *log.reference_names, time, *(names[number] for number in clocks)}
    others = {
        name: table.column(number)
        for number, name in enumerate(names)
        if name not in used and values[number].dtype.kind in "iufb" and len(values[number]) == len(log)
    }
    return replace(log, path=Path(), others={**others, **log.others})


def _table(names: list[str], values: list[Any]) -> Table:
    def numbers(which: int) -> FloatArray:
        try:
            return _seconds(values[which])
        except (TypeError, ValueError):
            name = shown(names[which])
            raise ArgumentTypeError(f"column {name} of the table holds no numbers or times; convert it") from None

    dated = frozenset(number for number, each in enumerate(values) if _is_dated(each))
    return Table(NAME, tuple(names), lambda keys: iter([[numbers(key) for key in keys]]), in_seconds=dated)


def _is_clock(index: Any) -> bool:
    """Return whether an index is the time: whole numbers may count the rows, whatever they are called but a clock."""
    values, name = np.asarray(index), str(index.name or "")
    return _is_dated(values) or bool(time_columns(_table([name], [values]))) or bool(name and values.dtype.kind == "f")


def _is_dated(values: Any) -> bool:
    """Return whether values are times; those with a zone are objects to NumPy."""
    return values.dtype.kind in "mM" or (
        values.dtype.kind == "O" and len(values) > 0 and all(hasattr(each, "timestamp") for each in values)
    )


def _seconds(values: Any) -> FloatArray:
    """Return numbers, and times as seconds since the first one."""
    if _is_dated(values):
        if values.dtype.kind == "O":  # pandas has them exactly
            since = [each.value if hasattr(each, "value") else round(1e9 * each.timestamp()) for each in values]
            values = np.array(since, "datetime64[ns]")
        return np.asarray((values - values[:1]) / np.timedelta64(1, "s"), np.float64)
    return np.asarray(values, np.float64)
