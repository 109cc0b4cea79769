"""Tables in memory, of pandas, polars or pyarrow, as a `Table`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from replant.errors import ArgumentTypeError, InvalidArgumentError, LogError, shown
from replant.logs.sampling_time import named_time_columns, time_candidates
from replant.logs.table import Table, listed, nth_row
from replant.logs.text_times import with_split_times
from replant.numerics.arguments import FloatArray
from replant.numerics.time_stamps import array_of, is_dated, seconds_of

NAME = Path("the table")  # in messages


def labels_of(frame: Any) -> list[Any]:
    """Return the labels of a table's columns."""
    if hasattr(frame, "collect"):
        raise ArgumentTypeError("the table is not computed yet: give table.collect()")
    return list(getattr(frame, "column_names", frame.columns))


class Frame:
    """A table in memory: its columns, followed by its index if that may be the time."""

    def __init__(self, frame: Any) -> None:
        self._labels = labels_of(frame)
        parts = [label if type(label) is tuple else (label,) for label in self._labels]  # a MultiIndex has several
        names = [".".join(str(part) for part in label if part != "") for label in parts]
        by_place = getattr(frame, "iloc", None)  # pandas: two columns may have the same label
        columns = [frame[label] if by_place is None else by_place[:, k] for k, label in enumerate(self._labels)]
        self.values = [array_of(column) for column in columns]
        self.names, index = names, getattr(frame, "index", None)
        if index is not None and hasattr(index, "name"):  # in other libraries `index` is a method
            name, values = str(index.name or ""), array_of(index)
            # an index of whole numbers counts rows unless it has a name of time
            if is_dated(values) or time_candidates([name]) or (name and values.dtype.kind == "f"):
                names, self.values = [*names, name or "index"], [*self.values, values]
        dated = frozenset(number for number, each in enumerate(self.values) if is_dated(each))
        table = Table(NAME, tuple(names), lambda keys: iter([[self._numbers(k) for k in keys]]), in_seconds=dated)
        self.table = with_split_times(table)

    def find(self, role: str, key: Any) -> Any:
        """Return the number of a column by its label or as `Table.find`; a list for several keys, None for None."""
        if isinstance(key, list | tuple) and key and key not in self._labels:
            return [self.find(role, each) for each in key]
        found = [number for number, label in enumerate(self._labels) if type(label) is type(key) and label == key]
        if key is None or len(found) == 1:
            return found[0] if found else None
        if found:
            places = " or ".join(map(str, found))
            raise InvalidArgumentError(
                f"{role}: {len(found)} columns are called {shown(key)}; give the number of one, {places}"
            )
        try:
            return self.table.find(key)
        except (LogError, ArgumentTypeError):
            there = f"there are {listed(self.names)}"
            raise InvalidArgumentError(f"{role} must name a column, got {shown(key)}; {there}") from None

    @property
    def clock(self) -> int | None:
        """The default time column: an index of times, else the only column with a name of time, else another index."""
        named, last = named_time_columns(self.table), len(self.names)
        has_index = last < len(self.values)
        if (has_index and last in self.table.in_seconds) or (has_index and len(named) != 1):
            return last
        return named[0] if len(named) == 1 else None

    def beside(self, used: set[int | None], rows: int) -> dict[str, FloatArray]:
        """Return the unused numeric columns with this number of rows, by their names."""
        return {
            name: self._numbers(number)
            for number, name in enumerate(self.names)
            if number not in used and self.names.count(name) == 1
            and self.values[number].dtype.kind in "iufb" and self.values[number].shape == (rows,)
        }  # fmt: skip

    def _numbers(self, number: int) -> FloatArray:
        try:
            return seconds_of(self.values[number])
        except (TypeError, ValueError, OverflowError):
            row, cell = _first_unreadable(self.values[number])
            where = f"{NAME}: {nth_row(row)}, column {shown(self.table.names[number])}"
            problem = f"{shown(cell)} is neither a number nor a date"
            raise ArgumentTypeError(f"{where}: {problem}; convert the column") from None


def _first_unreadable(values: Any) -> tuple[int, Any]:
    """Return the first row of a column that is not a number, or not a time if the first row is one; and its value."""
    dated = len(values) > 0 and hasattr(values[0], "timestamp")
    for row, cell in enumerate(values.tolist()):
        try:
            cell.timestamp() if dated else float(cell)
        except (TypeError, ValueError, OverflowError, AttributeError):
            return row, cell
    return 0, values  # a time beyond NumPy's range
