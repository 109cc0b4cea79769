"""Checks of arguments, worded once: each returns the value in the type that the code works with, or raises."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from replant.errors import ArgumentTypeError, InvalidArgumentError

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


def keep(instance: object, name: str, check: Callable[..., Any], *limits: Any, called: str = "", **how: Any) -> None:
    """Check a field of a frozen object, and put what the check returns in its place.

    What the caller passed is never kept: a narrow integer wraps in the arithmetic that it enters, an array may be
    changed later.

    Parameters
    ----------
    instance : object
        A frozen dataclass, in its ``__post_init__``.
    name : str
        Of the field.
    check : callable
        Takes the argument's name, its value, ``limits`` and ``how``; returns the value to keep, or raises.
    called : str, optional
        The argument's name in messages, where it is not that of the field.
    """
    object.__setattr__(instance, name, check(called or name, getattr(instance, name), *limits, **how))


def number(name: str, value: Any) -> float:
    """Return ``value`` as a float; text, None, arrays and complex numbers are refused by name."""
    text_or_complex = isinstance(value, str | bytes | complex)
    of_numpy = isinstance(value, np.ndarray | np.generic)
    if text_or_complex or (of_numpy and (value.ndim > 0 or value.dtype.kind not in "fiub")):
        raise ArgumentTypeError(f"{name} must be a number, got {_describe(value)}")
    try:
        return float(value)
    except (TypeError, ValueError) as cause:
        raise ArgumentTypeError(f"{name} must be a number, got {_describe(value)}") from cause
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
    """Return ``value`` as a float in [low, high) (``closed="left"``) or [low, high] (``closed="both"``)."""
    result = finite(name, value)
    inside = low <= result <= high if closed == "both" else low <= result < high
    if not inside:
        bracket = "]" if closed == "both" else ")"
        raise InvalidArgumentError(f"{name} must lie in [{low:g}, {high:g}{bracket}, got {result:g}")
    return result


def whole(name: str, value: Any, least: int) -> int:
    """Return ``value`` as an int of at least ``least``; 2.0 is not a whole number here, nor is True."""
    if isinstance(value, bool) or (isinstance(value, np.ndarray) and value.ndim > 0):
        raise ArgumentTypeError(f"{name} must be a whole number, got {_describe(value)}")
    try:
        result = int(operator.index(value))  # of a subclass of int, index returns the object itself
    except TypeError as cause:
        raise ArgumentTypeError(f"{name} must be a whole number, got {_describe(value)}") from cause
    if result < least:
        raise InvalidArgumentError(f"{name} must be at least {least}, got {result}")
    return result


def one_of(name: str, value: Any, choices: Sequence[str]) -> str:
    """Return the one of the words in ``choices`` that ``value`` is."""
    if not isinstance(value, str) or value not in choices:
        listed = ", ".join(repr(choice) for choice in choices)
        raise InvalidArgumentError(f"{name} must be one of {listed}, got {value!r}")
    return choices[choices.index(value)]


def truth(name: str, value: Any) -> bool:
    """Return ``value`` as a bool; 1 is not a truth value here."""
    if not isinstance(value, bool | np.bool_):
        raise ArgumentTypeError(f"{name} must be True or False, got {value!r}")
    return bool(value)


def instance(name: str, value: Any, *kinds: Any) -> Any:
    """Return ``value`` if it is of one of these ``kinds``: classes, or words and None, which stand for themselves."""
    classes = tuple(kind for kind in kinds if isinstance(kind, type))
    if isinstance(value, classes):
        return value
    words = [kind for kind in kinds if not isinstance(kind, type)]
    if value is None or isinstance(value, str):
        for word in words:
            if word == value:
                return word
    allowed = " or ".join([*(_one(kind.__name__) for kind in classes), *(repr(word) for word in words)])
    raise ArgumentTypeError(f"{name} must be {allowed}, got {type(value).__name__} {value!r}")


def array_of_reals(name: str, value: Any) -> FloatArray:
    """Return ``value`` as a contiguous float64 array of its own shape; text, None and complex numbers are refused."""
    try:
        array = np.asarray(value)
    except ValueError as cause:
        raise ArgumentTypeError(f"{name} must be an array of numbers: {cause}") from cause
    if array.dtype.kind not in "fiub":
        raise ArgumentTypeError(f"{name} must hold real numbers, got dtype {array.dtype}")
    return np.asarray(array, np.float64, order="C")


def vector(name: str, value: Any) -> FloatArray:
    """Return ``value`` as a contiguous float64 vector (K,); a column (K, 1) or a scalar is refused by its shape."""
    array = array_of_reals(name, value)
    if array.ndim != 1:
        raise InvalidArgumentError(f"{name} must be a vector of shape (K,), got shape {array.shape}")
    return array


def record(u: Any, y: Any) -> tuple[FloatArray, FloatArray]:
    """Return input and output as vectors of one length."""
    u_vector, y_vector = vector("u", u), vector("y", y)
    if u_vector.size != y_vector.size:
        raise InvalidArgumentError(
            f"u and y must have the same length, got {u_vector.size} and {y_vector.size} samples"
        )
    return u_vector, y_vector


def stamps_of(t: Any, samples: int) -> FloatArray:
    """Return time stamps as a vector (K,), one for each sample."""
    stamps = vector("t", t)
    if stamps.size != samples:
        raise InvalidArgumentError(f"t must have one stamp for each of {samples} samples, got {stamps.size}")
    return stamps


def coefficients(name: str, value: Any) -> FloatArray:
    """Return polynomial coefficients, descending powers, as a finite read-only vector of at least one entry."""
    result = np.atleast_1d(array_of_reals(name, value)).copy()
    if result.ndim != 1 or result.size == 0:
        raise InvalidArgumentError(f"{name} must be a non-empty list of coefficients, got shape {result.shape}")
    if not np.isfinite(result).all():
        raise InvalidArgumentError(f"{name} must be finite, got {result.tolist()}")
    result.flags.writeable = False
    return result


def numbers(name: str, value: Any) -> tuple[float, ...]:
    """Return finite numbers, one or more, as a tuple of floats."""
    return tuple(coefficients(name, value).tolist())


def owned(name: str, value: Any, shape: tuple[int, ...]) -> FloatArray:
    """Return a read-only copy of ``value`` as a float64 array of this ``shape``."""
    array = array_of_reals(name, value).copy()
    if array.shape != shape:
        raise InvalidArgumentError(f"{name} must have shape {shape}, got {array.shape}")
    array.flags.writeable = False
    return array


def _one(name: str) -> str:
    return f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"


def _describe(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}"
    return f"{type(value).__name__} {value!r}" if isinstance(value, str | bytes) else type(value).__name__
