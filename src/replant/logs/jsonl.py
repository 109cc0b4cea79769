"""JSON lines (.jsonl, .ndjson): one object per line; keys are columns, those of an inner object ``rig.speed``."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
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
    forms = [
        find_format([str(value) for value in values if value is not None], keys[-1]) for keys, values in given.items()
    ]
    stamps = {number: form for number, form in enumerate(forms) if form is not None}
    names, most = tuple(map(".".join, given)), max(1, min(BLOCK_ROWS, BLOCK_VALUES // len(given)))
    columns = [partial(_column, path, keys, form) for keys, form in zip(given, forms, strict=True)]
    notes = (f"{path}: the last line is cut off ({quote(cut)}) and left out",) if cut else ()

    def blocks(numbers: Sequence[int]) -> Iterator[Arrays]:
        rows = _rows(path, is_cut=bool(cut))
        for block in iter(lambda: list(islice(rows, most)), []):
            yield [columns[number](block) for number in numbers]

    def line_of_row(row: int) -> str:
        return f"line {next(islice(_rows(path, is_cut=bool(cut)), row, None))[0]}"

    return with_stamps(Table(path, names, blocks, line_of_row, notes=notes, named_by=named_by), stamps)


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


def _column(path: Path, keys: _Keys, form: StampFormat | None, block: Sequence[_Row]) -> FloatArray:
    values = [_value(row, keys) for _, row in block]
    try:
        if form is None:
            return np.array([_number(at, value) for at, value in enumerate(values)])
        return form.seconds(["" if value is None else str(value) for value in values])
    except CellError as error:
        name = shown(".".join(keys))
        raise LogError(f"{path}: line {block[error.at][0]}, column {name}: {error}") from None


def _number(at: int, value: Any) -> float:
    if value is None:
        return math.nan
    if isinstance(value, int | float):
        return as_float(value)
    raise CellError(at, f"{quote(json.dumps(value))} is not a number; write numbers, or null")
