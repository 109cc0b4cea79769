"""A parser process: a second Python reads the file, as a parser may crash, hang or exhaust memory on damaged bytes.

`read` starts it without running the user's script again.  The process serves one table and ends with that table, or
with an unfinished pass over it.  Requests and answers are pickled, as by `multiprocessing`; the highest protocol copies
no array.  The process starts with limits of memory and time that are the same for every file; a reader raises them with
`allow` for samples that it has found, never for samples that the file only claims.
"""

from __future__ import annotations

import contextlib
import importlib
import math
import os
import pickle
import signal
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.abc import MetaPathFinder
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import LogError, ReplantError
from replant.logs.table import Table
from replant.numerics.operating_system import end_process, reason_of

MEMORY = 128 << 20  # memory for any file, without the libraries; with them and the caller below 300 MB [bytes]
SECONDS = 9  # processor time for any file [s]
HELD = 2  # memory for held samples, once in the file's type and once as float64 [times their size as float64]
SECONDS_PER_BYTE = 1e-6  # further processor time for each byte: parsers in Python read some 5 MB/s [s]
SECONDS_PER_SAMPLE = 4e-5  # further processor time for each sample found: a cell of a workbook takes some 8e-6 s [s]
STILL = 120.0  # timeout of an answer: stops a parser that waits and uses no processor time [s]
STILL_PER_BYTE = 1e-5  # further timeout for each byte of the file [s]
ENVIRONMENT = {  # fewer threads, and the system's allocator: each thread takes memory, Arrow's allocators reserve 1 GB
    "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "ARROW_IO_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system",
}  # fmt: skip
# arguments of the process: this program, reader, file, libraries, modules that must not be imported, import folders;
# the folders go to the end of sys.path, so that no module of the user hides one of Python
BEGIN = "import sys; sys.path += sys.argv[5:]; from replant.logs.parser_process import main; main()"
_ENDING = 10.0  # timeout for the end of a process that has closed its output [s]
_TO_ANSWER = 1 << 20  # memory granted for the answer with an error [bytes]
_CRASHES = {"SIGSEGV", "SIGBUS", "SIGABRT", "SIGFPE", "SIGILL"}
_AGAIN = "write it again, or export the log as CSV"

Reader = Callable[[Path], Table]


@dataclass(frozen=True)
class Parser:
    """A file format: its suffixes and its library.  A format without a library is read in this process."""

    suffixes: str
    kind: str = ""
    library: str = ""
    imports: tuple[str, ...] = ()  # modules imported before memory is limited
    remedy: str = _AGAIN
    without: tuple[str, ...] = ()  # modules that these would import without need


# The readers, as module.function of this folder: read(path) -> Table; a module is imported when it is first needed
PARSERS = {
    "csv.read": Parser(".csv .txt .tsv .dat .lvm"),
    # pyarrow imports pandas to convert a column; that takes 50 MB, and ten times as long as reading a short file
    "arrow.read_parquet": Parser(
        ".parquet .pq", "a Parquet file", "pyarrow", ("pyarrow.parquet", "pyarrow.compute"), without=("pandas",)
    ),
    "hdf5.read_matlab": Parser(
        ".mat", "a MATLAB file", "SciPy", ("scipy.io",), "save it again in MATLAB with save(..., '-v7')"
    ),
    "arrays.read_npz": Parser(".npz"),
    "typed_cells.read_json_lines": Parser(".jsonl .ndjson"),
    "arrow.read_ipc": Parser(
        ".feather .arrow", "an Arrow file", "pyarrow", ("pyarrow.ipc", "pyarrow.compute"), without=("pandas",)
    ),
    "typed_cells.read_workbook": Parser(".xlsx .xlsm", "an Excel workbook", "openpyxl", ("openpyxl",)),
    "hdf5.read_hdf5": Parser(".h5 .hdf5", "an HDF5 file", "h5py", ("h5py",)),
    "channels.read_tdms": Parser(".tdms", "a TDMS file", "npTDMS", ("nptdms",)),
    "channels.read_mdf": Parser(".mf4 .mdf", "a measurement data file", "asammdf", ("asammdf",)),
    "channels.read_ulog": Parser(".ulg", "a ULog file", "pyulog", ("pyulog",)),
    "channels.read_mcap": Parser(".mcap", "an MCAP file", "mcap", ("mcap.reader", "mcap_ros2.decoder")),
}
FORMATS = {suffix: name for name, parser in PARSERS.items() for suffix in parser.suffixes.split()}


def reader(name: str) -> Reader:
    """Return the function that reads a format, given as ``module.function`` of this folder."""
    module, _, function = name.partition(".")
    read: Reader = getattr(importlib.import_module(f"replant.logs.{module}"), function)
    return read


# --- the calling process


def is_apart(name: str) -> bool:
    """Return whether a reader gets its own process: it uses a library, and Python is not frozen into a program."""
    return bool(PARSERS[name].library and sys.executable) and not getattr(sys, "frozen", False)


def read(path: Path, reader: str) -> Table:
    """Open a file with a reader in its own process."""
    first = _Process(path, reader)
    about, idle = first.about, [first]

    def answers(name: str, argument: Any) -> Iterator[Any]:
        process = idle.pop() if idle else _Process(path, reader)  # a second process for two passes at once
        if process.about != about:
            raise LogError(f"{path}: the file has changed since it was opened; start again")
        try:
            yield from process.answers(name, argument)
        except BaseException:
            process.end()
            raise
        idle[:] = [process]

    def answer(name: str, argument: int) -> Any:
        (found,) = answers(name, argument)
        return found

    return Table(
        **{"stamps": lambda number: answer("stamps", number)[0]} | about,
        blocks=lambda columns: answers("blocks", list(columns)),
        describe_row=lambda row: answer("describe_row", row),
    )


class _Process:
    def __init__(self, path: Path, reader: str) -> None:
        self._path, self._parser = path, PARSERS[reader]
        size = path.stat().st_size if path.is_file() else 0
        self._seconds = STILL + STILL_PER_BYTE * size
        absent = {name for name, found in sys.modules.items() if found is None}.union(self._parser.without)
        folders = [entry for entry in sys.path if isinstance(entry, str)]
        command = [
            sys.executable, "-P", "-W", "ignore", "-c", BEGIN, reader, str(path), ",".join(self._parser.imports),
            ",".join(absent), *folders,
        ]  # fmt: skip
        try:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                env=os.environ | ENVIRONMENT,
            )  # fmt: skip
        except OSError as error:
            raise LogError(
                f"{path}: {self._parser.kind} is read by a second Python, and {sys.executable} did not start "
                f"({reason_of(error)}); save the signals as CSV"
            ) from error
        self.end = weakref.finalize(self, end_process, self._process, os.getpid())
        try:
            self.about: dict[str, Any] = self._answer()
        except BaseException:
            self.end()
            raise

    def answers(self, name: str, argument: Any) -> Iterator[Any]:
        """Yield the answers to a request: a function of the table, and its argument."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):  # if the process has ended, `_answer` raises the error
            pickle.dump((name, argument), self._process.stdin)
            self._process.stdin.flush()
        while (answer := self._answer()) is not None:
            yield answer

    def _answer(self) -> Any:
        late, process = threading.Event(), self._process
        output: Any = process.stdout

        def stop() -> None:  # keeps no reference to self: the timer's thread may outlive it
            late.set()
            process.kill()

        timer = threading.Timer(self._seconds, stop)
        timer.daemon = True
        timer.start()
        try:
            answer = pickle.load(output)
        except Exception:  # it has ended, or its output is no pickle, on which unpickling raises nearly any exception
            raise self._ended(is_late=late.is_set()) from None
        finally:
            timer.cancel()
        if isinstance(answer, Exception):
            raise answer
        return answer

    def _ended(self, *, is_late: bool) -> LogError:
        """Return the error for a process that ended before it had read the file."""
        parser, path = self._parser, self._path
        if is_late:
            return LogError(
                f"{path}: the file is damaged: reading it takes over {self._seconds:.0f} s; {parser.remedy}"
            )
        try:
            code = self._process.wait(_ENDING)
        except subprocess.TimeoutExpired:  # it runs on: it has closed its output, or written something else
            self._process.kill()
            code = self._process.wait()
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"code {code}"
        if name == "SIGXCPU":
            return LogError(
                f"{path}: reading it takes more processor time than its samples justify: {parser.kind} that is "
                f"damaged, or holds mostly other data; {parser.remedy}"
            )
        if name in _CRASHES or os.name == "nt":
            return LogError(
                f"{path}: the file is damaged: {parser.library}'s reader crashed on it ({name}); {parser.remedy}"
            )
        return LogError(f"{path}: the process that reads it was ended ({name}); free some memory, and try again")


# --- the parser process


def main() -> None:
    """Read the file that the arguments name, and answer requests about it; see `BEGIN`."""
    function, name, libraries, absent = sys.argv[1:5]
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # some libraries print their errors
    sys.meta_path.insert(0, _Without(absent.split(",")))
    read, parser, path = reader(function), PARSERS[function], Path(name)
    for library in libraries.split(","):
        with contextlib.suppress(ImportError):  # the reader reports it
            importlib.import_module(library)
    begin(path.stat().st_size if path.is_file() else 0)

    def send(answer: Any) -> None:
        pickle.dump(answer, out, pickle.HIGHEST_PROTOCOL)
        out.flush()

    with contextlib.suppress(BrokenPipeError):
        try:
            for answer in _answers(read(path)):
                send(answer)
        except Exception as error:
            allow(held=_TO_ANSWER)  # the error's traceback may still hold all the memory allowed
            if isinstance(error, OSError) and error.errno is not None:
                error = OSError(error.errno, error.strerror)
            elif not isinstance(error, ReplantError):  # the caller may not be able to import its class
                reason = reason_of(error)[:120]
                error = LogError(f"{path}: not readable as {parser.kind} ({reason}); {parser.remedy}")
            send(error)
    os._exit(0)  # skip the libraries' clean-up, which may fail on a damaged file


class _Without(MetaPathFinder):
    """An import hook that hides modules: Cython would take None in `sys.modules` for the module."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = frozenset(names)

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        """Refuse the hidden modules; leave others to the next finder."""
        if name in self._names:
            raise ModuleNotFoundError(f"{name} is not imported here", name=name)


def _answers(table: Table) -> Iterator[Any]:
    """Yield the table's plain fields, then the answers to each request; None ends each request."""
    yield {name: each for name, each in vars(table).items() if not callable(each)}
    requests: Any = sys.stdin.buffer
    while requests.peek(1):
        name, argument = pickle.load(requests)
        if name == "describe_row":
            yield table.describe_row(argument)
        else:
            stamps: Any = table.stamps
            for block in table.blocks(argument) if name == "blocks" else [[stamps(argument)]]:
                allow(found=sum(int(np.count_nonzero(np.isfinite(array))) for array in block))
                yield block
        yield None


# --- its limits

_limits: dict[int, float] = {}  # limits of this process by resource number: memory [bytes] and processor time [s]


def begin(size: int) -> None:
    """Limit the memory and processor time of this process for a file of ``size`` bytes; Windows has no such limits."""
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        data = 1 << 62  # no limit if the system does not report the present size
        with contextlib.suppress(OSError):
            data = int(Path("/proc/self/statm").read_text().split()[5]) * resource.getpagesize()
        used = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
        _limit(resource.RLIMIT_DATA, data + MEMORY)
        _limit(resource.RLIMIT_CPU, math.ceil(used + SECONDS + SECONDS_PER_BYTE * size))


def allow(*, held: float = 0, found: float = 0) -> None:
    """Raise the limits of the parser process for ``held`` bytes of float64 and for ``found`` samples."""
    if not _limits:
        return
    import resource

    _limit(resource.RLIMIT_DATA, _limits[resource.RLIMIT_DATA] + HELD * held)
    _limit(resource.RLIMIT_CPU, _limits[resource.RLIMIT_CPU] + SECONDS_PER_SAMPLE * (found + held / 8))


def _limit(kind: int, most: float) -> None:
    """Set a limit of this process, rounded down and at most the system's hard limit."""
    import resource

    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (int(most) if hard == resource.RLIM_INFINITY else min(int(most), hard), hard))
    _limits[kind] = most
