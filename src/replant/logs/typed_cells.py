"""Files whose cells have types, beside dates in text: JSON lines (.jsonl, .ndjson), and Excel workbooks (openpyxl).

JSON lines have one object per line; keys are columns, those of an inner object ``rig.speed``.  Of a workbook the first
sheet with a table of numbers below a row of names is read.
"""

from __future__ import annotations

import json
import math
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import date, datetime, time, timedelta
from functools import partial
from itertools import chain, islice, repeat
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import LogError, shown
from replant.logs.parser_process import allow
from replant.logs.table import (
    MOST_COLUMNS,
    Arrays,
    Table,
    at_most,
    damage_as_log_error,
    listed,
    needed,
    open_zip,
    too_many_error,
)
from replant.logs.text_cells import CellError, as_float, quote, units_in, with_units
from replant.logs.text_layout import MOST_LINES_ABOVE, last_lines, lines_of
from replant.logs.text_times import StampFormat, find_format, is_missing, with_stamps
from replant.numerics.arguments import FloatArray

BLOCK_ROWS = 1 << 14  # rows read at a time [rows]
BLOCK_VALUES = 1 << 18  # most values in a block; a block of many columns has fewer rows [count]
DEEPEST = 32  # deepest nesting of objects that is read [count]
_FIRST_OBJECTS = 1000  # first rows, whose keys are the columns [rows]
_ENCODING = "utf-8-sig"

_Object = tuple[int, dict[str, Any]]
_Keys = tuple[str, ...]


def read_json_lines(path: Path) -> Table:
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
        if count == _FIRST_OBJECTS or found > BLOCK_VALUES:  # wide rows: fewer suffice
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


def _rows(path: Path, *, is_cut: bool) -> Iterator[_Object]:
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


def _column(path: Path, keys: _Keys, form: StampFormat | None, block: Sequence[_Object]) -> FloatArray:
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


_HEADER_ROWS = 100  # first rows of a sheet that are searched for the names [rows]
_NEXT_ROWS = 10  # rows below the names that are searched for each column's first cell [rows]
_SAMPLE_ROWS = 100  # rows of data from which dates in text are recognized [rows]
_EPOCH = datetime(1970, 1, 1)

_Row = Sequence[Any]
_VALUES = int | float | date | time | timedelta
MOST_ROWS = 1 << 20  # most rows of a sheet: Excel's limit [rows]
MOST_SHEETS = 1000  # most sheets of a workbook [count]
_COUNTED = 1 << 10  # cells between two requests for memory [cells]


class _Cells(Sequence[Any]):
    """The cells of a column: numbers in an array, the few other cells in a dictionary by row."""

    def __init__(self) -> None:
        self.numbers = array("d")
        self.others: dict[int, Any] = {}

    def append(self, cell: Any) -> None:
        if not isinstance(cell, float | int) or isinstance(cell, bool):
            if cell is not None:
                self.others[len(self.numbers)] = cell
            cell = math.nan
        self.numbers.append(as_float(cell))

    def __len__(self) -> int:
        return len(self.numbers)

    def __getitem__(self, row: Any) -> Any:
        if isinstance(row, slice):
            return [self[at] for at in range(*row.indices(len(self)))]
        found = self.numbers[row]
        return self.others.get(row) if math.isnan(found) else found


def read_workbook(path: Path) -> Table:
    """Open an Excel workbook: skip rows above the names, accept a row of units below; formulas give their values."""
    openpyxl = needed(path, "openpyxl", "reading Excel files needs openpyxl", "'replant[xlsx]'")
    with damage_as_log_error(path, "Excel workbook", "save it again as .xlsx, or as CSV"):
        with open_zip(path):
            pass
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        try:
            sheets = at_most(path, book.worksheets, "sheets", MOST_SHEETS)
            every = ((str(each.title), _table_in(path, each)) for each in sheets)
            title, table = next(((title, found) for title, found in every if found is not None), ("", None))
            others = [str(each.title) for each in sheets if table is not None and _has_table(path, each)]
        finally:
            book.close()
    if table is None:
        raise LogError(f"{path}: no sheet has a row of names above columns of numbers; put the log's signals into one")
    if others:
        left_out = listed(list(map(shown, others)))
        note = f"{path}: sheet {shown(title)} is read, the first with a table; left out: {left_out}"
        table = replace(table, notes=(*table.notes, note))
    return table


def _table_in(path: Path, sheet: Any) -> Table | None:
    rows = _rows_of(path, sheet)
    head = list(islice(rows, _HEADER_ROWS + _NEXT_ROWS))
    found = _begin_of_table(head)
    if found is None:
        return None
    names, first, columns = found
    return _table(path, str(sheet.title), names, first + 1, _columns(chain(head[first:], rows), columns))


def _has_table(path: Path, sheet: Any) -> bool:
    """Return whether a sheet that is not read could be; a damaged one could not."""
    with suppress(Exception):
        return _begin_of_table(list(islice(_rows_of(path, sheet), _HEADER_ROWS + _NEXT_ROWS))) is not None
    return False


def _rows_of(path: Path, sheet: Any) -> Iterator[_Row]:
    if not hasattr(sheet, "iter_rows"):  # a sheet that is a chart
        return iter(())
    every = (tuple(row) for row in sheet.iter_rows(values_only=True))  # rows missing in the file are empty
    return at_most(path, every, "rows in a sheet", MOST_ROWS)


def _begin_of_table(head: Sequence[_Row]) -> tuple[tuple[str, ...], int, tuple[int, ...]] | None:
    """Return names, first row of data and columns of the table in the first rows of a sheet; None without one."""
    for number, row in enumerate(head[:_HEADER_ROWS]):
        columns = tuple(at for at, cell in enumerate(row) if isinstance(cell, str) and cell.strip())
        if not columns or any(isinstance(cell, _VALUES) for cell in row):
            continue
        names = tuple(" ".join(row[at].split()) for at in columns)
        first = number + 1
        units = units_in(["" if cell is None else str(cell) for cell in _cells_at(head, first, columns)])
        if units is not None:
            names, first = with_units(names, units), first + 1
        below = [_cells_at(head, at, columns) for at in range(first, first + _NEXT_ROWS)]
        begins = (next((cell for cell in cells if cell is not None), None) for cells in zip(*below, strict=True))
        numbers = sum(isinstance(cell, _VALUES) for cell in begins)
        if numbers > 1 or numbers == len(columns):
            return names, first, columns
    return None


def _table(path: Path, title: str, names: tuple[str, ...], first: int, columns: Sequence[_Cells]) -> Table:
    """Return the table of a sheet whose data begin in row ``first``."""
    forms = {
        number: form
        for number, cells in enumerate(columns)
        if (form := find_format(list(map(_text, cells[:_SAMPLE_ROWS])), names[number])) is not None
    }

    def column(number: int) -> FloatArray:
        try:
            form, cells = forms.get(number), columns[number]
            return _numbers(cells) if form is None else form.seconds(map(_text, cells))
        except CellError as error:
            raise table.error(number, f": {error}", error.at) from None

    table = Table(
        path,
        names,
        lambda numbers: iter([[column(number) for number in numbers]]),
        lambda row: f"sheet {shown(title)}, row {first + row}",
        approximate_rows=len(columns[0]),
    )
    return with_stamps(table, forms)


def _columns(rows: Iterator[_Row], chosen: Sequence[int]) -> list[_Cells]:
    """Return the cells of some columns, without the empty rows at the end."""
    columns = [_Cells() for _ in chosen]
    empty = given = 0  # empty rows since the last one with a cell; cells since the last request for memory
    for row in rows:
        cells = _cells_at([row], 0, chosen)
        if all(cell is None for cell in cells):
            empty += 1
            continue
        for column, cell in zip(columns, cells, strict=True):
            column.numbers.extend(repeat(math.nan, empty))
            column.append(cell)
        given, empty = given + sum(cell is not None for cell in cells), 0
        if given >= _COUNTED:
            allow(held=8 * given, found=given)
            given = 0
    return columns


def _cells_at(rows: Sequence[_Row], number: int, columns: Sequence[int]) -> list[Any]:
    row = rows[number] if number < len(rows) else ()
    return [row[at] if at < len(row) else None for at in columns]


def _text(cell: Any) -> str:
    """Return a cell as text; a duration becomes a date in UTC, which has no daylight saving time."""
    if isinstance(cell, timedelta):
        return f"{_EPOCH + cell}Z"
    return "" if cell is None else str(cell)


def _numbers(cells: _Cells) -> FloatArray:
    values = np.array(cells.numbers)
    for row, cell in cells.others.items():
        if isinstance(cell, bool):
            values[row] = cell
        elif not isinstance(cell, str) or not (is_missing(cell) or cell == "#N/A"):
            raise CellError(row, f"{quote(str(cell))} is not a number; correct it, or empty the cell")
    return values
