"""The types of the kernels' subset, and what is said where something is outside of it.

========================  ===========================  ==================================================
in Python                 here                         in C
========================  ===========================  ==================================================
truth, int, float         "b", "i", "d"                bool, int64_t, double
np.uint64                 "u"                          uint64_t
a number of each member   "l"                          lanes, a vector
array in C order          Array("d", 2)                reals2: where it begins, and its sizes
one lane of such          Array("d", 1, strided=True)  reals1s
tuple                     Tuple of kinds               a struct
table of the schema       Record(table)                a struct over its arrays, see `records`
function, constant        Known(value)                 nothing: the function is translated for it
========================  ===========================  ==================================================
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from types import ModuleType
from typing import Any


class UnsupportedError(Exception):
    """A construct that is no part of the subset; the message names file and line."""


@dataclass(frozen=True)
class Array:
    """An array of so many dimensions in C order; ``strided``: every LANES-th number of one."""

    element: str
    dimensions: int
    strided: bool = False

    @property
    def name(self) -> str:
        """Its type in C."""
        word = {"d": "reals", "i": "ints", "l": "vectors"}[self.element]
        return f"{word}{self.dimensions}{'s' if self.strided else ''}"

    @property
    def struct(self) -> str:
        """The definition of its type."""
        sizes = ", ".join(f"n{axis}" for axis in range(self.dimensions))
        stride = ", stride" if self.strided else ""
        return f"typedef struct {{ {C[self.element]} *p; int64_t {sizes}{stride}; }} {self.name};"


@dataclass(frozen=True)
class Tuple:
    """Values of these kinds side by side."""

    parts: tuple[Kind, ...]


@dataclass(frozen=True)
class Record:
    """A table of the schema; of "d" one identifier, "l" the vectors of several, "s" one lane of these."""

    table: type
    element: str = "d"

    @property
    def schema(self) -> ModuleType:
        """The module that declares it."""
        return sys.modules[self.table.__module__]

    @property
    def title(self) -> str:
        """What it is a table of."""
        return self.table.__name__.removesuffix("Slots")

    @property
    def name(self) -> str:
        """Its type in C."""
        return self.title + {"d": "", "l": "Vectors", "s": "Lane"}[self.element]

    @property
    def prefix(self) -> str:
        """What the names of the functions begin with that cut out its blocks."""
        whole = {"d": "", "l": "vectors", "s": "lane"}[self.element]
        part = "" if self.table.integers and whole else self.title  # several parts may have a block of the same name
        return "_".join(word for word in (part, whole) if word).lower()


@dataclass(frozen=True)
class Known:
    """What is known when translating; told apart by identity, as a function has no other."""

    value: Any
    name: str = ""

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Known) and (self.value is other.value or self.value == other.value)

    def __hash__(self) -> int:
        return hash(self.value)


Kind = str | Array | Tuple | Record | Known

C = {"b": "bool", "i": "int64_t", "u": "uint64_t", "d": "double", "l": "lanes", "v": "void"}
RANK = {"b": 0, "i": 1, "u": 2, "d": 3, "l": 4}
#: The annotations of what Python calls.
ANNOTATIONS: dict[str, Kind] = {
    "bool": "b",
    "int": "i",
    "float": "d",
    "Ints": Array("i", 1),
    "IntMatrix": Array("i", 2),
    "Reals": Array("d", 1),
    "Matrix": Array("d", 2),
    "Cube": Array("d", 3),
}


def unify(one: Kind | None, other: Kind) -> Kind:
    """Return the kind of a variable that is both."""
    if one is None or one == other:
        return other
    if isinstance(one, str) and isinstance(other, str) and one in RANK and other in RANK:
        return "i" if {one, other} == {"i", "u"} else max(one, other, key=RANK.__getitem__)
    raise UnsupportedError(f"a value is {describe(one)} and {describe(other)}")


def describe(kind: Kind) -> str:
    """Return a kind in words."""
    if isinstance(kind, str):
        return {"b": "a truth", "v": "nothing", "l": "a vector"}.get(kind, C.get(kind, kind))
    if isinstance(kind, Known):
        return f"the constant {kind.name or kind.value!r}"
    return kind.name if isinstance(kind, Array | Record) else "a tuple"
