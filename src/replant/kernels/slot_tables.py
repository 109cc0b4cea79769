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


class Slot:
    """One declared number, or block of numbers: its meaning in a line, the part that writes it, its unit if any."""

    def __init__(self, meaning: str, writer: str, unit: str = "") -> None:
        self.meaning, self.writer, self.unit = meaning, writer, unit
        # name of the property; place in ``ints`` or ``reals``, for a block the place in ``ints`` that holds its begin
        self.name, self.index = "", -1

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def is_sound(self, holder: Any) -> bool:
        """Return whether the number is one that the program can have written."""
        raise NotImplementedError


class Property(Generic[Value]):
    """Descriptor that reads a slot: the number on an instance, the slot itself on the class."""

    @overload
    def __get__(self, holder: None, owner: type) -> Self: ...
    @overload
    def __get__(self, holder: object, owner: type) -> Value: ...
    def __get__(self, holder: Any, owner: type) -> Self | Value:
        return self if holder is None else self._of(holder)

    def _of(self, holder: Any) -> Value:
        """Return the number, or a view of the block."""
        raise NotImplementedError


class Whole(Property[Value]):
    """A number of ``ints``, converted by ``kind``."""

    kind: Callable[[int], Value]
    index: int

    def _of(self, holder: Any) -> Value:
        return self.kind(int(holder.ints[self.index]))

    def __set__(self, holder: Any, value: Value) -> None:
        holder.ints[self.index] = value


class Integer(Slot, Whole[int]):
    """An integer of ``ints``, at least ``least`` and below a sum of slots and numbers, such as "samples + 1"."""

    kind = int

    def __init__(self, meaning: str, writer: str, unit: str = "", *, least: int = 0, below: str = "") -> None:
        super().__init__(meaning, writer, unit)
        self.least, self.below = least, below

    def is_sound(self, holder: Any) -> bool:
        """Whether the number is in its range."""
        terms = [term.strip() for term in self.below.split("+")] if self.below else [str(NEVER)]
        below = sum(int(term) if term.isdigit() else getattr(holder, term) for term in terms)
        return bool(self.least <= holder.ints[self.index] < below)


class Flag(Slot, Whole[bool]):
    """A flag of ``ints``, 1 or 0."""

    kind = bool

    def is_sound(self, holder: Any) -> bool:
        """Return whether the number is 0 or 1."""
        return int(holder.ints[self.index]) in (0, 1)


class Choice(Slot, Whole[Kind]):
    """One of a few named values, in ``ints``."""

    def __init__(self, kind: type[Kind], meaning: str, writer: str) -> None:
        super().__init__(meaning, writer)
        self.kind, self._values = kind, set(kind)

    def is_sound(self, holder: Any) -> bool:
        """Return whether the number is one of the values."""
        return int(holder.ints[self.index]) in self._values


class Real(Slot, Property[float]):
    """A number of ``reals``, from ``least`` to ``most``; unless ``finite``, it may also be infinite or NaN."""

    def __init__(
        self, meaning: str, writer: str, unit: str = "", *, least: float = -math.inf, most: float = math.inf,
        finite: bool = True,
    ) -> None:  # fmt: skip
        super().__init__(meaning, writer, unit)
        self.least, self.most, self.finite = least, most, finite

    def _of(self, holder: Any) -> float:
        return float(holder.reals[self.index])

    def is_sound(self, holder: Any) -> bool:
        """Whether the number is in its range."""
        value = float(holder.reals[self.index])
        return not (value < self.least or value > self.most) and (math.isfinite(value) or not self.finite)

    def __set__(self, holder: Any, value: float) -> None:
        holder.reals[self.index] = value


class Block(Slot, Property[Array]):
    """Several numbers of ``reals`` as an array; ``shape`` names the dimensions, as in "PAST, 1 + T"."""

    def __init__(self, shape: str, meaning: str, writer: str, unit: str = "", *, finite: bool = True) -> None:
        super().__init__(meaning, writer, unit)
        self.shape, self.finite = shape, finite

    def is_sound(self, holder: Any) -> bool:
        """Return whether every number is finite, if they must be."""
        return not self.finite or bool(np.isfinite(getattr(holder, self.name)).all())

    def _of(self, holder: Any) -> Array:
        shape, begin = self.sizes(holder.dimensions), holder.begin_of(self)
        return np.asarray(holder.reals[begin : begin + math.prod(shape)].reshape(shape))

    def sizes(self, dimensions: Numbers) -> tuple[int, ...]:
        """Return the shape as integers: each axis is a sum of products of the named dimensions."""
        return sizes(self.shape, dimensions)

    def size(self, dimensions: Numbers) -> int:
        """Return how many numbers it has."""
        return math.prod(self.sizes(dimensions))


class Table:
    """A class that lists slots and numbers them in order.  An instance has ``reals``, and ``ints`` for integers."""

    __slots__ = ()

    integers: ClassVar[tuple[Slot, ...]] = ()
    scalars: ClassVar[tuple[Real, ...]] = ()
    blocks: ClassVar[tuple[Block, ...]] = ()

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        own = [slot for slot in vars(cls).values() if isinstance(slot, Slot)]
        if not own:
            return
        cls.blocks = tuple(slot for slot in own if isinstance(slot, Block))
        cls.scalars = tuple(slot for slot in own if isinstance(slot, Real))
        cls.integers = tuple(slot for slot in own if not isinstance(slot, Block | Real))
        for slots in (cls.scalars, (*cls.integers, *cls.blocks)):
            for index, slot in enumerate(slots):
                slot.index = index

    @property
    def dimensions(self) -> Numbers:
        """The named dimensions used in the shapes of blocks."""
        raise NotImplementedError

    def begin_of(self, block: Block) -> int:
        """Return where in ``reals`` a block begins."""
        raise NotImplementedError

    @property
    def fields(self) -> Fields:
        """The fields that interpreted kernels get."""
        return Fields(self)


class Part(Table):
    """A table whose numbers, ``reals`` (size,), are a block of another table: scalars first, then its blocks."""

    __slots__ = ("_dimensions", "reals")

    def __init__(self, reals: Array, dimensions: Numbers) -> None:
        self.reals, self._dimensions = reals, dimensions

    @property
    def dimensions(self) -> Numbers:
        """The named dimensions used in the shapes of blocks."""
        return self._dimensions

    def begin_of(self, block: Block) -> int:
        """Return where in ``reals`` a block begins."""
        return begins(self.scalars, self.blocks, self._dimensions)[block.name]

    @classmethod
    def zeros(cls, dimensions: Mapping[str, int]) -> Self:
        """Return a part with an array of its own, all zero."""
        known = numbers(tuple(dimensions.items()))
        return cls(np.zeros(cls.size(known)), known)

    @classmethod
    def size(cls, dimensions: Numbers) -> int:
        """Return how many numbers there are."""
        return begins(cls.scalars, cls.blocks, dimensions)[""]


class Nested(Block, Generic[Inner]):
    """A block that is itself a table."""

    def __init__(self, table: type[Inner], meaning: str) -> None:
        super().__init__("", meaning, "")
        self.table = table

    def is_sound(self, holder: Any) -> bool:
        """Return whether every number of the table is sound."""
        part = getattr(holder, self.name)
        return all(slot.is_sound(part) for slot in (*self.table.scalars, *self.table.blocks))

    @overload  # type: ignore[override]
    def __get__(self, holder: None, owner: type) -> Nested[Inner]: ...
    @overload
    def __get__(self, holder: object, owner: type) -> Inner: ...
    def __get__(self, holder: Any, owner: type) -> Nested[Inner] | Inner:
        if holder is None:
            return self
        begin = holder.begin_of(self)
        return self.table(holder.reals[begin : begin + self.size(holder.dimensions)], holder.dimensions)

    def sizes(self, dimensions: Numbers) -> tuple[int, ...]:
        """Return how many numbers the table has."""
        return (begins(self.table.scalars, self.table.blocks, dimensions)[""],)


@lru_cache(maxsize=256)
def numbers(dimensions: tuple[tuple[str, int], ...]) -> Numbers:
    """Return the dimensions as one cached object."""
    return Numbers(dimensions)


@lru_cache(maxsize=4096)
def sizes(shape: str, dimensions: Numbers) -> tuple[int, ...]:
    """Return a shape as integers: each axis is a sum of products of the named dimensions."""
    return tuple(sum(_product(term, dimensions) for term in axis.split("+")) for axis in shape.split(","))


@lru_cache(maxsize=1024)
def begins(scalars: tuple[Real, ...], blocks: tuple[Block, ...], dimensions: Numbers) -> dict[str, int]:
    """Return where each block of a part begins; the entry "" is the end of the last one."""
    found, end = {}, len(scalars)
    for block in blocks:
        found[block.name] = end
        end += block.size(dimensions)
    return found | {"": end}


def _product(text: str, dimensions: Mapping[str, int]) -> int:
    factors = (factor.strip() for factor in text.split("*"))
    return math.prod(int(factor) if factor.isdigit() else dimensions[factor] for factor in factors)


class Fields:
    """A table as interpreted kernels see it: blocks are views, numbers are NumPy's, which divide by zero as C does."""

    def __init__(self, holder: Any, beside: tuple[str, ...] = ()) -> None:
        own, ints = vars(self), getattr(holder, "ints", None)
        own |= {name: getattr(holder, name) for name in beside}
        own["_places"] = {slot.name: (holder.reals, slot.index) for slot in holder.scalars}
        own["_places"] |= {slot.name: (ints, slot.index) for slot in holder.integers}
        own["size"] = holder.reals.size
        for block in holder.blocks:
            part = getattr(holder, block.name)
            own[block.name] = Fields(part) if isinstance(block, Nested) else part

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
