"""Parse lines and payloads of live samples: CSV, JSON, or packed; faults are counted by reason, see `Malformed`."""

from __future__ import annotations

import contextlib
import json
import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from itertools import chain
from operator import itemgetter
from typing import Any

import numpy as np

from replant.errors import shown
from replant.live.streams.source import (
    NUMBER,
    REFERENCE,
    TIME,
    UY,
    Batch,
    Columns,
    Signals,
    header_of,
    remark_on,
    titles_of,
    together,
)
from replant.logs.sampling_time import LATEST, unit_in_seconds, unit_of_stamps
from replant.logs.text_cells import parse_number
from replant.logs.text_layout import is_data
from replant.logs.text_times import parse_stamp
from replant.numerics.arguments import BoolArray, FloatArray

Row = tuple[float, ...]


class Malformed(Exception):  # noqa: N818 - not an error of the program, but a reason that is counted
    """A line or message without a valid sample; the text is the reason."""


def check_width(row: Row, width: int) -> None:
    """Check that a row has ``width`` cells."""
    if len(row) != width:
        raise Malformed("fields missing" if len(row) < width else "too many fields")


def table_from_cells(lines: Sequence[str], width: int) -> FloatArray | None:
    """Parse lines of CSV together, in C; return None if a line is not ``width`` numbers."""
    if not any(map(str.strip, lines)):  # loadtxt warns about a block without data
        return None
    try:
        table = np.loadtxt(lines, delimiter=",", comments=None, ndmin=2)
    except ValueError:
        return None
    return table if table.shape[1] == width else None


def table_from_json(lines: Sequence[str], columns: Sequence[str]) -> FloatArray | None:
    """Parse lines of JSON together, one sample each; return None if a line is not an object of numbers."""
    try:
        # parsing them together takes half the time; the nulls between keep two lines from forming one object
        values = json.loads(f"[{',null,'.join(lines)}]")
        if len(values) != 2 * len(lines) - 1 or any(between is not None for between in values[1::2]):
            return None
        rows = list(map(itemgetter(*columns), values[::2]))
        if set(map(type, chain.from_iterable(rows))) <= {float, int}:  # bool is neither
            return np.array(rows, dtype=np.float64)
    except (ValueError, LookupError, TypeError, OverflowError, RecursionError):
        pass
    return None


def columns_of(value: Any, signals: Signals) -> Columns:
    """Return the columns of a JSON object, or of the first in an array; None if it holds no sample."""
    first = value[0] if isinstance(value, list) and value else value
    if not isinstance(first, dict) or not set(signals.names) <= first.keys():
        return None
    return tuple(name for name in signals.fields if name in first)


def from_json(value: Any, columns: Sequence[str], one: str) -> list[Row]:
    """Return the samples in JSON objects, ``{"n": 7, "u": 1.0, "y": 0.2}``; with arrays, n may be the first number."""
    rows: list[Row] = []
    for item in value if isinstance(value, list) else [value]:
        if not isinstance(item, dict):
            raise Malformed("not an object")
        if not set(columns) <= item.keys():
            raise Malformed("fields missing")
        fields = {name: item[name] for name in columns}
        if not isinstance(item[one], list):
            rows.append(tuple(_number(name, value) for name, value in fields.items()))
            continue
        count = len(item[one])
        if type(fields.get(NUMBER)) is int:
            fields[NUMBER] = list(range(fields[NUMBER], fields[NUMBER] + count))
        if any(not isinstance(values, list) or len(values) != count for values in fields.values()):
            raise Malformed("arrays of different lengths")
        rows += zip(*(_numbers(name, values) for name, values in fields.items()), strict=True)
    return rows


def _numbers(name: str, values: Sequence[Any]) -> list[float]:
    if set(map(type, values)) <= {float, int}:
        with contextlib.suppress(OverflowError):
            return list(map(float, values))
    return [_number(name, value) for value in values]


def _number(name: str, value: Any) -> float:
    if value is None and name not in (NUMBER, TIME):
        return float("nan")
    if type(value) in (float, int):  # bool is neither
        with contextlib.suppress(OverflowError):
            return float(value)
    raise Malformed("not a number")


def _as_csv(line: str | bytes) -> str:
    """Return how the numbers of a line with dates or other separators are to be written; empty if it has none."""
    if isinstance(line, str) and any(map(_is_date, line.split(","))):
        return "; dates and clock times are not read: write t in seconds, since any moment"
    cells = re.split(r"[;\s]+", line.strip()) if isinstance(line, str) else []
    if len(cells) < 2 or any(cell.startswith(",") or cell.endswith(",") for cell in cells):
        return ""
    cells = [cell.replace(",", ".") for cell in cells]
    try:
        is_known = all(math.isfinite(parse_number(cell)) for cell in cells)
    except ValueError:
        return ""
    return f"; separate numbers by commas: {','.join(cells)}" if is_known else ""


def _as_seconds(stamps: FloatArray) -> str:
    """Return of which unit stamps beyond the year 5000 are by their size, and what to write; empty for others."""
    unit = unit_of_stamps(TIME, stamps)
    short = {1e-3: "ms", 1e-6: "us", 1e-9: "ns"}.get(unit.seconds)
    return f"; {unit.doubt}; write seconds, or first a header with {TIME} [{short}]" if short else ""


def _is_date(cell: str) -> bool:
    with contextlib.suppress(ValueError):
        return bool(parse_stamp(cell, month_first=False).parts)
    return False


FEW = 10  # most lines that are parsed one by one: parsing a block together costs as much as ten lines [lines]
#: The first bytes of a packed payload; four letters that name its columns follow ("ntuy", "tuyr", "uy  ").
MAGIC = b"RPL1"
HEADER = 8  # bytes before the numbers of a packed payload [bytes]
LARGEST_NUMBER = 2.0**53  # bound up to which float64 represents all whole numbers exactly [number]
#: The reasons under which rows with an invalid number or time stamp are counted, and which rows they are.
FAULTS: dict[str, dict[str, Callable[[FloatArray], BoolArray]]] = {
    NUMBER: {  # whole, not negative, and exact in float64
        "not a sequence number": lambda n: ~((n >= 0.0) & (n < LARGEST_NUMBER) & (n == np.trunc(n)))
    },
    TIME: {
        "time not finite": lambda t: ~np.isfinite(t),
        "time beyond the year 5000": lambda t: np.abs(t) > LATEST,
    },
}


class Parser:
    """Parses the lines of one stream: CSV, with or without a header, or JSON; blank lines and comments are skipped.

    If the columns are not given, they come from two lines of CSV of equal width (the first line may have been cut),
    from the first JSON object, or from a header that names the signals.  Of a header with other names `remark` says
    how the columns were read, unless it contradicts that, or a user has named the signals: then `LogError` is raised.
    """

    def __init__(self, counters: Counter[str], columns: Columns = None, signals: Signals = UY) -> None:
        self.columns, self.signals = columns, signals
        self._counters = counters
        self.refused = ""  # the first line or message without a valid sample, and the reason
        self.remark = ""  # how the columns under a header with other names were read; empty if there was none
        self._titles: tuple[str, ...] = ()  # the newest line of text alone: a header, if the rows have its width
        self._unit = 1.0  # of the time column, in s
        self._waiting: Row | None = None  # the first line of CSV, until a second line confirms its width

    def parse(self, block: bytes, arrived: float) -> Batch | None:
        """Return the samples in a block of whole lines; None if there are none."""
        return self.batch(self.tables(block), arrived)

    def tables(self, block: bytes) -> list[FloatArray]:
        """Return the rows in a block of whole lines as tables (K, C), whose columns are `columns`."""
        lines = block.decode("ascii", "replace").replace("\r\n", "\n").split("\n")
        if not lines[-1]:
            lines.pop()  # empty: the block ended with a line end
        return self._tables(lines)

    def payloads(self, payloads: Sequence[bytes], arrived: float, *, bare: bool = False) -> Batch | None:
        """Return the samples in payloads: lines; or `MAGIC`, the letters of the columns padded to four, and rows.

        Rows are of little-endian float64; ``bare`` payloads are such rows alone, with all columns.
        """
        if not bare and not any(payload.startswith(MAGIC) for payload in payloads):
            return self.parse(b"\n".join(payloads), arrived)
        tables: list[FloatArray] = []
        for payload in payloads:
            try:
                is_packed = bare or payload.startswith(MAGIC)
                tables += [self._unpack(payload, bare=bare)] if is_packed else self.tables(payload)
            except Malformed as reason:
                self._refuse(payload, reason)
        return self.batch(tables, arrived)

    def _unpack(self, payload: bytes, *, bare: bool) -> FloatArray:
        names, numbers = self.columns, payload
        if not bare:
            names = tuple(payload[len(MAGIC) : HEADER].decode("ascii", "replace").strip())
            numbers = payload[HEADER:]
        is_known = names is not None and self.signals.are_in(names)
        if names is None or not is_known or not numbers or len(numbers) % (8 * len(names)):
            raise Malformed("not packed right")
        table = np.frombuffer(numbers, "<f8").astype(np.float64).reshape(-1, len(names))
        if self.columns is None:
            self.set_columns(names)
            return table
        if not set(self.columns) <= set(names):
            raise Malformed("fields missing")
        return table[:, [names.index(name) for name in self.columns]]

    def finish(self, arrived: float) -> Batch | None:
        """Return the sample of the first line if the stream ended before a second line confirmed it."""
        row, self._waiting = self._waiting, None
        if row is None:
            return None
        self.columns = self._by_width(len(row))
        return self.batch([self._in_seconds(np.array([row]))], arrived)

    def batch(self, tables: Sequence[FloatArray], arrived: float) -> Batch | None:
        """Return the rows of tables as samples; rows with an invalid number or time stamp are dropped and counted."""
        if not tables or self.columns is None:
            return None
        table = self._valid_rows(np.concatenate(tables) if len(tables) > 1 else tables[0])
        by_name = {name: table[:, column].copy() for column, name in enumerate(self.columns)}
        sequence = by_name[NUMBER].astype(np.int64) if NUMBER in by_name else None
        u = together([by_name[name] for name in self.signals.inputs])
        return Batch(u, by_name[self.signals.output], by_name.get(TIME), sequence, arrived, by_name.get(REFERENCE))

    def _valid_rows(self, table: FloatArray) -> FloatArray:
        """Return the rows with a valid number and time stamp; count the others."""
        for column, name in enumerate(self.columns or ()):
            for reason, are_wrong in FAULTS.get(name, {}).items():
                values = table[:, column]
                wrong = are_wrong(values)
                if wrong.any():
                    self._counters[reason] += int(wrong.sum())
                    what = f"{name} = {values[wrong][0]:g}: {reason}"
                    self.refused = self.refused or f"{what}{_as_seconds(values[wrong][:1]) if name == TIME else ''}"
                    table = table[~wrong]
        return table

    def set_columns(self, columns: tuple[str, ...]) -> None:
        """Set the columns; a waiting first line of CSV has other columns, and is counted as refused."""
        self.columns = columns
        if self._waiting is not None:
            self._counters["fields missing"] += 1
            self._waiting = None

    def _tables(self, lines: list[str]) -> list[FloatArray]:
        """Return the rows of lines; a block with a faulty line is halved until few lines remain to parse singly."""
        if self.columns is None or len(lines) <= FEW:
            return self._each(lines)
        is_json = lines[0].startswith("{")
        table = table_from_json(lines, self.columns) if is_json else table_from_cells(lines, len(self.columns))
        if table is not None:
            return [table if is_json else self._in_seconds(table)]
        if is_json:
            return self._each(lines)
        middle = len(lines) // 2
        return self._tables(lines[:middle]) + self._tables(lines[middle:])

    def _each(self, lines: list[str]) -> list[FloatArray]:
        """Return the rows of lines, parsed one by one; refused lines are counted."""
        rows: list[Row] = []
        for line in filter(is_data, lines):
            try:
                rows += self._line(line.strip())
            except Malformed as reason:
                self._refuse(line, reason)
        return [np.array(rows)] if rows else []

    def _refuse(self, given: str | bytes, reason: Malformed) -> None:
        self._counters[str(reason)] += 1
        self.refused = self.refused or f"{shown(given)}: {reason}{_as_csv(given)}"

    def _line(self, line: str) -> list[Row]:
        if line[0] in "{[":
            return self._json(line)
        header = header_of(line, self.signals) if self.columns is None else None
        if header is not None:
            columns, self._unit = header
            self.set_columns(columns)
            return []
        try:
            row = tuple(map(parse_number, line.split(",")))  # a missing cell is NaN, as in a log
        except ValueError:
            self._titles = titles_of(line) if self.columns is None else ()
            raise Malformed("not a number") from None
        if self.columns is not None:
            check_width(row, len(self.columns))
            return [row if self._unit == 1.0 else tuple(self._in_seconds(np.array([row]))[0])]
        by_width = self.signals.by_width
        check_width(row, min(max(len(row), min(by_width)), max(by_width)))
        first, self._waiting = self._waiting, row
        if first is None:
            return []
        check_width(first, len(row))  # if the widths differ, the first line was cut
        self.columns, self._waiting = self._by_width(len(row)), None
        return [tuple(each) for each in self._in_seconds(np.array([first, row])).tolist()]

    def _by_width(self, width: int) -> tuple[str, ...]:
        columns = self.signals.by_width[width]
        if len(self._titles) == width:
            self.remark = remark_on(self._titles, columns, self.signals)
            self._unit = unit_in_seconds(self._titles[columns.index(TIME)]) if TIME in columns else 1.0
        return columns

    def _in_seconds(self, table: FloatArray) -> FloatArray:
        """Return rows of CSV with the time in s, whatever the header's unit; JSON and packed rows have it in s."""
        if self._unit != 1.0 and self.columns is not None:
            with np.errstate(over="ignore"):  # an infinite time is refused
                table[:, self.columns.index(TIME)] *= self._unit
        return table

    def _json(self, line: str) -> list[Row]:
        try:
            value = json.loads(line)
        except (ValueError, RecursionError):
            raise Malformed("not JSON") from None
        columns = columns_of(value, self.signals) if self.columns is None else self.columns
        rows = from_json(value, columns or self.signals.names, self.signals.inputs[0])
        if self.columns is None and rows and columns:
            self.set_columns(columns)
        return rows
