"""MATLAB files (.mat): variables, and the fields of a struct as ``data.time``, ``data.udat[:,0]``.

Files of version 7.3 are HDF5 files, see `hdf5`.  The others are read with SciPy.
"""

from __future__ import annotations

import contextlib
import math
import struct
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant.data.logs import hdf5, limits
from replant.data.logs.arrays import array_table, is_sampling_time, places_of
from replant.data.logs.damage import damage_as_log_error
from replant.data.logs.table import Table

_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_HEADER_BYTES = 512 + len(_HDF5_MAGIC)
"""Text that names the version, and, in a v7.3 file, the magic number after 512 bytes of it [bytes]."""
_SAVE_AGAIN = "save it again in MATLAB with save(..., '-v7')"
_COMPRESSED = 15  # kind of an element of a file that holds another one, compressed [code]
_FIRST_ELEMENT = 128  # place of the first element [bytes]
_PART = 1 << 18  # part of a compressed element that is unpacked at a time, to see how long it is [bytes]
_NUMERIC = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
_NO_SIGNALS = {"char", "cell", "sparse", "function"}


def read(path: Path) -> Table:
    """Open a MATLAB file of any version."""
    with path.open("rb") as file:
        head = file.read(_HEADER_BYTES)
    if head.startswith((_HDF5_MAGIC, b"MATLAB 7.3")) or head.endswith(_HDF5_MAGIC):
        return hdf5.read_matlab(path)
    with damage_as_log_error(path, "MATLAB file", _SAVE_AGAIN):
        contents = _load(path, head)
        return array_table(path, list(_signals(contents)), hdf5.reasons(_objects(contents)))


def _load(path: Path, head: bytes) -> dict[str, Any]:
    """Return the variables that may hold signals."""
    import scipy.io

    sizes = list(limits.at_most(path, _sizes(path, head), "variables"))
    chosen, held = None, sum(sizes)
    with warnings.catch_warnings(action="ignore"):  # SciPy warns about variables that are no signals
        with contextlib.suppress(TypeError):  # SciPy lists no objects of classes of MATLAB's
            listed = scipy.io.whosmat(str(path))
            chosen = [(at, *about) for at, about in enumerate(listed) if _may_be_signal(*about)]
            of = sizes if len(sizes) == len(listed) else [max(sizes, default=0)] * len(listed)
            held = sum(
                min(8 * math.prod(shape), 8 * of[at]) if kind in _NUMERIC else of[at] for at, _, shape, kind in chosen
            )
        limits.allow(held=held)
        names = None if chosen is None else [name for _, name, *_ in chosen]
        contents: dict[str, Any] = scipy.io.loadmat(str(path), variable_names=names)
    return contents


def _may_be_signal(name: str, shape: tuple[int, ...], kind: str) -> bool:
    if kind in _NUMERIC:
        return any(True for _ in places_of(name, shape)) or is_sampling_time(name, shape, "f")
    return kind not in _NO_SIGNALS


def _sizes(path: Path, head: bytes) -> Iterator[int]:
    """Yield the unpacked lengths of the variables in the order of the file, in bytes."""
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


def _signals(contents: dict[str, Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the numeric arrays among variables with their names, those in a struct as ``data.time``."""
    for name, value in _arrays(contents):
        if value.dtype.kind in "biuf" and (value.size > 1 or is_sampling_time(name, value.shape, value.dtype.kind)):
            yield name, value


def _arrays(contents: dict[str, Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    for name, value in contents.items():
        if name.startswith("__") or not isinstance(value, np.ndarray):
            continue
        if value.dtype.names is None:
            yield name, value
        elif value.size == 1 and not _is_opaque(value):
            fields = value.reshape(-1)[0]
            for field in value.dtype.names:
                if isinstance(fields[field], np.ndarray):
                    yield f"{name}.{field}", fields[field]
                    if field == "signals":
                        yield from _simulink_signals(f"{name}.{field}", fields[field])


def _simulink_signals(name: str, signals: NDArray[Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield the values of what Simulink logs as a structure with time."""
    if signals.dtype.names and "values" in signals.dtype.names:
        for number, signal in enumerate(signals.reshape(-1), 1):
            place = name if signals.size == 1 else f"{name}({number})"
            yield f"{place}.values", signal["values"]


def _is_opaque(value: Any) -> bool:
    """Whether it is an object of a class of MATLAB's, of which SciPy knows the name alone."""
    return value.dtype.names is not None and {"s0", "s1", "s2", "arr"} <= set(value.dtype.names)


def _objects(contents: dict[str, Any]) -> dict[str, str]:
    """Return the names of the objects that cannot be read, with their classes."""
    found = {}
    for value in contents.values():
        if hasattr(value, "dtype") and _is_opaque(value):
            for one in value.reshape(-1):
                name, kind = (bytes(part).decode(errors="replace") for part in (one["s0"], one["s2"]))
                found[name] = kind
    return found
