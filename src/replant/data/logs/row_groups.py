"""Rows of Parquet files that belong together: some row groups of each file, perhaps only those with a certain key."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant.data.logs.arrow_columns import as_float, check_type, is_stamp
from replant.data.logs.parquet import BLOCK_ROWS, open_parquet
from replant.data.logs.prefetch import prefetch
from replant.data.logs.table import Table, nth_row
from replant.errors import LogError


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
        parts[0].path, tuple(names), partial(_blocks, parts), _place_of(parts), in_seconds=stamps, approximate_rows=rows
    )


def first_stamp(part: RowGroups, number: int) -> float:
    """Return the first value of a column, for sorting: time stamps as s since 1970; infinite where there is none."""
    for block in _blocks_of(part, [number], [[0]]):
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


def _blocks(parts: Sequence[RowGroups], columns: Sequence[int]) -> Iterator[list[NDArray[np.float64]]]:
    origins: list[list[int]] = [[] for _ in columns]  # time stamps count from the first row of the first part
    for part in parts:
        yield from _blocks_of(part, columns, origins)


def _blocks_of(
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
