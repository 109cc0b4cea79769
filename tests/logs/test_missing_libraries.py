"""A format whose library is not installed is answered with what to install, before the file is looked into."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from replant.errors import MissingDependencyError
from replant.logs import read_columns
from support.cases import every

LIBRARIES = [
    ("log.arrow", "pyarrow", r"needs pyarrow: pip install 'replant\[parquet\]'$"),
    ("log.parquet", "pyarrow", r"pip install 'replant\[parquet\]'"),
    ("log.ulg", "pyulog", r"reading ULog needs pyulog: pip install 'replant\[ulog\]'$"),
    ("log.xlsx", "openpyxl", r"needs openpyxl: pip install 'replant\[xlsx\]'$"),
    ("log.csv.zst", "zstandard", r"needs zstandard: pip install 'replant\[zstd\]'$"),
    ("log.mf4", "asammdf", r"reading MDF needs asammdf: pip install asammdf"),
    ("log.tdms", "nptdms", r"reading TDMS needs npTDMS: pip install npTDMS"),
]


@every("frozen", [True, False])
@every(("name", "library", "message"), LIBRARIES, ids=[name for name, *_ in LIBRARIES])
def test_without_its_library_the_message_says_what_to_install(
    write: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, name: str, library: str, message: str, *, frozen: bool
) -> None:
    """In a program without an interpreter, and in one that would start a second Python for the file."""
    monkeypatch.setattr(sys, "frozen", frozen, raising=False)
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(MissingDependencyError, match=message):
        read_columns(write(b"x", name))
