"""MATLAB files up to version 7 (.mat): variables, and the fields of a struct as ``data.time``, ``data.udat[:,0]``."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant.data.logs.arrays import array_table
from replant.data.logs.damage import damage_refused
from replant.data.logs.table import Table
from replant.errors import LogError

_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_HEADER_BYTES = 128  # text that names the version; in a v7.3 file 512 bytes of it come before the magic


def read(path: Path) -> Table:
    """Open a MATLAB file of version 4, 5, 6 or 7.

    Raises
    ------
    LogError
        If it is a v7.3 (HDF5) file or damaged, or holds no signal.
    """
    with path.open("rb") as file:
        head = file.read(_HEADER_BYTES)
    if head.startswith((_HDF5_MAGIC, b"MATLAB 7.3")):
        raise LogError(f"{path}: a MATLAB v7.3 (HDF5) file; save it again in MATLAB with save(..., '-v7')")
    return array_table(path, _arrays(_load(path)))


def _load(path: Path) -> dict[str, Any]:
    import scipy.io

    with (
        warnings.catch_warnings(action="ignore"),  # about variables that are no signals
        damage_refused(path, "MATLAB file", "save it again in MATLAB with save(..., '-v7')"),
    ):
        contents: dict[str, Any] = scipy.io.loadmat(path)
    return contents


def _arrays(contents: dict[str, Any]) -> Iterator[tuple[str, NDArray[Any]]]:
    for name, value in contents.items():
        if name.startswith("__") or not isinstance(value, np.ndarray):
            continue
        if value.dtype.names is None:
            yield name, value
        elif value.size == 1:
            fields = value.reshape(-1)[0]
            for field in value.dtype.names:
                if isinstance(fields[field], np.ndarray):
                    yield f"{name}.{field}", fields[field]
