"""Refusals: what the operating system denies a process, in words, and what to do about it."""

from __future__ import annotations

import errno

_MEMORY = "free memory, or raise its limit (ulimit -v)"
_DISK = "make room on the disk"
_PROCESSES = "raise the limit on processes and threads (ulimit -u), or free memory"
#: What to do where these are refused.
REMEDIES = {
    errno.EMFILE: "raise the limit on open files (ulimit -n)",
    errno.ENFILE: "the whole machine has too many open files: close what else is running",
    errno.ENOMEM: _MEMORY,
    errno.ENOBUFS: _MEMORY,
    errno.EAGAIN: _PROCESSES,
    errno.ENOSPC: _DISK,
    errno.EDQUOT: _DISK,
    errno.EIO: "look after the disk, or the device",
    errno.EROFS: "choose a place that can be written to",
    errno.EACCES: "choose a place that you may use",
}


def refusal(error: BaseException) -> str | None:
    """Return in one line what the system refused, and what to do; None where the error is of another kind.

    Examples
    --------
    >>> refusal(OSError(errno.EMFILE, "Too many open files"))
    'Too many open files; raise the limit on open files (ulimit -n)'
    >>> refusal(MemoryError())
    'out of memory; free memory, or raise its limit (ulimit -v)'
    >>> refusal(ValueError("of ours"))
    """
    match error:
        case MemoryError():
            detail = " ".join(str(error).split())  # NumPy says how much it was
            return f"out of memory{f' ({detail})' if detail else ''}; {_MEMORY}"
        case RuntimeError() if "start new thread" in str(error):  # the only sign that Python gives
            return f"the system starts no more threads; {_PROCESSES}"
        case OSError():
            words = (error.strerror or " ".join(str(error).split()) or type(error).__name__) + (
                f": {error.filename!r}" if error.filename else ""
            )
            remedy = REMEDIES.get(error.errno or 0)
            return f"{words}; {remedy}" if remedy else words
    return None
