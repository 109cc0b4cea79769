"""Parquet files (.parquet, .pq), or a folder of them, with pyarrow: only the requested columns are read.

Files written by replant have a checksum in each page, which is verified when the page is read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant.data.logs.arrow_columns import as_float, check_type, is_stamp
from replant.data.logs.damage import damage_as_log_error
from replant.data.logs.prefetch import prefetch
from replant.data.logs.table import Table, nth_row
from replant.errors import LogError, MissingDependencyError

BLOCK_ROWS = 1 << 16  # rows read at a time [rows]
BUFFER_BYTES = 1 << 20  # buffer of a column [bytes]
SUFFIXES = (".parquet", ".pq")
CHECKED: dict[str, Any] = {"write_page_checksum": True}  # what pyarrow's writers are called with

_REMEDY = "write it again, or move it away"


def read(path: Path) -> Table:
    """Open a Parquet file, or a folder of Parquet files with equal columns, in the order of their names.

    Columns of time stamps are returned in seconds since the first row.
    """
    parts = parts_of(path) if path.is_dir() else [path]
    lengths, schema = [], None
    for part in parts:
        with open_parquet(part) as file:
            found = file.schema_arrow
            lengths.append(int(file.metadata.num_rows))
        if schema is not None and found.names != schema.names:
            raise LogError(f"{part}: other columns than in {parts[0].name}; keep the parts of one log in a folder")
        schema = schema or found
    if schema is None or not schema.names:
        raise LogError(f"{path}: the file has no columns; write the log's signals into it")
    stamps = frozenset(number for number, field in enumerate(schema) if is_stamp(field.type))
    describe_row = partial(_part_and_row, parts, lengths) if len(parts) > 1 else nth_row
    names, blocks = tuple(schema.names), partial(_blocks, parts)
    return Table(path, names, blocks, describe_row, in_seconds=stamps, approximate_rows=sum(lengths))


def parts_of(folder: Path) -> list[Path]:
    """Return the Parquet files in a folder, or in its folder ``samples``, in the order of their names.

    Files whose names begin with a dot or an underscore are left out: they are being written, or are no data.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name in ("part-2.parquet", "part-1.parquet", ".part-3.parquet"):
    ...         Path(folder, name).touch()
    ...     [part.name for part in parts_of(Path(folder))]
    ['part-1.parquet', 'part-2.parquet']
    """
    recorded = folder / "samples"
    found = (recorded if recorded.is_dir() else folder).iterdir()
    return sorted(part for part in found if part.suffix.lower() in SUFFIXES and part.name[0] not in "._")


def _part_and_row(parts: Sequence[Path], lengths: Sequence[int], row: int) -> str:
    """Return the name of the part that holds a row, and the row's number in it."""
    for part, length in zip(parts, lengths, strict=True):
        if row < length:
            return f"{part.name}, {nth_row(row)}"
        row -= length
    return nth_row(row)


@contextmanager
def open_parquet(path: Path) -> Iterator[Any]:
    """Open a file as `pyarrow.parquet.ParquetFile`."""
    try:
        from pyarrow import parquet
    except ImportError as error:
        raise MissingDependencyError(
            f"{path}: reading Parquet needs pyarrow: pip install 'replant[parquet]'"
        ) from error
    # pre_buffer would keep every block in memory
    options = {"pre_buffer": False, "buffer_size": BUFFER_BYTES, "page_checksum_verification": True}
    with (
        damage_as_log_error(path, "Parquet file", _REMEDY),
        parquet.ParquetFile(path, **options) as file,
    ):
        yield file


def _blocks(parts: Sequence[Path], columns: Sequence[int]) -> Iterator[list[NDArray[np.float64]]]:
    origins: list[list[int]] = [[] for _ in columns]
    for part in parts:
        yield from _blocks_of(part, columns, origins)


def _blocks_of(path: Path, columns: Sequence[int], origins: Sequence[list[int]]) -> Iterator[list[NDArray[np.float64]]]:
    with open_parquet(path) as file:
        schema = file.schema_arrow
        for number in columns:
            check_type(path, schema.field(number))
        names = [schema.names[number] for number in columns]
        twins = [schema.names[:number].count(name) for number, name in zip(columns, names, strict=True)]
        batches = file.iter_batches(BLOCK_ROWS, columns=sorted(set(names)), use_threads=False)
        rows = 0

        def next_block() -> list[NDArray[np.float64]] | None:
            nonlocal rows
            batch = next(batches, None)
            if batch is None:
                check_rows(path, file, rows)
                return None
            rows += batch.num_rows
            places = [batch.schema.get_all_field_indices(name)[twin] for name, twin in zip(names, twins, strict=True)]
            return [as_float(batch.column(at), origin) for at, origin in zip(places, origins, strict=True)]

        for block in prefetch(repeat(next_block), workers=1):
            if block is None:
                return
            yield block


def check_rows(path: Path, file: Any, rows: int) -> None:
    """Check that every row of a file was read: pyarrow skips a page whose header is damaged."""
    held = file.metadata.num_rows
    if rows != held:
        raise LogError(f"{path}: the file is damaged: {rows:,} of its {held:,} rows can be read; {_REMEDY}")
