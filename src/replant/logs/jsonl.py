"""JSON lines (.jsonl, .ndjson): one object per line; keys are columns, those of an inner object ``rig.speed``."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import LogError, shown
from replant.logs.csv import last_lines
from replant.logs.table import MOST_COLUMNS, Arrays, Table, too_many_error
from replant.logs.text_cells import CellError, as_float, quote
from replant.logs.text_layout import MOST_LINES_ABOVE, lines_of
from replant.logs.text_times import StampFormat, find_format, with_stamps
from replant.numerics.arguments import FloatArray

BLOCK_ROWS = 1 << 14  # rows read at a time [rows]
BLOCK_VALUES = 1 << 18  # most values in a block; a block of many columns has fewer rows [count]
DEEPEST = 32  # deepest nesting of objects that is read [count]
_SAMPLE_ROWS = 1000  # first rows, whose keys are the columns [rows]
_ENCODING = "utf-8-sig"

_Row = tuple[int, dict[str, Any]]
_Keys = tuple[str, ...]


@dataclass(frozen=True)
class _Layout:
    """The columns of a file: the keys of each, outermost first, and the columns that are dates or clock times."""

    path: Path
    keys: tuple[_Keys, ...]
    names: tuple[str, ...]
    stamps: Mapping[int, StampFormat]
    is_cut: bool


def read(path: Path) -> Table:
    """Open JSON lines; columns: keys of the first 1000 objects; cells: numbers, true, false, null (missing), times."""
    cut = _cut_line(path)
    given: dict[_Keys, list[Any]] = {}  # the values of each column in the first rows
    found, named_by = 0, ""
    for count, (_, row) in enumerate(_rows(path, is_cut=bool(cut)), 1):
        for keys, value in _items_of(row):
            found += 1
            given.setdefault(keys, []).append(value)
            if len(given) > MOST_COLUMNS:
                raise too_many_error(path, "columns")
        if count == _SAMPLE_ROWS or found > BLOCK_VALUES:  # wide rows: fewer suffice
            named_by = f" in its first {count:,} objects, which name the columns: give it there, null if it is missing"
            break
    if not given:
        raise LogError(f"{path}: no object with a key; a log has one object for each sample, each on its own line")
    stamps = {}
    for number, (keys, values) in enumerate(given.items()):
        known = [str(value) for value in values if value is not None]
        if (form := find_format(known, keys[-1])) is not None:
            stamps[number] = form
    layout = _Layout(path, tuple(given), tuple(map(".".join, given)), stamps, bool(cut))
    notes = (f"{path}: the last line is cut off ({quote(cut)}) and left out",) if cut else ()
    table = Table(
        path, layout.names, partial(_blocks, layout), partial(_line_of_row, layout), notes=notes, named_by=named_by
    )
    return with_stamps(table, stamps)


def _cut_line(path: Path) -> str:
    _, line = last_lines(path, _ENCODING)
    try:
        json.loads(line or "0")
    except (ValueError, RecursionError):
        return line.strip()
    return ""


def _rows(path: Path, *, is_cut: bool) -> Iterator[_Row]:
    """Yield the objects with the numbers of their lines."""
    last = 0
    for number, line in lines_of(path, _ENCODING):
        if last == 0 and number > MOST_LINES_ABOVE:
            raise LogError(f"{path}: no object in its first {MOST_LINES_ABOVE:,} lines; remove what is above")
        if not line.strip() or (is_cut and not line.endswith("\n")):
            continue
        try:
            row = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise LogError(f"{path}: line {number} is not JSON ({error}); correct or delete it") from None
        if not isinstance(row, dict):
            raise LogError(f'{path}: line {number} is not a JSON object, such as {{"t": 0.1, "u": 1.5}}; correct it')
        last = number
        yield number, row


def _items_of(row: Mapping[str, Any], above: _Keys = ()) -> Iterator[tuple[_Keys, Any]]:
    for key, value in row.items():
        if isinstance(value, dict):
            if len(above) < DEEPEST:
                yield from _items_of(value, (*above, key))
        elif not isinstance(value, list):
            yield (*above, key), value


def _value(row: Mapping[str, Any], keys: Sequence[str]) -> Any:
    found: Any = row
    for key in keys:
        found = found.get(key) if isinstance(found, dict) else None
    return found


def _blocks(layout: _Layout, numbers: Sequence[int]) -> Iterator[Arrays]:
    rows = _rows(layout.path, is_cut=layout.is_cut)
    most = max(1, min(BLOCK_ROWS, BLOCK_VALUES // len(layout.keys)))
    for block in iter(lambda: list(islice(rows, most)), []):
        yield [_column(layout, number, block) for number in numbers]


def _column(layout: _Layout, number: int, block: Sequence[_Row]) -> FloatArray:
    values = [_value(row, layout.keys[number]) for _, row in block]
    form = layout.stamps.get(number)
    try:
        if form is None:
            return np.array([_number(at, value) for at, value in enumerate(values)])
        return form.seconds(["" if value is None else str(value) for value in values])
    except CellError as error:
        line, name = block[error.at][0], layout.names[number]
        raise LogError(f"{layout.path}: line {line}, column {shown(name)}: {error}") from None


def _number(at: int, value: Any) -> float:
    if value is None:
        return math.nan
    if isinstance(value, int | float):
        return as_float(value)
    raise CellError(at, f"{quote(json.dumps(value))} is not a number; write numbers, or null")


def _line_of_row(layout: _Layout, row: int) -> str:
    number, _ = next(islice(_rows(layout.path, is_cut=layout.is_cut), row, None))
    return f"line {number}"
