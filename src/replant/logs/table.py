"""Table: the named columns of a file; and the readers' common parts: limits, errors of libraries, zip archives."""

from __future__ import annotations

import importlib
import io
import mmap
import operator
import os
import re
import sys
import tempfile
import zipfile
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any, SupportsIndex, TypeVar

import numpy as np

from replant.errors import SHOWN, ArgumentTypeError, LogError, MissingDependencyError, ReplantError, shown
from replant.model.interop import without_unit
from replant.numerics.arguments import FloatArray, IntArray
from replant.numerics.operating_system import reason_of

T = TypeVar("T")
Arrays = list[FloatArray]  # columns of a file, or of a block of its rows
Blocks = Callable[[Sequence[int]], Iterator[Arrays]]  # reads columns by their numbers, in blocks of rows

MOST_COLUMNS = 1 << 17  # most columns of a file, or groups or other parts of it [count]
LONGEST_NAME = 1000  # longest name of a column [characters]
MOST_EMPTY = 1 << 24  # missing values of a file beyond which at least a third of the values must be present [count]
PART_ROWS = 1 << 16  # rows of a long log processed at a time [rows]


def at_most(path: Path, found: Iterable[T], what: str, most: int = MOST_COLUMNS) -> Iterator[T]:
    """Yield items of a file; raise LogError if there are more than ``most``."""
    for number, one in enumerate(found):
        if number == most:
            raise too_many_error(path, what, most)
        yield one


def too_many_error(path: Path, what: str, most: int = MOST_COLUMNS) -> LogError:
    """Return the error for a file with too many parts of a kind."""
    return LogError(f"{path}: more than {most:,} {what}; write the log's signals into a file of their own")


def needed(path: Path | str, module: str, why: str, package: str) -> Any:
    """Import a module of an optional package; the error names ``path``, what needs the package, and the package."""
    try:
        importlib.import_module(module.partition(".")[0])
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingDependencyError(f"{path}: {why}: pip install {package}") from error


@contextmanager
def damage_as_log_error(path: Path, kind: str, remedy: str) -> Iterator[None]:
    """Turn any exception of a parser into a LogError, except errors of the system and of this package."""
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
        raise LogError(f"{path}: not a readable {kind} ({reason_of(error)[:120]}); {remedy}") from error


MOST_MEMBERS = 4096  # most files in an archive [count]
DEFLATE_RATIO = 1032  # most bytes that one deflated byte can unpack to, by its format [bytes]
_STREAMED = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}  # `zipfile` unpacks the other methods without a bound


@contextmanager
def open_zip(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open an archive whose members can be read in parts; no member yields more bytes than the directory states."""
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        if len(members) > MOST_MEMBERS:
            raise LogError(
                f"{path}: {len(members):,} files in one archive; put the log's signals into one of their own"
            )
        if any(member.compress_type not in _STREAMED for member in members):
            raise LogError(f"{path}: packed by another method than deflate; pack it again with zip")
        yield archive


NAMES_SHOWN = 12  # most names in the error of a wrong name, closest first [count]
LIST_SHOWN = 160  # length after which a list of names ends, so that it stays readable [characters]
LONGEST_NUMBER = 20  # digits of a number that is too large for a column [characters]
NEAR = 0.6  # smallest similarity at which a name is suggested [ratio of difflib]


def nth_row(row: int) -> str:
    """Return a row as text for a message, counted from 1; ``row`` counts from 0."""
    return f"row {row + 1}"


@dataclass(frozen=True, eq=False)
class Table:
    """The columns of a log file."""

    path: Path
    names: tuple[str, ...]
    blocks: Blocks
    describe_row: Callable[[int], str] = nth_row
    in_seconds: frozenset[int] = frozenset()
    parts: frozenset[int] = frozenset()  # columns that are only a part of the stamps in another one
    doubts: Mapping[int, str] = field(default_factory=dict)  # why a column in seconds may have another unit
    origins: Mapping[int, int] = field(default_factory=dict)
    approximate_rows: int = 0
    notes: tuple[str, ...] = ()
    dt: float | None = None
    left_out: Mapping[str, str] = field(default_factory=dict)
    stamps: Callable[[int], FloatArray] | None = None
    named_by: str = ""  # the part of the file that gives the names, and what to do if one is missing there

    def __post_init__(self) -> None:
        if len(self.names) > MOST_COLUMNS:
            raise too_many_error(self.path, "columns")
        long = next((name for name in self.names if len(name) > LONGEST_NAME), None)
        if long is not None:
            raise LogError(
                f"{self.path}: {shown(long)} is the name of a column, of {len(long):,} characters; shorten "
                f"it to {LONGEST_NAME:,} or fewer"
            )

    def error(self, number: int, problem: str, row: int | None = None) -> LogError:
        """Return the error for a column, or for one of its rows."""
        place = "" if row is None else f"{self.describe_row(row)}, "
        return LogError(f"{self.path}: {place}column {shown(self.names[number])}{problem}")

    def column(self, key: str | int) -> FloatArray:
        """Return one column as float64, by name or 0-based number."""
        return self.columns([key])[0]

    def columns(
        self,
        keys: Sequence[str | int],
        most_held: int = sys.maxsize,
        progress: Callable[[int, int], None] = lambda rows, about: None,
    ) -> Arrays:
        """Return columns by name or number from 0, as float64, in one pass; over ``most_held`` rows on the disk."""
        columns = [_Growing(self.path, most_held) for _ in keys]
        rows = 0
        try:
            for block in self.stream(keys):
                for column, values in zip(columns, block, strict=True):
                    column.add(values)
                    rows = max(rows, column.rows)
                progress(rows, max(self.approximate_rows, rows))
            return [column.array() for column in columns]
        finally:
            for column in columns:
                column.close()

    def head(self, keys: Sequence[str | int], rows: int) -> Arrays:
        """Return the first rows of columns: at least ``rows`` if there are as many, up to the end of their block."""
        parts: list[Arrays] = [[np.empty(0)] for _ in keys]
        with closing(self.stream(keys)) as blocks:
            for block in blocks:
                for column, values in zip(parts, block, strict=True):
                    column.append(values)
                rows -= max(map(len, block), default=0)
                if rows <= 0:
                    break
        return [np.concatenate(column) for column in parts]

    def stream(self, keys: Sequence[str | int]) -> Generator[Arrays, None, None]:
        """Yield several columns as float64 in blocks of rows, in one pass over the file."""
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
        """Return the number of a column: by its name, else without its unit, else ignoring case, else by number."""
        if not isinstance(key, str):
            return self._number(key)
        for form in (str, _bare, _folded, lambda name: _folded(without_unit(name))):
            found = [number for number, name in enumerate(self.names) if form(name) == form(key)]
            if len(found) == 1:
                return found[0]
            if found:
                names = listed([f"{number} ({shown(self.names[number])})" for number in found])
                raise LogError(f"{self.path}: column {shown(key)} could be any of {names}; choose it by its number")
        if key.strip().isdecimal() and len(key) < LONGEST_NUMBER:
            return self._number(int(key))
        reason = next((why for name, why in self.left_out.items() if _folded(name) == _folded(key)), None)
        if reason is not None:
            raise LogError(f"{self.path}: {reason}")
        near = sorted(self.names, key=lambda name: -_likeness(key, name))
        meant = f" (did you mean {shown(near[0])}?)" if _likeness(key, near[0]) >= NEAR else ""
        raise LogError(f"{self.path}: no column {shown(key)}{self.named_by}{meant}; there are: {listed(near)}")

    def _number(self, key: SupportsIndex) -> int:
        try:
            number = None if isinstance(key, bool) else operator.index(key)
        except TypeError:
            number = None
        if number is None:
            raise ArgumentTypeError(f"a column is chosen by name (str) or number (int), not {type(key).__name__}")
        if not 0 <= number < len(self.names):
            last = len(self.names) - 1
            raise LogError(f"{self.path}: no column {shown(number)}; columns 0 to {last} are: {listed(self.names)}")
        return number


class _Growing:
    """A column that grows: in memory up to ``most_held`` rows, then in a file without a name."""

    def __init__(self, path: Path, most_held: int) -> None:
        self.rows, self._path, self._most_held = 0, path, most_held
        self._file: Any = io.BytesIO()

    def add(self, values: FloatArray) -> None:
        """Append the values of the next rows."""
        self.rows += values.size
        # /var/tmp is on a disk; /tmp may be in memory
        folder = os.environ.get("TMPDIR") or ("/var/tmp" if os.access("/var/tmp", os.W_OK) else tempfile.gettempdir())
        try:
            if self.rows > self._most_held and isinstance(self._file, io.BytesIO):
                held, self._file = self._file, tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 - see `close`
                self._file.write(held.getbuffer())
            self._file.write(np.ascontiguousarray(values, np.float64).data)
            self._file.flush()
        except OSError as error:
            raise LogError(
                f"{self._path}: a long log needs a temporary file in {folder}, which cannot be written "
                f"({reason_of(error)}); free some space, or set TMPDIR to a folder that has it"
            ) from error

    def array(self) -> FloatArray:
        """Return the values."""
        if isinstance(self._file, io.BytesIO):
            return np.frombuffer(self._file.getbuffer())
        return np.frombuffer(mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ)) if self.rows else np.empty(0)

    def close(self) -> None:
        """Close the file; a mapped array stays valid."""
        if not isinstance(self._file, io.BytesIO):
            self._file.close()


def repeated_rows(t: FloatArray, columns: Sequence[FloatArray]) -> IntArray:
    """Return the rows that repeat the previous row, stamp and values; empty if any stamp repeats with other values.

    In that case the stamps are too coarse for the rows, and equal rows are separate samples, too.
    """
    found = [np.zeros(0, np.int64)]
    for first in range(0, t.size - 1, PART_ROWS):
        part = t[first : first + PART_ROWS + 1]
        rows = first + 1 + np.flatnonzero(part[1:] == part[:-1])
        for column in columns:
            one, other = column[rows], column[rows - 1]
            if not ((one == other) | (np.isnan(one) & np.isnan(other))).all():
                return found[0]
        found.append(rows)
        forget(t)
    return np.concatenate(found)


def in_parts(arrays: Sequence[FloatArray]) -> Iterator[Arrays]:
    """Yield arrays in parts; of an array mapped from a file, only the current part stays in memory."""
    for begin in range(0, max(map(len, arrays)), PART_ROWS):
        yield [array[begin : begin + PART_ROWS] for array in arrays]
        for array in arrays:
            forget(array)


def forget(array: FloatArray) -> None:
    """Release the memory of an array that is mapped from a file; it is read again when needed."""
    mapped = getattr(array.base, "obj", None)
    if isinstance(mapped, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        mapped.madvise(mmap.MADV_DONTNEED)


def unreadable_error(path: Path, error: OSError) -> LogError:
    """Return the error for a file that the operating system refuses to read."""
    return LogError(f"{path}: cannot be read ({reason_of(error)}); check the path and its permissions")


def _folded(name: str) -> str:
    return "".join(name.split()).casefold()


def _bare(name: str) -> str:
    return "".join(without_unit(name).split())


def _likeness(key: str, name: str) -> float:
    core = re.sub(r"^.*\.|[\[(].*$", "", name)  # without struct, index and unit: udat for data.udat[:,0]
    return max(SequenceMatcher(None, _folded(key), _folded(one)).ratio() for one in (name, core))


def listed(names: Sequence[str]) -> str:
    """Return the first names as a list for a message; long names are shortened."""
    parts: list[str] = []
    for name in names[:NAMES_SHOWN]:
        flat = " ".join(name[: 2 * SHOWN].split())
        parts.append(flat if len(flat) <= SHOWN else flat[:SHOWN] + "...")
        if sum(map(len, parts)) > LIST_SHOWN:
            break
    more = len(names) - len(parts)
    return ", ".join(parts) + (f", ... ({more} more)" if more > 0 else "")
