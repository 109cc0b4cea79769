"""Named arrays as the columns of a table, and NumPy archives (.npz), read block by block."""

from __future__ import annotations

import math
import warnings
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from replant.errors import LogError
from replant.logs.table import Arrays, Table, at_most, damage_as_log_error, open_zip
from replant.numerics.arguments import FloatArray

SAMPLING_TIME = "Ts"  # name of a scalar, perhaps in a struct, that is the sampling time in s


def places_of(name: str, shape: Sequence[int]) -> Iterator[tuple[str, tuple[int | slice, ...]]]:
    """Yield name and index of each signal in an array of a shape: a vector itself, a matrix along its longer side."""
    every = slice(None)
    long = [axis for axis, length in enumerate(shape) if length != 1]
    if len(long) == 1 and shape[long[0]] > 1:
        yield name, tuple(every if axis == long[0] else 0 for axis in range(len(shape)))
    elif len(long) == 2 == len(shape) and min(shape) > 0:
        rows, columns = shape
        if rows >= columns:
            yield from ((f"{name}[:,{index}]", (every, index)) for index in range(columns))
        else:
            yield from ((f"{name}[{index},:]", (index, every)) for index in range(rows))


def stated_dt(path: Path, scalars: Sequence[tuple[str, float]]) -> float | None:
    """Return the sampling time that scalars called Ts state; None if there is none, or they differ."""
    if len({value for _, value in scalars}) != 1:
        return None
    name, value = scalars[0]
    if not 0.0 < value < np.inf:
        raise LogError(f"{path}: {name} is the sampling time, and must be finite and positive; it is {value}")
    return value


def is_sampling_time(name: str, shape: Sequence[int], kind: str) -> bool:
    """Return whether a variable is a number that states the sampling time."""
    own = name.replace("/", ".").rpartition(".")[2].partition("{")[0]  # Ts{2}: in a cell
    return own == SAMPLING_TIME and kind in "iuf" and int(np.prod(shape)) == 1


def array_table(path: Path, found: Sequence[tuple[str, NDArray[Any]]], left_out: Mapping[str, str]) -> Table:
    """Make a table from named arrays of numbers; one number called Ts is the sampling time."""
    places = [(name, array[index]) for of, array in found for name, index in places_of(of, array.shape)]
    if not places:
        raise no_signal_error(path, left_out)
    values = [value.reshape(-1) for _, value in places]
    scalars = [
        (name, float(array.reshape(-1)[0]))
        for name, array in found
        if is_sampling_time(name, array.shape, array.dtype.kind)
    ]
    return Table(
        path,
        tuple(name for name, _ in places),
        lambda numbers: iter([[np.array(values[number], dtype=np.float64) for number in numbers]]),
        approximate_rows=max(map(len, values)),
        dt=stated_dt(path, scalars),
        left_out=left_out,
    )


def no_signal_error(path: Path, left_out: Mapping[str, str]) -> LogError:
    """Return the error for a file without a signal; it says why the first of what cannot be read is none."""
    reason = next(iter(left_out.values()), "")
    if reason:
        return LogError(f"{path}: {reason}")
    return LogError(f"{path}: no numeric array of two samples or more in the file; save the signals as vectors")


BLOCK_BYTES = 1 << 19  # part of an array that is read at a time [bytes]
_SUFFIX = ".npy"


@dataclass(frozen=True)
class _Array:
    """An array of an archive: where it lies, and what its header says."""

    member: str
    shape: tuple[int, ...]
    is_fortran: bool
    dtype: np.dtype[Any]

    @property
    def name(self) -> str:
        return self.member.removesuffix(_SUFFIX)


@dataclass(frozen=True)
class _Signal:
    """A column: its array, where its first item lies in it, how far apart its items are, and how many there are."""

    array: _Array
    first: int
    step: int
    rows: int


def read(path: Path) -> Table:
    """Open a NumPy archive."""
    signals: dict[str, _Signal] = {}
    scalars: list[tuple[str, float]] = []
    with _opened(path) as file:
        for array in _arrays(file):
            columns = ((name, _signal(array, index)) for name, index in places_of(array.name, array.shape))
            signals.update(at_most(path, columns, "columns"))
            if is_sampling_time(array.name, array.shape, array.dtype.kind):
                (values,) = _blocks_of(file, _Signal(array, 0, 1, 1))
                scalars.append((array.name, float(values[0])))
    if not signals:
        raise no_signal_error(path, {})
    return Table(
        path,
        tuple(signals),
        partial(_blocks, path, list(signals.values())),
        approximate_rows=max(signal.rows for signal in signals.values()),
        dt=stated_dt(path, scalars),
    )


@contextmanager
def _opened(path: Path) -> Iterator[zipfile.ZipFile]:
    with damage_as_log_error(path, ".npz archive", "save it with numpy.savez"), open_zip(path) as file:
        yield file


def _arrays(file: zipfile.ZipFile) -> Iterator[_Array]:
    """Yield the arrays of numbers; Python objects are no signals, and unsafe to load."""
    for member in file.infolist():
        if not member.filename.endswith(_SUFFIX):
            continue
        with file.open(member) as content:
            shape, is_fortran, dtype = _header(content)
        if dtype.kind in "biuf" and dtype.itemsize <= 8:
            claimed = math.prod(shape) * dtype.itemsize
            if claimed > member.file_size:
                raise ValueError(f"{member.filename} claims {claimed:,} bytes and holds {member.file_size:,}")
            yield _Array(member.filename, shape, is_fortran, dtype)


def _header(content: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    with warnings.catch_warnings(action="ignore"):  # of types that Python 2 wrote
        version = npy.read_magic(content)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        return read(content)


def _signal(array: _Array, index: tuple[int | slice, ...]) -> _Signal:
    """Return where the items of a column lie in the array as its file has it."""
    order = range(len(array.shape)) if array.is_fortran else reversed(range(len(array.shape)))
    first, step, size, rows = 0, 1, 1, 1
    for axis in order:
        at = index[axis]
        if isinstance(at, slice):
            step, rows = size, array.shape[axis]
        else:
            first += at * size
        size *= array.shape[axis]
    return _Signal(array, first, step, rows)


def _blocks(path: Path, signals: Sequence[_Signal], columns: Sequence[int]) -> Iterator[Arrays]:
    chosen = [signals[number] for number in columns]
    with _opened(path) as file:
        if len({(signal.rows, signal.step, signal.array.dtype.itemsize) for signal in chosen}) == 1:
            yield from map(list, zip(*(_blocks_of(file, signal) for signal in chosen), strict=True))
        else:
            yield [np.concatenate(list(_blocks_of(file, signal))) for signal in chosen]


def _blocks_of(file: zipfile.ZipFile, signal: _Signal) -> Iterator[FloatArray]:
    """Yield the values of a column, block by block."""
    width = signal.array.dtype.itemsize
    rows = max(1, BLOCK_BYTES // (signal.step * width))
    with file.open(signal.array.member) as content:
        _header(content)
        content.seek(signal.first * width, 1)
        for begin in range(0, signal.rows, rows):
            count = min(rows, signal.rows - begin)
            length = ((count - 1) * signal.step + 1) * width
            read = content.read(length)
            if len(read) != length:
                raise ValueError(f"it ends {length - len(read):,} bytes before its array")
            items = np.frombuffer(read, signal.array.dtype)
            if begin + count < signal.rows:
                content.seek((signal.step - 1) * width, 1)
            yield np.array(items[:: signal.step], np.float64)
