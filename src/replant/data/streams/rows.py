"""Rows: the numbers of samples, parsed from text; a faulty line raises `Malformed` with the reason."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Sequence
from itertools import chain
from operator import itemgetter
from typing import Any

import numpy as np

from replant.arguments import FloatArray
from replant.data.logs.text_cells import parse_number

#: The fields of a sample: sequence number, time stamp in s, input, output, reference.
FIELDS = ("n", "t", "u", "y", "r")
#: The columns of lines with two, three and four cells, where the URL does not name them.
BY_WIDTH = {2: ("u", "y"), 3: ("t", "u", "y"), 4: ("n", "t", "u", "y")}

Row = tuple[float, ...]


class Malformed(Exception):  # noqa: N818 - not an error of the program: a reason to count
    """A line or message that holds no sample; its text is the reason."""


def from_cells(line: str) -> Row:
    """Parse one line of CSV; a missing cell is NaN, as in a log."""
    try:
        return tuple(map(parse_number, line.split(",")))
    except ValueError:
        raise Malformed("not a number") from None


def check_width(row: Row, width: int) -> None:
    """Check that a row has ``width`` cells."""
    if len(row) != width:
        raise Malformed("fields missing" if len(row) < width else "too many fields")


def table_from_cells(lines: Sequence[str], width: int) -> FloatArray | None:
    """Parse lines of CSV as a whole, in C; return None if a line has anything but ``width`` numbers."""
    try:
        table = np.loadtxt(lines, delimiter=",", comments=None, ndmin=2)
    except ValueError:
        return None
    return table if table.shape[1] == width else None


def json_value(line: str) -> Any:
    """Parse one line of JSON."""
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        raise Malformed("not JSON") from None


def json_values(lines: Sequence[str]) -> list[Any] | None:
    """Parse lines of JSON as a whole; return None if a line is anything but an object or an array."""
    try:
        values = json.loads(f"[{',null,'.join(lines)}]")  # the null between keeps two lines from forming one object
    except (ValueError, RecursionError):
        return None
    if len(values) != 2 * len(lines) - 1 or any(value is not None for value in values[1::2]):
        return None
    values = values[::2]
    return values if all(type(value) in (dict, list) for value in values) else None


def table_from_json(values: Sequence[Any], columns: Sequence[str]) -> FloatArray | None:
    """Return JSON objects of one sample each as a table (K, C); None if they are anything else."""
    try:
        rows = list(map(itemgetter(*columns), values))
        if set(map(type, chain.from_iterable(rows))) <= {float, int}:
            return np.array(rows, dtype=np.float64)
    except (LookupError, TypeError, OverflowError):
        pass
    return None


def columns_of(value: Any) -> tuple[str, ...] | None:
    """Return the columns of a JSON object, or of the first in an array; None if it holds no sample."""
    first = value[0] if isinstance(value, list) and value else value
    if not isinstance(first, dict) or not {"u", "y"} <= first.keys():
        return None
    return tuple(name for name in FIELDS if name in first)


def from_json(value: Any, columns: Sequence[str]) -> list[Row]:
    """Return the samples in a JSON object, or in an array of them.

    ``{"n": 7, "t": 0.7, "u": 1.0, "y": 0.2}`` is one sample.  An object whose fields are arrays holds several samples;
    its n may be the number of the first.  null is NaN.
    """
    rows: list[Row] = []
    for item in value if isinstance(value, list) else [value]:
        if not isinstance(item, dict):
            raise Malformed("not an object")
        if not set(columns) <= item.keys():
            raise Malformed("fields missing")
        rows += _samples(item, columns)
    return rows


def _samples(item: dict[str, Any], columns: Sequence[str]) -> list[Row]:
    fields = {name: item[name] for name in columns}
    if not isinstance(item["u"], list):
        return [tuple(_number(name, value) for name, value in fields.items())]
    count = len(item["u"])
    if type(fields.get("n")) is int:
        fields["n"] = list(range(fields["n"], fields["n"] + count))
    if any(not isinstance(values, list) or len(values) != count for values in fields.values()):
        raise Malformed("arrays of different lengths")
    return list(zip(*(_numbers(name, values) for name, values in fields.items()), strict=True))


def _numbers(name: str, values: Sequence[Any]) -> list[float]:
    if set(map(type, values)) <= {float, int}:
        with contextlib.suppress(OverflowError):
            return list(map(float, values))
    return [_number(name, value) for value in values]


def _number(name: str, value: Any) -> float:
    kind = type(value)
    if value is None and name in ("u", "y", "r"):
        return float("nan")
    if kind is float or kind is int:  # bool is neither
        with contextlib.suppress(OverflowError):
            return float(value)
    raise Malformed("not a number")
