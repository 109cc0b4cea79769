"""Compressed logs (.gz, .zip, .zst) and logs from standard input: unpacked into a temporary file, which is then read.

The file lives as long as its `Table`, which may be read several times.  Messages name the file that the user named.
"""

from __future__ import annotations

import gzip
import shutil
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

import numpy as np
from numpy.typing import NDArray

from replant.data.logs import archive
from replant.data.logs.damage import damage_as_log_error
from replant.data.logs.table import Table, listed
from replant.errors import LogError, MissingDependencyError

STANDARD_INPUT = Path("-")  # what stands for standard input

_KINDS = {".gz": "gzip file", ".zip": "zip archive", ".zst": "Zstandard file"}
SUFFIXES = tuple(_KINDS)
_BLOCK_BYTES = 1 << 20  # bytes unpacked at a time [bytes]
_ZSTD_BYTES = 1 << 10
"""Bytes of a Zstandard file taken at a time; each block of 4 bytes may stand for 128 kB, so that these yield at most
32 MB [bytes].
"""
LARGEST_WINDOW = 1 << 27
"""Memory that unpacking a Zstandard file may take: what zstd itself takes unless it is told otherwise [bytes]."""
HEAD_BYTES = 1 << 25  # unpacked bytes after which text is looked at, before the rest is unpacked [bytes]
MOST_OF_DISK = 0.8  # part of the disk's free space that an unpacked file may take [part]


def read_packed(path: Path, read: Callable[[Path], Table], check: Callable[[Path], None]) -> Table:
    r"""Read a compressed log, such as ``log.csv.gz``, or a zip archive with one file in it.

    >>> from replant.data.logs.csv import read
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "log.csv.gz")
    ...     _ = file.write_bytes(gzip.compress(b"t,u,y\n0,1,2\n1,2,3\n"))
    ...     table = read_packed(file, read, check=lambda head: None)
    >>> table.path.name, table.column("u")
    ('log.csv.gz', array([1., 2.]))
    """
    suffix = path.suffix.lower()
    with (
        damage_as_log_error(path, _KINDS[suffix], "pack or copy the log again"),
        _opened(path, suffix) as (name, parts),
    ):
        inner = PurePosixPath(name.replace("\\", "/")).name
        if PurePosixPath(inner).suffix.lower() in SUFFIXES:
            raise LogError(f"{path}: holds another compressed file, {inner}; unpack it first")
        copy = _Copy(path, inner, parts, check)
    return _table_of(path, copy, read)


def read_standard_input(read: Callable[[Path], Table], check: Callable[[Path], None]) -> Table:
    """Read a log from standard input: text, or JSON lines if it begins with a brace."""
    if sys.stdin is None or sys.stdin.isatty():
        raise LogError("standard input: a log is to be piped into it, as in: cat log.csv | replant run - ...")
    file = getattr(sys.stdin, "buffer", None)
    if file is None:
        raise LogError("standard input: not open for reading bytes; give the log's path")
    head = file.read(_BLOCK_BYTES)
    name = "log.jsonl" if head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"{") else "log.csv"
    copy = _Copy(STANDARD_INPUT, name, chain([head], _parts_of(file)), check)
    return _table_of(STANDARD_INPUT, copy, read)


class _Copy:
    """A file in a temporary folder, which is removed with this object."""

    def __init__(self, path: Path, name: str, parts: Iterable[bytes], check: Callable[[Path], None]) -> None:
        folder = tempfile.mkdtemp(prefix="replant-")
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self.path = Path(folder, name)
        room, size, is_checked = MOST_OF_DISK * shutil.disk_usage(folder).free, 0, False
        with self.path.open("wb") as file:
            for part in parts:
                size += file.write(part)
                if size > room:
                    raise LogError(
                        f"{path}: unpacked it is over {size / 1e9:.1f} GB, more than {tempfile.gettempdir()} has room "
                        "for; unpack it where there is room"
                    )
                if size >= HEAD_BYTES and not is_checked:
                    is_checked = True
                    file.flush()
                    with _named(self, path):
                        check(self.path)


def _table_of(path: Path, copy: _Copy, read: Callable[[Path], Table]) -> Table:
    if copy.path.stat().st_size == 0:
        raise LogError(f"{path}: the file is empty; record the log again")
    with _named(copy, path):
        table = read(copy.path)

    def blocks(numbers: Sequence[int]) -> Iterator[list[NDArray[np.float64]]]:
        with _named(copy, path):
            yield from table.blocks(numbers)

    def describe_row(row: int) -> str:
        with _named(copy, path):
            return table.describe_row(row)

    notes = tuple(note.replace(str(copy.path), str(path)) for note in table.notes)
    return replace(table, path=path, blocks=blocks, describe_row=describe_row, notes=notes)


@contextmanager
def _named(copy: _Copy, path: Path) -> Iterator[None]:
    """Have errors name the file that the user named."""
    try:
        yield
    except (LogError, MissingDependencyError) as error:
        raise type(error)(str(error).replace(str(copy.path), str(path))) from error


@contextmanager
def _opened(path: Path, suffix: str) -> Iterator[tuple[str, Iterator[bytes]]]:
    """Open the only file in a compressed one; return its name and its content part by part."""
    if suffix == ".gz":
        with gzip.open(path) as file:
            yield path.stem, _parts_of(file)
    elif suffix == ".zst":
        with path.open("rb") as packed:
            yield path.stem, _zstd_parts(path, packed)
    else:
        with archive.opened(path) as found:
            member = _only_member(path, found)
            with found.open(member) as file:
                yield member.filename, _parts_of(file)


def _parts_of(file: Any) -> Iterator[bytes]:
    return iter(lambda: file.read(_BLOCK_BYTES), b"")


def _zstd_parts(path: Path, packed: BinaryIO) -> Iterator[bytes]:
    try:
        import zstandard
    except ImportError as error:
        raise MissingDependencyError(
            f"{path}: reading a .zst file needs zstandard: pip install 'replant[zstd]'"
        ) from error
    frame = None
    for part in iter(lambda: packed.read(_ZSTD_BYTES), b""):
        rest = part
        while rest:
            if frame is None or frame.eof:
                frame = zstandard.ZstdDecompressor(max_window_size=LARGEST_WINDOW).decompressobj()
            yield frame.decompress(rest)
            rest = frame.unused_data if frame.eof else b""
    if frame is None or not frame.eof:  # which its library does not say
        raise ValueError("it ends in the middle of a frame")


def _only_member(path: Path, found: zipfile.ZipFile) -> zipfile.ZipInfo:
    members = [member for member in found.infolist() if not member.is_dir() and not _is_of_macos(member.filename)]
    if not members:
        raise LogError(f"{path}: the archive has no file in it; pack the log again")
    if len(members) > 1:
        names = listed([member.filename for member in members])
        raise LogError(f"{path}: the archive has {len(members)} files; unpack it, and give one of: {names}")
    return members[0]


def _is_of_macos(name: str) -> bool:
    return name.startswith("__MACOSX/") or PurePosixPath(name).name == ".DS_Store"
