"""MATLAB files (.mat): variables, and the fields of a struct as ``data.time``, ``data.udat[:,0]``.

Files of version 7.3 are HDF5 files, see `hdf5`.  The others are read with SciPy.
SciPy's parser is compiled, and may crash on damaged bytes: it runs in a separate process (`matlab_process`).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from replant.data.logs import hdf5, matlab_process, parser_process
from replant.data.logs.arrays import array_table
from replant.data.logs.damage import damage_as_log_error
from replant.data.logs.parser_process import Parser
from replant.data.logs.table import Table
from replant.errors import LogError

MEMORY = 4 << 30
"""Memory that the reading process may take for any file: far above the need of a record, which compression makes at
most about ten times smaller [bytes].
"""
SECONDS = 120.0
"""Time that the reading process may take for any file [s]."""

_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_HEADER_BYTES = 512 + len(_HDF5_MAGIC)
"""Text that names the version, and, in a v7.3 file, the magic number after 512 bytes of it [bytes]."""
_SAVE_AGAIN = "save it again in MATLAB with save(..., '-v7')"


def read(path: Path) -> Table:
    """Open a MATLAB file of any version.

    Raises
    ------
    LogError
        If it is damaged or holds no signal.
    MissingDependencyError
        If it is a v7.3 (HDF5) file, and h5py is not installed.
    """
    with path.open("rb") as file:
        head = file.read(_HEADER_BYTES)
        if head.startswith((_HDF5_MAGIC, b"MATLAB 7.3")) or head.endswith(_HDF5_MAGIC):
            return hdf5.read_matlab(path)
        file.seek(0)
        with damage_as_log_error(path, "MATLAB file", _SAVE_AGAIN):
            if not parser_process.is_possible():
                contents = matlab_process.load(file)
                arrays, objects = list(matlab_process.signals(contents)), matlab_process.objects(contents)
            else:
                arrays, objects = _answered(read_in_subprocess(path, file))
    return array_table(path, arrays, hdf5.reasons(objects))


def read_in_subprocess(path: Path, file: BinaryIO) -> bytes:
    """Return the arrays of a MATLAB file, as bytes in the format of `matlab_process`, read by a separate process.

    Raises
    ------
    LogError
        If the process does not start, crashes or takes too long.
    """
    return parser_process.run(_parser(), path, matlab_process.__file__, stdin=file)


def process_error(path: Path, code: int) -> LogError:
    """Return the error for a process that ended before it had read the file.

    Examples
    --------
    >>> str(process_error(Path("log.mat"), 3))
    'log.mat: the process that reads it was ended (code 3); free some memory, and try again'
    """
    return parser_process.process_error(_parser(), path, code)


def _parser() -> Parser:
    return Parser("a MATLAB file", "SciPy", _SAVE_AGAIN, SECONDS, MEMORY)


def _answered(answer: bytes) -> tuple[list[tuple[str, NDArray[Any]]], dict[str, str]]:
    message, at = parser_process.message_of(answer)
    arrays = []
    for name, kind, shape, order in message["arrays"]:
        flat = np.frombuffer(answer, np.dtype(kind), math.prod(shape), at)
        arrays.append((name, flat.reshape(shape, order=order)))
        at += flat.nbytes
    return arrays, message.get("objects", {})
