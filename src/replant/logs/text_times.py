"""Time stamps that are no plain numbers, as exact seconds: dates and clock times in text, and stamps in two columns.

A clock jumps at midnight and at daylight saving time.  ROS writes whole seconds, and the rest of a second in a finer
unit, into two columns.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import date
from functools import lru_cache

import numpy as np

from replant.errors import LogError
from replant.logs.sampling_time import UNITS, mostly_rise
from replant.logs.table import Arrays, Table
from replant.logs.text_cells import MISSING, CellError, quote
from replant.numerics.arguments import FloatArray

# the accepted forms, for messages
READ = "2024-05-01T10:00:00.5, with Z or +02:00 where it is known, 01.05.2024 10:00:00,5 and 10:00:00.5 are read"

_EPOCH = date(1970, 1, 1).toordinal()
_NANOSECOND = 1_000_000_000  # unit of the stamps [1/s]
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_DATE = (
    r"(?:(?P<year>\d{4})(?P<mark>[-/.])(?P<month>\d{1,2})(?P=mark)(?P<day>\d{1,2})"
    r"|(?P<basic>\d{8})(?=[T_ ])"
    # a year of two digits needs points before it and a clock time after it: 10.05.07 alone may be a clock time
    r"|(?P<one>\d{1,2})(?P<sep>[-/.])(?P<other>\d{1,2})(?P=sep)(?P<local_year>\d{4}|(?<=\.)\d{2}(?=,? +\d))"
    rf"|(?P<named_day>\d{{1,2}})[- ](?P<name>{'|'.join(_MONTHS)})[a-z]*[- ](?P<named_year>\d{{4}}|\d{{2}}))"
)
_HEAD = re.compile(rf"(?:{_DATE}(?:(?:[T_]|,? +|,)|$))?(?:(?P<hour>\d{{1,4}}):(?P<minute>\d{{2}}))?", re.IGNORECASE)
# two numbers without a date are hours and minutes, unless the column's name says minutes and seconds
_TWO = re.compile(r"\d{1,4}:\d{2}")
_STATED = re.compile(r"(?<![:\w])(?:(?P<minutes>mm?:ss?)|hh?:mm?)(?![:\w])", re.IGNORECASE)
# a fraction behind two numbers is one of seconds
_STOPWATCH = re.compile(r"(?P<minute>\d{1,4}):(?P<second>[0-5]\d)[.,](?P<fraction>\d{1,9})")
# a clock time without colons behind a date, also one of eight digits, which need nothing between
_RUN_TOGETHER = re.compile(r"^(?P<day>.*\d(?=[T_ ])|(?:19|20)\d{6})[T_ ]?(?P<h>\d\d)(?P<m>\d\d)(?P<s>\d\d)(?!\d)")
_DOUBT = "stamps such as {} are taken as hours and minutes, and may be minutes and seconds"
_CELL = re.compile(
    r"(?P<head>[^:]*:\d{2}|[^:]*)(?::(?P<second>\d{2})(?:(?:[.,]|:(?=\d{3}(?!\d)))(?P<fraction>\d{1,9}))?)?"
    r"(?: ?(?P<half>[ap])\.?m\.?)?(?: ?(?P<zone>Z|UTC|GMT|[+-]\d{2}(?::?\d{2})?))?",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Stamp:
    """One time stamp."""

    nanoseconds: int
    parts: str
    day: int = 0
    month: int = 0


@dataclass(frozen=True)
class StampFormat:
    """The format of a column of dates or clock times."""

    parts: str
    month_first: bool | None
    first: Stamp
    date_column: int | None = None
    in_minutes: bool = False  # whether two numbers are minutes and seconds
    doubt: str = ""  # why they may be, although the name does not say so

    @property
    def origin(self) -> int | None:
        """The first stamp in ns since 1970; None without a date, or if day and month may be exchanged."""
        certain = self.month_first is not None or self.first.day == self.first.month
        return self.first.nanoseconds if "d" in self.parts and certain else None

    def seconds(self, cells: Iterable[str]) -> FloatArray:
        """Return the seconds since the first stamp, from whole nanoseconds; a missing cell is NaN."""
        return np.fromiter((self._seconds_of(at, cell) for at, cell in enumerate(cells)), np.float64)

    def _seconds_of(self, at: int, cell: str) -> float:
        if is_missing(cell):
            return math.nan
        try:
            stamp = parse_stamp(cell, bool(self.month_first), in_minutes=self.in_minutes)
        except ValueError:
            raise CellError(at, f"{quote(cell)} is no date or clock time; {READ}") from None
        if stamp.parts != self.parts:
            raise CellError(
                at,
                f"{quote(cell)} has not the form of the first time stamp (date, clock time and zone must be in all "
                "stamps or in none); write all stamps alike",
            )
        if self.month_first is None and (stamp.day, stamp.month) != (self.first.day, self.first.month):
            raise CellError(
                at,
                f"{quote(cell)}: day and month may be in either order; write dates as year-month-day, or give the "
                "sampling time (dt, --dt)",
            )
        return float(stamp.nanoseconds - self.first.nanoseconds) / _NANOSECOND


def is_missing(cell: str) -> bool:
    """Return whether a cell means a missing value."""
    return cell.strip().lower() in MISSING or cell.strip().lower() == "nan"


def parse_stamp(cell: str, month_first: bool, *, in_minutes: bool = False) -> Stamp:
    """Read one time stamp; ``in_minutes``: two numbers are minutes and seconds."""
    text = cell.strip()
    if ":" not in text:
        text = _RUN_TOGETHER.sub(r"\g<day>T\g<h>:\g<m>:\g<s>", text, count=1)
    elif stopwatch := _STOPWATCH.fullmatch(text):
        minute, second, fraction = stopwatch.groups()
        return Stamp((60 * int(minute) + int(second)) * _NANOSECOND + int(fraction.ljust(9, "0")), "c")
    found = _CELL.fullmatch(text)
    if found is None:
        raise ValueError(cell)
    head, second, fraction, half, zone = found.group("head", "second", "fraction", "half", "zone")
    base = _parse_head(head.strip(), (half or "").lower(), (zone or "").upper(), month_first)
    if second is None:
        is_hours = not in_minutes or _TWO.fullmatch(head) is None
        return base if is_hours else replace(base, nanoseconds=base.nanoseconds // 60)
    if "c" not in base.parts or int(second) > 59:
        raise ValueError(cell)
    nanoseconds = base.nanoseconds + int(second) * _NANOSECOND + int((fraction or "0").ljust(9, "0"))
    return Stamp(nanoseconds, base.parts, base.day, base.month)


@lru_cache(maxsize=1 << 12)  # all stamps of a minute share the head
def _parse_head(head: str, half: str, zone: str, month_first: bool) -> Stamp:
    found = _HEAD.fullmatch(head)
    if found is None or not head:
        raise ValueError(head)
    part = found.groupdict()
    day, numbers = _day_of(part, month_first)
    if part["hour"] is None:
        if day is None or half or zone:
            raise ValueError(head)
        return Stamp(day * 86400 * _NANOSECOND, "d", *numbers)
    hour, minute = int(part["hour"]), int(part["minute"])
    if minute > 59 or (hour > 23 and day is not None) or (half and not 1 <= hour <= 12) or (zone and day is None):
        raise ValueError(head)
    if half:
        hour = hour % 12 + 12 * (half == "p")
    seconds = (day or 0) * 86400 + hour * 3600 + minute * 60 - _offset(zone)
    return Stamp(seconds * _NANOSECOND, ("" if day is None else "d") + "c" + ("z" if zone else ""), *numbers)


def _day_of(part: dict[str, str | None], month_first: bool) -> tuple[int | None, tuple[int, int]]:
    """Return the day since 1970, None without a date; and the two numbers that may be day and month."""
    numbers = (0, 0)
    if part["year"]:
        day = _date(part["year"], part["month"], part["day"])
    elif part["basic"]:
        day = _date(part["basic"][:4], part["basic"][4:6], part["basic"][6:])
    elif part["name"]:
        day = _date(part["named_year"], _MONTHS.index(part["name"].lower()) + 1, part["named_day"])
    elif part["one"] and part["sep"] == ".":  # in dates with points the day comes first
        day = _date(part["local_year"], part["other"], part["one"])
    elif part["one"]:
        numbers = int(part["one"]), int(part["other"] or 0)
        of_day, of_month = reversed(numbers) if month_first else numbers
        day = _date(part["local_year"], of_month, of_day)
    else:
        return None, numbers
    return day.toordinal() - _EPOCH, numbers


def _date(year: str | None, month: str | int | None, day: str | int | None) -> date:
    century = 0 if len(year or "") > 2 else 1900 if int(year or 0) > 68 else 2000  # POSIX: 69 to 99 are 1969 to 1999
    return date(century + int(year or 0), int(month or 0), int(day or 0))


def _offset(zone: str) -> int:
    """Return the zone's offset from UTC in seconds."""
    if zone in {"", "Z", "UTC", "GMT"}:
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    hours, minutes = int(digits[:2]), int(digits[2:])
    if hours > 23 or minutes > 59:
        raise ValueError(zone)
    return (hours * 60 + minutes) * (-60 if zone[0] == "-" else 60)


def find_format(cells: Sequence[str], name: str = "") -> StampFormat | None:
    """Return the format of a column whose first cell, and at least half of all, are dates or clock times; else None."""
    given = [cell for cell in cells if not is_missing(cell)]
    stated = _STATED.search(name)
    in_minutes = any(map(_STOPWATCH.fullmatch, map(str.strip, given))) or (
        stated is not None and stated["minutes"] is not None
    )

    def stamps_in(cells: Sequence[str], month_first: bool) -> list[Stamp]:
        stamps = []
        for cell in cells:
            with suppress(ValueError):
                stamps.append(parse_stamp(cell, month_first, in_minutes=in_minutes))
        return stamps

    if not (stamps_in(given[:1], False) or stamps_in(given[:1], True)):
        return None
    ways = stamps_in(given, False), stamps_in(given, True)
    month_first = len(ways[1]) > len(ways[0])
    stamps = ways[month_first]
    if 2 * len(stamps) < len(given):
        return None
    certain = not stamps[0].day or any(max(stamp.day, stamp.month) > 12 for stamp in stamps)
    doubt = _DOUBT.format(quote(given[0])) if stated is None and all(map(_TWO.fullmatch, map(str.strip, given))) else ""
    return StampFormat(stamps[0].parts, month_first if certain else None, stamps[0], in_minutes=in_minutes, doubt=doubt)


_HOUR = 3600.0  # shift of a clock by daylight saving time [s]
_DAY = 86400.0  # step back at midnight of a clock without a date; of one of minutes and seconds it is an hour [s]
_NEAR = 0.5  # largest deviation from an hour or a day of a jump that counts as one [usual intervals]
_REMEDY = "write the stamps with their offset from UTC (+01:00), or give the sampling time (dt, --dt)"
_TURNS = (
    (-_HOUR, "back", "as at the end of daylight saving time"),
    (_HOUR, "on", "as at the beginning of daylight saving time, or after a pause of an hour"),
)


def with_stamps(table: Table, forms: Mapping[int, StampFormat]) -> Table:
    """Return a table whose columns of dates and clock times are in seconds; clocks without a date run over midnight."""

    def blocks(numbers: Sequence[int]) -> Iterator[Arrays]:
        stamped = {at: (number, forms[number]) for at, number in enumerate(numbers) if number in forms}
        clocks = {
            at: _LocalClock(table, number, form)
            for at, (number, form) in stamped.items()
            if "c" in form.parts and "z" not in form.parts  # daylight saving time may shift it
        }
        for block in table.blocks(numbers):
            yield [clocks[at].unwrapped(part) if at in clocks else part for at, part in enumerate(block)]

    origins = {number: form.origin for number, form in forms.items() if form.origin is not None}
    doubts = {number: form.doubt for number, form in forms.items() if form.doubt}
    return replace(table, blocks=blocks, in_seconds=frozenset(forms), origins=origins, doubts=doubts)


class _LocalClock:
    """A local clock, block by block: without a date it is unwrapped at midnight; with one a shift is an error."""

    def __init__(self, table: Table, number: int, form: StampFormat) -> None:
        self._table, self._number, self._has_date = table, number, "d" in form.parts
        self._turn = _HOUR if form.in_minutes else _DAY
        self._rows, self._last, self._usual, self._days = 0, np.full(1, np.nan), math.nan, 0

    def unwrapped(self, stamps: FloatArray) -> FloatArray:
        """Return the next stamps in s, without the jumps at midnight."""
        steps = np.diff(np.concatenate([self._last, stamps]))
        forward = steps[steps > 0.0]
        if math.isnan(self._usual) and forward.size:
            self._usual = float(np.median(forward))
        # stamps nearly an hour apart cannot show a shift by an hour
        near = _NEAR * self._usual if self._usual < 0.25 * _HOUR else math.nan
        for turn, way, said in _TURNS if self._has_date else ():
            found = np.abs(steps - self._usual - turn) <= near
            if found.any():
                at = int(np.argmax(found))
                problem = f": the clock goes {way} by {abs(steps[at]):.6g} s, {said}; {_REMEDY}"
                raise self._table.error(self._number, problem, self._rows + at)
        days = self._days + np.cumsum((np.abs(steps - self._usual + self._turn) <= near) & (not self._has_date))
        self._rows += stamps.size
        if stamps.size:
            self._last, self._days = stamps[-1:], int(days[-1])
        return np.asarray(stamps + self._turn * days)


_PART = re.compile(rf"(?:(.*)[./_ ])?({'|'.join(UNITS)})", re.IGNORECASE)
_FIRST_ROWS = 1 << 10  # first rows that decide whether two columns are one clock [rows]


def with_split_times(table: Table) -> Table:
    """Return a table in which columns of whole seconds hold the sum with the column of the rest, in s from row 1."""
    rests = {
        seconds: (rest, unit, origin)
        for seconds, rest, unit in _pairs(table.names)
        if not {seconds, rest} & table.in_seconds and (origin := _origin(table, seconds, rest, unit)) is not None
    }
    if table.stamps is not None or not rests:
        return table
    whole_of = {rest: seconds for seconds, (rest, _, _) in rests.items()}

    def blocks(numbers: Sequence[int]) -> Iterator[Arrays]:
        for number in numbers:
            if number in whole_of:  # it goes back every second: neither a clock by itself, nor a signal
                whole = table.names[whole_of[number]]
                raise table.error(number, f" is the rest of the seconds in column {whole!r}, which has the sum")
        split = [number for number in numbers if number in rests]
        for block in table.blocks([*numbers, *(rests[number][0] for number in split)]):
            further = dict(zip(split, block[len(numbers) :], strict=True))
            yield [
                _sum(column, further[number], *rests[number][1:]) if number in further else column
                for number, column in zip(numbers, block[: len(numbers)], strict=True)
            ]

    origins = {number: round(1e9 * origin) for number, (_, _, origin) in rests.items()}
    return replace(
        table,
        blocks=blocks,
        in_seconds=table.in_seconds | set(rests),
        parts=frozenset(whole_of),
        origins={**table.origins, **origins},
    )


def _pairs(names: Sequence[str]) -> Iterator[tuple[int, int, float]]:
    """Yield columns of seconds, each with the one column of a finer unit that has the same name but for the unit."""
    parts: dict[str, dict[float, list[int]]] = {}
    for number, name in enumerate(names):
        if found := _PART.fullmatch(name.strip()):
            of, unit = parts.setdefault((found[1] or "").casefold(), {}), UNITS[found[2].lower()]
            of.setdefault(unit, []).append(number)
    for of in parts.values():
        finer = [(number, unit) for unit, numbers in of.items() if unit < 1.0 for number in numbers]
        if len(of.get(1.0, [])) == 1 and len(finer) == 1:
            yield of[1.0][0], *finer[0]


def _origin(table: Table, seconds: int, rest: int, unit: float) -> float | None:
    """Return the first whole second; None if the columns are not whole seconds and a rest below one, that advance.

    They may begin anew, as the seconds of a minute do: who reads them as a time says so, with the line.
    """
    try:
        whole, further = table.head([seconds, rest], _FIRST_ROWS)
    except LogError:  # they hold no numbers
        return None
    known = np.isfinite(whole) & np.isfinite(further)
    whole, further = whole[known], further[known] * unit
    is_split = whole.size and (whole == np.rint(whole)).all() and ((further >= 0.0) & (further < 1.0)).all()
    steps = np.diff(whole + further)
    return float(whole[0]) if is_split and (steps > 0.0).any() and mostly_rise(steps) else None


def _sum(seconds: FloatArray, rest: FloatArray, unit: float, origin: float) -> FloatArray:
    """Return stamps (K,) in s; without the seconds of the first one, a nanosecond would be lost in rounding."""
    return np.asarray((seconds - origin) + unit * rest)
