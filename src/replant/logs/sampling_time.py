"""The sampling time of a log, from its time stamps or given as a number, and the unit of the stamps."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from numbers import Real

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError, LogError, shown
from replant.logs.table import Table, forget
from replant.model.interop import unit_of
from replant.numerics.arguments import FloatArray, number
from replant.numerics.limits import duration
from replant.numerics.time_stamps import (
    COUNTS,
    TOLERANCE,
    StampResolution,
    is_regular,
    is_regular_interval,
    recent_day,
)

MOSTLY = 0.95  # part of the steps of a column that must be those of a time [part]
UNEVEN = 2.0  # most that a step of a clock is longer or shorter than the usual one, but for gaps [usual intervals]
CHECKED = 1 << 18  # stamps from which the median interval is computed [samples]
FINE = 1e-4  # largest rounding error at which the digits of an interval are still rounded off [part of the interval]
#: Words of units of time in names of columns, with their seconds.
UNITS = {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
UNITS |= {"μs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0, "day": 86400.0, "days": 86400.0}
UNITS |= {"msec": 1e-3, "millis": 1e-3, "milliseconds": 1e-3, "usec": 1e-6, "micros": 1e-6, "microseconds": 1e-6}
UNITS |= {"nsec": 1e-9, "nsecs": 1e-9, "nanosec": 1e-9, "nanosecs": 1e-9, "nanos": 1e-9, "nanoseconds": 1e-9}
UNITS |= {"minutes": 60.0, "hours": 3600.0}
_AFTER_UNDERSCORE = (
    "s|secs?|seconds|[mun]s|[mun]secs?|nanosecs?|millis|micros|nanos|milliseconds|microseconds|nanoseconds"
)
_UNIT = rf"(?:(?:\s*[\[(/]\s*|\s+in\s+)({'|'.join(UNITS)})\s*[\])]?|_({_AFTER_UNDERSCORE}))"
_ALONE = r"(?:.*\.)?(millis|micros)(?:\(\))?"  # Arduino's clocks
_UNIT_AT_END = re.compile(rf".*{_UNIT}|{_ALONE}", re.IGNORECASE)
_TIME_NAME = re.compile(rf"(?:.*\.)?(?:t|time|timestamp){_UNIT}?|{_ALONE}", re.IGNORECASE)
_ENDLESS = 1e300  # magnitude of a stamp beyond which the difference of two may overflow float64 [s]
_REMEDY = "drop that row, or give the sampling time (dt, --dt) instead of a time column"
# a smaller step back is only a stamp out of order
ANEW = 10.0  # step back that is a restart of the clock [usual intervals]
_LAPS = {60.0: "minute", 3600.0: "hour", 86400.0: "day"}  # after which a clock that counts within them begins anew [s]
_WITHIN = (
    "the clock begins anew after one {0}: if it counts within the {0}, give the sampling time (dt, --dt) instead; if "
    "another recording begins here, cut the file there and give both parts"
)
_BEGINS_ANEW = (
    "the clock begins anew: if another recording begins here, cut the file there and give both parts; if the same one "
    "goes on, give the sampling time (dt, --dt)"
)


def time_candidates(names: Sequence[str]) -> list[int]:
    """Return the columns called t, time or timestamp, with or without a unit, or millis or micros, in any case."""
    return [number for number, name in enumerate(names) if _TIME_NAME.fullmatch(name.strip())]


def time_columns(table: Table) -> list[int]:
    """Return the columns that may be the time: by name, or, if no name is that of a time, the columns of dates."""
    if named := named_time_columns(table):
        return named
    dates = sorted(table.in_seconds)
    try:  # a constant date is no clock, unless all are constant
        heads = table.head(dates, 1) if len(dates) > 1 else []
    except LogError:  # one cannot be read
        return dates
    return [number for number, head in zip(dates, heads, strict=False) if np.unique(head).size > 1] or dates


def named_time_columns(table: Table) -> list[int]:
    """Return the columns with a name of time; T, without a unit of time, only as the first steady clock."""
    by_path = [name.replace("/", ".") for name in table.names]  # HDF5: t/s may be a path, or t in s
    found = {*time_candidates(table.names), *time_candidates(by_path)} - table.parts
    named = clearer_times(by_path, sorted(found))
    if not any(is_letter(by_path[number]) for number in named):
        return named
    # behind another clock it is a temperature that rises
    first = next((number for number in range(len(by_path)) if _is_clock(table, number)), None)
    return sorted({*named} & {*table.in_seconds, first})


def clearer_times(names: Sequence[str], candidates: Sequence[int]) -> list[int]:
    """Return the candidates for the time without those called T, unless there is no other."""
    return [number for number in candidates if not is_letter(names[number])] or list(candidates)


def is_letter(name: str) -> bool:
    """Return whether a column is called T, without a unit: the time, or a temperature."""
    return name.strip().rpartition(".")[2] == "T"


def _is_clock(table: Table, number: int) -> bool:
    """Return whether the first values of a column increase in nearly equal steps, but for few stamps out of order."""
    try:
        (values,) = table.head([number], 1)
    except LogError:  # it holds no numbers
        return False
    with np.errstate(invalid="ignore", over="ignore"):
        changes = np.diff(values)
    rising = changes[changes > 0.0]
    if not rising.size or not mostly_rise(changes):
        return False
    usual = float(np.median(rising))
    return bool(np.mean((rising >= usual / UNEVEN) & (rising <= usual * UNEVEN)) >= MOSTLY)


def mostly_rise(steps: FloatArray) -> bool:
    """Return whether few of the steps other than 0 go back."""
    rising, falling = np.count_nonzero(steps > 0.0), np.count_nonzero(steps < 0.0)
    return bool(rising >= MOSTLY * (rising + falling))


def is_shuffled(stamps: FloatArray) -> bool:
    """Return whether rows are not in the order of their stamps (K,); few wrong stamps or a clock's restarts are not."""
    stamps = stamps[np.isfinite(stamps)]
    with np.errstate(invalid="ignore", over="ignore"):
        steps = np.diff(stamps)
    if mostly_rise(steps) or not (steps > 0.0).any():
        return False
    # sorted by a clock that restarts again and again, parts would interleave
    are_unique = np.unique(stamps).size >= MOSTLY * stamps.size
    return bool(are_unique and np.median(-steps[steps < 0.0]) <= ANEW * np.median(np.abs(steps)))


def unit_in_seconds(name: str) -> float:
    """Return the unit in a time column's name, in seconds; 1 if the name has no unit."""
    match = _UNIT_AT_END.fullmatch(name.strip())
    return UNITS[(match[1] or match[2] or match[3]).lower()] if match else 1.0


def check_dt(dt: object) -> float:
    """Return a sampling time as float."""
    if isinstance(dt, bool) or not isinstance(dt, Real):
        raise ArgumentTypeError(f"the sampling time (dt, --dt) must be a number of seconds, not {type(dt).__name__}")
    step = number("dt", dt)
    if not (math.isfinite(step) and step > 0.0):
        raise InvalidArgumentError(f"the sampling time (dt, --dt) must be finite and positive, in seconds; got {step}")
    return duration("the sampling time (dt, --dt)", step)


def interval_of(table: Table, number: int, stamps: FloatArray) -> tuple[float, str]:
    """Return the interval of increasing time stamps (K,), and a text on the first irregular one.

    A regular clock gives the mean interval and an empty text; an irregular clock gives the median interval.
    """
    resolution, median, least, most = StampResolution(), math.nan, math.inf, -math.inf
    for first, part in _parts(stamps):
        _check_increasing(table, number, part, first)
        resolution.add(part)
        steps = np.diff(part)
        median = float(np.median(steps)) if math.isnan(median) else median
        least, most = min(least, float(steps.min())), max(most, float(steps.max()))
    digits = resolution.step
    # regular: each interval is within 1 % of the median (of the first 2^18), or within the rounding of the printed
    # digits; the mean cancels rounding, and the median ignores gaps
    if is_regular_interval(least, most, median, digits):
        return _rounded(float(stamps[-1] - stamps[0]) / (stamps.size - 1)), ""
    deviation = max(most - median, median - least)
    allowed = TOLERANCE * median + (digits if digits < 0.25 * median else 0.0)
    allowed *= 1.001  # the sum of both is often met exactly
    row, step = _first_beyond(stamps, median, allowed if deviation > allowed else TOLERANCE * median)
    interval = _without_noise(median, stamps)
    irregularity = f": irregular time stamps, {step:.6g} after the one before instead of the usual {interval:.6g}"
    return interval, str(table.error(number, irregularity, row))


def clock_of(stamps: FloatArray) -> tuple[float, bool]:
    """Return the interval of two or more increasing stamps (K,) as `interval_of`, and whether the clock is regular."""
    if is_regular(stamps):
        return _rounded(float(stamps[-1] - stamps[0]) / (stamps.size - 1)), True
    return _without_noise(float(np.median(np.diff(stamps))), stamps), False


def _without_noise(median: float, stamps: FloatArray) -> float:
    """Return the median interval rounded to the resolution of float64 at the largest of the stamps (K,)."""
    noise = 2.0 * math.ulp(max(abs(float(stamps[0])), abs(float(stamps[-1]))))
    return _rounded(median if noise > FINE * median else round(median, math.floor(-math.log10(noise))))


def _parts(stamps: FloatArray) -> Iterator[tuple[int, FloatArray]]:
    """Yield parts of time stamps with their first rows; each part begins with the last stamp of the previous one."""
    for first in range(0, stamps.size - 1, CHECKED):
        yield first, stamps[first : first + CHECKED + 1]
        forget(stamps)


def _rounded(interval: float) -> float:
    """Round an interval to 12 digits: 0.1, not 0.09999999999999999."""
    return float(f"{interval:.12g}")


def _first_beyond(stamps: FloatArray, median: float, allowed: float) -> tuple[int, float]:
    """Return the first row whose interval is more than ``allowed`` off the median, and that interval."""
    for first, part in _parts(stamps):
        steps = np.diff(part)
        over = np.abs(steps - median) > allowed
        if over.any():
            at = int(np.argmax(over))
            return first + at + 1, float(steps[at])
    raise AssertionError("one interval is the largest deviation")


def _check_increasing(table: Table, number: int, stamps: FloatArray, first: int) -> None:
    finite = np.abs(stamps) < _ENDLESS
    steps, remedy = np.diff(stamps), _REMEDY
    if not finite.all():
        row = int(np.argmin(finite))
        what = f"is {stamps[row]}"
    elif not (steps > 0.0).all():
        row = int(np.argmin(steps > 0.0)) + 1
        what = "repeats" if steps[row - 1] == 0.0 else "goes back from"
        what = f"{stamps[row]:.12g} {what} the one before ({stamps[row - 1]:.12g})"
        if (steps < 0.0).all():
            remedy = "the file runs backwards: sort its rows by time"
        elif is_shuffled(stamps):
            back = f"{np.count_nonzero(steps < 0.0):,} of {stamps.size:,}"
            remedy = f"the time goes back in {back} rows: sort the rows by time"
        elif lap := _lap(table, number, steps, row - 1):
            remedy = _WITHIN.format(lap)
        elif not steps.any():
            remedy = "all stamps are equal: give the sampling time (dt, --dt) instead of a time column"
        elif -steps[row - 1] > ANEW * float(np.median(np.abs(steps))) or not mostly_rise(steps):
            remedy = _BEGINS_ANEW
    else:
        return
    raise table.error(number, f": the time stamp {what}; {remedy}", first + row)


def _lap(table: Table, number: int, steps: FloatArray, at: int) -> str:
    """Return what a clock counts within, if a step back is as long as that, but for the usual step; else empty."""
    unit = 1.0 if number in table.in_seconds else unit_in_seconds(table.names[number])
    usual = float(np.median(steps))
    return next((lap for length, lap in _LAPS.items() if abs(usual - steps[at] - length / unit) <= usual), "")


LATEST = 1e11  # largest plausible stamp: in seconds since 1970 it is the year 5138 [s]
COARSE = 1.0  # interval from which stamps without a unit may be counts of ms, us or ns [their unit]
# Excel counts days from 1900, MATLAB from the year 0
_DATES = (36_526.0, 73_051.0), (730_486.0, 767_011.0)  # day numbers of the years 2000 to 2100 [days]
FIRST = 1 << 16  # stamps from which the unit of time is guessed [samples]
ROUND = 1e-3  # rounding error of a step with one or two digits [part of the step]
_GIVE_DT = "or give the sampling time (dt, --dt) instead of a time column"


@dataclass(frozen=True)
class StampUnit:
    """The unit of a column of time stamps."""

    seconds: float  # one unit in s: stated by the name, else guessed
    doubt: str = ""  # the guess and its reason; empty if the unit is stated
    refused: bool = False  # whether the doubt is too large to use these stamps
    remedy: str = ""  # what to do about the doubt


def unit_of_stamps(name: str, stamps: FloatArray) -> StampUnit:
    """Return the unit of the time stamps (K,) in the column ``name``."""
    unit, known = unit_in_seconds(name), _UNIT_AT_END.fullmatch(name.strip()) is not None
    stated = unit_of(name)
    if stated and not known:
        doubt = f"the unit {shown(stated)} in its name is not one of s, ms, us, ns, min, h, d"
        return StampUnit(unit, doubt, True, f"write one of these, {_GIVE_DT}")
    finite = stamps[np.isfinite(stamps)]
    if form := _digits_of(finite, is_clock=not known):
        doubt = f"the digits of its stamps are {form}, no count of a unit of time"
        return StampUnit(math.nan, doubt, True, f"write them as in 2024-05-01 10:00:00 or 10:00:00, {_GIVE_DT}")
    farthest = float(np.abs(finite).max()) if finite.size else 0.0
    if farthest * unit > LATEST:
        for seconds, words, short in COUNTS:
            since = f"{words} since 1970"
            if not known and (begin := recent_day(finite, seconds)):
                doubt = f"its name states no unit; by their size its stamps are {since}, from {begin} on"
                return StampUnit(seconds, doubt, False, f"if they are not, state the unit in its name, {_GIVE_DT}")
            if farthest * seconds <= LATEST:
                taken = "of its name" if known else "of s, as its name states none,"
                doubt = f"its stamps in the unit {taken} are beyond the year 5000; by their size they are {since}"
                return StampUnit(seconds, doubt, True, f"name the column {_core(name)}_{short}, {_GIVE_DT}")
    if not known and _are_dates(finite):
        doubt = "its name states no unit; by size and step its stamps are dates, counted in days as by a spreadsheet"
        return StampUnit(86400.0, doubt, True, f"name the column {_core(name)} [d], {_GIVE_DT}")
    with np.errstate(over="ignore"):
        step = float(np.median(np.diff(finite))) if finite.size > 1 else 0.0
    if not known and step >= COARSE:
        doubt = (
            f"its name states no unit; its steps of {step:.6g} are taken as seconds, and may be milliseconds or less"
        )
        remedy = f"if they are, name the column {_core(name)}_ms, {_GIVE_DT}"
        return StampUnit(unit, doubt, False, remedy)
    return StampUnit(unit)


def _digits_of(stamps: FloatArray, *, is_clock: bool) -> str:
    """Return how the digits of stamps (K,) are to be read if they are those of dates or clock times; else empty."""
    hours, minutes, seconds = stamps // 1e4 % 100.0, stamps // 100.0 % 100.0, stamps % 100.0
    if not stamps.size or not (hours.max() < 24.0 and minutes.max() < 60.0 and seconds.max() < 60.0):
        return ""
    parts = ((stamps // 1e10, 1970, 2100), (stamps // 1e8 % 100.0, 1, 12), (stamps // 1e6 % 100.0, 1, 31))
    if all(least <= part.min() and part.max() <= most for part, least, most in parts):
        return "YYYYMMDDhhmmss"
    if not is_clock or stamps.size < 2 or stamps.min() < 0.0 or stamps.max() >= 240_000.0:
        return ""
    steps, true = np.diff(stamps), np.diff(3600.0 * hours + 60.0 * minutes + seconds) % 86_400.0
    # the steps that are odd as a number, 41 from 59 to 100, are the usual one as clock times
    usual = float(np.median(true))
    odd = np.abs(steps - np.median(steps)) > 0.5 * usual
    are_usual = np.abs(true[odd] - usual) <= 0.5 * usual
    return "hhmmss" if odd.any() and are_usual.mean() >= MOSTLY else ""


def _are_dates(stamps: FloatArray) -> bool:
    """Return whether stamps (K,) can be day numbers: their step is a round number in s, not in days."""
    if stamps.size < 2 or not any(first <= stamps[0] < last for first, last in _DATES):
        return False
    step = float(stamps[-1] - stamps[0]) / (stamps.size - 1)
    return step > 0.0 and _is_round(86400.0 * step) and not _is_round(step)


def _is_round(value: float) -> bool:
    """Return whether a number has one or two digits, apart from rounding."""
    return abs(value / float(f"{value:.2g}") - 1.0) <= ROUND


def unit_of_column(table: Table, number: int, stamps: FloatArray) -> StampUnit:
    """Return the unit of the time stamps (K,) in a column of numbers, dates or clock times."""
    if number not in table.in_seconds:
        return unit_of_stamps(table.names[number], stamps)
    remedy = f"if they are, name the column {_core(table.names[number])} [mm:ss], {_GIVE_DT}"
    return StampUnit(1.0, table.doubts.get(number, ""), remedy=remedy)


def checked_unit(table: Table, number: int, stamps: FloatArray) -> StampUnit:
    """Return the unit of a column of time stamps (K,), from its first ones; raise if it is refused."""
    unit = unit_of_column(table, number, stamps[:FIRST])
    if unit.refused:
        raise table.error(number, f": {unit.doubt}; {unit.remedy}")
    return unit


def _core(name: str) -> str:
    """Return a column's name without struct and unit, as a part of another name."""
    return name.rpartition(".")[2].partition("[")[0].partition("(")[0].strip().replace(" ", "_") or "t"
