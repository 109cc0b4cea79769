"""Arrays as the columns of a table; and NumPy archives (.npz), read block by block."""

from __future__ import annotations

import math
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from replant.errors import LogError
from replant.logs.table import Arrays, Table, at_most, damage_as_log_error, open_zip
from replant.numerics.arguments import FloatArray

SAMPLING_TIME = "Ts"  # name of a scalar, perhaps in a struct, that is the sampling time in s


@dataclass(frozen=True)
class Signal:
    """A column: its name, the array that it lies in, its index there, and its length."""

    name: str
    array: Any
    index: tuple[int | slice, ...]
    rows: int


def signals_in(name: str, array: Any) -> Iterator[Signal]:
    """Yield the signals in an array, by its shape: a vector itself, a matrix along its longer side."""
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
    """Return whether an array is a number that states the sampling time."""
    own = name.replace("/", ".").rpartition(".")[2].partition("{")[0]  # Ts{2}: in a cell
    return own == SAMPLING_TIME and array.dtype.kind in "iuf" and int(np.prod(array.shape)) == 1


def table_of_arrays(
    path: Path,
    found: Iterable[tuple[str, Any]],
    blocks: Callable[[Sequence[Signal]], Iterator[Arrays]],
    number: Callable[[Any], float],
    left_out: Mapping[str, str],
) -> Table:
    """Make a table from named arrays of numbers, which have a shape and a dtype; one number called Ts is dt.

    ``blocks`` reads signals, and ``number`` an array of one number; ``left_out`` says why something is no signal.
    """
    scalars: list[tuple[str, float]] = []

    def each() -> Iterator[Signal]:
        for name, array in found:
            yield from signals_in(name, array)
            if is_sampling_time(name, array):
                scalars.append((name, number(array)))

    signals = list(at_most(path, each(), "columns"))
    if not signals:
        reason = next(iter(left_out.values()), "") or (
            "no numeric array of two samples or more in the file; save the signals as vectors"
        )
        raise LogError(f"{path}: {reason}")
    return Table(
        path,
        tuple(signal.name for signal in signals),
        lambda columns: blocks([signals[number] for number in columns]),
        approximate_rows=max(signal.rows for signal in signals),
        dt=_stated_dt(path, scalars),
        left_out=left_out,
    )


def _stated_dt(path: Path, scalars: Sequence[tuple[str, float]]) -> float | None:
    """Return the sampling time that scalars called Ts state; None if there is none, or they differ."""
    if len({value for _, value in scalars}) != 1:
        return None
    name, value = scalars[0]
    if not 0.0 < value < np.inf:
        raise LogError(f"{path}: {name} is the sampling time, and must be finite and positive; it is {value}")
    return value


BLOCK_BYTES = 1 << 19  # part of an array that is read at a time [bytes]
_SUFFIX = ".npy"


@dataclass(frozen=True)
class _Array:
    """An array of an archive: where it lies, and what its header says."""

    member: str
    shape: tuple[int, ...]
    is_fortran: bool
    dtype: np.dtype[Any]


def read(path: Path) -> Table:
    """Open a NumPy archive."""
    with _opened(path) as file:
        return table_of_arrays(path, _arrays(file), partial(_blocks, path), partial(_number, file), {})


@contextmanager
def _opened(path: Path) -> Iterator[zipfile.ZipFile]:
    with damage_as_log_error(path, ".npz archive", "save it with numpy.savez"), open_zip(path) as file:
        yield file


def _arrays(file: zipfile.ZipFile) -> Iterator[tuple[str, _Array]]:
    """Yield the arrays of numbers; Python objects are no signals, and unsafe to load."""
    for member in {each.filename: each for each in file.infolist()}.values():
        if not member.filename.endswith(_SUFFIX):
            continue
        with file.open(member) as content:
            shape, is_fortran, dtype = _header(content)
        if dtype.kind in "biuf" and dtype.itemsize <= 8:
            claimed = math.prod(shape) * dtype.itemsize
            if claimed > member.file_size:
                raise ValueError(f"{member.filename} claims {claimed:,} bytes and holds {member.file_size:,}")
            yield member.filename.removesuffix(_SUFFIX), _Array(member.filename, shape, is_fortran, dtype)


def _header(content: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    with warnings.catch_warnings(action="ignore"):  # of types that Python 2 wrote
        version = npy.read_magic(content)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        return read(content)


def _number(file: zipfile.ZipFile, array: _Array) -> float:
    (values,) = _parts(file, Signal("", array, (), 1), 1)
    return float(values[0])


def _blocks(path: Path, signals: Sequence[Signal]) -> Iterator[Arrays]:
    widest = max((_place(signal)[1] * signal.array.dtype.itemsize for signal in signals), default=1)
    with _opened(path) as file:
        parts = [_parts(file, signal, max(1, BLOCK_BYTES // widest)) for signal in signals]
        if len({signal.rows for signal in signals}) == 1:
            yield from map(list, zip(*parts, strict=True))
        else:  # which the caller says; none can be cut into blocks
            yield [np.concatenate(list(each)) for each in parts]


def _place(signal: Signal) -> tuple[int, int]:
    """Return where the first item of a column lies in the array as its file has it, and how far apart its items are."""
    shape, first, step, size = signal.array.shape, 0, 1, 1
    axes = list(enumerate(signal.index))
    for axis, at in axes if signal.array.is_fortran else reversed(axes):
        if isinstance(at, slice):
            step = size
        else:
            first += at * size
        size *= shape[axis]
    return first, step


def _parts(file: zipfile.ZipFile, signal: Signal, rows: int) -> Iterator[FloatArray]:
    """Yield the values of a column, some rows at a time."""
    (first, step), width = _place(signal), signal.array.dtype.itemsize
    with file.open(signal.array.member) as content:
        _header(content)
        content.seek(first * width, 1)
        for begin in range(0, signal.rows, rows):
            count = min(rows, signal.rows - begin)
            length = ((count - 1) * step + 1) * width
            read = content.read(length)
            if len(read) != length:
                raise ValueError(f"it ends {length - len(read):,} bytes before its array")
            items = np.frombuffer(read, signal.array.dtype)
            if begin + count < signal.rows:
                content.seek((step - 1) * width, 1)
            yield np.array(items[::step], np.float64)
