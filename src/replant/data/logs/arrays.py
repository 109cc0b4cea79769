"""Named arrays as the columns of a table, for MATLAB and npz files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant.data.logs.table import Table
from replant.errors import LogError


def columns_of(name: str, array: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the signals of an array with their names: a vector itself, a matrix along its longer side.

    Scalars, text, complex numbers and arrays of more than two dimensions are no signals.

    Examples
    --------
    >>> [name for name, _ in columns_of("udat", np.zeros((100, 2)))]
    ['udat[:,0]', 'udat[:,1]']
    >>> [name for name, _ in columns_of("u", np.zeros((1, 100)))]
    ['u']
    >>> [name for name, _ in columns_of("d", np.zeros((2, 100)))]
    ['d[0,:]', 'd[1,:]']
    """
    if array.dtype.kind not in "biuf" or array.size < 2 or array.ndim > 2:
        return
    if max(array.shape) == array.size:
        yield name, array.reshape(-1)
    elif array.shape[0] >= array.shape[1]:
        yield from ((f"{name}[:,{index}]", array[:, index]) for index in range(array.shape[1]))
    else:
        yield from ((f"{name}[{index},:]", array[index]) for index in range(array.shape[0]))


def array_table(path: Path, arrays: Iterable[tuple[str, NDArray[Any]]]) -> Table:
    """Make a table from named arrays.

    Raises
    ------
    LogError
        If none of them is a signal.

    Examples
    --------
    >>> array_table(Path("log.npz"), [("u", np.zeros(100)), ("version", np.array(7))]).names
    ('u',)
    """
    columns = [column for name, array in arrays for column in columns_of(name, array)]
    if not columns:
        raise LogError(f"{path}: no numeric array of two samples or more in the file; save the signals as vectors")
    values = [value for _, value in columns]
    return Table(
        path,
        tuple(name for name, _ in columns),
        lambda numbers: iter([[np.array(values[number], dtype=np.float64) for number in numbers]]),
        approximate_rows=max(map(len, values)),
    )
