"""HDF5 files (.h5, .hdf5) and MATLAB files of version 7.3, with h5py: data sets by their path, as ``rig/speed``.

MATLAB stores each array with its dimensions reversed, and a struct as a group, whose fields are called ``data.speed``
as in its older files.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant.data.logs import limits
from replant.data.logs.arrays import is_sampling_time, no_signal_error, places_of, stated_dt
from replant.data.logs.damage import damage_as_log_error
from replant.data.logs.table import Table
from replant.errors import MissingDependencyError

_MATLAB = "a MATLAB v7.3 (HDF5) file; save it again in MATLAB with save(..., '-v7')"
BLOCK_ROWS = 1 << 16  # rows read at a time, or one chunk where that has more [rows]
DEEPEST = 64  # groups within each other that are looked into [count]
MOST_UNWRITTEN = 16  # length of a data set, of which a recorder wrote only a part, in lengths of that part [times]

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
    """Open an HDF5 file.  Its columns are vectors, the columns of matrices, and the fields of tables."""
    return _table(path, matlab=False)


def read_matlab(path: Path) -> Table:
    """Open a MATLAB file of version 7.3."""
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
    left_out: dict[str, str] = {}
    with _opened(path, matlab=matlab) as file:
        for place, dataset in _datasets(path, file):
            name = place.replace("/", ".") if matlab else place
            reason = _reason_not_to_read(path, name, dataset)
            if reason:
                left_out[name] = reason
                continue
            kind = dataset.attrs.get(_CLASS)
            if matlab and _DECODED in dataset.attrs:
                objects[name] = bytes(kind or b"").decode(errors="replace")
            elif not matlab or kind in _NUMBERS:
                signals += _signals_in(name, place, dataset, matlab=matlab)
                if is_sampling_time(name, dataset.shape or (), dataset.dtype.kind):
                    scalars.append((name, float(np.asarray(dataset[()]).reshape(-1)[0])))
            if len(signals) > limits.MOST_COLUMNS:
                raise limits.too_many_error(path, "columns")
    left_out |= reasons(objects)
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


def _datasets(path: Path, file: Any) -> Iterator[tuple[str, Any]]:
    """Yield the data sets with their paths; what begins with # is MATLAB's own."""
    import h5py

    found: list[tuple[str, Any]] = []
    objects = 0

    def visit(name: str, item: Any) -> None:  # links to other files are not followed
        nonlocal objects
        objects += 1
        if objects > limits.MOST_COLUMNS:
            raise limits.too_many_error(path, "groups and data sets")
        if name.count("/") >= DEEPEST:
            raise limits.too_many_error(path, "groups within each other", DEEPEST)
        if isinstance(item, h5py.Dataset) and not name.startswith("#"):
            found.append((name, item))

    file.visititems(visit)
    yield from found


def _reason_not_to_read(path: Path, name: str, dataset: Any) -> str:
    """Return why the samples of a data set are not to be had from this file; empty where they are."""
    if dataset.external or dataset.is_virtual:
        return f"{name} lies in another file, which is not read; copy its samples into this one, as h5repack does"
    if dataset.shape is None or dataset.id.get_storage_size() == 0:
        return f"{name} holds no samples: nothing was written into it" if dataset.size else ""
    claimed = math.prod(dataset.shape) * dataset.dtype.itemsize
    if dataset.chunks is None:
        written = min(dataset.id.get_storage_size(), path.stat().st_size)
    else:
        written = dataset.id.get_num_chunks() * math.prod(dataset.chunks) * dataset.dtype.itemsize
    if claimed > MOST_UNWRITTEN * written + BLOCK_ROWS * 8:
        part = f"about {written // max(1, claimed // dataset.shape[0]):,} of its {dataset.shape[0]:,} rows"
        return f"{name} claims samples that it does not hold: {part} were written; write it again"
    return ""


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
    chosen = [signals[number] for number in columns]
    with _opened(path, matlab=matlab) as file:
        rows = {signal.rows for signal in chosen}
        step = max((_block_rows(file[signal.dataset], signal, matlab=matlab) for signal in chosen), default=1)
        if len(rows) != 1:  # which the caller says; none can be cut into blocks
            limits.allow(held=8 * sum(signal.rows for signal in chosen))
            step = max(rows, default=0)
        for begin in range(0, max(rows, default=0), max(1, step)):
            yield [_values(file, signal, slice(begin, begin + step), matlab=matlab) for signal in chosen]


def _block_rows(dataset: Any, signal: _Signal, *, matlab: bool) -> int:
    """Return the rows to read at a time: whole chunks, which are unpacked as a whole."""
    if dataset.chunks is None:
        return BLOCK_ROWS
    index = signal.index[::-1] if matlab else signal.index
    rows = next(length for length, one in zip(dataset.chunks, index, strict=True) if isinstance(one, slice))
    chunk, whole = math.prod(dataset.chunks), math.prod(dataset.shape)
    limits.allow(held=8 * (min(chunk, whole) + min(rows, signal.rows)))
    return int(rows * max(1, BLOCK_ROWS // rows))


def _values(file: Any, signal: _Signal, rows: slice, *, matlab: bool) -> NDArray[np.float64]:
    at = tuple(rows if isinstance(one, slice) else one for one in signal.index)
    values = file[signal.dataset][at[::-1] if matlab else at]
    if signal.field is not None:
        values = values[signal.field]
    return np.array(values, np.float64).reshape(-1)
