"""The sampling time: from a column of time stamps, which must be regular, or as a number given."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from numbers import Real
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from replant.errors import ArgumentTypeError, InvalidArgumentError, LogError

TOLERANCE = 0.01  # an interval may differ from the sampling time by this share of it

_UNITS = {"s": 1.0, "sec": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6}
_UNITS |= {"ns": 1e-9, "min": 60.0, "h": 3600.0}
_UNIT = rf"(?:\s*[\[(/]\s*({'|'.join(_UNITS)})\s*[\])]?|_(s|ms|us|ns))"
_UNIT_AT_END = re.compile(rf".*{_UNIT}", re.IGNORECASE)
_TIME_NAME = re.compile(rf"(?:.*\.)?(?:t|time|timestamp){_UNIT}?", re.IGNORECASE)

_ENDLESS = 1e300  # the difference of two stamps beyond it may leave float64
_REMEDY = "drop that row, or give the sampling time (dt, --dt) instead of a time column"
_RESAMPLE = "resample the log, or drop --time and give the sampling time (dt, --dt) if the stamps are only jitter"


def time_candidates(names: Sequence[str]) -> list[int]:
    """Return the columns that are called time: t, time or timestamp in any case, with or without a unit.

    Examples
    --------
    >>> time_candidates(["Time [s]", "u", "data.time", "temperature"])
    [0, 2]
    """
    return [number for number, name in enumerate(names) if _TIME_NAME.fullmatch(name.strip())]


def unit_in_seconds(name: str) -> float:
    """Return the unit that a time column states in its name, in seconds; 1 if it states none.

    Examples
    --------
    >>> unit_in_seconds("t [ms]"), unit_in_seconds("time_us"), unit_in_seconds("t")
    (0.001, 1e-06, 1.0)
    """
    match = _UNIT_AT_END.fullmatch(name.strip())
    return _UNITS[(match[1] or match[2]).lower()] if match else 1.0


def check_dt(dt: object) -> float:
    """Return a sampling time as float.

    Raises
    ------
    ArgumentTypeError
        If it is not a number.
    InvalidArgumentError
        If it is not finite and positive.
    """
    if isinstance(dt, bool) or not isinstance(dt, Real):
        raise ArgumentTypeError(f"the sampling time (dt, --dt) must be a number of seconds, not {type(dt).__name__}")
    step = float(dt)
    if not (math.isfinite(step) and step > 0.0):
        raise InvalidArgumentError(f"the sampling time (dt, --dt) must be finite and positive, in seconds; got {step}")
    return step


def sampling_time(path: Path, name: str, stamps: NDArray[np.float64], place: Callable[[int], str]) -> float:
    """Derive the sampling time from regular time stamps, in their unit.

    It is the mean interval, so rounding of the stamps does not add up. The stamps are regular if each interval is
    within 1 % of the median, or if rounding to their printed digits explains the rest.

    Parameters
    ----------
    path, name : Path, str
        The file and the column, for messages.
    stamps : float64 array, shape (K,), K >= 2
        The time stamps.
    place : callable
        From a 0-based row to words that find it in the file.

    Raises
    ------
    LogError
        If a stamp is not finite, repeats or goes back, or if the stamps are irregular; it names the first such row.

    Examples
    --------
    >>> sampling_time(Path("log.csv"), "t", np.array([0.0, 0.033, 0.067, 0.1]), "row {}".format)
    0.0333333333333
    """
    _check_increasing(path, name, stamps, place)
    intervals = np.diff(stamps)
    median = float(np.median(intervals))
    deviation = np.abs(intervals - median)
    if np.all(deviation <= TOLERANCE * median) or _is_rounded_grid(intervals, median, digits := resolution(stamps)):
        mean = float((stamps[-1] - stamps[0]) / intervals.size)
        return float(f"{mean:.12g}")  # 0.1, not 0.09999999999999999: the last digits are rounding of the stamps
    allowed = TOLERANCE * median + (digits if digits < 0.25 * median else 0.0)
    allowed *= 1.001  # the sum of both is often met exactly
    over = deviation > (allowed if np.any(deviation > allowed) else TOLERANCE * median)
    row = int(np.argmax(over)) + 1
    raise LogError(
        f"{path}: {place(row)}, column {name!r}: irregular time stamps, {intervals[row - 1]:.6g} after the one before "
        f"where {median:.6g} is usual; {_RESAMPLE}"
    )


def resolution(stamps: NDArray[np.float64]) -> float:
    """Return the step to which time stamps were rounded: of their decimals, else two steps of float32 or float64.

    Two, because an interval that crosses a power of two has one end on the finer and one on the coarser grid.

    Examples
    --------
    >>> resolution(np.array([0.0, 0.033, 0.067, 0.1]))
    0.001
    """
    largest = float(np.max(np.abs(stamps)))
    for decimals in range(16):
        error = 4.0 * math.ulp(largest * 10.0**decimals)
        if error > 0.01:
            break  # beyond the digits of float64 every number looks whole
        scaled = stamps * 10.0**decimals
        if np.all(np.abs(scaled - np.rint(scaled)) <= error):
            return 10.0**-decimals
    if largest <= np.finfo(np.float32).max and np.array_equal(stamps, stamps.astype(np.float32)):
        return 2.0 * float(np.spacing(np.float32(largest)))
    return 2.0 * float(np.spacing(largest))


def _check_increasing(path: Path, name: str, stamps: NDArray[np.float64], place: Callable[[int], str]) -> None:
    finite = np.abs(stamps) < _ENDLESS
    if not np.all(finite):
        row = int(np.argmin(finite))
        raise LogError(f"{path}: {place(row)}, column {name!r}: the time stamp is {stamps[row]}; {_REMEDY}")
    steps = np.diff(stamps)
    if not np.all(steps > 0.0):
        row = int(np.argmin(steps > 0.0)) + 1
        what = "repeats" if steps[row - 1] == 0.0 else "goes back from"
        raise LogError(
            f"{path}: {place(row)}, column {name!r}: the time stamp {stamps[row]:.12g} {what} the one before "
            f"({stamps[row - 1]:.12g}); {_REMEDY}"
        )


def _is_rounded_grid(intervals: NDArray[np.float64], median: float, digits: float) -> bool:
    """Tell whether the intervals are those of a regular grid, rounded.

    Rounding leaves two lengths, one digit apart; a displaced stamp makes one interval longer and one shorter, so
    three. A missing sample is four digits or more, as coarser ones are not believed.
    """
    return bool(digits <= 0.25 * median and np.ptp(intervals) <= digits + TOLERANCE * median)
