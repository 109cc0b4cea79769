"""The formats of logs: a suffix selects the reader; compressed logs and standard input are copied to a file first.

The copy exists as long as its `Table`, which may be read several times.  Messages name the file that the user named.
"""

from __future__ import annotations

import gzip
import os
import shutil
import stat
import sys
import tempfile
import weakref
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO

from replant.errors import LogError, MissingDependencyError
from replant.logs import arrow, channels, parser_process
from replant.logs.parser_process import FORMATS
from replant.logs.table import (
    Arrays,
    Table,
    damage_as_log_error,
    listed,
    needed,
    open_zip,
    unreadable_error,
)
from replant.logs.text_times import with_split_times

STANDARD_INPUT = Path("-")  # the path that means standard input
_KINDS = {".gz": "gzip file", ".zip": "zip archive", ".zst": "Zstandard file"}
SUFFIXES = tuple(_KINDS)
_ZSTD_BYTES = 1 << 10  # packed bytes read at a time: 4 bytes can unpack to 128 kB, so these give at most 32 MB [bytes]
LARGEST_WINDOW = 1 << 27  # largest window for unpacking a Zstandard file, the default of zstd [bytes]
HEAD_BYTES = 1 << 25  # unpacked bytes of text that are checked before the rest is unpacked [bytes]


MOST_OF_DISK = 0.8  # largest part of the disk's free space for an unpacked file [part]
_PART_BYTES = 1 << 20  # bytes unpacked at a time [bytes]


def chunks_of(file: Any) -> Iterator[bytes]:
    """Yield the content of an open file in parts."""
    return iter(lambda: file.read(_PART_BYTES), b"")


class UnpackedFile:
    """A file in a temporary folder, which is removed with this object; ``check`` is called after each part."""

    def __init__(
        self,
        path: Path,
        name: str,
        parts: Iterable[bytes],
        check: Callable[[Path, int], None] = lambda path, size: None,
    ) -> None:
        folder = tempfile.mkdtemp(prefix="replant-")
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self.path = Path(folder, name)
        room, size = MOST_OF_DISK * shutil.disk_usage(folder).free, 0
        with self.path.open("wb") as file:
            for part in parts:
                size += file.write(part)
                if size > room:
                    raise LogError(
                        f"{path}: unpacked it is over {size / 1e9:.1f} GB, more than {tempfile.gettempdir()} has room "
                        "for; unpack it where there is room"
                    )
                file.flush()
                check(self.path, size)


def read_packed(path: Path) -> Table:
    """Read a compressed log, such as ``log.csv.gz``, or a zip archive with one file in it."""
    suffix = path.suffix.lower()
    with (
        damage_as_log_error(path, _KINDS[suffix], "pack or copy the log again"),
        _opened(path, suffix) as (name, parts),
    ):
        inner = PurePosixPath(name.replace("\\", "/")).name
        if PurePosixPath(inner).suffix.lower() in SUFFIXES:
            raise LogError(f"{path}: holds another compressed file, {inner}; unpack it first")
        copy = _unpacked(path, inner, parts)
    return _table_of(path, copy)


def read_standard_input() -> Table:
    """Read a log from standard input: text, or JSON lines if it begins with a brace."""
    if sys.stdin is None or sys.stdin.isatty():
        raise LogError("standard input: a log is to be piped into it, as in: cat log.csv | replant run - ...")
    file = getattr(sys.stdin, "buffer", None)
    if file is None:
        raise LogError("standard input: not open for reading bytes; give the log's path")
    parts = chunks_of(file)
    head = next(parts, b"")
    name = "log.jsonl" if head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"{") else "log.csv"
    return _table_of(STANDARD_INPUT, _unpacked(STANDARD_INPUT, name, chain([head], parts)))


def _unpacked(path: Path, name: str, parts: Iterable[bytes]) -> UnpackedFile:
    """Unpack a file; the first lines of a long text must hold rows before the rest is unpacked."""
    # the other formats cannot be checked by their first bytes
    is_checked = FORMATS.get(PurePosixPath(name).suffix.lower(), "") not in ("csv.read", "typed_cells.read_json_lines")

    def check(copy: Path, size: int) -> None:
        nonlocal is_checked
        if size >= HEAD_BYTES and not is_checked:
            is_checked = True
            with _named(copy, path):
                _read_file(copy)

    return UnpackedFile(path, name, parts, check)


def _table_of(path: Path, copy: UnpackedFile) -> Table:
    if copy.path.stat().st_size == 0:
        raise LogError(f"{path}: the file is empty; record the log again")
    with _named(copy.path, path):
        table = _read_file(copy.path)

    def blocks(numbers: Sequence[int]) -> Iterator[Arrays]:
        with _named(copy.path, path):
            yield from table.blocks(numbers)

    named = _named(copy.path, path)
    return replace(
        table,
        path=path,
        blocks=blocks,
        describe_row=named(table.describe_row),
        stamps=table.stamps and named(table.stamps),
        notes=tuple(note.replace(str(copy.path), str(path)) for note in table.notes),
    )


@contextmanager
def _named(copy: Path, path: Path) -> Iterator[None]:
    """Put the user's path in place of the copy's into errors."""
    try:
        with _unreadable_as_log_error(copy):
            yield
    except (LogError, MissingDependencyError) as error:
        raise type(error)(str(error).replace(str(copy), str(path))) from error


@contextmanager
def _opened(path: Path, suffix: str) -> Iterator[tuple[str, Iterator[bytes]]]:
    """Open the only file in a compressed one; give its name and its content in parts."""
    if suffix == ".gz":
        with gzip.open(path) as file:
            yield path.stem, chunks_of(file)
    elif suffix == ".zst":
        with path.open("rb") as packed:
            yield path.stem, _zstd_parts(path, packed)
    else:
        with open_zip(path) as found:
            member = _only_member(path, found)
            with found.open(member) as file:
                yield member.filename, chunks_of(file)


def _zstd_parts(path: Path, packed: BinaryIO) -> Iterator[bytes]:
    zstandard = needed(path, "zstandard", "reading a .zst file needs zstandard", "'replant[zstd]'")
    frame = None
    for part in iter(lambda: packed.read(_ZSTD_BYTES), b""):
        rest = part
        while rest:
            if frame is None or frame.eof:
                frame = zstandard.ZstdDecompressor(max_window_size=LARGEST_WINDOW).decompressobj()
            yield frame.decompress(rest)
            rest = frame.unused_data if frame.eof else b""
    if frame is None or not frame.eof:  # zstandard raises no error for it
        raise ValueError("it ends in the middle of a frame")


def _only_member(path: Path, found: zipfile.ZipFile) -> zipfile.ZipInfo:
    members = [member for member in found.infolist() if not member.is_dir()]
    members = [m for m in members if not m.filename.startswith("__MACOSX/") and ".DS_Store" not in m.filename]
    if not members:
        raise LogError(f"{path}: the archive has no file in it; pack the log again")
    if len(members) > 1:
        names = listed([member.filename for member in members])
        raise LogError(f"{path}: the archive has {len(members)} files; unpack it, and give one of: {names}")
    return members[0]


def read_columns(path: str | os.PathLike[str]) -> Table:
    r"""Open a log file of any format; the table has the columns' names, and reads columns on request.

    Parameters
    ----------
    path : path
        A file with one of the suffixes in `FORMATS`, perhaps compressed (.gz, .zip, .zst); a folder of Parquet files,
        which are the parts of one log in the order of their names; the folder of a ROS 2 bag; or ``-``, standard input.

    Raises
    ------
    LogError
        If the file is missing, empty, damaged, or of another format.
    MissingDependencyError
        If the package that reads the format is not installed.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "log.csv")
    ...     _ = file.write_text("t;u [V];y\n0,0;1,5;0,0\n0,1;1,5;0,7\n")
    ...     table = read_columns(file)
    ...     print(table.names, table.column("y"))
    ('t', 'u [V]', 'y') [0.  0.7]
    """
    path = Path(path)
    if path == STANDARD_INPUT:
        return read_standard_input()
    with _unreadable_as_log_error(path):
        if path.suffix.lower() in SUFFIXES and not path.is_dir():
            _check_file(path)
            return read_packed(path)
        return _read_file(path)


def _read_file(path: Path) -> Table:
    suffix = _suffix_of_folder(path) if path.is_dir() else path.suffix.lower()
    if suffix not in FORMATS:
        known = " ".join(FORMATS)
        raise LogError(
            f"{path}: unknown file type {suffix!r}; a log is one of {known}, perhaps with {' '.join(SUFFIXES)}; "
            "rename a log of text to .txt"
        )
    parts_of = channels.parts_of if suffix == ".mcap" else arrow.parts_of
    for part in parts_of(path) if path.is_dir() else [path]:
        _check_file(part)
    if parser_process.is_apart(FORMATS[suffix]):
        return with_split_times(parser_process.read(path, FORMATS[suffix]))
    return with_split_times(parser_process.reader(FORMATS[suffix])(path))


def _check_file(path: Path) -> None:
    """Check that a path is a regular file with content: reading a device or a pipe may never end."""
    about = path.stat()
    if not stat.S_ISREG(about.st_mode):
        raise LogError(
            f"{path}: a device, pipe or socket; copy the log into a file, or pipe it in and give - as the log"
        )
    if about.st_size == 0:
        raise LogError(f"{path}: the file is empty; record the log again")


def _suffix_of_folder(path: Path) -> str:
    """Return the suffix of the parts of a log in a folder."""
    if channels.parts_of(path):
        return ".mcap"
    if arrow.parts_of(path):
        return ".parquet"
    if any(part.suffix == ".db3" for part in path.iterdir()):
        raise LogError(f"{path}: a ROS 2 bag in SQLite; write it as MCAP with: ros2 bag convert")
    raise LogError(
        f"{path}: a directory; give the log file inside it, or a folder of Parquet files; `replant fleet` fits a "
        "model to each file"
    )


@contextmanager
def _unreadable_as_log_error(path: Path) -> Iterator[None]:
    try:
        yield
    except FileNotFoundError:
        raise LogError(f"{path}: no such file; check the path") from None
    except OSError as error:
        raise unreadable_error(path, error) from error
