"""Hostile arguments: an ordinary one in another type or layout, or in its place what nobody expects."""

from __future__ import annotations

import array
import collections
import random
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

INTEGERS = [np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.int64, np.uint64]
REALS = [np.float16, np.float32, np.float64, np.longdouble, Decimal, Fraction]
ODD = [str, bytes, complex, np.complex64, np.clongdouble, np.bool_, bool, np.str_, np.bytes_]
FLOATS = [
    5e-324, 1e-320, 2.2e-308, 1e-300, 1e-160, 1e-30, 1e-9, 1e9, 1e16, 1e30, 1e75, 1e150, 1.1e150, 1e160, 1e300, 1e308,
    1.7976931348623157e308, np.inf, np.nan, 0.0, 1.0, 0.5, 0.3333333333333333, 7.0,
]  # fmt: skip
WHOLE = [
    0, 1, 2, 3, 5, 10, 11, 100, 127, 128, 255, 256, 65536, 2**31 - 1, 2**31, 2**32, 2**53 + 1, 2**62, 2**63 - 1, 2**63,
    2**64, 10**9, 999_999_999, 10**400, 10**5000,
]  # fmt: skip


class Count(int):
    """A whole number of the user's own kind."""


class Word(str):
    """A word of the user's own kind."""

    __slots__ = ()


class Rambling:
    """An object whose name fills pages."""

    def __repr__(self) -> str:
        return "Rambling(\n" + 10_000 * "x, " + ")"


def scalar(chance: random.Random) -> Any:
    """A number, or what may be taken for one."""
    kind = chance.randrange(10)
    if kind < 4:
        value: Any = chance.choice(FLOATS) * chance.choice([1.0, 1.0, -1.0])
    elif kind < 7:
        value = chance.choice(WHOLE) * chance.choice([1, 1, 1, -1])
    else:
        return chance.choice(THINGS)()
    return retyped_scalar(value, chance) if chance.random() < 0.4 else value


THINGS: list[Callable[[], Any]] = [
    lambda: None, lambda: True, lambda: False, lambda: np.True_, lambda: "1", lambda: "0.1", lambda: "", lambda: "nan",
    lambda: "auto", lambda: "mean", lambda: 10_000 * "x", lambda: "a\nb", lambda: "\0", lambda: b"1", lambda: 1j,
    lambda: Fraction(1, 3), lambda: Fraction(10**400), lambda: Fraction(1, 10**400), lambda: Decimal("0.1"),
    lambda: Decimal("NaN"), lambda: Decimal("sNaN"), lambda: Decimal("1e400"), lambda: Decimal("-Infinity"),
    lambda: np.datetime64("NaT"), lambda: np.timedelta64(1, "s"), lambda: np.void(b"x"),
    lambda: np.longdouble("1e4000"),
    lambda: np.float16(np.inf), lambda: np.ma.masked, lambda: Ellipsis, object, Rambling, lambda: float, lambda: len,
    lambda: Count(2), lambda: Word("exact"), lambda: Path("x"), lambda: slice(None), lambda: {}, lambda: {"a": 1.0},
    lambda: set(), lambda: [], lambda: (), lambda: [[]], lambda: [1.0], lambda: (2,), lambda: [1, None],
    lambda: [[1.0], [2.0, 3.0]], lambda: [10**400], lambda: [Rambling()], lambda: range(1, 3), lambda: range(10**6),
    lambda: iter([1.0, 2.0]), lambda: (x for x in (1.0, 2.0)), lambda: np.zeros(0), lambda: np.zeros((0, 3)),
    lambda: np.zeros((2, 2, 2)), lambda: np.array(1.0), lambda: np.array("x"), lambda: np.array(None),
    lambda: np.array([object()]), lambda: np.array(["1", "2"]), lambda: np.array([1 + 1j]), lambda: np.array([b"1"]),
    lambda: np.array(["NaT"], "M8[s]"), lambda: np.zeros(2, [("a", float)]), lambda: memoryview(b"ab"),
    lambda: bytearray(b"ab"), lambda: 1000 * ["a column's name"], lambda: {"x" * 10_000: 1},
]  # fmt: skip


def retyped_scalar(value: Any, chance: random.Random) -> Any:
    """The number in another type, where that can hold it."""
    kind = chance.choice([*INTEGERS, *REALS, *ODD, Count, np.array, "0-d", "masked", "big-endian"])
    with np.errstate(all="ignore"):
        try:
            if kind == "0-d":
                return np.array(value, chance.choice(INTEGERS[-2:] + REALS[:4]))
            if kind == "masked":
                return np.ma.array(value, mask=chance.random() < 0.5)
            if kind == "big-endian":
                return np.array(value, ">f8")
            return kind(str(value).encode()) if kind in (bytes, np.bytes_) else kind(value)
        except (ValueError, TypeError, OverflowError, ArithmeticError):
            return value


def signal(values: np.ndarray, chance: random.Random) -> Any:
    """A vector or matrix of numbers in another type or layout, some of its entries replaced, or another shape."""
    values = np.array(values, float)
    if chance.random() < 0.5 and values.size:
        values = _spiked(values, chance)
    with np.errstate(all="ignore"):
        try:
            return chance.choice(LAYOUTS)(values)
        except (ValueError, TypeError, OverflowError, ArithmeticError):
            return values


def _spiked(values: np.ndarray, chance: random.Random) -> np.ndarray:
    """Some or all of the entries scaled or replaced."""
    kind = chance.randrange(5)
    if kind == 0:
        return values * chance.choice(FLOATS)
    if kind == 1:
        return np.full_like(values, chance.choice(FLOATS))
    where = np.array([chance.random() < 0.1 for _ in range(values.size)]).reshape(values.shape)
    if kind == 2:
        return np.where(where, chance.choice(FLOATS), values)
    if kind == 3:
        return np.where(
            where, np.array([chance.choice(FLOATS) for _ in range(values.size)]).reshape(values.shape), values
        )
    return values + chance.choice(FLOATS)


def _strided(values: np.ndarray) -> np.ndarray:
    wide = np.full((*values.shape[:-1], 2 * values.shape[-1]), np.nan)
    wide[..., ::2] = values
    return wide[..., ::2]


def _reversed_twice(values: np.ndarray) -> np.ndarray:
    return values[::-1].copy()[::-1]


def _read_only(values: np.ndarray) -> np.ndarray:
    values = values.copy()
    values.flags.writeable = False
    return values


def _masked(values: np.ndarray) -> Any:
    return np.ma.masked_greater(values, np.median(values) if values.size else 0.0)


def _series(values: np.ndarray) -> Any:
    import pandas as pd

    return pd.Series(values) if values.ndim == 1 else pd.DataFrame(values)


#: The same numbers otherwise; of those that hold other numbers, or none, the first line of a loss is enough.
SAME: list[Callable[[np.ndarray], Any]] = [
    np.ndarray.tolist, lambda v: tuple(v.tolist()), lambda v: v.astype(">f8"), lambda v: v.astype(np.longdouble),
    _strided, _reversed_twice, _read_only, np.asfortranarray, _series, np.ma.array,
    lambda v: [np.float64(x) for x in v] if v.ndim == 1 else v.tolist(), lambda v: [np.array(x) for x in v],
    lambda v: memoryview(v) if v.ndim == 1 else v, lambda v: array.array("d", v) if v.ndim == 1 else v,
    lambda v: np.frombuffer(v.tobytes()).reshape(v.shape) if v.size else v,
]  # fmt: skip
LAYOUTS: list[Callable[[np.ndarray], Any]] = [
    *SAME, lambda v: v.astype(np.float16), lambda v: v.astype(np.float32), lambda v: v.astype(np.int8),
    lambda v: v.astype(np.uint64), lambda v: v.astype(bool), lambda v: v.astype(object), lambda v: v.astype(complex),
    lambda v: v.astype(str), lambda v: v.astype("S"), lambda v: v.astype("M8[s]"), _masked, lambda v: v[:, None],
    lambda v: v[None], lambda v: v[:1], lambda v: v[:0], lambda v: v[:2], lambda v: v[:-1], lambda v: v.ravel()[0],
    lambda v: iter(v.tolist()), lambda v: (x for x in v.tolist()), lambda v: collections.deque(v.tolist()),
    lambda v: set(v.ravel().tolist()), lambda v: dict(enumerate(v.tolist())), lambda v: [*v.tolist(), None],
    lambda v: [*v.tolist()[1:], [1.0]], lambda v: [Fraction(x) for x in v.ravel()], lambda v: v[::-1],
    lambda v: [Decimal(x) for x in v.ravel().tolist()], lambda v: [str(x) for x in v.ravel()], lambda v: v.T,
    lambda v: [*v.tolist()[1:], 10**400], lambda v: [int(x) for x in v.ravel()], lambda v: list(map(bool, v.ravel())),
    lambda v: v.view([("a", float)]), lambda v: v.astype("m8[ms]"), lambda v: [[x] for x in v.tolist()],
    lambda v: np.repeat(v, 2), lambda v: np.broadcast_to(v.ravel()[0], v.shape), lambda v: np.asmatrix(v),
]  # fmt: skip


def hostile(ordinary: Any, chance: random.Random, *, mild: bool = False) -> Any:
    """Something in the place of an ordinary argument; what is mild may be taken, and goes deeper."""
    if not mild and chance.random() < 0.1:
        return chance.choice(THINGS)()
    if isinstance(ordinary, np.ndarray | list | tuple) and chance.random() < 0.9:
        try:
            values = np.array(ordinary, float)
        except (ValueError, TypeError):
            return scalar(chance)
        return chance.choice(SAME)(_spiked(values, chance)) if mild and values.size else signal(values, chance)
    if isinstance(ordinary, int | float) and (mild or chance.random() < 0.3):
        scaled: Any = ordinary
        if chance.random() < 0.7:
            scaled = float(ordinary or 1.0) * 10.0 ** chance.uniform(-20.0, 20.0)
        return retyped_scalar(scaled, chance) if chance.random() < 0.3 else scaled
    return chance.choice(FLOATS) if mild and isinstance(ordinary, float) else scalar(chance)
