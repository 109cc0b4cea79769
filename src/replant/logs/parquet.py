"""Parquet files (.parquet, .pq), with pyarrow: only the columns asked for are read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant.errors import LogError, MissingDependencyError
from replant.logs.damage import damage_refused
from replant.logs.table import Table

_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def read(path: Path) -> Table:
    """Open a Parquet file; columns of time stamps come in seconds since the first row.

    Raises
    ------
    MissingDependencyError
        If pyarrow is not installed.
    LogError
        If the file is not a Parquet file, or has no column.
    """
    with _opened(path) as file:
        schema = file.schema_arrow
    if not schema.names:
        raise LogError(f"{path}: the file has no columns; write the log's signals into it")
    stamps = frozenset(number for number, field in enumerate(schema) if _is_stamp(field.type))
    return Table(path, tuple(schema.names), partial(_load, path), in_seconds=stamps)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        from pyarrow import parquet
    except ImportError as error:
        raise MissingDependencyError(
            f"{path}: reading Parquet needs pyarrow: pip install 'replant[parquet]'"
        ) from error
    with damage_refused(path, "Parquet file", "write it again"), parquet.ParquetFile(path) as file:
        yield file


def read_folder(folder: Path) -> Table:
    """Open a folder of Parquet files with the same columns as one log, in the order of their names.

    So `replant live --record` leaves them; of the folder that it was given, the samples are read.

    Raises
    ------
    MissingDependencyError
        If pyarrow is not installed.
    LogError
        If there is no Parquet file in it, or one is damaged or has other columns than the first.
    """
    recorded = folder / "samples"
    found = (recorded if recorded.is_dir() else folder).glob("*.parquet")
    paths = sorted(path for path in found if not path.name.startswith((".", "_")))  # those are being written
    if not paths:
        raise LogError(f"{folder}: a directory; give the log file inside it, or a folder of Parquet files")
    first = read(paths[0])
    for path in paths[1:]:
        if read(path).names != first.names:
            raise LogError(f"{path}: other columns than in {paths[0].name}; give the log file itself")
    return Table(folder, first.names, partial(_load_all, paths, first.in_seconds), in_seconds=frozenset())


def _load_all(paths: Sequence[Path], stamps: frozenset[int], columns: Sequence[int]) -> list[NDArray[np.float64]]:
    if stamps & set(columns):  # they count from the first of each file
        raise LogError(f"{paths[0].parent}: dates in a folder of files are not read; store the time in s as numbers")
    parts = [_load(path, columns) for path in paths]
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def _load(path: Path, columns: Sequence[int]) -> list[NDArray[np.float64]]:
    with _opened(path) as file:
        schema = file.schema_arrow
        for number in columns:
            _check_type(path, schema.field(number))
        names = [schema.names[number] for number in columns]
        table = file.read(columns=sorted(set(names)))
        twins = [schema.names[:number].count(name) for number, name in zip(columns, names, strict=True)]
        return [
            _as_float(table.column(table.schema.get_all_field_indices(name)[twin]))
            for name, twin in zip(names, twins, strict=True)
        ]


def _is_stamp(kind: Any) -> bool:
    import pyarrow.types

    return bool(pyarrow.types.is_timestamp(kind) or pyarrow.types.is_duration(kind))


def _check_type(path: Path, field: Any) -> None:
    from pyarrow import types

    number = types.is_integer(field.type) or types.is_floating(field.type) or types.is_decimal(field.type)
    if not (number or types.is_boolean(field.type) or _is_stamp(field.type)):
        raise LogError(
            f"{path}: column {field.name!r} holds {field.type}, not numbers; choose another or convert it to a number"
        )


def _as_float(column: Any) -> NDArray[np.float64]:
    """Convert a column of numbers or time stamps to float64; a null is NaN."""
    import pyarrow
    from pyarrow import types

    if not _is_stamp(column.type):
        if types.is_boolean(column.type):
            column = column.cast(pyarrow.int8())
        values = column.cast(pyarrow.float64(), safe=False).to_numpy()
        return np.array(values, dtype=np.float64)
    counts = column.cast(pyarrow.int64())
    valid = np.asarray(counts.is_valid().to_numpy())
    exact = np.asarray(counts.fill_null(0).to_numpy())  # int64: nanoseconds since 1970 do not fit a float64
    seconds = np.full(exact.shape, np.nan)
    if valid.any():
        seconds[valid] = (exact[valid] - exact[valid][0]) * _SECONDS[column.type.unit]
    return seconds
