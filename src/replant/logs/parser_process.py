"""A second Python in which a parser reads a file: on damaged bytes it may crash, hang, or take memory without end.

`read` starts it without running the user's script again.  It serves one table, and ends with it, or with a pass over it
that is not finished.  Requests and answers are pickled, as between the processes of `multiprocessing`; the highest
protocol copies no array.  The process begins with an allowance of memory and time that is the same for every file; a
reader that holds samples asks for more when it has found them (`allow`); what a file merely claims gives none.
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
from replant.logs.table import Arrays, Table
from replant.numerics.arguments import FloatArray
from replant.numerics.operating_system import end_process, reason_of

MEMORY = 128 << 20  # for any file, beside the libraries: with these and the caller below 300 MB [bytes]
SECONDS = 9  # processor time that it may take for any file [s]
HELD = 2  # memory for samples that a reader holds: as the file has them, and as float64 [times their size as float64]
SECONDS_PER_BYTE = 1e-6  # further processor time for each byte: parsers in Python read some 5 MB in a second [s]
SECONDS_PER_SAMPLE = 4e-5  # further processor time for each sample found: a cell of a workbook takes some 8e-6 s [s]
STILL = 120.0  # time to answer in: bounds what the limit of processor time does not, a parser that waits [s]
STILL_PER_BYTE = 1e-5  # further time for each byte of the file [s]
ENVIRONMENT = {  # each thread takes memory, and Arrow's own allocators reserve a gigabyte
    "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "ARROW_IO_THREADS": "1", "ARROW_DEFAULT_MEMORY_POOL": "system",
}  # fmt: skip
# what the process is called with: this, reader, file, libraries, modules that must not be imported, folders to import
# from; these at the end, so that no module of the user hides one of Python
BEGIN = "import sys; sys.path += sys.argv[5:]; from replant.logs.parser_process import main; main()"
_ENDING = 10.0  # time within which a process ends that has ended its output [s]
_TO_ANSWER = 1 << 20  # memory kept for the answer [bytes]
_CRASHES = {"SIGSEGV", "SIGBUS", "SIGABRT", "SIGFPE", "SIGILL"}
_AGAIN = "write it again, or export the log as CSV"

Reader = Callable[[Path], Table]


@dataclass(frozen=True)
class Parser:
    """What reads a kind of files, by their suffixes: without a library, Python and NumPy alone, and here."""

    suffixes: str
    kind: str = ""
    library: str = ""
    imports: tuple[str, ...] = ()  # before memory is limited
    remedy: str = _AGAIN
    without: tuple[str, ...] = ()  # what these would import beside, and do not need


# For each function of a module in this folder, read(path) -> Table; it is imported when such a file is opened
PARSERS = {
    "csv.read": Parser(".csv .txt .tsv .dat"),
    # pandas, which pyarrow imports to convert a column, takes 50 MB and ten times what reading a short file takes
    "arrow.read_parquet": Parser(
        ".parquet .pq", "a Parquet file", "pyarrow", ("pyarrow.parquet", "pyarrow.compute"), without=("pandas",)
    ),
    "hdf5.read_matlab": Parser(
        ".mat", "a MATLAB file", "SciPy", ("scipy.io",), "save it again in MATLAB with save(..., '-v7')"
    ),
    "npz.read": Parser(".npz"),
    "jsonl.read": Parser(".jsonl .ndjson"),
    "arrow.read_ipc": Parser(
        ".feather .arrow", "an Arrow file", "pyarrow", ("pyarrow.ipc", "pyarrow.compute"), without=("pandas",)
    ),
    "xlsx.read": Parser(".xlsx .xlsm", "an Excel workbook", "openpyxl", ("openpyxl",)),
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


# --- the process that asks


def is_apart(name: str) -> bool:
    """Return whether a reader runs in a process of its own: where there is a Python to start, not in a program."""
    return bool(PARSERS[name].library and sys.executable) and not getattr(sys, "frozen", False)


def read(path: Path, reader: str) -> Table:
    """Open a file by a reader, in a process of its own."""
    first = _Process(path, reader)
    about, idle = first.about, [first]

    def answers(name: str, argument: Any) -> Iterator[Any]:
        process = idle.pop() if idle else _Process(path, reader)  # the latter for two passes at once
        if process.about != about:
            raise LogError(f"{path}: the file has changed since it was opened; start again")
        try:
            yield from process.answers(name, argument)
        except BaseException:
            process.end()
            raise
        idle[:] = [process]

    def stamps(number: int) -> FloatArray:
        (((found,)),) = answers("stamps", number)
        return np.asarray(found)

    def describe_row(row: int) -> str:
        (words,) = answers("describe_row", row)
        return str(words)

    def blocks(columns: Sequence[int]) -> Iterator[Arrays]:
        return answers("blocks", list(columns))

    return Table(**{"stamps": stamps} | about, blocks=blocks, describe_row=describe_row)


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
        with contextlib.suppress(OSError):  # it has ended, which the answer says
            pickle.dump((name, argument), self._process.stdin)
            self._process.stdin.flush()
        while (answer := self._answer()) is not None:
            yield answer

    def _answer(self) -> Any:
        late, process = threading.Event(), self._process
        output: Any = process.stdout

        def stop() -> None:  # holds the process alone, as its thread may outlive this object
            late.set()
            process.kill()

        timer = threading.Timer(self._seconds, stop)
        timer.daemon = True
        timer.start()
        try:
            answer = pickle.load(output)
        except Exception:  # it has ended, or written something else, of which unpickling raises nearly any exception
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
        except subprocess.TimeoutExpired:  # it has closed its output alone, or written something else
            self._process.kill()
            code = self._process.wait()
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"code {code}"
        if name == "SIGXCPU":
            return LogError(
                f"{path}: reading it takes more processor time than its samples justify: {parser.kind} that is "
                f"damaged, or holds much else; {parser.remedy}"
            )
        if name in _CRASHES or os.name == "nt":
            return LogError(
                f"{path}: the file is damaged: {parser.library}'s reader crashed on it ({name}); {parser.remedy}"
            )
        return LogError(f"{path}: the process that reads it was ended ({name}); free some memory, and try again")


# --- the process that reads


def main() -> None:
    """Read a file as the arguments say, and answer requests about it; see `BEGIN`."""
    function, name, libraries, absent = sys.argv[1:5]
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # some libraries print what they cannot read
    sys.meta_path.insert(0, _Without(absent.split(",")))
    read, parser, path = reader(function), PARSERS[function], Path(name)
    for library in libraries.split(","):
        with contextlib.suppress(ImportError):  # which the reader says
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
            allow(held=_TO_ANSWER)  # what the error still holds may be all that was allowed
            if isinstance(error, OSError) and error.errno is not None:
                error = OSError(error.errno, error.strerror)
            elif not isinstance(error, ReplantError):  # which only the libraries may know
                reason = reason_of(error)[:120]
                error = LogError(f"{path}: not readable as {parser.kind} ({reason}); {parser.remedy}")
            send(error)
    os._exit(0)  # nothing of a damaged file is to be put in order


class _Without(MetaPathFinder):
    """Some modules are not there: None in `sys.modules` says so too, but Cython takes it for the module."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = frozenset(names)

    def find_spec(self, name: str, path: object = None, target: object = None) -> None:
        """Refuse them; others are found as ever."""
        if name in self._names:
            raise ModuleNotFoundError(f"{name} is not imported here", name=name)


def _answers(table: Table) -> Iterator[Any]:
    """Yield what a table tells of itself; then the answers to each request, which None ends."""
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

_limits: dict[int, float] = {}  # of this process, by the system's numbers for memory [bytes] and processor time [s]


def begin(size: int) -> None:
    """Limit this process for a file of so many bytes; the system gives it no more.  Windows has no such limits."""
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        data = 1 << 62  # where the system does not tell what counts
        with contextlib.suppress(OSError):
            data = int(Path("/proc/self/statm").read_text().split()[5]) * resource.getpagesize()
        used = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
        _limit(resource.RLIMIT_DATA, data + MEMORY)
        _limit(resource.RLIMIT_CPU, math.ceil(used + SECONDS + SECONDS_PER_BYTE * size))


def allow(*, held: float = 0, found: float = 0) -> None:
    """Raise the limits of the process that reads: for bytes that it holds as float64, for samples that it has found."""
    if not _limits:
        return
    import resource

    _limit(resource.RLIMIT_DATA, _limits[resource.RLIMIT_DATA] + HELD * held)
    _limit(resource.RLIMIT_CPU, _limits[resource.RLIMIT_CPU] + SECONDS_PER_SAMPLE * (found + held / 8))


def _limit(kind: int, most: float) -> None:
    """Limit this process, to whole numbers and no more than the system allows it."""
    import resource

    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (int(most) if hard == resource.RLIM_INFINITY else min(int(most), hard), hard))
    _limits[kind] = most
