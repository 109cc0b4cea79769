"""The header of lines of CSV: the columns that it names, and how lines are read under one with other names."""

from __future__ import annotations

from collections.abc import Sequence

from replant.errors import LogError, shown
from replant.live.streams.source import TIME, UY, Signals
from replant.logs.sampling_time import time_candidates, unit_in_seconds
from replant.logs.text_cells import parse_number


def header_of(line: str, signals: Signals) -> tuple[tuple[str, ...], float] | None:
    """Return the columns in a header of CSV, the time column as t, and its unit in s; None if a signal is missing."""
    cells, unit = [cell.strip().strip('"') for cell in line.split(",")], 1.0
    if not set(signals.names) <= set(cells) or len(set(cells)) < len(cells):
        return None
    times = [k for k in time_candidates(cells) if cells[k] not in signals.names]
    if len(times) == 1:
        cells[times[0]], unit = TIME, unit_in_seconds(cells[times[0]])
    return tuple(cells), unit


def titles_of(line: str) -> tuple[str, ...]:
    """Return the cells of a line in which each is text and another one, as in a header; else none."""
    cells = tuple(cell.strip().strip('"') for cell in line.split(","))
    return () if len(set(cells)) < len(cells) or not all(map(_is_text, cells)) else cells


def _is_text(cell: str) -> bool:
    try:
        parse_number(cell)
    except ValueError:
        return True
    return False


def remark_on(titles: Sequence[str], columns: Sequence[str], signals: Signals) -> str:
    """Return how lines are read as ``columns`` under a header that does not name each signal.

    Raise LogError if the header contradicts that, as it names another place of a column, or if a user has named the
    signals: one of the names is then wrong, and any reading a guess.
    """
    times, missing = time_candidates(titles), [name for name in signals.names if name not in titles]
    known = [TIME if k in times else title for k, title in enumerate(titles)]
    moved = any(name != read and name in signals.fields for name, read in zip(known, columns, strict=True))
    if moved or signals != UY:
        there = ", ".join(map(shown, titles))
        raise LogError(f"no column {shown(missing[0])} in the header; there are: {there}; name signals with -i and -o")
    read = ", ".join(f"{name} from {shown(title)}" for name, title in zip(columns, titles, strict=True))
    return f"the header does not name {' and '.join(missing)}: read {read}; if not, give -i and -o"
