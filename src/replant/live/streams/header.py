"""The header of lines of CSV: the columns that it names, and how lines are read under one with other names."""

from __future__ import annotations

from collections.abc import Sequence

from replant.errors import LogError, shown
from replant.live.streams.source import TIME, UY, Signals
from replant.logs.sampling_time import clearer_times, is_letter, time_candidates, unit_in_seconds
from replant.logs.text_cells import parse_number
from replant.model.interop import without_unit


def header_of(line: str, signals: Signals) -> tuple[tuple[str, ...], float] | None:
    """Return the columns in a header of CSV, the time column as t, and its unit in s; None if a signal is missing."""
    titles = [cell.strip().strip('"') for cell in line.split(",")]
    cells, times = _known(titles, signals)
    if not set(signals.names) <= set(cells) or len(set(cells)) < len(cells):
        return None
    return tuple(cells), unit_in_seconds(titles[times[0]]) if len(times) == 1 else 1.0


def _known(titles: Sequence[str], signals: Signals) -> tuple[list[str], list[int]]:
    """Return titles with the names of fields in the place of those that stand for them, and the time's candidates.

    A title stands for a field of its name, or, if there is none, of its name without unit; one of time stands for t.
    T may be a temperature: it is no time beside another one, or if too few columns would be left for the signals.
    """
    fields = {without_unit(name): name for name in signals.fields if name != TIME and name not in titles}
    bare = [without_unit(title) for title in titles]
    cells = [
        fields.get(name, title) if bare.count(name) == 1 else title for name, title in zip(bare, titles, strict=True)
    ]
    named = [number for number in time_candidates(titles) if cells[number] not in signals.names]
    times = clearer_times(titles, named)
    if len(titles) - len(times) < len(signals.names):
        times = [number for number in times if not is_letter(titles[number])]
    if len(times) == 1:
        cells[times[0]] = TIME
    return cells, times


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
    """Return how lines are read as ``columns`` after a line of texts that does not name each signal.

    Raise LogError if it is a header, as it names a field, and contradicts that: it names another place of a column, or
    a user has named the signals.  One of the names is then wrong, and any reading a guess.
    """
    known, times = _known(titles, signals)
    if not times and not set(known) & set(signals.fields):  # perhaps a greeting
        order = f"read {', '.join(columns)} in this order; if it is a header, name signals as it does with -i and -o"
        return f"the line {shown(','.join(titles))} before the rows names no signal: {order}"
    missing = [name for name in signals.names if name not in known]
    known = [TIME if k in times else title for k, title in enumerate(known)]
    moved = any(name != read and name in signals.fields for name, read in zip(known, columns, strict=True))
    if moved or signals != UY:
        there = ", ".join(map(shown, titles))
        advice = "name signals with -i and -o" if signals == UY else "correct -i and -o, or the header"
        raise LogError(f"no column {shown(missing[0])} in the header; there are: {there}; {advice}")
    read = ", ".join(f"{name} from {shown(title)}" for name, title in zip(columns, titles, strict=True))
    return f"the header does not name {' and '.join(missing)}: read {read}; if not, give -i and -o"
