"""Parquet (.parquet, .pq, or a folder of them), Feather and Arrow files, read with pyarrow; columns as float64.

Parquet files of replant have a checksum in each page, verified on reading.  Time stamps become seconds since the first
row.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import LogError, shown
from replant.logs.parser_process import allow
from replant.logs.table import Arrays, Table, damage_as_log_error, needed, nth_row
from replant.numerics.arguments import FloatArray

SUFFIXES = (".parquet", ".pq")
CHECKED: dict[str, Any] = {"write_page_checksum": True}  # arguments of pyarrow's writers
BLOCK_ROWS = 1 << 16  # rows read at a time [rows]
BUFFER_BYTES = 1 << 20  # buffer of a column [bytes]
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_REMEDY = "write it again, or move it away"


@dataclass(frozen=True)
class RowGroups:
    """Rows of a Parquet file: all or some row groups; with ``column``, only the rows that have ``key`` there."""

    path: Path
    groups: tuple[int, ...] | None = None
    column: str = ""
    key: str | int | None = None

    def groups_of(self, file: Any) -> list[int]:
        """Return the numbers of the row groups in an open file."""
        return list(range(file.metadata.num_row_groups) if self.groups is None else self.groups)


def read_parquet(path: Path) -> Table:
    """Open a Parquet file, or a folder of Parquet files with equal columns, in the order of their names."""
    return read_row_groups([RowGroups(part) for part in (parts_of(path) if path.is_dir() else [path])], path)


def parts_of(folder: Path) -> list[Path]:
    """Return the Parquet files in a folder or its ``samples``, sorted by name, without hidden and unfinished ones."""
    recorded = folder / "samples"
    found = (recorded if recorded.is_dir() else folder).iterdir()
    return sorted(part for part in found if part.suffix.lower() in SUFFIXES and part.name[0] not in "._")


def read_row_groups(parts: Sequence[RowGroups], path: Path | None = None) -> Table:
    """Return the rows of several files with equal columns as one table, in the order given."""
    path, lengths, schema = path or parts[0].path, [], None
    for part in parts:
        with open_parquet(part.path) as file:
            found = file.schema_arrow
            lengths.append(sum(file.metadata.row_group(group).num_rows for group in part.groups_of(file)))
        if schema is not None and found.names != schema.names:
            raise LogError(f"{part.path}: other columns than in {parts[0].path.name}; parts of one log have equal ones")
        schema = schema or found

    def blocks(columns: Sequence[int]) -> Iterator[Arrays]:
        origins: list[list[int]] = [[] for _ in columns]  # shared: stamps count from the first row of the first part
        return chain.from_iterable(_blocks_of(part, columns, origins) for part in parts)

    return _table(path, schema, blocks, partial(_place_of, parts, lengths), sum(lengths))


def first_stamp(part: RowGroups, number: int) -> float:
    """Return the first value of a column, for sorting: time stamps in s since 1970; infinite if there is no value."""
    for (stamps,) in _blocks_of(part, [number], [[0]]):
        known = stamps[np.isfinite(stamps)]
        if known.size:
            return float(known[0])
    return np.inf


def read_ipc(path: Path) -> Table:
    """Open a Feather file of version 2, an Arrow file or an Arrow stream."""
    with _opened_ipc(path) as reader:
        return _table(path, reader.schema, partial(_blocks_of_ipc, path), nth_row)


def _table(path: Path, schema: Any, blocks: Any, describe_row: Any, approximate_rows: int = 0) -> Table:
    if schema is None or not schema.names:
        raise LogError(f"{path}: the file has no columns; write the log's signals into it")
    stamps = frozenset(number for number, field in enumerate(schema) if _is_stamp(field.type))
    return Table(path, tuple(schema.names), blocks, describe_row, in_seconds=stamps, approximate_rows=approximate_rows)


def _place_of(parts: Sequence[RowGroups], lengths: Sequence[int], row: int) -> str:
    """Return the text that locates a row of the table in its file or files."""
    if all(part.groups is None and not part.column for part in parts):  # whole files
        for part, length in zip(parts, lengths, strict=True):
            if row < length:
                return f"{part.path.name}, {nth_row(row)}" if len(parts) > 1 else nth_row(row)
            row -= length
    of = f"of {parts[0].path.name}" if len(parts) == 1 else f"of the {len(parts)} files joined in the order of time"
    key = f" with {parts[0].column} {parts[0].key}" if parts[0].column else ""
    return f"{nth_row(row)} {of}{key}"


@contextmanager
def open_parquet(path: Path) -> Iterator[Any]:
    """Open a file as `pyarrow.parquet.ParquetFile`."""
    parquet = needed(path, "pyarrow.parquet", "reading Parquet needs pyarrow", "'replant[parquet]'")
    # pre_buffer would hold every block in memory
    options = {"pre_buffer": False, "buffer_size": BUFFER_BYTES, "page_checksum_verification": True}
    with damage_as_log_error(path, "Parquet file", _REMEDY), parquet.ParquetFile(path, **options) as file:
        yield file


def _blocks_of(part: RowGroups, columns: Sequence[int], origins: Sequence[list[int]]) -> Iterator[Arrays]:
    with open_parquet(part.path) as file:
        groups, rows = part.groups_of(file), 0
        names = _checked_names(part.path, file.schema_arrow, columns)
        if max(groups, default=-1) >= file.metadata.num_row_groups:
            raise LogError(f"{part.path}: the file has changed since it was looked at; start again")
        twins = [file.schema_arrow.names[:number].count(name) for number, name in zip(columns, names, strict=True)]
        asked = sorted({*names, part.column} - {""})
        for batch in file.iter_batches(BLOCK_ROWS, row_groups=groups, columns=asked, use_threads=False):
            rows += batch.num_rows
            batch = _with_key(batch, part) if part.column else batch
            places = [batch.schema.get_all_field_indices(name)[twin] for name, twin in zip(names, twins, strict=True)]
            yield [_as_float(batch.column(at), origin) for at, origin in zip(places, origins, strict=True)]
        check_rows(part.path, file, rows, groups)


def check_rows(path: Path, file: Any, rows: int, groups: Sequence[int] | None = None) -> None:
    """Check that all rows of a file or of its ``groups`` were read: pyarrow skips a page with a damaged header."""
    about = file.metadata
    held = about.num_rows if groups is None else sum(about.row_group(group).num_rows for group in groups)
    if rows != held:
        raise LogError(f"{path}: the file is damaged: {rows:,} of its {held:,} rows can be read; {_REMEDY}")


def _with_key(batch: Any, part: RowGroups) -> Any:
    import pyarrow
    import pyarrow.compute

    keys = batch.column(part.column)
    if pyarrow.types.is_dictionary(keys.type):
        keys = keys.dictionary_decode()
    key = part.key
    return batch.filter(keys.is_null() if key is None else pyarrow.compute.equal(keys, pyarrow.scalar(key, keys.type)))


_UNPACKED = 4  # memory for the batches, each of which is held as a whole [times the file]
_FILE_MAGIC = b"ARROW1"
_OLD_MAGIC = b"FEA1"


@contextmanager
def _opened_ipc(path: Path) -> Iterator[Any]:
    ipc = needed(path, "pyarrow.ipc", "reading Feather and Arrow files needs pyarrow", "'replant[parquet]'")
    import pyarrow

    with damage_as_log_error(path, "Feather or Arrow file", "write it again"), pyarrow.OSFile(str(path)) as file:
        allow(held=_UNPACKED * path.stat().st_size)
        magic = file.read(len(_FILE_MAGIC))
        if magic.startswith(_OLD_MAGIC):
            raise LogError(f"{path}: a Feather file of version 1; write it again with a newer pyarrow")
        file.seek(0)
        yield ipc.open_file(file) if magic == _FILE_MAGIC else ipc.open_stream(file)


def _blocks_of_ipc(path: Path, columns: Sequence[int]) -> Iterator[Arrays]:
    with _opened_ipc(path) as reader:
        _checked_names(path, reader.schema, columns)
        origins: list[list[int]] = [[] for _ in columns]
        of_file = getattr(reader, "num_record_batches", None)
        for batch in iter(reader) if of_file is None else map(reader.get_batch, range(of_file)):
            batch.validate(full=True)  # damaged offsets would make pyarrow read beyond the buffer
            for begin in range(0, max(1, batch.num_rows), BLOCK_ROWS):
                rows = batch.slice(begin, BLOCK_ROWS)
                yield [_as_float(rows.column(number), origin) for number, origin in zip(columns, origins, strict=True)]


def _is_stamp(kind: Any) -> bool:
    """Return whether an Arrow type is a time stamp or a duration."""
    import pyarrow.types

    return bool(pyarrow.types.is_timestamp(kind) or pyarrow.types.is_duration(kind))


def _checked_names(path: Path, schema: Any, columns: Sequence[int]) -> list[str]:
    """Return the names of columns, which must hold numbers or time stamps."""
    from pyarrow import types

    kinds = (types.is_integer, types.is_floating, types.is_decimal, types.is_boolean, _is_stamp)
    fields = [schema.field(number) for number in columns]
    for field in fields:
        if not any(is_kind(field.type) for is_kind in kinds):
            raise LogError(
                f"{path}: column {shown(field.name)} holds {field.type}, not numbers; choose another, or convert it"
            )
    return [field.name for field in fields]


def _as_float(column: Any, origin: list[int]) -> FloatArray:
    """Convert numbers or time stamps to float64, null to NaN; the first stamp is appended to an empty ``origin``."""
    import pyarrow
    from pyarrow import types

    if not _is_stamp(column.type):
        if types.is_boolean(column.type):
            column = column.cast(pyarrow.int8())
        values = column.cast(pyarrow.float64(), safe=False).to_numpy(zero_copy_only=False)
        return np.array(values, dtype=np.float64)
    valid = np.asarray(column.is_valid().to_numpy(zero_copy_only=False))
    # int64: float64 cannot represent nanoseconds since 1970
    exact = np.asarray(column.cast(pyarrow.int64()).fill_null(0).to_numpy())
    if valid.any() and not origin:
        origin.append(int(exact[valid][0]))
    return np.where(valid, (exact - (origin or [0])[0]) * _SECONDS[column.type.unit], np.nan)
