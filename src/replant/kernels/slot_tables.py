"""Slots: declarations of named numbers in flat arrays, each written once.

A class lists its slots; the order of the list is the order in the arrays.  `Integer`, `Flag` and `Choice` lie in
``ints``, `Real` in ``reals``.  A `Block` lies in ``reals`` after the scalars, and an entry of ``ints`` holds its begin.
On an instance with these two arrays each slot is a property: it reads and writes the number, or returns a view of the
block.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from enum import IntEnum
from functools import lru_cache
from typing import Any, ClassVar, Generic, Self, TypeVar, overload

import numpy as np

# longer than any stream; float64 is exact up to it, and sums of many stay within int64
NEVER = 2**53  # a sample that never comes [samples]

Value = TypeVar("Value")
Kind = TypeVar("Kind", bound=IntEnum)
Inner = TypeVar("Inner", bound="Part")
Array = np.ndarray[Any, np.dtype[np.float64]]


class Numbers(dict[str, int]):
    """The dimensions used in shapes, by name; never changed."""

    __slots__ = ()

    # the same dimensions are looked up thousands of times: caches compare the object, not its content
    def __hash__(self) -> int:  # type: ignore[override]
        return id(self)

    def __eq__(self, other: object) -> bool:
        return self is other


class Slot(Generic[Value]):
    """One declared number, or block of numbers: a property of an instance; on the class, the declaration itself.

    ``meaning`` is a line, with any unit in brackets; ``laid_out``: the settings decide it, once.
    """

    def __init__(self, meaning: str, laid_out: bool = False) -> None:
        self.meaning, self.laid_out = meaning, laid_out
        # name of the property; place in ``ints`` or ``reals``, for a block the place in ``ints`` that holds its begin
        self.name, self.index = "", -1

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, holder: None, owner: type) -> Self: ...
    @overload
    def __get__(self, holder: object, owner: type) -> Value: ...
    def __get__(self, holder: Any, owner: type) -> Self | Value:
        return self if holder is None else self._of(holder)

    def _of(self, holder: Any) -> Value:
        raise NotImplementedError

    def is_sound(self, holder: Any) -> bool:
        """Return whether the number is one that the program can have written."""
        raise NotImplementedError

    def size(self, dimensions: Numbers) -> int:
        """Return how many numbers it has."""
        return 1


class Whole(Slot[Value]):
    """A number of ``ints``, converted by ``kind``."""

    kind: Callable[[int], Value]

    def _of(self, holder: Any) -> Value:
        return self.kind(int(holder.ints[self.index]))

    def __set__(self, holder: Any, value: Value) -> None:
        holder.ints[self.index] = value


class Integer(Whole[int]):
    """An integer, at least ``least`` and below a sum of slots and numbers, such as "samples + 1"."""

    kind = int

    def __init__(self, meaning: str, laid_out: bool = False, *, least: int = 0, below: str = str(NEVER)) -> None:
        super().__init__(meaning, laid_out)
        self.least, self.below = least, below

    def is_sound(self, holder: Any) -> bool:
        """Return whether the number is in its range."""
        below = sum(int(term) if term.isdigit() else getattr(holder, term) for term in self.below.split(" + "))
        return bool(self.least <= holder.ints[self.index] < below)


class Flag(Whole[bool]):
    """A flag, 1 or 0."""

    kind = bool

    def is_sound(self, holder: Any) -> bool:
        """Return whether the number is 0 or 1."""
        return int(holder.ints[self.index]) in (0, 1)


class Choice(Whole[Kind]):
    """One of a few named values."""

    def __init__(self, kind: type[Kind], meaning: str) -> None:
        super().__init__(meaning)
        self.kind, self._values = kind, set(kind)

    def is_sound(self, holder: Any) -> bool:
        """Return whether the number is one of the values."""
        return int(holder.ints[self.index]) in self._values


class Real(Slot[float]):
    """A number of ``reals``, from ``least`` to ``most``; unless ``finite``, it may also be infinite or NaN."""

    def __init__(
        self, meaning: str, laid_out: bool = False, *, least: float = -math.inf, most: float = math.inf,
        finite: bool = True,
    ) -> None:  # fmt: skip
        super().__init__(meaning, laid_out)
        self.least, self.most, self.finite = least, most, finite

    def _of(self, holder: Any) -> float:
        return float(holder.reals[self.index])

    def __set__(self, holder: Any, value: float) -> None:
        holder.reals[self.index] = value

    def is_sound(self, holder: Any) -> bool:
        """Return whether the number is in its range."""
        value = self._of(holder)
        return not (value < self.least or value > self.most) and (math.isfinite(value) or not self.finite)


class Block(Slot[Array]):
    """Several numbers of ``reals`` as an array; ``shape`` names the dimensions, as in "PAST, 1 + T"."""

    def __init__(self, shape: str, meaning: str, laid_out: bool = False, *, finite: bool = True) -> None:
        super().__init__(meaning, laid_out)
        self.shape, self.finite = shape, finite

    def _of(self, holder: Any) -> Array:
        shape, begin = sizes(self.shape, holder.dimensions), holder.begin_of(self)
        return np.asarray(holder.reals[begin : begin + math.prod(shape)].reshape(shape))

    def is_sound(self, holder: Any) -> bool:
        """Return whether every number is finite, if they must be."""
        return not self.finite or bool(np.isfinite(self._of(holder)).all())

    def size(self, dimensions: Numbers) -> int:
        """Return how many numbers it has."""
        return math.prod(sizes(self.shape, dimensions))


class Nested(Slot[Inner]):
    """A block that is itself a table."""

    def __init__(self, table: type[Inner], meaning: str) -> None:
        super().__init__(meaning)
        self.table = table

    def _of(self, holder: Any) -> Inner:
        begin = holder.begin_of(self)
        return self.table(holder.reals[begin : begin + self.size(holder.dimensions)], holder.dimensions)

    def is_sound(self, holder: Any) -> bool:
        """Return whether every number of the table is sound."""
        part = self._of(holder)
        return all(slot.is_sound(part) for slot in (*self.table.scalars, *self.table.blocks))

    def size(self, dimensions: Numbers) -> int:
        """Return how many numbers the table has."""
        return self.table.size(dimensions)


class Table:
    """A class that lists slots and numbers them in order.

    An instance has ``reals``, the ``dimensions`` that shapes name, and ``begin_of`` a block; ``ints`` for integers.
    """

    __slots__ = ()

    integers: ClassVar[tuple[Slot[Any], ...]] = ()
    scalars: ClassVar[tuple[Real, ...]] = ()
    blocks: ClassVar[tuple[Slot[Any], ...]] = ()

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        own = [slot for slot in vars(cls).values() if isinstance(slot, Slot)]
        if not own:
            return
        cls.blocks = tuple(slot for slot in own if isinstance(slot, Block | Nested))
        cls.scalars = tuple(slot for slot in own if isinstance(slot, Real))
        cls.integers = tuple(slot for slot in own if isinstance(slot, Whole))
        for slots in (cls.scalars, (*cls.integers, *cls.blocks)):
            for index, slot in enumerate(slots):
                slot.index = index

    @classmethod
    @lru_cache(maxsize=1024)
    def begins(cls, dimensions: Numbers) -> dict[str, int]:
        """Return where each block begins in ``reals``, by its name; the entry "" is the end of the last one."""
        found, end = {}, len(cls.scalars)
        for block in cls.blocks:
            found[block.name] = end
            end += block.size(dimensions)
        return found | {"": end}

    @classmethod
    def size(cls, dimensions: Numbers) -> int:
        """Return how many numbers ``reals`` has."""
        return cls.begins(dimensions)[""]


class Part(Table):
    """A table whose numbers, ``reals`` (size,), are a block of another table: scalars first, then its blocks."""

    __slots__ = ("dimensions", "reals")

    def __init__(self, reals: Array, dimensions: Numbers) -> None:
        self.reals, self.dimensions = reals, dimensions

    def begin_of(self, block: Slot[Any]) -> int:
        """Return where in ``reals`` a block begins."""
        return self.begins(self.dimensions)[block.name]

    @classmethod
    def zeros(cls, dimensions: Mapping[str, int]) -> Self:
        """Return a part with an array of its own, all zero."""
        known = Numbers(dimensions)
        return cls(np.zeros(cls.size(known)), known)

    @property
    def fields(self) -> Fields:
        """The fields that interpreted kernels get."""
        return Fields(self)


@lru_cache(maxsize=4096)
def sizes(shape: str, dimensions: Numbers) -> tuple[int, ...]:
    """Return a shape as integers: each axis is a sum of products of the named dimensions."""
    return tuple(sum(_product(term, dimensions) for term in axis.split("+")) for axis in shape.split(","))


def _product(text: str, dimensions: Mapping[str, int]) -> int:
    factors = (factor.strip() for factor in text.split("*"))
    return math.prod(int(factor) if factor.isdigit() else dimensions[factor] for factor in factors)


class Fields:
    """A table as interpreted kernels see it: blocks are views, numbers are NumPy's, which divide by zero as C does."""

    def __init__(self, holder: Any, beside: tuple[str, ...] = ()) -> None:
        own, ints = vars(self), getattr(holder, "ints", None)
        own["_places"] = {slot.name: (holder.reals, slot.index) for slot in holder.scalars}
        own["_places"] |= {slot.name: (ints, slot.index) for slot in holder.integers}
        own |= {name: getattr(holder, name) for name in beside} | {"size": holder.reals.size}
        for block in holder.blocks:
            part = getattr(holder, block.name)
            own[block.name] = part.fields if isinstance(part, Part) else part

    def __getattr__(self, name: str) -> Any:
        array, index = self._place_of(name)
        return array[index]

    def __setattr__(self, name: str, value: Any) -> None:
        array, index = self._place_of(name)
        array[index] = value

    def _place_of(self, name: str) -> tuple[Any, int]:
        if name not in vars(self)["_places"]:
            raise AttributeError(f"no slot is called {name}")
        return vars(self)["_places"][name]  # type: ignore[no-any-return]
