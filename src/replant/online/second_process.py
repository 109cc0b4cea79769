"""A second Python: the process that does the work due between samples, and the memory that it shares with the first.

`background` defines this work.  The process serves all identifiers of its parent, and ends with its standard input.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable, Sequence
from multiprocessing import resource_tracker
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import SystemRefusedError
from replant.numerics.arguments import IntArray
from replant.numerics.operating_system import THREADS, end_process, signals_blocked

try:
    from multiprocessing.shared_memory import SharedMemory
except ImportError:  # a Python that was built without
    SharedMemory = None  # type: ignore[assignment,misc]

# called with the folders to import from; they come last, so that no module of the user hides one of Python
BEGIN = "import sys; sys.path += sys.argv[1:]; from replant.online.background import serve; serve()"
PREFIX = 24  # bytes before the arrays: the state of the job, and two numbers on the text or the result [bytes]
NUMBERS_ROOM = 2**18  # room for the numbers of a state, and the text; a state of ten poles takes half [bytes]
FREE, PENDING, DONE, FAILED = range(4)
Shapes = Sequence[tuple[int, ...]]
_starting = threading.Lock()
_worker: Worker | None = None


class Place:
    """Memory that both processes share, for one job at a time."""

    def __init__(self, history: int) -> None:
        size = NUMBERS_ROOM + 48 * history
        try:
            memory = SharedMemory(create=True, size=size)
        except (OSError, TypeError) as error:
            raise SystemRefusedError(
                f"background=True needs shared memory, which the system refuses ({error})"
            ) from error
        self._owner = os.getpid()
        # freed by its owner alone, also if `multiprocessing` has forked it: `weakref.finalize` then does not run
        self._end = Finalize(self, _give_back, (memory,), exitpriority=0)
        assert memory.buf is not None
        self.name, self.buffer = memory.name, memory.buf
        self._told: tuple[Any, bytes] = None, b""
        there = Path("/dev/shm", memory.name.lstrip("/"))  # its file in Linux
        if there.exists():
            with there.open("r+b") as file:
                try:
                    os.posix_fallocate(file.fileno(), 0, size)  # without room, writing would end the process
                except OSError as error:
                    raise SystemRefusedError(
                        f"background=True needs {size} bytes of shared memory, which the system refuses ({error})"
                    ) from error

    def told(self, settings: Any, as_bytes: Callable[[Any], bytes]) -> bytes:
        """Return settings as bytes; pickled once, as that takes a tenth of a sample at 1 kHz."""
        if self._told[0] is not settings:
            self._told = settings, as_bytes(settings)
        return self._told[1]

    @property
    def is_mine(self) -> bool:
        """Whether it belongs to this process, and not to one that this was forked from."""
        return self._owner == os.getpid()

    @property
    def is_busy(self) -> bool:
        """Whether the second Python may still write to it."""
        return self.buffer[0] == PENDING


def _give_back(memory: Any) -> None:
    with contextlib.suppress(OSError, BufferError):
        memory.unlink()
        memory.close()


def end_of(shapes: Shapes) -> int:
    """Return the offset in shared memory after arrays of these shapes."""
    return PREFIX + 8 * sum(math.prod(shape) for shape in shapes)


def write(buffer: memoryview, shapes: Shapes, text: bytes) -> bool:
    """Write the text of a job after the arrays; return whether there was room."""
    at = end_of(shapes)
    if at + len(text) > len(buffer):
        return False
    noted(buffer)[:] = at, len(text)
    buffer[at : at + len(text)] = text
    return True


def read(buffer: memoryview) -> bytes:
    """Return the text of a job."""
    at, length = noted(buffer).tolist()
    return bytes(buffer[at : at + length])


def noted(buffer: memoryview) -> IntArray:
    """Return a view of the two numbers before the arrays."""
    return np.frombuffer(buffer, np.int64, 2, 8)


def views(buffer: memoryview, shapes: Shapes) -> list[Any]:
    """Return views of the arrays in shared memory: raw samples, oldest first, then the numbers."""
    return [view_of(buffer, shapes, place) for place in range(len(shapes))]


def view_of(buffer: memoryview, shapes: Shapes, place: int) -> Any:
    """Return a view of one of the arrays; the second one holds integers."""
    kind = np.int64 if place == 1 else np.float64
    return np.frombuffer(buffer, kind, math.prod(shapes[place]), end_of(shapes[:place])).reshape(shapes[place])


# --- the second Python


class Worker:
    """The second Python; it serves all identifiers of its owner, and ends with it."""

    def __init__(self) -> None:
        self._owner = os.getpid()
        folders = [entry for entry in sys.path if isinstance(entry, str)]
        if not sys.executable or getattr(sys, "frozen", False):
            raise SystemRefusedError(
                "background=True needs a second Python, and there is none to start in this program"
            )
        # more threads would take the core of the first process
        environment = os.environ | dict.fromkeys(THREADS, "1")
        try:
            with signals_blocked(signal.SIGINT):
                self._process = subprocess.Popen(
                    [sys.executable, "-P", "-W", "ignore", "-c", BEGIN, *folders], bufsize=0, env=environment,
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
                )  # fmt: skip
        except OSError as error:
            raise SystemRefusedError(
                f"background=True needs a second Python, and {sys.executable} did not start ({error.strerror or error})"
            ) from error
        self._end = weakref.finalize(self, end_process, self._process, self._owner)
        self._is_ready = False

    def lives(self) -> bool:
        """Return whether it runs, and was started by this process, not by one that this was forked from."""
        return self._owner == os.getpid() and self._process.poll() is None

    def wait(self) -> None:
        """Wait until it has imported what it needs."""
        assert self._process.stdout is not None
        if not self._is_ready and not self._process.stdout.read(1):
            raise SystemRefusedError(
                f"background=True needs a second Python, and {sys.executable} ended as it imported replant"
            )
        self._is_ready = True

    def send(self, place: Place) -> None:
        """Send the name of the memory of a job, so that it begins."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError):  # if it has ended, that is noticed when the result is due
            self._process.stdin.write(place.name.encode() + b"\n")

    def forget(self) -> None:
        """In a forked process: close the pipes, and leave the second Python to the parent."""
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            pipe.close()
        self._process.returncode = 0


def worker() -> Worker | None:
    """Return the second Python, if one was started."""
    return _worker


def start(*, wait: bool = True) -> None:
    """Start the second Python if none is alive; ``wait`` until it is ready."""
    global _worker
    with _starting:
        if _worker is None or not _worker.lives():
            _worker = Worker()
        if wait:
            _worker.wait()


def _begin_child() -> None:
    global _worker, _starting
    if _worker is not None:
        _worker.forget()
    _worker, _starting = None, threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_begin_child)


def serve(answer: Callable[[memoryview], int]) -> None:
    """Answer jobs until the first process has ended."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the first process
    resource_tracker.register = lambda *_: None  # the first process frees the memory
    sys.stdout.write("+")
    sys.stdout.flush()
    for name in iter(sys.stdin.readline, ""):
        try:
            memory = SharedMemory(name.strip())
        except FileNotFoundError:  # the first process has dropped the job meanwhile
            continue
        assert memory.buf is not None
        memory.buf[0] = answer(memory.buf)
        memory.close()
