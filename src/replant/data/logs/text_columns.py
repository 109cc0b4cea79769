"""The columns of a text log: cells of chosen columns become float64, and an error names line and column."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from replant.data.logs.text_cells import quote
from replant.data.logs.text_content import joined_cell
from replant.data.logs.text_layout import Layout
from replant.data.logs.text_numbers import DecimalMark, NumberError, TwoMarksError, common_mark, mark_of, parse_numbers
from replant.data.logs.text_times import READ, StampError
from replant.errors import LogError, shown

_CELL_REMEDY = "correct it, leave the cell empty, or put # before the line"
_DATE = re.compile(r"\s*\d+[-/.:]\d+[-/.:]\d+")
_DATE_REMEDY = f"convert dates and clock times to seconds, or give the sampling time (dt, --dt); as the time {READ}"
_WORDS = {".": "decimal point", ",": "comma"}


def decimal_mark(layout: Layout, column: int) -> DecimalMark | None:
    """Return what separates the fractions in a column; None: nothing in the log tells, or the delimiter is a comma."""
    return layout.content.marks.get(column, layout.content.mark)


def parse_column(
    path: Path, layout: Layout, rows: Sequence[tuple[int, Sequence[str]]], column: int
) -> NDArray[np.float64]:
    """Turn the cells of one column into float64: numbers, or seconds since the first stamp of the log.

    >>> layout = Layout(("t", "u"), ";", 1, 2, "utf-8")
    >>> parse_column(Path("log.csv"), layout, [(2, ["0", "1,5"]), (3, ["1", ""])], 1)
    array([1.5, nan])
    """
    cells = [row[column] for _, row in rows]
    form = layout.content.stamps.get(column)
    try:
        if form is not None:
            if form.date_column is not None:
                cells = [joined_cell(row[form.date_column], row[column]) for _, row in rows]
            return form.seconds(cells)
        mark = decimal_mark(layout, column)
        if mark is None and layout.delimiter != ",":
            mark = common_mark(mark_of(cell, line) for (line, _), cell in zip(rows, cells, strict=True))
        return parse_numbers(cells, mark)
    except (NumberError, StampError) as error:
        line, name = rows[error.index][0], layout.names[column]
        if isinstance(error, TwoMarksError):
            assert mark is not None
            raise LogError(_two_marks(path, name, str(error), line, mark)) from None
        remedy = _DATE_REMEDY if _DATE.match(cells[error.index]) else _CELL_REMEDY
        end = f"; {remedy}" if isinstance(error, NumberError) else ""
        raise LogError(f"{path}: line {line}, column {shown(name)}: {error}{end}") from None


def _two_marks(path: Path, name: str, cell: str, line: int, mark: DecimalMark) -> str:
    """Return the message for 1.234 beside 0,5: the point may be a decimal point or a thousands separator."""
    return (
        f"{path}: column {shown(name)} has a {_WORDS[mark.other]} in line {line} ({quote(cell)}) and the log a "
        f"{_WORDS[mark.mark]} in line {mark.line} ({quote(mark.cell)}); write all numbers one way, without thousands "
        "separators"
    )
