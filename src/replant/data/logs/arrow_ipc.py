"""Feather and Arrow files (.feather, .arrow), with pyarrow: files and streams of Arrow's IPC format."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant.data.logs import limits
from replant.data.logs.arrow_columns import as_float, check_type, is_stamp
from replant.data.logs.damage import damage_as_log_error
from replant.data.logs.parquet import BLOCK_ROWS
from replant.data.logs.table import Table
from replant.errors import LogError, MissingDependencyError

_UNPACKED = 4  # size of a batch, which is held as a whole [times the file]

_FILE_MAGIC = b"ARROW1"
_OLD_MAGIC = b"FEA1"


def read(path: Path) -> Table:
    """Open a Feather file of version 2, an Arrow file or an Arrow stream.

    Columns of time stamps are returned in seconds since the first row.
    """
    with _opened(path) as reader:
        names = tuple(reader.schema.names)
        stamps = frozenset(number for number, field in enumerate(reader.schema) if is_stamp(field.type))
    if not names:
        raise LogError(f"{path}: the file has no columns; write the log's signals into it")
    return Table(path, names, partial(_blocks, path), in_seconds=stamps)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a file as a reader of record batches."""
    try:
        import pyarrow
        from pyarrow import ipc
    except ImportError as error:
        raise MissingDependencyError(
            f"{path}: reading Feather and Arrow files needs pyarrow: pip install 'replant[parquet]'"
        ) from error
    with damage_as_log_error(path, "Feather or Arrow file", "write it again"), pyarrow.OSFile(str(path)) as file:
        limits.allow(held=_UNPACKED * path.stat().st_size)  # a batch is held as a whole
        magic = file.read(len(_FILE_MAGIC))
        if magic.startswith(_OLD_MAGIC):
            raise LogError(f"{path}: a Feather file of version 1; write it again with a newer pyarrow")
        file.seek(0)
        yield ipc.open_file(file) if magic == _FILE_MAGIC else ipc.open_stream(file)


def _blocks(path: Path, columns: Sequence[int]) -> Iterator[list[NDArray[np.float64]]]:
    with _opened(path) as reader:
        for number in columns:
            check_type(path, reader.schema.field(number))
        origins: list[list[int]] = [[] for _ in columns]
        for batch in _batches(reader):
            batch.validate(full=True)  # damaged offsets would be read beyond the file's bytes
            for begin in range(0, max(1, batch.num_rows), BLOCK_ROWS):
                part = batch.slice(begin, BLOCK_ROWS)
                yield [as_float(part.column(number), origin) for number, origin in zip(columns, origins, strict=True)]


def _batches(reader: Any) -> Iterator[Any]:
    if hasattr(reader, "num_record_batches"):
        return (reader.get_batch(number) for number in range(reader.num_record_batches))
    return iter(reader)
