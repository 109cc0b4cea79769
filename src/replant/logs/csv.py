"""Text logs (.csv, .txt, .tsv, .dat): read in blocks of lines, in C where the block is clean.

A block with quotes, comments, missing cells or an error takes the path in Python, which also says where an error is.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from replant.errors import LogError
from replant.logs.layout import Layout, is_data, is_number, parse_number, sniff, split_line
from replant.logs.table import Table

BLOCK_LINES = 1 << 16  # bounds the memory of the text held at a time

_CELL_SHOWN = 40
_CELL_REMEDY = "correct it, leave the cell empty, or put # before the line"
_DATE = re.compile(r"\s*\d+[-/.:]\d+[-/.:]\d+")
_DATE_REMEDY = "convert dates and clock times to seconds, or give the sampling time (dt, --dt)"


def read(path: Path) -> Table:
    """Open a text log: delimiter, decimal comma and header are found out from its first lines.

    Raises
    ------
    LogError
        If the file is empty, is not text, or has no row of data.
    """
    layout = sniff(path)
    return Table(path, layout.names, partial(_load, path, layout), partial(_place, path, layout))


def parse_block(
    path: Path, layout: Layout, lines: Sequence[str], first: int, columns: Sequence[int]
) -> list[NDArray[np.float64]]:
    """Turn consecutive lines of a text log into one float64 array per chosen column.

    Blank lines and comments are passed over; a missing cell is NaN.

    Parameters
    ----------
    path : Path
        The file, for messages.
    layout : Layout
        How its lines are laid out.
    lines : sequence of str
        The lines.
    first : int
        The 1-based number of the first of them, for messages.
    columns : sequence of int
        The columns wanted; text in the others does not matter.

    Raises
    ------
    LogError
        If a row has too few or too many cells, or a chosen cell is not a number.

    Examples
    --------
    >>> layout = Layout(names=("t", "u"), delimiter=";", names_line=1, data_line=2, encoding="utf-8")
    >>> parse_block(Path("log.csv"), layout, ["0;1,5", "# stop", "1;2,5"], first=2, columns=[1])
    [array([1.5, 2.5])]
    """
    table = _parse_clean(layout, lines)
    if table is not None:
        return [table[:, column].copy() for column in columns]
    rows = [(number, _split(line, layout)) for number, line in enumerate(lines, first) if is_data(line)]
    for number, row in rows:
        if len(row) != len(layout.names):
            _check_width(path, layout, number, row)
    return [_parse_column(path, layout, rows, column) for column in columns]


def _load(path: Path, layout: Layout, columns: Sequence[int]) -> list[NDArray[np.float64]]:
    blocks = [parse_block(path, layout, lines, first, columns) for first, lines in _blocks(path, layout)]
    return [np.concatenate([block[index] for block in blocks]) for index in range(len(columns))]


def _blocks(path: Path, layout: Layout) -> Iterator[tuple[int, list[str]]]:
    with path.open(encoding=layout.encoding, errors="replace") as file:
        first = layout.data_line
        rest = islice(file, first - 1, None)
        while lines := list(islice(rest, BLOCK_LINES)):
            yield first, lines
            first += len(lines)


def _place(path: Path, layout: Layout, row: int) -> str:
    """Name the line that holds a row: only for messages, so the file is read once more."""
    with path.open(encoding=layout.encoding, errors="replace") as file:
        numbers = (n for n, line in enumerate(file, 1) if n >= layout.data_line and is_data(line))
        return f"line {next(islice(numbers, row, None))}"


def _parse_clean(layout: Layout, lines: Sequence[str]) -> NDArray[np.float64] | None:
    """Parse a block in C, or return None if it holds anything but a full grid of numbers."""
    if layout.delimiter != ",":
        text = "".join(lines)
        if "," in text:
            if "." in text:
                return None
            lines = text.replace(",", ".").split("\n")
    if not any(map(str.strip, lines)):
        return None  # loadtxt warns about a block without data
    try:
        table = np.loadtxt(lines, delimiter=layout.delimiter, comments=None, ndmin=2)
    except ValueError:
        return None
    return table if table.shape[1] == len(layout.names) else None


def _split(line: str, layout: Layout) -> list[str]:
    if '"' in line:
        return split_line(line, layout.delimiter)
    return line.split(layout.delimiter)


def _check_width(path: Path, layout: Layout, number: int, row: list[str]) -> None:
    """Drop the empty cell after a delimiter at the end of the line; refuse any other difference."""
    width = len(layout.names)
    if len(row) == width + 1 and not row[-1].strip():
        row.pop()
        return
    model = f"line {layout.names_line or layout.data_line}"
    cells = "1 cell" if len(row) == 1 else f"{len(row)} cells"
    raise LogError(
        f"{path}: line {number} has {cells} where {model} has {width}; complete the line, or put # before it"
    )


def _parse_column(
    path: Path, layout: Layout, rows: Sequence[tuple[int, list[str]]], column: int
) -> NDArray[np.float64]:
    cells = [row[column] for _, row in rows]
    commas = layout.delimiter != "," and any("," in cell for cell in cells)
    if commas:
        if any("." in cell for cell in cells):
            _check_one_decimal_mark(path, layout, rows, column)
        cells = [cell.replace(",", ".") for cell in cells]
    values = _plain_numbers(cells)
    if values is not None:
        return values
    values = np.empty(len(cells))
    for index, cell in enumerate(cells):
        try:
            values[index] = parse_number(cell)
        except ValueError:
            (number, row), name = rows[index], layout.names[column]
            remedy = _DATE_REMEDY if _DATE.match(row[column]) else _CELL_REMEDY
            raise LogError(
                f"{path}: line {number}, column {name!r}: {_shown(row[column])} is not a number; {remedy}"
            ) from None
    return values


def _plain_numbers(cells: Sequence[str]) -> NDArray[np.float64] | None:
    """Convert numbers at once, or return None if a cell is anything else."""
    text = "".join(cells)
    if "_" in text or not text.isascii():
        return None
    try:
        return np.fromiter(map(float, cells), np.float64, len(cells))
    except ValueError:
        return None


def _check_one_decimal_mark(path: Path, layout: Layout, rows: Sequence[tuple[int, list[str]]], column: int) -> None:
    """Refuse 1.234 beside 0,5: the point may be a decimal point or a separator of thousands."""
    numbers = [(number, row[column]) for number, row in rows if is_number(row[column], layout.delimiter)]
    point = next(((number, cell) for number, cell in numbers if "." in cell), None)
    comma = next(((number, cell) for number, cell in numbers if "," in cell), None)
    if point and comma:
        raise LogError(
            f"{path}: column {layout.names[column]!r} has a decimal point in line {point[0]} ({_shown(point[1])}) and "
            f"a comma in line {comma[0]} ({_shown(comma[1])}); write all numbers one way, without thousands separators"
        )


def _shown(cell: str) -> str:
    text = cell.strip()
    return repr(text if len(text) <= _CELL_SHOWN else text[:_CELL_SHOWN] + "...")
