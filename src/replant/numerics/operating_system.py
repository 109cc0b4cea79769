"""The operating system: its refusals in words, files written as a whole, and threads that stop."""

from __future__ import annotations

import _thread
import contextlib
import errno
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from replant.errors import SystemRefusedError

if TYPE_CHECKING:
    import subprocess
    from pathlib import Path

#: By these libraries learn, when they are loaded, how many threads linear algebra may have.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_MEMORY = "free memory, or raise its limit (ulimit -v)"
_DISK = "make room on the disk"
_PROCESSES = "raise the limit on processes and threads (ulimit -u), or free memory"
#: For each error number, what to do about it.
REMEDIES = {
    errno.EMFILE: "raise the limit on open files (ulimit -n)",
    errno.ENFILE: "the whole machine has too many open files: close other programs",
    errno.ENOMEM: _MEMORY,
    errno.ENOBUFS: _MEMORY,
    errno.EAGAIN: _PROCESSES,
    errno.ENOSPC: _DISK,
    errno.EDQUOT: _DISK,
    errno.EIO: "check the disk, or the device",
    errno.EROFS: "choose a place that can be written to",
    errno.EACCES: "choose a place that you have access to",
}


def ask_for_one_thread() -> None:
    """Have linear algebra that is loaded from now on use one thread, unless the environment says otherwise."""
    # matrices here are small: to wake a second thread and to await it takes longer than what it does
    for name in THREADS:
        os.environ.setdefault(name, "1")


@contextmanager
def signals_blocked(*numbers: int) -> Iterator[None]:
    """Start processes to which some signals mean nothing from their first instruction on; one to this process waits."""
    # Ctrl-C, `timeout` and service managers signal every process of a group: who started the others ends them itself
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # started later, by the start of a process, it would unblock the signals
    before = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def reason_of(error: BaseException) -> str:
    """Return the reason of an error in one line, without the name of a file."""
    words = " ".join(str((isinstance(error, OSError) and error.strerror) or error).split())
    return words or ("out of memory" if isinstance(error, MemoryError) else type(error).__name__)


def one_line(error: BaseException) -> str:
    """Return the message of an error in one line, with the name of the file if the system gives one."""
    file = error.filename if isinstance(error, OSError) and error.strerror else None
    return reason_of(error) + (f": {file!r}" if file else "")


def refusal(error: BaseException) -> str | None:
    """Return in one line what the system refused, and what to do; None for an error of another kind."""
    match error:
        case MemoryError():
            detail = " ".join(str(error).split())  # NumPy's message has the size of the array
            return f"out of memory{f' ({detail})' if detail else ''}; {_MEMORY}"
        case RuntimeError() if "start new thread" in str(error):  # Python raises no more specific error
            return f"the system starts no more threads; {_PROCESSES}"
        case OSError():
            remedy = REMEDIES.get(error.errno or 0)
            return f"{one_line(error)}; {remedy}" if remedy else one_line(error)
    return None


ENDING = ".new"


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give the name under which a file is written; it gets its own when the ``with`` block ends without an error."""
    import socket  # here, as `replant --help` writes no file
    import zlib

    named = zlib.crc32(os.fsencode(path.name))  # short: the name itself may be as long as names can be
    new = path.with_name(f".{named:08x}.{socket.gethostname()}.{os.getpid()}.{threading.get_ident()}{ENDING}")
    try:
        new.unlink(missing_ok=True)
        new.open("x").close()  # a new file, not what a link of this name leads to
        yield new
        with new.open("rb+") as stream:
            os.fsync(stream.fileno())
        new.replace(path)
    finally:
        with contextlib.suppress(OSError):
            new.unlink(missing_ok=True)


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Hold a file or folder, there or not, by a lock beside it; SystemRefusedError where another process holds it."""
    with contextlib.ExitStack() as held:
        try:
            real = path.resolve()
            lock = held.enter_context(real.with_name(f".{real.name}.lock").open("ab"))
        except (OSError, ValueError, RuntimeError):  # what is wrong with the path is said where it is written
            lock = None  # as in a folder that cannot be written: nobody is refused
        if lock is not None and not _locked(lock.fileno()):
            raise SystemRefusedError(f"{path}: another session writes there; end that one, or give another name")
        yield


def _locked(descriptor: int) -> bool:
    """Lock an open file until it is closed; return whether no other process has locked it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:  # a disk without locks
        return True
    return True


def end_process(process: subprocess.Popen[bytes], owner: int) -> None:
    """End a process that ``owner`` started, and close its pipes; a fork of the owner leaves it alone."""
    if os.getpid() != owner:
        return
    with contextlib.suppress(OSError), process:  # of a request that was not sent
        process.kill()


START_TIMEOUT = 60.0  # time within which a thread that was started must have begun: it needs microseconds [s]


class Worker:
    """A thread that does not keep the process alive."""

    def __init__(self, job: Callable[[], None]) -> None:
        self._job = job
        self._begun, self._ended = threading.Event(), threading.Event()

    def start(self) -> None:
        """Start the thread."""
        # `threading.Thread.start` waits until the thread has begun: without end, if a lack of memory ends it before
        _thread.start_new_thread(self._run, ())
        if not self._begun.wait(START_TIMEOUT):
            self._ended.set()
            raise RuntimeError("can't start new thread")

    def is_alive(self) -> bool:
        """Return whether the thread has begun and not ended."""
        return self._begun.is_set() and not self._ended.is_set()

    def join(self, timeout: float | None = None) -> None:
        """Wait until the thread has ended, at most ``timeout`` s."""
        self._ended.wait(timeout)

    def _run(self) -> None:
        self._begun.set()
        try:
            self._job()
        finally:
            self._ended.set()
