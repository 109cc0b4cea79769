"""What the readers of files share: what reading may cost, the errors of libraries, zip directories, blocks read ahead.

The process that reads a file (`parser_process`) begins with an allowance that is the same for every file.  A reader
that holds samples asks for more when it has found them; what a file merely claims gives none.
"""

from __future__ import annotations

import contextlib
import math
import zipfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from replant.errors import LogError, ReplantError

T = TypeVar("T")

MEMORY = 128 << 20
"""Memory that the reading process may take for any file, beside its libraries [bytes].
Derivation: with the libraries, some 100 MB, and what the calling process takes, it stays below the 300 MB promised.
"""
SECONDS = 9  # processor time that it may take for any file [s]
HELD = 2  # memory for samples that a reader holds: as the file has them, and as float64 [times their size as float64]
SECONDS_PER_BYTE = 1e-6
"""Further processor time for each byte of the file: the parsers written in Python read some 5 MB in a second [s]."""
SECONDS_PER_SAMPLE = 4e-5  # further processor time for each sample found: a cell of a workbook takes some 8e-6 s [s]

MOST_COLUMNS = 1 << 17  # columns of a file, or groups and other parts of it [count]
LONGEST_NAME = 1000  # longest name of a column [characters]
MOST_EMPTY = 1 << 24
"""Missing values of a file, from which on there must be a value for every two of them: 128 MB [count]."""

_limited = False


def begin(size: int) -> None:
    """Limit this process for a file of so many bytes; the system gives it no more.  Windows has no such limits."""
    global _limited
    with contextlib.suppress(ImportError, ValueError, OSError):
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        _limited = True
        _set(resource.RLIMIT_DATA, (_data_bytes() or 1 << 62) + MEMORY)
        used = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
        _set(resource.RLIMIT_CPU, math.ceil(used + SECONDS + SECONDS_PER_BYTE * size))


def allow(*, held: float = 0, found: float = 0) -> None:
    """Raise the limits of the process that reads."""
    if _limited:
        import resource

        _raise(resource.RLIMIT_DATA, HELD * held)
        _raise(resource.RLIMIT_CPU, SECONDS_PER_SAMPLE * (found + held / 8))


_owed: dict[int, float] = {}  # fractions of a second, which the system does not count


def _raise(kind: int, more: float) -> None:
    import resource

    more += _owed.pop(kind, 0.0)
    if more >= 1.0:
        _set(kind, resource.getrlimit(kind)[0] + int(more))
    _owed[kind] = more % 1.0


def _set(kind: int, most: int) -> None:
    import resource

    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _data_bytes() -> int:
    """Return the memory of this process that the limit counts; 0 where the system does not tell."""
    try:
        fields = Path("/proc/self/statm").read_text().split()
    except OSError:
        return 0
    import resource

    return int(fields[5]) * resource.getpagesize()


def at_most(path: Path, found: Iterable[T], what: str, most: int = MOST_COLUMNS) -> Iterator[T]:
    """Yield what is found in a file as long as it is not too much.

    >>> list(at_most(Path("log.h5"), "abc", "data sets", most=2))
    Traceback (most recent call last):
    replant.errors.LogError: log.h5: more than 2 data sets; write the log's signals into a file of their own
    """
    for number, one in enumerate(found):
        if number == most:
            raise too_many_error(path, what, most)
        yield one


def too_many_error(path: Path, what: str, most: int = MOST_COLUMNS) -> LogError:
    """Return the error for a file with too much of something."""
    return LogError(f"{path}: more than {most:,} {what}; write the log's signals into a file of their own")


@contextmanager
def damage_as_log_error(path: Path, kind: str, remedy: str) -> Iterator[None]:
    """Turn the errors of a library that parses a file into a LogError.

    On damaged bytes such a library fails with almost any exception.  Errors of the operating system and of replant are
    raised as they are.

    >>> with damage_as_log_error(Path("log.npz"), ".npz archive", "save it with numpy.savez"):
    ...     raise KeyError("u.npy")
    Traceback (most recent call last):
    replant.errors.LogError: log.npz: not a readable .npz archive ('u.npy'); save it with numpy.savez
    """
    try:
        yield
    except ReplantError:
        raise
    except MemoryError:
        reason = "reading it takes more memory than its samples justify"
        raise LogError(f"{path}: not a readable {kind} ({reason}); {remedy}") from None
    except Exception as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise LogError(f"{path}: not a readable {kind} ({reason[:120]}); {remedy}") from error


MOST_MEMBERS = 4096  # files in an archive [count]
DEFLATE_RATIO = 1032  # bytes that a byte of deflated data can stand for: what its format allows [bytes]

_STREAMED = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}  # the others are unpacked by `zipfile` without a bound


@contextmanager
def opened(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open an archive whose members can be read part by part; none yields more bytes than its directory says."""
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        if len(members) > MOST_MEMBERS:
            raise LogError(
                f"{path}: {len(members):,} files in one archive; put the log's signals into one of their own"
            )
        if any(member.compress_type not in _STREAMED for member in members):
            raise LogError(f"{path}: packed by another method than deflate; pack it again with zip")
        yield archive


def prefetch(jobs: Iterable[Callable[[], T]], workers: int) -> Iterator[T]:
    """Yield the results of ``jobs`` in their order, with ``workers`` + 1 jobs running or waiting.

    Threads suffice: reading, parsing and identification each release the interpreter's lock.

    Examples
    --------
    >>> list(prefetch((lambda k=k: k * k for k in range(5)), workers=2))
    [0, 1, 4, 9, 16]
    """
    pending: deque[Future[T]] = deque()
    pool = ThreadPoolExecutor(workers, "replant-read")
    try:
        for job in jobs:
            pending.append(pool.submit(job))
            if len(pending) > workers:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    finally:
        # Never wait here: the garbage collector may end an abandoned generator in any thread, in one of the pool's too,
        # and at any place, also where that thread holds the locks of `threading`.
        pool.shutdown(wait=False, cancel_futures=True)
