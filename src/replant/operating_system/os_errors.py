"""Errors of the operating system: what it denied a process, in words, and what to do about it."""

from __future__ import annotations

import errno

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


def reason_of(error: BaseException) -> str:
    """Return the reason of an error in one line, without the name of a file.

    Examples
    --------
    >>> reason_of(OSError(errno.ENOSPC, "No space left on device", "a/b")), reason_of(MemoryError())
    ('No space left on device', 'out of memory')
    """
    words = " ".join(str((isinstance(error, OSError) and error.strerror) or error).split())
    return words or ("out of memory" if isinstance(error, MemoryError) else type(error).__name__)


def one_line(error: BaseException) -> str:
    """Return the message of an error in one line, with the name of the file if the system gives one.

    Examples
    --------
    >>> one_line(OSError(errno.ENOSPC, "No space left on device", "a/b"))
    "No space left on device: 'a/b'"
    """
    file = error.filename if isinstance(error, OSError) and error.strerror else None
    return reason_of(error) + (f": {file!r}" if file else "")


def refusal(error: BaseException) -> str | None:
    """Return in one line what the system refused, and what to do; None for an error of another kind.

    Examples
    --------
    >>> refusal(OSError(errno.EMFILE, "Too many open files"))
    'Too many open files; raise the limit on open files (ulimit -n)'
    >>> refusal(MemoryError())
    'out of memory; free memory, or raise its limit (ulimit -v)'
    >>> refusal(ValueError("invalid"))
    """
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
