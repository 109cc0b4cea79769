"""Rigs that a column of Parquet files names: found by the statistics of the row groups.

A row group whose least and greatest name are equal is one rig's.  Of one with several rigs, or without statistics, the
column of the names is read, and nothing else; each rig then reads that row group and keeps its own rows.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from replant.data.logs.arrow import SUFFIXES, open_parquet
from replant.data.logs.table import listed
from replant.errors import LogError
from replant.fleet.job import Piece

READERS = 8  # threads that read footers: they wait for the disk, or the network [count]
NAMELESS = "(no name)"

Key = str | int | None


def rigs_in_columns(pieces: Sequence[Piece], column: str) -> list[tuple[str, Piece, str]]:
    """Return the name of a rig, a part of a file with its rows, and why they cannot be used; empty if they can.

    A file that cannot be read is a rig of its own, under the file's name.
    """
    for piece in pieces:
        if Path(piece.path).suffix.lower() not in SUFFIXES:
            raise LogError(
                f"{piece.path}: no folder {column}=..., and a column names rigs in Parquet files only; "
                "choose --by file or --by folder"
            )
    with ThreadPoolExecutor(READERS, "replant-footers") as pool:
        return [rig for found in pool.map(partial(_rigs_of, column=column), pieces) for rig in found]


def _rigs_of(piece: Piece, column: str) -> list[tuple[str, Piece, str]]:
    try:
        with open_parquet(Path(piece.path)) as file:
            schema = file.schema_arrow
            names = schema.names
            usable = column in names and _is_name(schema.field(column).type)
            found = _groups(file, column) if usable else {}
    except LogError as problem:
        return [(piece.name, piece, str(problem))]
    if column not in names:
        raise LogError(
            f"{piece.path}: no column {column!r}, nor a folder {column}=...; there are: {listed(names)}; "
            "choose --by file, --by folder or a column"
        )
    if not usable:
        raise LogError(
            f"{piece.path}: column {column!r} holds {schema.field(column).type}; a rig is named by text or a whole "
            "number"
        )
    parts = []
    for key, (groups, rows, alone) in found.items():
        part = replace(
            piece, groups=tuple(groups), rows=rows, column="" if alone else column, key=None if alone else key
        )
        lacking = f"{piece.path}: {rows} rows have no value in column {column!r}, so that they are no rig's"
        nobody = key is None or not str(key).strip()
        parts.append((NAMELESS if nobody else str(key), part, lacking if nobody else ""))
    return parts


def _groups(file: Any, column: str) -> dict[Key, tuple[list[int], int, bool]]:
    """Return, for each rig, its row groups, about how many rows it has, and whether they are its alone."""
    about, found = file.metadata, defaultdict(list)
    leaf = _leaf(about, column)
    for group in range(about.num_row_groups):
        rows, statistics = about.row_group(group).num_rows, about.row_group(group).column(leaf).statistics
        if rows == 0:
            continue
        known = statistics is not None and statistics.has_min_max and statistics.has_null_count
        if known and statistics.min == statistics.max and statistics.null_count == 0:
            found[statistics.min].append((group, rows, True))
            continue
        for key, count in _counted(file, group, column):
            found[key].append((group, count, count == rows))
    return {
        key: ([group for group, _, _ in of], sum(rows for _, rows, _ in of), all(alone for _, _, alone in of))
        for key, of in found.items()
    }


def _leaf(about: Any, column: str) -> int:
    """Return the number of a column in the footer, where a column of structures counts once for each of its fields."""
    paths = [about.schema.column(number).path for number in range(about.num_columns)]
    return paths.index(column)


def _counted(file: Any, group: int, name: str) -> list[tuple[Key, int]]:
    """Return the rigs of a row group, and how many rows each has."""
    column = file.read_row_group(group, columns=[name], use_threads=False).column(0)
    counts = column.combine_chunks().value_counts() if column.num_chunks else []
    return [(entry["values"].as_py(), entry["counts"].as_py()) for entry in counts]


def _is_name(kind: Any) -> bool:
    """Return whether an Arrow type is that of text or whole numbers."""
    from pyarrow import types

    if types.is_dictionary(kind):
        kind = kind.value_type
    return bool(types.is_integer(kind) or types.is_string(kind) or types.is_large_string(kind))
