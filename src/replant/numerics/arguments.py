"""Checks of arguments: each returns the value in the type that the code uses, or raises."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from replant.errors import ArgumentTypeError, InvalidArgumentError, shown

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
IntArray = npt.NDArray[np.int64]


def keep(instance: object, name: str, check: Callable[..., Any], *limits: Any, called: str = "", **how: Any) -> None:
    """Check a field of a frozen object, and replace it by the value that the check returns."""
    # the caller's value is not kept: a narrow integer would overflow in arithmetic, an array could be changed later
    object.__setattr__(instance, name, check(called or name, getattr(instance, name), *limits, **how))


def number(name: str, value: Any) -> float:
    """Return ``value`` as a float; here and in all checks below, ``name`` is its name in messages."""
    not_a_number = isinstance(value, str | bytes | complex | np.ma.MaskedArray)
    of_numpy = isinstance(value, np.ndarray | np.generic)
    if not_a_number or (of_numpy and (value.ndim > 0 or value.dtype.kind not in "fiub")):
        raise ArgumentTypeError(f"{name} must be a number, got {_describe(value)}{_seconds(name, value)}")
    try:
        with np.errstate(over="ignore"):
            return float(value)
    except (TypeError, ValueError) as cause:
        raise ArgumentTypeError(f"{name} must be a number, got {_describe(value)}{_seconds(name, value)}") from cause
    except OverflowError as cause:
        raise InvalidArgumentError(f"{name} must be within the range of float64") from cause


def finite(name: str, value: Any) -> float:
    """Return ``value`` as a finite float."""
    result = number(name, value)
    if not math.isfinite(result):
        raise InvalidArgumentError(f"{name} must be finite, got {result}")
    return result


def positive(name: str, value: Any) -> float:
    """Return ``value`` as a finite float above zero."""
    result = finite(name, value)
    if result <= 0:
        raise InvalidArgumentError(f"{name} must be greater than 0, got {result:g}")
    return result


def not_negative(name: str, value: Any) -> float:
    """Return ``value`` as a finite float of at least zero."""
    result = finite(name, value)
    if result < 0:
        raise InvalidArgumentError(f"{name} must be at least 0, got {result:g}")
    return result


def between(name: str, value: Any, low: float, high: float, *, closed: str = "left") -> float:
    """Return ``value`` as a float in an interval."""
    result = finite(name, value)
    inside = low <= result <= high if closed == "both" else low <= result < high
    if not inside:
        bracket = "]" if closed == "both" else ")"
        raise InvalidArgumentError(f"{name} must lie in [{low:g}, {high:g}{bracket}, got {result:g}")
    return result


def whole(name: str, value: Any, least: int, most: int | None = None) -> int:
    """Return ``value`` as an int; neither 2.0 nor True is accepted."""
    if isinstance(value, bool | np.ma.MaskedArray) or (isinstance(value, np.ndarray) and value.ndim > 0):
        raise ArgumentTypeError(f"{name} must be a whole number, got {_describe(value)}")
    try:
        result = int(operator.index(value))  # index returns an instance of a subclass of int unchanged
    except TypeError as cause:
        raise ArgumentTypeError(f"{name} must be a whole number, got {_describe(value)}") from cause
    if result < least:
        raise InvalidArgumentError(f"{name} must be at least {least}, got {shown(result)}")
    if most is not None and result > most:
        raise InvalidArgumentError(f"{name} must be at most {most}, got {shown(result)}")
    return result


def is_frame(value: Any) -> bool:
    """Return whether a value is a table with named columns."""
    # a lazy table of polars warns when its columns are read
    has_columns = hasattr(value, "collect") or hasattr(value, "columns")
    return has_columns and hasattr(value, "__getitem__") and not isinstance(value, np.ndarray)


def one_of(name: str, value: Any, choices: Sequence[str]) -> str:
    """Return ``value``, which must be one of several words."""
    if not isinstance(value, str) or value not in choices:
        listed = ", ".join(repr(choice) for choice in choices)
        raise InvalidArgumentError(f"{name} must be one of {listed}, got {shown(value)}")
    return choices[choices.index(value)]


def truth(name: str, value: Any) -> bool:
    """Return ``value`` as a bool; 1 and 0 are not accepted."""
    if not isinstance(value, bool | np.bool_):
        raise ArgumentTypeError(f"{name} must be True or False, got {shown(value)}")
    return bool(value)


def text(name: str, value: Any) -> str:
    """Return ``value`` as a plain str."""
    if not isinstance(value, str):
        raise ArgumentTypeError(f"{name} must be a str, got {shown(value)}")
    return str(value)


def instance(name: str, value: Any, *kinds: Any) -> Any:
    """Return ``value`` if it is an instance of a class, or equal to a word or None."""
    classes = tuple(kind for kind in kinds if isinstance(kind, type))
    if isinstance(value, classes):
        return value
    words = [kind for kind in kinds if not isinstance(kind, type)]
    if (value is None or isinstance(value, str)) and value in words:
        return words[words.index(value)]
    allowed = " or ".join([*(_one(kind.__name__) for kind in classes), *(repr(word) for word in words)])
    got = _describe(value) if is_frame(value) else f"{type(value).__name__} {shown(value)}"
    raise ArgumentTypeError(f"{name} must be {allowed}, got {got}")


def array_of_reals(name: str, value: Any) -> FloatArray:
    """Return ``value`` as a contiguous float64 array of the same shape; masked entries are NaN."""
    try:
        array = np.asarray(value)
    except (ValueError, TypeError, OverflowError) as cause:
        raise ArgumentTypeError(f"{name} must be an array of numbers: {cause}") from cause
    if array.dtype.kind not in "fiub":
        first = array.flat[0] if array.size else None
        got = _describe(value) if is_frame(value) else f"dtype {array.dtype}{_seconds(name, first)}"
        if array.dtype.kind == "O" and not is_frame(value):
            got += _as_floats(name, value, array)
        raise ArgumentTypeError(f"{name} must hold real numbers, got {got}")
    with np.errstate(over="ignore"):  # a number of a wider type may become infinite
        reals = np.asarray(array, np.float64, order="C")
    if isinstance(value, np.ma.MaskedArray):
        return np.where(np.ma.getmaskarray(value), np.nan, reals)
    return reals


def vector(name: str, value: Any) -> FloatArray:
    """Return ``value`` as a contiguous float64 vector (K,)."""
    array = array_of_reals(name, value)
    if array.ndim != 1:
        got = _describe(value) if is_frame(value) else f"shape {array.shape}"
        raise InvalidArgumentError(f"{name} must be a vector of shape (K,), got {got}")
    return array


def record(u: Any, y: Any, names: tuple[str, str] = ("u", "y")) -> tuple[FloatArray, FloatArray]:
    """Return input and output, or two other signals, as vectors (K,) of equal length."""
    one, other = vector(names[0], u), vector(names[1], y)
    both = " and ".join(names)
    if one.size != other.size:
        raise InvalidArgumentError(f"{both} must have the same length, got {one.size} and {other.size} samples")
    indices = [each.index for each in (u, y) if hasattr(each, "iloc")]  # of pandas
    if len(indices) == 2 and not indices[0].equals(indices[1]):
        aligned = f"{', '.join(names)} = {names[0]}.align({names[1]}, join='inner')"
        raise InvalidArgumentError(f"{both} have different indices: pair their rows first, {aligned}, or give arrays")
    return one, other


def no_output(log: Any, needed: str) -> InvalidArgumentError:
    """Return the error for a record that is no `Log` and has no output."""
    got = f", got {_describe(log)}" if is_frame(log) else ""
    return InvalidArgumentError(f"give a Log, or {needed}: model.validate(u, y){got}")


def coefficients(name: str, value: Any) -> FloatArray:
    """Return polynomial coefficients, in descending powers, as a finite read-only vector of at least one entry."""
    result = np.atleast_1d(array_of_reals(name, value)).copy()
    if result.ndim != 1 or result.size == 0:
        raise InvalidArgumentError(f"{name} must be a non-empty list of coefficients, got shape {result.shape}")
    if not np.isfinite(result).all():
        raise InvalidArgumentError(f"{name} must be finite, got {shown(result.tolist())}")
    result.flags.writeable = False
    return result


def numbers(name: str, value: Any) -> tuple[float, ...]:
    """Return one or more finite numbers as a tuple of floats; raises as `coefficients` does."""
    return tuple(coefficients(name, value).tolist())


def owned(name: str, value: Any, shape: tuple[int, ...]) -> FloatArray:
    """Return a read-only copy of ``value`` as a float64 array."""
    array = array_of_reals(name, value).copy()
    if array.shape != shape:
        raise InvalidArgumentError(f"{name} must have shape {shape}, got {array.shape}")
    array.flags.writeable = False
    return array


def iterable(value: Any) -> bool:
    """Return whether a value holds several values; text and a 0-d array are iterable, but single values."""
    return isinstance(value, Iterable) and not isinstance(value, str | bytes) and getattr(value, "ndim", 1) != 0


def _one(name: str) -> str:
    return f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"


def _describe(value: Any) -> str:
    if is_frame(value):
        return "a table: rp.read_log(table, input=..., output=...) makes a Log of it, with input, output and stamps"
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    return f"{type(value).__name__} {shown(value)}" if isinstance(value, str | bytes) else type(value).__name__


def _as_floats(name: str, value: Any, array: Any) -> str:
    """Return how objects become numbers; nothing where they are none."""
    if hasattr(value, "__next__"):
        return f", an iterator: give np.asarray(list({name}), float)"
    try:
        np.asarray(array, np.float64)
    except (TypeError, ValueError, OverflowError):
        return ""
    return f": np.asarray({name}, float) makes numbers of them, and NaN of None" if array.ndim else ""


def _seconds(name: str, value: Any) -> str:
    """Return how dates and durations become numbers; nothing for other values."""
    if isinstance(value, np.datetime64):
        return f": seconds are ({name} - {name}[0]) / np.timedelta64(1, 's')"
    if isinstance(value, np.timedelta64):
        return f": seconds are {name} / np.timedelta64(1, 's')"
    # a table with a column of that name has it as an attribute, too
    found = next((each for each in ("timestamp", "total_seconds") if callable(getattr(value, each, None))), "")
    return f": {found}() gives the seconds" if found else ""
