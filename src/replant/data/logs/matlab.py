"""MATLAB files (.mat): variables, and the fields of a struct as ``data.time``, ``data.udat[:,0]``.

Files of version 7.3 are HDF5 files, see `hdf5`.  The others are read with SciPy.
SciPy's parser is compiled, and may crash on damaged bytes: it runs in a separate process (`matlab_process`).
"""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from replant.data.logs import hdf5, matlab_process
from replant.data.logs.arrays import array_table
from replant.data.logs.damage import damage_as_log_error
from replant.data.logs.table import Table
from replant.errors import LogError

MEMORY = 4 << 30
"""Memory that the reading process may take: far above the need of a record, which compression makes at most about ten
times smaller [bytes].
"""

MEMORY_PER_BYTE = 32
"""The same for each byte of the file, in addition [bytes]."""
SECONDS = 120.0
"""Time that the reading process may take [s]."""
SECONDS_PER_BYTE = 1e-6
"""The same for each byte of the file, in addition [s]."""

_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_HEADER_BYTES = 512 + len(_HDF5_MAGIC)
"""Text that names the version, and, in a v7.3 file, the magic number after 512 bytes of it [bytes]."""
_SAVE_AGAIN = "save it again in MATLAB with save(..., '-v7')"
_CRASHES = {"SIGSEGV", "SIGBUS", "SIGABRT", "SIGFPE", "SIGILL"}


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
        is_alone = not sys.executable or getattr(sys, "frozen", False)  # Python is part of a program: none to start
        with damage_as_log_error(path, "MATLAB file", _SAVE_AGAIN):
            if is_alone:
                contents = matlab_process.load(file)
                arrays, objects = list(matlab_process.signals(contents)), matlab_process.objects(contents)
            else:
                answer = read_in_subprocess(path, file)
                arrays, objects = list(_signals(answer)), _message(answer).get("objects", {})
    return array_table(path, arrays, hdf5.reasons(objects))


def read_in_subprocess(path: Path, file: BinaryIO) -> bytes:
    """Return the arrays of a MATLAB file, as bytes in the format of `matlab_process`, read by a separate process.

    Raises
    ------
    LogError
        If the process does not start, crashes or takes too long.
    """
    size = os.fstat(file.fileno()).st_size
    seconds = SECONDS + SECONDS_PER_BYTE * size
    memory = MEMORY + MEMORY_PER_BYTE * size
    folders = [entry for entry in sys.path if isinstance(entry, str)]
    command = [sys.executable, "-P", matlab_process.__file__, str(memory), *folders]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            command, stdin=file, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            env=environment, timeout=seconds, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise LogError(f"{path}: the file is damaged: reading it takes over {seconds:.0f} s; {_SAVE_AGAIN}") from None
    except OSError as error:
        reason = error.strerror or error
        raise LogError(
            f"{path}: a MATLAB file is read by a second Python, and {sys.executable} did not start ({reason}); "
            "save the signals as CSV"
        ) from error
    if done.returncode != 0:
        raise process_error(path, done.returncode)
    return done.stdout


def process_error(path: Path, code: int) -> LogError:
    """Return the error for a process that ended before it had read the file.

    Examples
    --------
    >>> str(process_error(Path("log.mat"), 3))
    'log.mat: the process that reads it was ended (code 3); free some memory, and try again'
    """
    name = signal.Signals(-code).name if -code in set(signal.Signals) else f"code {code}"
    if name in _CRASHES or os.name == "nt":
        return LogError(f"{path}: the file is damaged: SciPy's reader crashed on it ({name}); {_SAVE_AGAIN}")
    return LogError(f"{path}: the process that reads it was ended ({name}); free some memory, and try again")


def _signals(answer: bytes) -> Iterator[tuple[str, NDArray[Any]]]:
    message = _message(answer)
    if "error" in message:
        raise ValueError(message["error"])
    at = answer.find(b"\n") + 1
    for name, kind, shape, order in message["arrays"]:
        dtype = np.dtype(kind)
        flat = np.frombuffer(answer, dtype, math.prod(shape), at)
        yield name, flat.reshape(shape, order=order)
        at += flat.nbytes


def _message(answer: bytes) -> Any:
    return json.loads(answer[: answer.find(b"\n") + 1])
