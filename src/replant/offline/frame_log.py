"""A log from a table of pandas or polars: columns by their names, the clock from a column or the index."""

from __future__ import annotations

from typing import Any

import numpy as np

from replant.arguments import FloatArray
from replant.errors import ArgumentTypeError, InvalidArgumentError, shown
from replant.log import Log

CLOCKS = ("t", "time", "timestamp")


def is_frame(value: Any) -> bool:
    """Return whether a value is a table with named columns.

    Examples
    --------
    >>> is_frame(np.zeros(3)), is_frame({"u": [1.0]})
    (False, False)
    """
    return hasattr(value, "columns") and hasattr(value, "__getitem__") and not isinstance(value, np.ndarray)


def log_of_frame(frame: Any, input: Any, output: Any, time: Any, dt: float | None, reference: Any) -> Log:  # noqa: A002
    """Return the log of a table's columns, and the other columns of numbers beside them.

    The clock is ``dt``, or the column ``time``, or that called t, time or timestamp, or an index of dates or rising
    numbers with a name.

    >>> import pandas
    >>> frame = pandas.DataFrame({"t": [0.0, 0.1, 0.2], "u": [0, 1, 1], "y": [0.0, 0.0, 0.5], "pump": [1, 1, 2]})
    >>> log = log_of_frame(frame, "u", "y", None, None, None)
    >>> log.dt, log.output, list(log.others)
    (0.1, array([0. , 0. , 0.5]), ['pump'])
    """
    names = [str(name) for name in frame.columns]
    if input is None or output is None:
        raise ArgumentTypeError(f"name columns of the table, input=... and output=...; there are {', '.join(names)}")
    roles = {"input": input, "output": output, "t": time, "reference": reference}
    for role, name in roles.items():
        if name is not None and (not isinstance(name, str) or name not in names):
            raise InvalidArgumentError(f"{role} must name a column, got {shown(name)}; there are {', '.join(names)}")
    signals = {role: _numbers(frame, name) for role, name in roles.items() if name is not None}
    found = [name for name in names if name.lower() in CLOCKS and name not in roles.values()]
    if time is None and len(found) == 1:
        signals["t"] = _numbers(frame, found[0])
    stamps = None if dt is not None else signals.get("t", _of_index(frame))
    if dt is None and stamps is None:
        raise InvalidArgumentError("the table has no column t, time or timestamp: give dt, or t, the name of its clock")
    if dt is None and stamps is not None:
        steps = np.diff(stamps)
        dt = float(f"{np.median(steps):.12g}") if steps.size else 1.0
    used = {*roles.values(), *found}
    others = {name: _numbers(frame, name) for name in names if name not in used and _is_numeric(frame, name)}
    assert dt is not None
    return Log(
        signals["input"], signals["output"], dt, stamps, input, output,
        reference=signals.get("reference"), reference_name=reference or "", others=others,
    )  # fmt: skip


def _of_index(frame: Any) -> FloatArray | None:
    index = getattr(frame, "index", None)
    if index is None or not (np.asarray(index).dtype.kind in "mM" or getattr(index, "name", None)):
        return None
    return _seconds(np.asarray(index))


def _numbers(frame: Any, name: str) -> FloatArray:
    return _seconds(np.asarray(frame[name]))


def _seconds(values: Any) -> FloatArray:
    """Return numbers as float64, and dates or durations as s since the first."""
    if values.dtype.kind in "mM":
        return np.asarray((values - values[0]) / np.timedelta64(1, "s"), np.float64)
    return np.asarray(values, np.float64)


def _is_numeric(frame: Any, name: str) -> bool:
    return np.asarray(frame[name]).dtype.kind in "iufb"
