"""HDF5 files (.h5, .hdf5), and MATLAB files (.mat) of every version: h5py reads version 7.3, SciPy the older ones.

In version 7.3 MATLAB stores each array with reversed dimensions and a struct as a group; the fields are called
``logs.speed`` in every version.
"""

from __future__ import annotations

import contextlib
import math
import re
import struct
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant.logs.arrays import BLOCK_ROWS, Signal, is_sampling_time, signals_in, table_of_arrays
from replant.logs.parser_process import allow
from replant.logs.sampling_time import unit_of_stamps
from replant.logs.table import MOST_COLUMNS, Table, at_most, damage_as_log_error, needed, too_many_error
from replant.logs.text_cells import with_units

_SAVE_AGAIN = "save it again in MATLAB with save(..., '-v7')"
_MATLAB = f"a MATLAB v7.3 (HDF5) file; {_SAVE_AGAIN}"
DEEPEST = 64  # deepest nesting of groups that is read [count]
MOST_UNWRITTEN = 16  # largest claimed size of a data set that was written in part [times the size of that part]
_UNIT = re.compile(r"\s*\[?\s*([^\[\]()]{1,30}?)\s*\]?\s*(?: since .*)?$", re.DOTALL)
_CLASS, _DECODED = "MATLAB_class", "MATLAB_object_decode"
_NUMERIC = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}


@dataclass(frozen=True, eq=False)
class _Array:
    """A data set of an open file, or a field of a data set with several."""

    dataset: Any
    field: str | None
    dtype: np.dtype[Any]
    is_reversed: bool  # whether the file has the dimensions in reverse order, as MATLAB writes them

    @property
    def shape(self) -> tuple[int, ...]:
        shape: tuple[int, ...] = self.dataset.shape
        return shape[::-1] if self.is_reversed else shape

    def __getitem__(self, index: tuple[int | slice, ...]) -> Any:
        values = self.dataset[index[::-1] if self.is_reversed else index]
        return values if self.field is None else values[self.field]


def read_hdf5(path: Path) -> Table:
    """Open an HDF5 file; the columns are vectors, the columns of matrices, and the fields of tables."""
    h5py = needed(path, "h5py", "reading HDF5 needs h5py", "'replant[hdf5]'")
    guard = partial(damage_as_log_error, path, "HDF5 file", "write it again, or copy it again")
    return _table(path, h5py, guard, matlab=False)


def reasons(objects: Mapping[str, str]) -> dict[str, str]:
    """Return for each MATLAB object why it cannot be read, and the remedy."""
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


def _table(path: Path, h5py: Any, guard: Callable[[], AbstractContextManager[None]], *, matlab: bool) -> Table:
    """Return the table of a file; the file stays open as long as the table exists."""
    left_out: dict[str, str] = {}
    with guard():
        file = h5py.File(path, "r")
    return table_of_arrays(path, _arrays(path, file, left_out, matlab=matlab), left_out, guard, _block_rows)


def _arrays(path: Path, file: Any, left_out: dict[str, str], *, matlab: bool) -> Iterator[tuple[str, _Array]]:
    """Yield the numeric arrays with their names; the reasons for unreadable ones go into ``left_out``."""
    objects: dict[str, str] = {}
    for place, dataset in _datasets(path, file):
        name = place.replace("/", ".") if matlab else place
        if reason := _reason_not_to_read(path, name, dataset):
            left_out[name] = reason
            continue
        given = dataset.attrs.get(_CLASS)
        kind = given.decode(errors="replace") if isinstance(given, bytes) else ""
        if matlab and _DECODED in dataset.attrs:
            objects[name] = kind
        elif dataset.shape is not None and (not matlab or kind in _NUMERIC):
            fields: dict[str | None, Any] = {None: dataset.dtype}
            if dataset.dtype.names is not None:  # in a table of one row, Ts would be taken for the sampling time
                fields = {field: dataset.dtype[field] for field in dataset.dtype.names if dataset.size > 1}
            for field, dtype in fields.items():
                if dtype.kind in "biuf" and dtype.shape == ():
                    called = _with_unit(name, dataset) if field is None else f"{name}.{field}"
                    yield called, _Array(dataset, field, dtype, matlab)
    left_out |= reasons(objects)


def _with_unit(name: str, dataset: Any) -> str:
    """Return the name of a data set with the unit that its attribute states, of netCDF as in "days since 1970"."""
    given = [dataset.attrs[key] for key in dataset.attrs if key.lower() in ("unit", "units")]
    texts = [text.decode(errors="replace") if isinstance(text, bytes) else text for text in np.ravel(given[:1])]
    is_column = dataset.size > 1 or is_sampling_time(name, dataset)
    unit = _UNIT.match(texts[0]) if is_column and texts and isinstance(texts[0], str) else None
    return name if unit is None else with_units([name], [unit[1]])[0]


def _datasets(path: Path, file: Any) -> list[tuple[str, Any]]:
    """Return the data sets with their paths; names that begin with # are internal to MATLAB."""
    import h5py

    found: list[tuple[str, Any]] = []
    objects = 0

    def visit(name: str, item: Any) -> None:  # links to other files are not followed
        nonlocal objects
        objects += 1
        if objects > MOST_COLUMNS:
            raise too_many_error(path, "groups and data sets")
        if name.count("/") >= DEEPEST:
            raise too_many_error(path, "groups within each other", DEEPEST)
        if isinstance(item, h5py.Dataset) and not name.startswith("#"):
            found.append((name, item))

    file.visititems(visit)
    return found


def _reason_not_to_read(path: Path, name: str, dataset: Any) -> str:
    """Return why the samples of a data set cannot be read from this file; empty if they can."""
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


def _block_rows(signal: Signal) -> int:
    """Return the number of rows to read at a time: whole chunks, as h5py unpacks each chunk as a whole."""
    dataset, index = signal.array.dataset, signal.index[::-1] if signal.array.is_reversed else signal.index
    if dataset.chunks is None:
        return BLOCK_ROWS
    rows = next(length for length, one in zip(dataset.chunks, index, strict=True) if isinstance(one, slice))
    chunk, whole = math.prod(dataset.chunks), math.prod(dataset.shape)
    allow(held=8 * (min(chunk, whole) + min(rows, signal.rows)))
    return int(rows * max(1, BLOCK_ROWS // rows))


_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_HEADER_BYTES = 512 + len(_HDF5_MAGIC)  # text with the version, and in a v7.3 file the magic number [bytes]
_COMPRESSED = 15  # type of an element that holds a compressed element [code]
_FIRST_ELEMENT = 128  # offset of the first element [bytes]
_PART = 1 << 18  # bytes unpacked at a time to measure a compressed element [bytes]
_NO_SIGNALS = {"char", "cell", "sparse", "function"}


def read_matlab(path: Path) -> Table:
    """Open a MATLAB file of any version."""
    with path.open("rb") as file:
        head = file.read(_HEADER_BYTES)
    if head.startswith((_HDF5_MAGIC, b"MATLAB 7.3")) or head.endswith(_HDF5_MAGIC):
        h5py = needed(path, "h5py", f"{_MATLAB}, or install h5py", "'replant[hdf5]'")
        return _table(path, h5py, partial(damage_as_log_error, path, "MATLAB v7.3 file", _MATLAB), matlab=True)
    guard = partial(damage_as_log_error, path, "MATLAB file", _SAVE_AGAIN)
    with guard():
        contents = _load(path, head)
        return table_of_arrays(path, _arrays_in(contents), reasons(_objects(contents)), guard)


def _load(path: Path, head: bytes) -> dict[str, Any]:
    """Return the variables that may hold signals."""
    import scipy.io

    sizes = list(at_most(path, _sizes(path, head), "variables"))
    chosen, held = None, sum(sizes)
    with warnings.catch_warnings(action="ignore"):  # SciPy warns about variables of other kinds
        with contextlib.suppress(TypeError):  # SciPy cannot list a file with objects of MATLAB classes
            listed = scipy.io.whosmat(str(path))
            chosen = [(at, *about) for at, about in enumerate(listed) if _may_be_signal(*about)]
            of = sizes if len(sizes) == len(listed) else [max(sizes, default=0)] * len(listed)
            held = sum(
                min(8 * math.prod(shape), 8 * of[at]) if kind in _NUMERIC else of[at] for at, _, shape, kind in chosen
            )
        allow(held=held)
        names = None if chosen is None else [name for _, name, *_ in chosen]
        contents: dict[str, Any] = scipy.io.loadmat(str(path), variable_names=names)
    return contents


def _may_be_signal(name: str, shape: tuple[int, ...], kind: str) -> bool:
    if kind in _NUMERIC:
        array = np.broadcast_to(0.0, shape)
        return any(True for _ in signals_in(name, array)) or is_sampling_time(name, array)
    return kind not in _NO_SIGNALS


def _sizes(path: Path, head: bytes) -> Iterator[int]:
    """Yield the unpacked size of each variable in bytes, in the order of the file."""
    if len(head) < _FIRST_ELEMENT or head[126:128] not in (b"IM", b"MI"):  # version 4, which is not compressed
        yield path.stat().st_size
        return
    tag = struct.Struct("<II" if head[126:128] == b"IM" else ">II")
    with path.open("rb") as file:
        file.seek(_FIRST_ELEMENT)
        while len(read := file.read(tag.size)) == tag.size:
            kind, length = tag.unpack(read)
            end = file.tell() + length
            yield _unpacked_size(file, length) if kind == _COMPRESSED else length
            file.seek(end)


def _unpacked_size(file: Any, length: int) -> int:
    unpacker, size = zlib.decompressobj(), 0
    while length > 0 and (packed := file.read(min(length, _PART))):
        length -= len(packed)
        while packed:
            size += len(unpacker.decompress(packed, _PART))
            packed = unpacker.unconsumed_tail
    return size


def _arrays_in(contents: dict[str, Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the numeric arrays among variables with their names; a field of a struct is ``logs.time``."""
    variables = {name: each for name, each in contents.items() if name[:2] != "__" and isinstance(each, np.ndarray)}
    for deep in (False, True):  # nested structs are read only if the outer ones hold no signal
        found: list[tuple[str, NDArray[Any]]] = []
        for name, value in variables.items():
            if value.dtype.names is None:
                found.append((name, value))
            elif value.size == 1 and not _is_opaque(value):  # a struct, or an object whose fields SciPy reads
                found += _in_struct(name, value, deep=deep)
        found = [(name, value) for name, value in found if value.dtype.kind in "biuf"]
        if any(value.size > 1 for _, value in found):
            return iter(found)
    return iter(())


def _in_struct(name: str, value: NDArray[Any], *, deep: bool) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the arrays in a struct or an array of structs; if ``deep``, also those of nested structs."""
    for of_one, fields in _numbered(name, value, "()"):
        unit = _unit_of_time(fields)
        for field in value.dtype.names or ():
            for place, held in _in_cells(f"{of_one}.{field}", fields[field]):
                if field == "signals" and held.dtype.names is not None:  # Simulink's format "structure with time"
                    named = _numbered(place, held, "()") if "values" in held.dtype.names else ()
                    yield from ((f"{one}.values", signal["values"]) for one, signal in named)
                elif deep and held.dtype.names is not None and not _is_opaque(held):
                    yield from _in_struct(place, held, deep=deep)
                elif not is_sampling_time(place, held):
                    yield place, held
                elif unit is not None:
                    yield place, held * unit


def _numbered(name: str, values: NDArray[Any], marks: str) -> Iterator[tuple[str, Any]]:
    """Yield the items of an array with their names; several items have their number in brackets."""
    for number, value in enumerate(values.reshape(-1), 1):
        yield name if values.size == 1 else f"{name}{marks[0]}{number}{marks[1]}", value


def _in_cells(name: str, value: Any) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the array of a field, or the arrays in its cells: an iddata object has a cell for each experiment."""
    if isinstance(value, np.ndarray):
        cells = _numbered(name, value, "{}") if value.dtype == object else [(name, value)]
        yield from ((place, cell) for place, cell in cells if isinstance(cell, np.ndarray))


def _unit_of_time(fields: Any) -> float | None:
    """Return the unit of a struct's times in s, which an iddata object states as a word; None if it is unknown."""
    stated = fields["TimeUnit"] if "TimeUnit" in fields.dtype.names else None
    if not isinstance(stated, np.ndarray) or stated.size != 1:
        return 1.0
    unit = unit_of_stamps(f"t [{stated.item()}]", np.empty(0))
    return None if unit.refused else unit.seconds


def _is_opaque(value: Any) -> bool:
    """Return whether a value is an object of a MATLAB class, of which SciPy reads only the name."""
    return value.dtype.names is not None and {"s0", "s1", "s2", "arr"} <= set(value.dtype.names)


def _objects(contents: dict[str, Any]) -> dict[str, str]:
    opaque = [value for value in contents.values() if hasattr(value, "dtype") and _is_opaque(value)]
    return {
        bytes(one["s0"]).decode(errors="replace"): bytes(one["s2"]).decode(errors="replace")
        for value in opaque
        for one in value.reshape(-1)
    }
