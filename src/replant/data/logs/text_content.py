"""What the first rows of a text log hold: dates and clock times in which columns, and which decimal mark."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from replant.data.logs.sampling_time import time_candidates
from replant.data.logs.text_numbers import DecimalMark, common_mark, mark_of
from replant.data.logs.text_times import StampFormat, find_format, is_missing, parse_stamp


@dataclass(frozen=True)
class Content:
    """What the cells of a text log hold."""

    stamps: Mapping[int, StampFormat] = field(default_factory=dict)
    mark: DecimalMark | None = None
    marks: Mapping[int, DecimalMark] = field(default_factory=dict)


def content_of(names: Sequence[str], rows: Sequence[tuple[int, Sequence[str]]], delimiter: str | None) -> Content:
    """Return what rows of cells hold, each with the number of its line.

    Examples
    --------
    >>> found = content_of(("time", "u"), [(2, ["10:00:00", "0,5"]), (3, ["10:00:01", "1.000,5"])], ";")
    >>> list(found.stamps), found.mark.mark
    ([0], ',')
    """
    whole = [(line, cells) for line, cells in rows if len(cells) >= len(names)]
    stamps = _stamps(names, [cells for _, cells in whole])
    if delimiter == ",":
        return Content(stamps)
    own = {
        column: mark
        for column in range(len(names))
        if column not in stamps
        and (mark := common_mark(mark_of(cells[column], line) for line, cells in whole)) is not None
    }
    common = common_mark(own.values())
    return Content(stamps, common, _exceptions(own, common))


def _exceptions(own: Mapping[int, DecimalMark], common: DecimalMark | None) -> dict[int, DecimalMark]:
    return {column: mark for column, mark in own.items() if common and mark.certain and mark.mark != common.mark}


def _stamps(names: Sequence[str], rows: Sequence[Sequence[str]]) -> dict[int, StampFormat]:
    """Return the columns of stamps whose name is that of the time; all where no name is."""
    found = {}
    for column in range(len(names)):
        first = next((row[column] for row in rows if not is_missing(row[column])), "")
        if _may_be_stamp(first):
            form = find_format([row[column] for row in rows])
            if form is not None:
                found[column] = form
    dates = [column for column, form in found.items() if form.parts == "d"]
    for column, form in found.items():
        if form.parts == "c" and len(dates) == 1:
            joined = find_format([joined_cell(row[dates[0]], row[column]) for row in rows])
            if joined is not None:
                found[column] = replace(joined, date_column=dates[0])
    if any(form.date_column is not None for form in found.values()):
        del found[dates[0]]
    named = set(time_candidates(names))
    return {column: form for column, form in found.items() if not named or column in named}


def _may_be_stamp(cell: str) -> bool:
    try:
        parse_stamp(cell, month_first=False)
    except ValueError:
        try:
            parse_stamp(cell, month_first=True)
        except ValueError:
            return False
    return True


def joined_cell(day: str, clock: str) -> str:
    """Return the date of one column and the clock time of another in one cell; an empty one where either is missing.

    Examples
    --------
    >>> joined_cell("01.05.2024", "10:00:00"), joined_cell("", "10:00:00")
    ('01.05.2024 10:00:00', '')
    """
    return "" if is_missing(day) or is_missing(clock) else f"{day.strip()} {clock.strip()}"


def later_mark(
    mark: DecimalMark | None, rows: Iterable[tuple[int, Sequence[str]]], left_out: Iterable[int]
) -> DecimalMark | None:
    """Return the first certain decimal mark in further rows, else what the first rows told.

    >>> later_mark(None, [(9, ["2", "1.234"]), (10, ["2", "0,5"])], []).line
    10
    """
    best, skipped = mark, set(left_out)
    for line, cells in rows:
        for column, cell in enumerate(cells):
            found = None if column in skipped else mark_of(cell, line)
            if found is not None and found.certain:
                return found
            best = best or found
    return best
