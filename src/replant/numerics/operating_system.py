"""The operating system: messages for its errors, files replaced as a whole, locks, and threads that end."""

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

#: Environment variables that limit the threads of linear algebra; libraries read them when they are loaded.
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
    """Limit linear algebra libraries loaded from now on to one thread, unless the environment is set."""
    # matrices here are small: waking a second thread and waiting for it takes longer than its work
    for name in THREADS:
        os.environ.setdefault(name, "1")


@contextmanager
def signals_blocked(*numbers: int) -> Iterator[None]:
    """Block signals within the ``with`` block, so that processes started there ignore them from the first instruction.

    Ctrl-C, `timeout` and service managers signal every process of a group; the parent ends its children itself.  A
    signal to this process waits until the end of the block.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # if a process start launched it, it would unblock the signals
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
    """Return the message of an error in one line, with the file name if the system gives one."""
    file = error.filename if isinstance(error, OSError) and error.strerror else None
    return reason_of(error) + (f": {file!r}" if file else "")


def refusal(error: BaseException) -> str | None:
    """Return what the system refused and the remedy, in one line; None for another kind of error."""
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
    """Yield a temporary path to write to; it replaces ``path`` if the ``with`` block ends without an error."""
    import socket  # here, as `replant --help` writes no file
    import zlib

    named = zlib.crc32(os.fsencode(path.name))  # the name itself may already have the maximal length
    new = path.with_name(f".{named:08x}.{socket.gethostname()}.{os.getpid()}.{threading.get_ident()}{ENDING}")
    try:
        new.unlink(missing_ok=True)
        new.open("x").close()  # a new file, never the target of a link of this name
        yield new
        with new.open("rb+") as stream:
            os.fsync(stream.fileno())
        new.replace(path)
    finally:
        with contextlib.suppress(OSError):
            new.unlink(missing_ok=True)


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Lock a file or folder, which need not exist, by a file beside it; SystemRefusedError if it is locked."""
    with contextlib.ExitStack() as held:
        try:
            real = path.resolve()
            lock = held.enter_context(real.with_name(f".{real.name}.lock").open("ab"))
        except (OSError, ValueError, RuntimeError):  # a wrong path is reported when it is written
            lock = None  # without a lock, as in a read-only folder, nobody is refused
        if lock is not None and not _locked(lock.fileno()):
            raise SystemRefusedError(f"{path}: another session writes there; end that one, or give another name")
        yield


def _locked(descriptor: int) -> bool:
    """Lock an open file until it is closed; return whether it could be locked."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:  # a file system without locks
        return True
    return True


def end_process(process: subprocess.Popen[bytes], owner: int) -> None:
    """End a process that ``owner`` started, and close its pipes; a fork of the owner does nothing."""
    if os.getpid() != owner:
        return
    with contextlib.suppress(OSError), process:  # closing a pipe with an unsent request may fail
        process.kill()


START_TIMEOUT = 60.0  # time within which a new thread must begin; it needs microseconds [s]


class Worker:
    """A thread that does not keep the process alive."""

    def __init__(self, job: Callable[[], None]) -> None:
        self._job = job
        self._begun, self._ended = threading.Event(), threading.Event()

    def start(self) -> None:
        """Start the thread."""
        # `threading.Thread.start` waits until the thread has begun: forever, if lack of memory ends it earlier
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
