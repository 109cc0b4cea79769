"""HDF5 files (.h5, .hdf5) and MATLAB files of version 7.3, with h5py: data sets by their path, as ``rig/speed``.

MATLAB stores each array with its dimensions reversed, and a struct as a group, whose fields are called ``data.speed``
as in its older files.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant.data.logs.arrays import is_sampling_time, no_signal_error, places_of, stated_dt
from replant.data.logs.damage import damage_as_log_error
from replant.data.logs.table import Table
from replant.errors import MissingDependencyError

_MATLAB = "a MATLAB v7.3 (HDF5) file; save it again in MATLAB with save(..., '-v7')"
_CLASS, _DECODED = "MATLAB_class", "MATLAB_object_decode"
_INTEGERS = (f"{sign}int{bits}".encode() for sign in ("", "u") for bits in (8, 16, 32, 64))
_NUMBERS = frozenset({b"double", b"single", b"logical", *_INTEGERS})


@dataclass(frozen=True)
class _Signal:
    """Where a column lies: the path of its data set, its field if that is a table, and its index there."""

    name: str
    dataset: str
    field: str | None
    index: tuple[int | slice, ...]
    rows: int


def read(path: Path) -> Table:
    """Open an HDF5 file.  Its columns are vectors, the columns of matrices, and the fields of tables.

    Raises
    ------
    MissingDependencyError
        If h5py is not installed.
    LogError
        If it is damaged or holds no signal.
    """
    return _table(path, matlab=False)


def read_matlab(path: Path) -> Table:
    """Open a MATLAB file of version 7.3.

    Raises
    ------
    MissingDependencyError
        If h5py is not installed.
    LogError
        If it is damaged or holds no signal.
    """
    return _table(path, matlab=True)


def reasons(objects: Mapping[str, str]) -> dict[str, str]:
    """Return, for each object of a MATLAB file, why it cannot be read, and what to do.

    Examples
    --------
    >>> print(reasons({"speed": "timeseries"})["speed"])
    speed is a MATLAB timeseries, which MATLAB alone can open; there: t = speed.Time; y = speed.Data; save(...)
    """
    how = {
        "timeseries": "t = {0}.Time; y = {0}.Data; save(...)",
        "timetable": "t = seconds({0}.Properties.RowTimes); y = {0}.Variables; save(...)",
        "table": "y = {0}.Variables; save(...)",
    }
    return {
        name: f"{name} is a MATLAB {kind or 'object'}, which MATLAB alone can open; there: "
        + how.get(kind, "save its numbers as vectors").format(name)
        for name, kind in objects.items()
    }


def _table(path: Path, *, matlab: bool) -> Table:
    signals: list[_Signal] = []
    scalars: list[tuple[str, float]] = []
    objects: dict[str, str] = {}
    with _opened(path, matlab=matlab) as file:
        for place, dataset in _datasets(file):
            name = place.replace("/", ".") if matlab else place
            kind = dataset.attrs.get(_CLASS)
            if matlab and _DECODED in dataset.attrs:
                objects[name] = bytes(kind or b"").decode(errors="replace")
            elif not matlab or kind in _NUMBERS:
                signals += _signals_in(name, place, dataset, matlab=matlab)
                if is_sampling_time(name, dataset.shape or (), dataset.dtype.kind):
                    scalars.append((name, float(np.asarray(dataset[()]).reshape(-1)[0])))
    left_out = reasons(objects)
    if not signals:
        raise no_signal_error(path, left_out)
    return Table(
        path,
        tuple(signal.name for signal in signals),
        partial(_blocks, path, signals, matlab=matlab),
        approximate_rows=max(signal.rows for signal in signals),
        dt=stated_dt(path, scalars),
        left_out=left_out,
    )


@contextmanager
def _opened(path: Path, *, matlab: bool) -> Iterator[Any]:
    try:
        import h5py
    except ImportError as error:
        if matlab:
            raise MissingDependencyError(f"{path}: {_MATLAB}, or install h5py: pip install 'replant[hdf5]'") from error
        raise MissingDependencyError(f"{path}: reading HDF5 needs h5py: pip install 'replant[hdf5]'") from error
    kind, remedy = ("MATLAB v7.3 file", _MATLAB) if matlab else ("HDF5 file", "write it again, or copy it again")
    with damage_as_log_error(path, kind, remedy), h5py.File(path, "r") as file:
        yield file


def _datasets(file: Any) -> Iterator[tuple[str, Any]]:
    """Yield the data sets with their paths; what begins with # is MATLAB's own."""
    import h5py

    found: list[tuple[str, Any]] = []

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and not name.startswith("#"):
            found.append((name, item))

    file.visititems(visit)
    yield from found


def _signals_in(name: str, place: str, dataset: Any, *, matlab: bool) -> Iterator[_Signal]:
    if dataset.shape is None:
        return
    if dataset.dtype.names:
        parts = [(f"{name}.{field}", field, dataset.dtype[field]) for field in dataset.dtype.names]
    else:
        parts = [(name, None, dataset.dtype)]
    shape = dataset.shape[::-1] if matlab else dataset.shape
    for of_part, field, kind in parts:
        if kind.kind in "biuf" and kind.shape == ():
            for of_column, index in places_of(of_part, shape):
                rows = next(length for length, one in zip(shape, index, strict=True) if isinstance(one, slice))
                yield _Signal(of_column, place, field, index, rows)


def _blocks(
    path: Path, signals: Sequence[_Signal], columns: Sequence[int], *, matlab: bool
) -> Iterator[list[NDArray[np.float64]]]:
    with _opened(path, matlab=matlab) as file:
        yield [_values(file, signals[number], matlab=matlab) for number in columns]


def _values(file: Any, signal: _Signal, *, matlab: bool) -> NDArray[np.float64]:
    index = signal.index[::-1] if matlab else signal.index
    values = file[signal.dataset][index]
    if signal.field is not None:
        values = values[signal.field]
    return np.array(values, np.float64).reshape(-1)
