"""JSON lines (.jsonl, .ndjson): an object a line; its keys are the columns, an inner object's as ``rig.speed``."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
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
from replant.logs.text_times import StampFormat, find_format, followed_clocks
from replant.numerics.arguments import FloatArray

BLOCK_ROWS = 1 << 14  # rows read at a time [rows]
BLOCK_VALUES = 1 << 18  # values in them, from which on there are fewer rows [count]
DEEPEST = 32  # objects within each other that are looked into [count]
_SAMPLE_ROWS = 1000  # rows whose keys are the columns [rows]
_ENCODING = "utf-8-sig"

_Row = tuple[int, dict[str, Any]]
_Keys = tuple[str, ...]


@dataclass(frozen=True)
class _Columns:
    """What a file holds: the keys of each column, from the outermost, and which columns are dates or clock times."""

    keys: tuple[_Keys, ...]
    stamps: Mapping[int, StampFormat] = field(default_factory=dict)
    is_cut: bool = False

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(".".join(keys) for keys in self.keys)


def read(path: Path) -> Table:
    """Open JSON lines; columns: keys of the first 1000 objects; cells: numbers, true, false, null (missing), times."""
    cut = _cut_line(path)
    given: dict[_Keys, list[Any]] = {}  # of each column the values among the first rows
    for _, row in _head(path, is_cut=bool(cut)):
        for keys, value in _items_of(row):
            given.setdefault(keys, []).append(value)
            if len(given) > MOST_COLUMNS:
                raise too_many_error(path, "columns")
    if not given:
        raise LogError(f"{path}: no object with a key; a log has one object for each sample, each on its own line")
    stamps = {}
    for number, values in enumerate(given.values()):
        known = [value for value in values if value is not None]
        if known and all(isinstance(value, str) for value in known):
            form = find_format(known)
            if form is not None:
                stamps[number] = form
    columns = _Columns(tuple(given), stamps, bool(cut))
    blocks, describe_row = partial(_blocks, path, columns), partial(_line_of_row, path, bool(cut))
    notes = (f"{path}: the last line is cut off ({quote(cut)}) and left out",) if cut else ()
    return Table(path, columns.names, blocks, describe_row, in_seconds=frozenset(stamps), notes=notes)


def _head(path: Path, *, is_cut: bool) -> Iterator[_Row]:
    """Yield the first rows: fewer where they are wide."""
    found = 0
    for row in islice(_rows(path, is_cut=is_cut), _SAMPLE_ROWS):
        yield row
        found += sum(1 for _ in _items_of(row[1]))
        if found > BLOCK_VALUES:
            return


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


def _blocks(path: Path, columns: _Columns, numbers: Sequence[int]) -> Iterator[Arrays]:
    rows = _rows(path, is_cut=columns.is_cut)
    most = max(1, min(BLOCK_ROWS, BLOCK_VALUES // len(columns.keys)))
    blocks = iter(lambda: list(islice(rows, most)), [])
    arrays = ([_column(path, columns, number, block) for number in numbers] for block in blocks)
    describe_row = partial(_line_of_row, path, columns.is_cut)
    return followed_clocks(path, columns.names, columns.stamps, numbers, describe_row, arrays)


def _column(path: Path, columns: _Columns, number: int, block: Sequence[_Row]) -> FloatArray:
    keys, form = columns.keys[number], columns.stamps.get(number)
    values = [_value(row, keys) for _, row in block]
    if form is None:
        return np.array(
            [_number(path, line, columns.names[number], value) for (line, _), value in zip(block, values, strict=True)]
        )
    try:
        return form.seconds(["" if value is None else str(value) for value in values])
    except CellError as error:
        line = block[error.at][0]
        raise LogError(f"{path}: line {line}, column {shown(columns.names[number])}: {error}") from None


def _number(path: Path, line: int, name: str, value: Any) -> float:
    if value is None:
        return math.nan
    if isinstance(value, int | float):
        return as_float(value)
    raise LogError(
        f"{path}: line {line}, column {shown(name)}: {quote(json.dumps(value))} is not a number; write numbers, or null"
    )


def _line_of_row(path: Path, is_cut: bool, row: int) -> str:
    number, _ = next(islice(_rows(path, is_cut=is_cut), row, None))
    return f"line {number}"
