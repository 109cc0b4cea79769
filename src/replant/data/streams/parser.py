"""Parser: turns blocks of lines into samples; a clean block is parsed as a whole, any other line by line."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

import numpy as np

from replant.arguments import FloatArray
from replant.data.logs.text_layout import is_data
from replant.data.streams.rows import (
    BY_WIDTH,
    Malformed,
    Row,
    check_width,
    columns_of,
    from_cells,
    from_json,
    json_value,
    json_values,
    table_from_cells,
    table_from_json,
)
from replant.data.streams.source import Batch

Item = TypeVar("Item")

FEW = 10  # lines up to which a block is parsed line by line: parsing it as a whole costs as much as ten lines [lines]
LARGEST_NUMBER = 2.0**53  # largest whole number up to which float64 represents every one exactly [number]
#: The reason under which a row with an invalid number or time stamp is counted.
REASONS = {"n": "not a sequence number", "t": "time not finite"}


class Parser:
    r"""Parses the lines of one stream; each line is CSV or JSON.

    The columns are those of ``columns``, or follow from the first two lines of CSV of equal width (the first line may
    have been cut), or from the first JSON object.  Blank lines and comments are skipped.  Every other line gives
    samples, or is counted by the reason why it gives none.

    >>> counters = Counter()
    >>> parser = Parser(counters)
    >>> batch = parser.parse(b"0.0,1,0.5\n0.1,1,abc\n0.2,1,0.7\n", arrived=0.0)
    >>> batch.t, batch.y, dict(counters)
    (array([0. , 0.2]), array([0.5, 0.7]), {'not a number': 1})
    """

    def __init__(self, counters: Counter[str], columns: tuple[str, ...] | None = None) -> None:
        self.columns = columns
        self._counters = counters
        self._waiting: Row | None = None  # the first line of CSV, until a second line confirms its width

    def parse(self, block: bytes, arrived: float) -> Batch | None:
        """Return the samples in a block of whole lines, None if there are none."""
        return self.batch(self.tables(block), arrived)

    def tables(self, block: bytes) -> list[FloatArray]:
        """Return the rows in a block of whole lines as tables (K, C), whose columns are `columns`."""
        lines = block.decode("ascii", "replace").replace("\r\n", "\n").split("\n")
        if not lines[-1]:
            lines.pop()  # the empty rest behind the last line end
        return self._tables(lines)

    def finish(self, arrived: float) -> Batch | None:
        """Return the sample of the first line if the stream ended before a second line confirmed it."""
        row, self._waiting = self._waiting, None
        if row is None:
            return None
        self.columns = BY_WIDTH[len(row)]
        return self.batch([np.array([row])], arrived)

    def batch(self, tables: Sequence[FloatArray], arrived: float) -> Batch | None:
        """Return the rows of tables as samples; rows with an invalid number or time stamp are dropped and counted."""
        if not tables or self.columns is None:
            return None
        table = self._valid_rows(np.concatenate(tables) if len(tables) > 1 else tables[0])
        by_name = {name: table[:, column].copy() for column, name in enumerate(self.columns)}
        sequence = by_name["n"].astype(np.int64) if "n" in by_name else None
        return Batch(by_name["u"], by_name["y"], by_name.get("t"), sequence, arrived, by_name.get("r"))

    def _valid_rows(self, table: FloatArray) -> FloatArray:
        """Return the rows with a valid number and time stamp; count the others."""
        for column, name in enumerate(self.columns or ()):
            if name in REASONS:
                values = table[:, column]
                fine = np.isfinite(values) if name == "t" else is_number(values)
                if not fine.all():
                    self.count(REASONS[name], int(fine.size - fine.sum()))
                    table = table[fine]
        return table

    def count(self, reason: str, samples: int = 1) -> None:
        """Count lines or samples that were refused."""
        if samples:
            self._counters[reason] += samples

    def set_columns(self, columns: tuple[str, ...]) -> None:
        """Set the columns; a first line of CSV that still waits has others, and is counted as refused."""
        self.columns = columns
        if self._waiting is not None:
            self.count("fields missing")
            self._waiting = None

    def _tables(self, lines: list[str]) -> list[FloatArray]:
        """Return the rows of lines; a block with a faulty line is halved until few lines are left to parse singly."""
        if self.columns is None or len(lines) <= FEW:
            return self._each(filter(is_data, lines), self._line)
        if lines[0].startswith(("{", "[")):
            values = json_values(lines)
            if values is not None:
                table = table_from_json(values, self.columns)
                return self._each(values, self._value) if table is None else [table]
        elif any(map(str.strip, lines)):  # loadtxt warns about a block without data
            table = table_from_cells(lines, len(self.columns))
            if table is not None:
                return [table]
        middle = len(lines) // 2
        return self._tables(lines[:middle]) + self._tables(lines[middle:])

    def _each(self, items: Iterable[Item], read: Callable[[Item], list[Row]]) -> list[FloatArray]:
        """Return the rows that ``read`` finds in the items; items that it refuses are counted."""
        rows: list[Row] = []
        for item in items:
            try:
                rows += read(item)
            except Malformed as reason:
                self.count(str(reason))
        return [np.array(rows)] if rows else []

    def _line(self, line: str) -> list[Row]:
        line = line.strip()
        if line[0] in "{[":
            return self._value(json_value(line))
        row = from_cells(line)
        if self.columns is not None:
            check_width(row, len(self.columns))
            return [row]
        check_width(row, min(max(len(row), min(BY_WIDTH)), max(BY_WIDTH)))
        first, self._waiting = self._waiting, row
        if first is None:
            return []
        check_width(first, len(row))  # a first line of another width was cut
        self.columns, self._waiting = BY_WIDTH[len(row)], None
        return [first, row]

    def _value(self, value: Any) -> list[Row]:
        columns = columns_of(value) if self.columns is None else self.columns
        rows = from_json(value, columns or ("u", "y"))
        if self.columns is None and rows and columns:
            self.set_columns(columns)
        return rows


def is_number(values: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return which values (K,) are valid sequence numbers: whole, not negative, exact in float64.

    Examples
    --------
    >>> is_number(np.array([7.0, 0.5, -1.0]))
    array([ True, False, False])
    """
    return np.asarray((values >= 0.0) & (values < LARGEST_NUMBER) & (values == np.trunc(values)))
