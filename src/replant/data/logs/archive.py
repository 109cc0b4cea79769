"""Zip archives, which workbooks and .npz files are too: their directories are checked before anything is unpacked."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from replant.errors import LogError

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
