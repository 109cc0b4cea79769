"""Named arrays as the columns of a table, for MATLAB, HDF5 and npz files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant.data.logs.table import Table
from replant.errors import LogError

SAMPLING_TIME = "Ts"  # name of a scalar, perhaps in a struct, that is the sampling time in s

_NOTHING: Mapping[str, str] = MappingProxyType({})


def columns_of(name: str, array: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the signals of an array with their names: a vector itself, a matrix along its longer side.

    Scalars, text, complex numbers and arrays of more than two dimensions, those of length 1 apart, are no signals.

    Examples
    --------
    >>> [name for name, _ in columns_of("udat", np.zeros((100, 2)))]
    ['udat[:,0]', 'udat[:,1]']
    >>> [name for name, _ in columns_of("u", np.zeros((1, 1, 100)))]
    ['u']
    >>> [name for name, _ in columns_of("d", np.zeros((2, 100)))]
    ['d[0,:]', 'd[1,:]']
    """
    if array.dtype.kind in "biuf":
        yield from ((of_column, array[index].reshape(-1)) for of_column, index in places_of(name, array.shape))


def places_of(name: str, shape: Sequence[int]) -> Iterator[tuple[str, tuple[int | slice, ...]]]:
    """Yield name and index of each signal in an array of a shape; see `columns_of`.

    Examples
    --------
    >>> list(places_of("d", (2, 100)))
    [('d[0,:]', (0, slice(None, None, None))), ('d[1,:]', (1, slice(None, None, None)))]
    """
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
    """Return the sampling time that scalars called Ts state; None if there is none, or they differ.

    >>> stated_dt(Path("log.mat"), [("data.Ts", 0.1), ("Ts", 0.1)])
    0.1
    """
    if len({value for _, value in scalars}) != 1:
        return None
    name, value = scalars[0]
    if not 0.0 < value < np.inf:
        raise LogError(f"{path}: {name} is the sampling time, and must be finite and positive; it is {value}")
    return value


def is_sampling_time(name: str, shape: Sequence[int], kind: str) -> bool:
    """Return whether a variable is a number that states the sampling time.

    Examples
    --------
    >>> is_sampling_time("data.Ts", (1, 1), "f"), is_sampling_time("Ts", (100,), "f")
    (True, False)
    """
    return name.replace("/", ".").rpartition(".")[2] == SAMPLING_TIME and kind in "iuf" and int(np.prod(shape)) == 1


def array_table(
    path: Path, arrays: Iterable[tuple[str, NDArray[Any]]], left_out: Mapping[str, str] = _NOTHING
) -> Table:
    """Make a table from named arrays; a number called Ts is the sampling time.

    >>> array_table(Path("log.npz"), [("u", np.zeros(100)), ("version", np.array(7))]).names
    ('u',)
    """
    found = list(arrays)
    columns = [column for name, array in found for column in columns_of(name, array)]
    if not columns:
        raise no_signal_error(path, left_out)
    values = [value for _, value in columns]
    scalars = [
        (name, float(array.reshape(-1)[0]))
        for name, array in found
        if is_sampling_time(name, array.shape, array.dtype.kind)
    ]
    return Table(
        path,
        tuple(name for name, _ in columns),
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
