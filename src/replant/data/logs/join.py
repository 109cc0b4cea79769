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

    Raises
    ------
    LogError
        If their columns differ, a column has stamps of its own, or dates are counted from each file's first row.

    Examples
    --------
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
        if table.in_seconds or table.stamps is not None:
            raise LogError(
                f"{table.path}: its dates or time stamps are counted from its own first row, so it cannot be joined "
                f"with {first.path.name}; write the files as Parquet, or with a time in s that goes on"
            )

    def blocks(numbers: Sequence[int]) -> Iterator[list[NDArray[np.float64]]]:
        names = [first.names[number] for number in numbers]
        return chain.from_iterable(table.blocks([table.names.index(name) for name in names]) for table in tables)

    return Table(
        first.path,
        first.names,
        blocks,
        lambda row: f"{nth_row(row)} of the {len(tables)} files joined in the order of time",
        approximate_rows=sum(table.approximate_rows for table in tables),
        notes=tuple(note for table in tables for note in table.notes),
    )
