"""Checks of the limits of arguments: times, counts that must fit into memory, grids, paths."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError, shown
from replant.numerics.arguments import FloatArray, iterable, not_negative, positive, vector, whole
from replant.numerics.time_stamps import counted_since_1970, without_dates

MOST_TRIED = 1000  # most values of a grid, as each is tried [count]

# ten poles as fast as the sampling have coefficients of the size dt^-10, which float64 holds; it also holds the number
# of samples within the longest time
SHORTEST, LONGEST = 1e-30, 1e30  # shortest and longest time accepted [s]


def duration(name: str, value: Any) -> float:
    """Return ``value`` as a float: a time in s between `SHORTEST` and `LONGEST`."""
    result = positive(name, value)
    if not SHORTEST <= result <= LONGEST:
        raise InvalidArgumentError(f"{name} must lie between {SHORTEST:g} and {LONGEST:g} s, got {result:g} s")
    return result


def dead_time(name: str, value: Any) -> float:
    """Return ``value`` as a float: a dead time in s, which is zero or a `duration`."""
    result = not_negative(name, value)
    return duration(name, result) if result else 0.0


def stamps_of(t: Any, samples: int, *, is_first: bool = False) -> FloatArray:
    """Return time stamps as a vector (K,), one for each of K ``samples``; dates become seconds since 1970.

    The first ones must not be counts of milliseconds or less: among later ones a stamp may be misread.
    """
    stamps = vector("t", without_dates(t, since_1970=True))
    if stamps.size != samples:
        raise InvalidArgumentError(f"t must have one stamp for each of {samples} samples, got {stamps.size}")
    if is_first and (problem := counted_since_1970(stamps)):
        raise InvalidArgumentError(problem)
    return stamps


def increasing(t: Any, samples: int) -> FloatArray:
    """Return time stamps as a vector (K,), finite and strictly increasing, one for each of K ``samples``.

    Dates become seconds since the first one.
    """
    stamps = stamps_of(without_dates(t), samples, is_first=True)
    wrong = ~np.isfinite(stamps)
    wrong[1:] |= ~(stamps[1:] > stamps[:-1])
    if wrong.any():
        k = int(np.argmax(wrong))
        raise InvalidArgumentError(f"t must be finite and strictly increasing; t[{k}] = {stamps[k]:.12g} is not")
    if np.abs(stamps).max(initial=0.0) > LONGEST:
        raise InvalidArgumentError(f"t must lie between {-LONGEST:g} and {LONGEST:g} s")
    return stamps


def count(name: str, value: Any, least: int, numbers: int = 1) -> int:
    """Return ``value`` as an int: a number of items, each of so many ``numbers``, that fits into memory."""
    result = whole(name, value, least)
    numbers *= result
    try:
        if numbers:
            np.empty(numbers)
    except (MemoryError, ValueError, OverflowError) as cause:
        gibibytes = f"{numbers / 2**27:.3g}" if numbers < 10**300 else "1e300"
        raise InvalidArgumentError(
            f"{name} must be smaller: {shown(result)} need {gibibytes} GiB of memory, more than the system grants"
        ) from cause
    return result


def several(name: str, values: Any, check: Callable[[str, Any], Any]) -> tuple[Any, ...]:
    """Return the values of an iterable, or a single value, as a tuple; each is checked."""
    if not iterable(values):
        return (check(name, values),)
    taken = tuple(itertools.islice(values, MOST_TRIED + 1))
    if len(taken) > MOST_TRIED:
        raise InvalidArgumentError(f"{name} must be {MOST_TRIED} values at the most: each of them is tried")
    if not taken:
        raise InvalidArgumentError(f"{name} is empty: give the values to try")
    return tuple(check(name, value) for value in taken)


def file_path(name: str, value: Any) -> str:
    """Return the path of a file or folder as text."""
    path = value.__fspath__() if hasattr(type(value), "__fspath__") else value
    if not isinstance(path, str):
        raise ArgumentTypeError(f"{name} must be a path, got {type(value).__name__} {shown(value)}")
    return path


def typed_path(path: Any) -> str:
    """Return a path as an argument of a command: one that begins with a dash would be read as an option.

    >>> typed_path("-3.csv"), typed_path("3.csv"), typed_path("-")  # the last one is standard input
    ('./-3.csv', '3.csv', '-')
    """
    text = str(path)
    return f"./{text}" if text.startswith("-") and text != "-" else text
