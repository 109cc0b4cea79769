"""A separate Python process for a parser: on damaged bytes it may crash, hang, or take memory without end.

The script is started by its path, so that it does not run the user's script again.  It serves one table: `parser_child`
says how.  The process ends with the table, or with a pass over it that is not finished.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant import errors
from replant.data.logs import parser_child
from replant.data.logs.table import Table
from replant.errors import LogError

STILL = 120.0
"""Time that the process may take to answer, beside what each byte gives: it bounds what the limit of its processor time
does not, a parser that waits, and Windows [s]."""
STILL_PER_BYTE = 1e-5  # further time for each byte of the file [s]

ENVIRONMENT = {  # each thread takes memory, and Arrow's own allocators reserve a gigabyte
    "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "ARROW_IO_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system",
}  # fmt: skip

_ENDING = 10.0  # time within which a process ends that has ended its output [s]
_CRASHES = {"SIGSEGV", "SIGBUS", "SIGABRT", "SIGFPE", "SIGILL"}
_AGAIN = "write it again, or export the log as CSV"


@dataclass(frozen=True)
class Parser:
    """What reads a kind of files."""

    kind: str
    library: str
    imports: tuple[str, ...]
    remedy: str = _AGAIN


# For each reader that is not run here; those of text and .npz files parse with Python and NumPy alone
PARSERS = {
    "hdf5.read_matlab": Parser(
        "a MATLAB file", "SciPy", ("scipy.io",), "save it again in MATLAB with save(..., '-v7')"
    ),
    "hdf5.read_hdf5": Parser("an HDF5 file", "h5py", ("h5py",)),
    "arrow.read_parquet": Parser("a Parquet file", "pyarrow", ("pyarrow.parquet", "pyarrow.compute")),
    "arrow.read_ipc": Parser("an Arrow file", "pyarrow", ("pyarrow.ipc", "pyarrow.compute")),
    "xlsx.read": Parser("an Excel workbook", "openpyxl", ("openpyxl",)),
    "channels.read_tdms": Parser("a TDMS file", "npTDMS", ("nptdms",)),
    "channels.read_mdf": Parser("a measurement data file", "asammdf", ("asammdf",)),
    "channels.read_ulog": Parser("a ULog file", "pyulog", ("pyulog",)),
    "channels.read_mcap": Parser("an MCAP file", "mcap", ("mcap.reader", "mcap_ros2.decoder")),
}


def is_possible() -> bool:
    """Return whether there is a Python to start: not where it is part of a program."""
    return bool(sys.executable) and not getattr(sys, "frozen", False)


def read(path: Path, reader: str) -> Table:
    """Open a file by a reader, in a process of its own."""
    process = _Process(path, reader)
    file = _File(path, reader, process, process.about)
    about = process.about
    stamps = file.stamps if about["stamped"] else None
    return Table(
        path, tuple(about["names"]), file.blocks, file.describe_row, in_seconds=frozenset(about["in_seconds"]),
        origins=dict(about["origins"]), approximate_rows=about["approximate_rows"], notes=tuple(about["notes"]),
        dt=about["dt"], left_out=about["left_out"], stamps=stamps,
    )  # fmt: skip


class _File:
    """A file, and the process that has it open while no pass over it is under way."""

    def __init__(self, path: Path, reader: str, process: _Process, about: dict[str, Any]) -> None:
        self._path, self._reader, self._about = path, reader, about
        self._idle: list[_Process] = [process]

    def blocks(self, columns: Sequence[int]) -> Iterator[list[NDArray[np.float64]]]:
        with self._process() as process:
            yield from process.arrays({"columns": list(columns)})

    def stamps(self, number: int) -> NDArray[np.float64]:
        with self._process() as process:
            ((found,),) = process.arrays({"stamps": number})
        return found

    def describe_row(self, row: int) -> str:
        with self._process() as process:
            return str(process.ask({"row": row})["row"])

    @contextmanager
    def _process(self) -> Iterator[_Process]:
        try:
            process = self._idle.pop()
        except IndexError:  # two passes at once
            process = _Process(self._path, self._reader)
            if process.about != self._about:
                raise LogError(f"{self._path}: the file has changed since it was opened; start again") from None
        try:
            yield process
        except BaseException:
            process.end()
            raise
        self._idle[:] = [process]


class _Process:
    def __init__(self, path: Path, reader: str) -> None:
        self._path, self._parser = path, PARSERS[reader]
        size = path.stat().st_size if path.is_file() else 0
        self._seconds = STILL + STILL_PER_BYTE * size
        absent = [name for name, found in sys.modules.items() if found is None]
        folders = [entry for entry in sys.path if isinstance(entry, str)]
        command = [
            sys.executable, "-P", "-W", "ignore", parser_child.__file__, reader, str(path),
            ",".join(self._parser.imports), ",".join(absent), *folders,
        ]  # fmt: skip
        try:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                env=os.environ | ENVIRONMENT,
            )  # fmt: skip
        except OSError as error:
            reason = error.strerror or error
            raise LogError(
                f"{path}: {self._parser.kind} is read by a second Python, and {sys.executable} did not start "
                f"({reason}); save the signals as CSV"
            ) from error
        self.end = weakref.finalize(self, _end, self._process, os.getpid())
        try:
            self.about = self._answer()
        except BaseException:
            self.end()
            raise

    def ask(self, request: dict[str, Any]) -> dict[str, Any]:
        """Return the answer to a request."""
        self._send(request)
        return self._answer()

    def arrays(self, request: dict[str, Any]) -> Iterator[list[NDArray[np.float64]]]:
        """Yield the blocks of arrays that answer a request."""
        self._send(request)
        while "lengths" in (message := self._answer()):
            yield [self._array(length) for length in message["lengths"]]

    def _send(self, request: dict[str, Any]) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()
        except OSError:  # it has ended, which the answer says
            return

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        with self._in_time():
            line = self._process.stdout.readline()
        try:
            message: dict[str, Any] = json.loads(line)
        except ValueError:
            raise self._ended() from None
        if "error" not in message:
            return message
        kind, text = message["error"], message["text"]
        if kind == "OSError":
            raise OSError(message["code"], text)
        if not kind:
            raise LogError(f"{self._path}: not readable as {self._parser.kind} ({text}); {self._parser.remedy}")
        raise getattr(errors, kind)(text)

    def _array(self, length: int) -> NDArray[np.float64]:
        assert self._process.stdout is not None
        array = np.empty(length)
        left = array.data.cast("B") if length else memoryview(b"")
        with self._in_time():
            while left:
                got = self._process.stdout.readinto(left)  # type: ignore[attr-defined]
                if not got:
                    raise self._ended()
                left = left[got:]
        return array

    @contextmanager
    def _in_time(self) -> Iterator[None]:
        late, process = threading.Event(), self._process

        def stop() -> None:  # holds the process alone, as its thread may outlive this object
            late.set()
            process.kill()

        timer = threading.Timer(self._seconds, stop)
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
        if late.is_set():
            raise LogError(
                f"{self._path}: the file is damaged: reading it takes over {self._seconds:.0f} s; {self._parser.remedy}"
            )

    def _ended(self) -> LogError:
        try:
            code = self._process.wait(_ENDING)
        except subprocess.TimeoutExpired:  # it has closed its output alone, or written something else
            self._process.kill()
            code = self._process.wait()
        return process_error(self._parser, self._path, code)


def _end(process: subprocess.Popen[bytes], owner: int) -> None:
    if os.getpid() != owner:  # a fork has no part in it
        return
    process.kill()
    for pipe in (process.stdin, process.stdout):
        assert pipe is not None
        try:
            pipe.close()
        except OSError:  # a request that was not sent
            continue
    process.wait()


def process_error(parser: Parser, path: Path, code: int) -> LogError:
    """Return the error for a process that ended before it had read the file.

    Examples
    --------
    >>> str(process_error(PARSERS["xlsx.read"], Path("log.xlsx"), 3))
    'log.xlsx: the process that reads it was ended (code 3); free some memory, and try again'
    """
    name = signal.Signals(-code).name if -code in set(signal.Signals) else f"code {code}"
    if name == "SIGXCPU":
        return LogError(
            f"{path}: reading it takes more processor time than its samples justify: {parser.kind} that is damaged, or "
            f"holds much else; {parser.remedy}"
        )
    if name in _CRASHES or os.name == "nt":
        return LogError(
            f"{path}: the file is damaged: {parser.library}'s reader crashed on it ({name}); {parser.remedy}"
        )
    return LogError(f"{path}: the process that reads it was ended ({name}); free some memory, and try again")
