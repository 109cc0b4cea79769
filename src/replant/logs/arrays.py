"""Arrays as the columns of a table, read in blocks: NumPy archives (.npz), whose arrays are unpacked to files.

A table in memory, of pandas, polars or pyarrow, is a `Frame`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from replant.errors import ArgumentTypeError, InvalidArgumentError, LogError, shown
from replant.logs.file_formats import UnpackedFile, chunks_of
from replant.logs.parser_process import allow
from replant.logs.sampling_time import named_time_columns, time_candidates, unit_of_stamps
from replant.logs.table import (
    Arrays,
    Table,
    at_most,
    damage_as_log_error,
    listed,
    nth_row,
    open_zip,
)
from replant.logs.text_times import with_split_times
from replant.model.interop import without_unit
from replant.numerics.arguments import FloatArray
from replant.numerics.time_stamps import array_of, is_dated, seconds_of

SAMPLING_TIME = "Ts"  # name of a scalar, perhaps in a struct, that is the sampling time, in s without a unit
BLOCK_ROWS = 1 << 16  # rows read at a time [rows]
_SUFFIX = ".npy"


@dataclass(frozen=True)
class Signal:
    """A column: its name, the array that contains it, its index there, and its length."""

    name: str
    array: Any
    index: tuple[int | slice, ...]
    rows: int

    def values(self, rows: slice) -> FloatArray:
        """Read some rows."""
        index = tuple(rows if isinstance(one, slice) else one for one in self.index)
        return np.array(self.array[index], np.float64).reshape(-1)


def signals_in(name: str, array: Any) -> Iterator[Signal]:
    """Yield the signals in an array: a vector is one signal, a matrix has one for each index of its shorter side."""
    every, shape = slice(None), array.shape
    long = [axis for axis, length in enumerate(shape) if length != 1]
    if len(long) == 1 and shape[long[0]] > 1:
        index = tuple(every if axis == long[0] else 0 for axis in range(len(shape)))
        yield Signal(name, array, index, shape[long[0]])
    elif len(long) == 2 == len(shape) and min(shape) > 0:
        rows, columns = shape
        if rows >= columns:
            yield from (Signal(f"{name}[:,{at}]", array, (every, at), rows) for at in range(columns))
        else:
            yield from (Signal(f"{name}[{at},:]", array, (at, every), columns) for at in range(rows))


def is_sampling_time(name: str, array: Any) -> bool:
    """Return whether an array is a single number called Ts, perhaps with a unit."""
    own = without_unit(name).replace("/", ".").rpartition(".")[2].partition("{")[0]  # Ts{2}: in a cell
    return own == SAMPLING_TIME and array.dtype.kind in "iuf" and int(np.prod(array.shape)) == 1


def table_of_arrays(
    path: Path,
    found: Iterable[tuple[str, Any]],
    left_out: Mapping[str, str],
    guard: Callable[[], AbstractContextManager[None]],
    block_rows: Callable[[Signal], int] = lambda signal: BLOCK_ROWS,
) -> Table:
    """Make a table from named arrays of numbers, which have a shape and a dtype; a number called Ts is dt.

    The arrays are read within ``guard``, some rows at a time; ``left_out`` has the reasons for omitted names.
    """
    scalars: list[tuple[str, float]] = []

    def each() -> Iterator[Signal]:
        for name, array in found:
            yield from signals_in(name, array)
            if is_sampling_time(name, array) and not (unit := unit_of_stamps(name, np.empty(0))).refused:
                (value,) = Signal(name, array, (0,) * len(array.shape), 1).values(slice(1)) * unit.seconds
                scalars.append((name, float(value)))

    with guard():
        signals = list(at_most(path, each(), "columns"))
    if not signals:
        reason = next(iter(left_out.values()), "") or (
            "no numeric array of two samples or more in the file; save the signals as vectors"
        )
        raise LogError(f"{path}: {reason}")
    stated, dt = scalars[0] if scalars else ("", 1.0)
    is_one = len({value for _, value in scalars}) == 1  # different ones tell nothing
    if is_one and not 0.0 < dt < np.inf:
        raise LogError(f"{path}: {stated} is the sampling time, and must be finite and positive; it is {dt}")

    def blocks(numbers: Sequence[int]) -> Iterator[Arrays]:
        chosen = [signals[number] for number in numbers]
        lengths = {signal.rows for signal in chosen}
        with guard():
            step = max(map(block_rows, chosen), default=1)
            if len(lengths) > 1:  # the caller reports it; columns of different lengths have no common blocks
                allow(held=8 * sum(signal.rows for signal in chosen))
                step = max(lengths)
            for begin in range(0, max(lengths, default=0), step):
                yield [signal.values(slice(begin, begin + step)) for signal in chosen]

    return Table(
        path,
        tuple(signal.name for signal in signals),
        blocks,
        approximate_rows=max(signal.rows for signal in signals),
        dt=dt if is_one else None,
        left_out=left_out,
    )


@dataclass(frozen=True, eq=False)
class _Array:
    """An array of an archive, unpacked when it is first read."""

    path: Path
    member: str
    offset: int  # of its first item, after the header
    shape: tuple[int, ...]
    is_fortran: bool
    dtype: np.dtype[Any]

    def __getitem__(self, index: Any) -> Any:
        mapped: Any = np.memmap(
            self._file.path, self.dtype, "r", self.offset, self.shape, "F" if self.is_fortran else "C"
        )
        return mapped[index]

    @cached_property
    def _file(self) -> UnpackedFile:
        with open_zip(self.path) as archive, archive.open(self.member) as content:
            file = UnpackedFile(self.path, "array.npy", chunks_of(content))
        lost = self.offset + math.prod(self.shape) * self.dtype.itemsize - file.path.stat().st_size
        if lost > 0:
            raise ValueError(f"it ends {lost:,} bytes before its array")
        return file


def read_npz(path: Path) -> Table:
    """Open a NumPy archive."""
    return table_of_arrays(
        path, _arrays(path), {}, partial(damage_as_log_error, path, ".npz archive", "save it with numpy.savez")
    )


def _arrays(path: Path) -> Iterator[tuple[str, _Array]]:
    """Yield the arrays of numbers; Python objects are not signals, and unsafe to load."""
    with open_zip(path) as archive:
        for member in {each.filename: each for each in archive.infolist()}.values():
            if not member.filename.endswith(_SUFFIX):
                continue
            with archive.open(member) as content, warnings.catch_warnings(action="ignore"):  # types of Python 2
                is_first = npy.read_magic(content) == (1, 0)
                about = (npy.read_array_header_1_0 if is_first else npy.read_array_header_2_0)(content)
                array = _Array(path, member.filename, content.tell(), *about)
            if array.dtype.kind in "biuf" and array.dtype.itemsize <= 8:
                claimed = math.prod(array.shape) * array.dtype.itemsize
                if claimed > member.file_size:
                    raise ValueError(f"{member.filename} claims {claimed:,} bytes and holds {member.file_size:,}")
                yield member.filename.removesuffix(_SUFFIX), array


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
