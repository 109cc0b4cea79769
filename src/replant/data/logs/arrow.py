"""Parquet (.parquet, .pq, or a folder of them), Feather and Arrow files, with pyarrow; columns as float64.

Files written by replant have a checksum in each page, which is verified when the page is read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant.data.logs import table
from replant.data.logs.table import Table, damage_as_log_error, nth_row, prefetch
from replant.errors import LogError, MissingDependencyError, shown

_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def is_stamp(kind: Any) -> bool:
    """Return whether an Arrow type is that of time stamps, or of times between them."""
    import pyarrow.types

    return bool(pyarrow.types.is_timestamp(kind) or pyarrow.types.is_duration(kind))


def check_type(path: Path, field: Any) -> None:
    """Check that a field of a schema holds numbers or time stamps."""
    from pyarrow import types

    number = types.is_integer(field.type) or types.is_floating(field.type) or types.is_decimal(field.type)
    if not (number or types.is_boolean(field.type) or is_stamp(field.type)):
        raise LogError(
            f"{path}: column {shown(field.name)} holds {field.type}, not numbers; choose another, or convert it"
        )


def as_float(column: Any, origin: list[int]) -> NDArray[np.float64]:
    """Convert a column of numbers or time stamps to float64; a null is NaN.

    ``origin`` holds the first stamp of the file, once there is one.
    """
    import pyarrow
    from pyarrow import types

    if not is_stamp(column.type):
        if types.is_boolean(column.type):
            column = column.cast(pyarrow.int8())
        values = column.cast(pyarrow.float64(), safe=False).to_numpy(zero_copy_only=False)
        return np.array(values, dtype=np.float64)
    counts = column.cast(pyarrow.int64())
    valid = np.asarray(counts.is_valid().to_numpy(zero_copy_only=False))
    exact = np.asarray(counts.fill_null(0).to_numpy())  # int64: nanoseconds since 1970 do not fit a float64
    seconds = np.full(exact.shape, np.nan)
    if valid.any():
        if not origin:
            origin.append(int(exact[valid][0]))
        seconds[valid] = (exact[valid] - origin[0]) * _SECONDS[column.type.unit]
    return seconds


BLOCK_ROWS = 1 << 16  # rows read at a time [rows]
BUFFER_BYTES = 1 << 20  # buffer of a column [bytes]
SUFFIXES = (".parquet", ".pq")
CHECKED: dict[str, Any] = {"write_page_checksum": True}  # what pyarrow's writers are called with

_REMEDY = "write it again, or move it away"


def read_parquet(path: Path) -> Table:
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


_UNPACKED = 4  # size of a batch, which is held as a whole [times the file]

_FILE_MAGIC = b"ARROW1"
_OLD_MAGIC = b"FEA1"


def read_ipc(path: Path) -> Table:
    """Open a Feather file of version 2, an Arrow file or an Arrow stream.

    Columns of time stamps are returned in seconds since the first row.
    """
    with _opened(path) as reader:
        names = tuple(reader.schema.names)
        stamps = frozenset(number for number, field in enumerate(reader.schema) if is_stamp(field.type))
    if not names:
        raise LogError(f"{path}: the file has no columns; write the log's signals into it")
    return Table(path, names, partial(_blocks_of_ipc, path), in_seconds=stamps)


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
        table.allow(held=_UNPACKED * path.stat().st_size)  # a batch is held as a whole
        magic = file.read(len(_FILE_MAGIC))
        if magic.startswith(_OLD_MAGIC):
            raise LogError(f"{path}: a Feather file of version 1; write it again with a newer pyarrow")
        file.seek(0)
        yield ipc.open_file(file) if magic == _FILE_MAGIC else ipc.open_stream(file)


def _blocks_of_ipc(path: Path, columns: Sequence[int]) -> Iterator[list[NDArray[np.float64]]]:
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


@dataclass(frozen=True)
class RowGroups:
    """Rows of a Parquet file."""

    path: Path
    groups: tuple[int, ...] | None = None
    column: str = ""
    key: str | int | None = None


def read_row_groups(parts: Sequence[RowGroups]) -> Table:
    """Return the rows of several files as one table, in the order given.

    >>> import tempfile
    >>> import pyarrow
    >>> from pyarrow import parquet
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "log.parquet")
    ...     parquet.write_table(pyarrow.table({"rig": ["a", "b", "a"], "u": [1.0, 2.0, 3.0]}), file)
    ...     read_row_groups([RowGroups(file, None, "rig", "a")]).column("u")
    array([1., 3.])
    """
    names: list[str] = []
    stamps: frozenset[int] = frozenset()
    rows = 0
    for part in parts:
        with open_parquet(part.path) as file:
            schema, about = file.schema_arrow, file.metadata
            groups = range(about.num_row_groups) if part.groups is None else part.groups
            rows += sum(about.row_group(group).num_rows for group in groups)
        if names and schema.names != names:
            raise LogError(
                f"{part.path}: other columns than in {parts[0].path.name}; the files of a rig must have equal"
            )
        names = schema.names
        stamps = frozenset(number for number, field in enumerate(schema) if is_stamp(field.type))
    if not names:
        raise LogError(f"{parts[0].path}: the file has no columns; write the log's signals into it")
    return Table(
        parts[0].path,
        tuple(names),
        partial(_blocks_of_groups, parts),
        _place_of(parts),
        in_seconds=stamps,
        approximate_rows=rows,
    )


def first_stamp(part: RowGroups, number: int) -> float:
    """Return the first value of a column, for sorting: time stamps as s since 1970; infinite where there is none."""
    for block in _blocks_of_part(part, [number], [[0]]):
        known = block[0][np.isfinite(block[0])]
        if known.size:
            return float(known[0])
    return np.inf


def _place_of(parts: Sequence[RowGroups]) -> Any:
    """Return the words for a row of the table."""
    if len(parts) == 1 and parts[0].groups is None and not parts[0].column:
        return nth_row
    of = f"of {parts[0].path.name}" if len(parts) == 1 else f"of the {len(parts)} files joined in the order of time"
    key = "" if not parts[0].column else f" with {parts[0].column} {parts[0].key}"
    return lambda row: f"{nth_row(row)} {of}{key}"


def _blocks_of_groups(parts: Sequence[RowGroups], columns: Sequence[int]) -> Iterator[list[NDArray[np.float64]]]:
    origins: list[list[int]] = [[] for _ in columns]  # time stamps count from the first row of the first part
    for part in parts:
        yield from _blocks_of_part(part, columns, origins)


def _blocks_of_part(
    part: RowGroups, columns: Sequence[int], origins: Sequence[list[int]]
) -> Iterator[list[NDArray[np.float64]]]:
    with open_parquet(part.path) as file:
        schema = file.schema_arrow
        for number in columns:
            check_type(part.path, schema.field(number))
        names = [schema.names[number] for number in columns]
        asked = sorted({*names, part.column} - {""})
        groups = range(file.metadata.num_row_groups) if part.groups is None else part.groups
        if any(group >= file.metadata.num_row_groups for group in groups):
            raise LogError(f"{part.path}: the file has changed since it was looked at; start again")
        batches = file.iter_batches(BLOCK_ROWS, row_groups=list(groups), columns=asked, use_threads=False)
        held = sum(file.metadata.row_group(group).num_rows for group in groups)
        rows = 0

        def next_block() -> list[NDArray[np.float64]] | None:
            nonlocal rows
            batch = next(batches, None)
            if batch is None:
                if rows != held:  # pyarrow skips a page whose header is damaged
                    raise LogError(f"{part.path}: the file is damaged: {rows:,} of {held:,} rows can be read")
                return None
            rows += batch.num_rows
            if part.column:
                batch = _with_key(batch, part)
            return [as_float(batch.column(name), origin) for name, origin in zip(names, origins, strict=True)]

        for block in prefetch(repeat(next_block), workers=1):
            if block is None:
                return
            yield block


def _with_key(batch: Any, part: RowGroups) -> Any:
    """Return the rows of a batch that have the part's key."""
    import pyarrow
    import pyarrow.compute

    keys = batch.column(part.column)
    if pyarrow.types.is_dictionary(keys.type):
        keys = keys.dictionary_decode()
    if part.key is None:
        return batch.filter(keys.is_null())
    return batch.filter(pyarrow.compute.equal(keys, pyarrow.scalar(part.key, keys.type)))
