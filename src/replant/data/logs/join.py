"""Join: several logs of one rig, of any formats, as one table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from replant.data.logs.table import Table, nth_row
from replant.errors import LogError


def joined(tables: Sequence[Table]) -> Table:
    """Return tables with equal columns as one, in the order given.

    >>> from pathlib import Path
    >>> one, other = (
    ...     Table(Path(name), ("t", "u"), lambda numbers, t=t: iter([[np.array([t]) for _ in numbers]]))
    ...     for name, t in (("a.csv", 0.0), ("b.csv", 1.0))
    ... )
    >>> joined([one, other]).column("t")
    array([0., 1.])
    """
    first = tables[0]
    for table in tables:
        if set(table.names) != set(first.names):
            raise LogError(
                f"{table.path}: other columns than in {first.path.name}; the files of a rig must have equal columns"
            )
        if table.stamps is not None or _dated(table) != _dated(first) or len(table.origins) < len(table.in_seconds):
            raise LogError(
                f"{table.path}: its dates or time stamps are counted from its own first row, so it cannot be joined "
                f"with {first.path.name}; write the files as Parquet, with whole dates (year-month-day, clock time), "
                "or with a time in s that goes on"
            )

    def blocks(numbers: Sequence[int]) -> Iterator[list[NDArray[np.float64]]]:
        return chain.from_iterable(_blocks_of(table, first, numbers) for table in tables)

    return Table(
        first.path,
        first.names,
        blocks,
        in_seconds=first.in_seconds,
        origins=first.origins,
        describe_row=lambda row: f"{nth_row(row)} of the {len(tables)} files joined in the order of time",
        approximate_rows=sum(table.approximate_rows for table in tables),
        notes=tuple(note for table in tables for note in table.notes),
    )


def _dated(table: Table) -> set[str]:
    """Return the names of the columns of dates."""
    return {table.names[number] for number in table.in_seconds}


def _blocks_of(table: Table, first: Table, numbers: Sequence[int]) -> Iterator[list[NDArray[np.float64]]]:
    """Yield the blocks of a table, its dates counted from the first row of the first one."""
    own = [table.names.index(first.names[number]) for number in numbers]
    later = [
        (table.origins[here] - first.origins[number]) / 1e9 if here in table.origins else 0.0
        for here, number in zip(own, numbers, strict=True)
    ]
    for block in table.blocks(own):
        yield [column + off if off else column for column, off in zip(block, later, strict=True)]
