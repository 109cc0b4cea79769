"""Table: the named columns of a file; and what readers share: limits, libraries' errors, zip directories, prefetch."""

from __future__ import annotations

import operator
import re
import zipfile
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from difflib import SequenceMatcher
from pathlib import Path
from typing import SupportsIndex, TypeVar

import numpy as np
from numpy.typing import NDArray

from replant.errors import SHOWN, ArgumentTypeError, LogError, ReplantError, shown
from replant.interop import without_unit

T = TypeVar("T")

MOST_COLUMNS = 1 << 17  # columns of a file, or groups and other parts of it [count]
LONGEST_NAME = 1000  # longest name of a column [characters]
MOST_EMPTY = 1 << 24
"""Missing values of a file, from which on there must be a value for every two of them: 128 MB [count]."""


def at_most(path: Path, found: Iterable[T], what: str, most: int = MOST_COLUMNS) -> Iterator[T]:
    """Yield what is found in a file as long as it is not too much."""
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
def open_zip(path: Path) -> Iterator[zipfile.ZipFile]:
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


NAMES_SHOWN = 12  # names that the error of a wrong name lists, closest first [count]
LIST_SHOWN = 160  # characters of all of them: one line stays readable [characters]

LONGEST_NUMBER = 20  # digits of a column's number from which on it is that of no column [characters]

NEAR = 0.6  # likeness from which on a name is taken for the one that was meant [ratio of difflib]


def nth_row(row: int) -> str:
    """Return the words for a row in a message; rows are counted from 1 there, ``row`` from 0."""
    return f"row {row + 1}"


@dataclass(frozen=True, eq=False)
class Table:
    """The columns of a log file."""

    path: Path
    names: tuple[str, ...]
    blocks: Callable[[Sequence[int]], Iterator[list[NDArray[np.float64]]]]
    describe_row: Callable[[int], str] = nth_row
    in_seconds: frozenset[int] = frozenset()
    origins: Mapping[int, int] = field(default_factory=dict)
    approximate_rows: int = 0
    notes: tuple[str, ...] = ()
    dt: float | None = None
    left_out: Mapping[str, str] = field(default_factory=dict)
    stamps: Callable[[int], NDArray[np.float64]] | None = None

    def __post_init__(self) -> None:
        if len(self.names) > MOST_COLUMNS:
            raise too_many_error(self.path, "columns")
        long = next((name for name in self.names if len(name) > LONGEST_NAME), None)
        if long is not None:
            raise LogError(
                f"{self.path}: {shown(long)} is the name of a column, of {len(long):,} characters; shorten "
                f"it to {LONGEST_NAME:,} or fewer"
            )

    def column(self, key: str | int) -> NDArray[np.float64]:
        """Return one column as float64, by name or 0-based number."""
        return self.columns([key])[0]

    def columns(self, keys: Sequence[str | int]) -> list[NDArray[np.float64]]:
        """Return several columns as float64, by name or 0-based number, in one pass over the file."""
        blocks = list(self.stream(keys))
        return [np.concatenate([np.empty(0), *(block[index] for block in blocks)]) for index in range(len(keys))]

    def stream(self, keys: Sequence[str | int]) -> Generator[list[NDArray[np.float64]], None, None]:
        """Yield several columns as float64, block of rows by block of rows, in one pass over the file."""
        numbers = [self.find(key) for key in keys]
        values = found = 0
        try:
            for block in self.blocks(numbers):
                values += sum(array.size for array in block)
                found += sum(int(np.count_nonzero(~np.isnan(array))) for array in block)
                if values - found > MOST_EMPTY + 2 * found:
                    raise LogError(
                        f"{self.path}: {values - found:,} of its first {values:,} values are missing; leave out the "
                        "rows without samples, or the columns"
                    )
                yield block
        except OSError as error:
            raise unreadable_error(self.path, error) from error

    def find(self, key: str | int) -> int:
        """Return the number of a column: by its exact name, else in any case, without its unit, or 0-based."""
        if not isinstance(key, str):
            return self._number(key)
        for form in (str, _folded, _bare):
            found = [number for number, name in enumerate(self.names) if form(name) == form(key)]
            if len(found) == 1:
                return found[0]
            if found:
                raise LogError(self._ambiguous(key, found))
        if key.strip().isdecimal() and len(key) < LONGEST_NUMBER:
            return self._number(int(key))
        reason = self.left_out.get(key.strip())
        if reason is not None:
            raise LogError(f"{self.path}: {reason}")
        near = self._by_likeness(key)
        meant = f" (did you mean {shown(near[0])}?)" if self._likeness(key, near[0]) >= NEAR else ""
        raise LogError(f"{self.path}: no column {shown(key)}{meant}; there are: {listed(near)}")

    def _number(self, key: SupportsIndex) -> int:
        try:
            number = operator.index(key)
        except TypeError:
            kind = type(key).__name__
            raise ArgumentTypeError(f"a column is chosen by name (str) or number (int), not {kind}") from None
        if isinstance(key, bool):
            raise ArgumentTypeError("a column is chosen by name (str) or number (int), not bool")
        if not 0 <= number < len(self.names):
            last = len(self.names) - 1
            raise LogError(f"{self.path}: no column {shown(number)}; columns 0 to {last} are: {listed(self.names)}")
        return number

    def _ambiguous(self, key: str, found: list[int]) -> str:
        names = listed([f"{number} ({shown(self.names[number])})" for number in found])
        return f"{self.path}: column {shown(key)} could be any of {names}; choose it by its number"

    def _by_likeness(self, key: str) -> list[str]:
        return sorted(self.names, key=lambda name: -self._likeness(key, name))

    def _likeness(self, key: str, name: str) -> float:
        return max(_likeness(key, name), _likeness(key, _core(name)))


def unreadable_error(path: Path, error: OSError) -> LogError:
    """Return the error for a file that the operating system refuses to read."""
    return LogError(f"{path}: cannot be read ({error.strerror or error}); check the path and its permissions")


def _folded(name: str) -> str:
    return "".join(name.split()).casefold()


def _bare(name: str) -> str:
    return _folded(without_unit(name))


def _core(name: str) -> str:
    """Return a name without struct, index and unit: udat for data.udat[:,0], time for time [s]."""
    return re.sub(r"^.*\.|[\[(].*$", "", name)


def _likeness(one: str, other: str) -> float:
    return SequenceMatcher(None, _folded(one), _folded(other)).ratio()


def listed(names: Sequence[str]) -> str:
    """Return the first names as a list for a message; long names are cut."""
    parts: list[str] = []
    for name in names[:NAMES_SHOWN]:
        flat = " ".join(name[: 2 * SHOWN].split())
        parts.append(flat if len(flat) <= SHOWN else flat[:SHOWN] + "...")
        if sum(map(len, parts)) > LIST_SHOWN:
            break
    more = len(names) - len(parts)
    return ", ".join(parts) + (f", ... ({more} more)" if more > 0 else "")
