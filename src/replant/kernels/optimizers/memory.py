"""Layout of an optimizer's memory, and the random stream that draws what it learns.

The file of a loop declares its named blocks.  From the declaration come the places that the loop uses (`Memory.begins`
and `block`), the length of the memory, and its content before the first sample (`Memory.filled`).  The size of a block
is a polynomial in P, the entries of theta.

The random stream is seeded and counter-based, SplitMix64, whose whole state is the seed and a position.  Being a pure
function of (seed, position) it costs nothing to save, to resume or to run in any chunking.

Source: Steele, Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np


class Size(NamedTuple):
    """squares P^2 + entries P + ones: a block's length, or where it begins."""

    squares: int
    entries: int
    ones: int

    def at(self, P: int) -> int:
        """Return the number for P entries."""
        return self.squares * P * P + self.entries * P + self.ones


ONE, VECTOR, MATRIX = Size(0, 0, 1), Size(0, 1, 0), Size(1, 0, 0)


class Memory:
    """Blocks of numbers, one after the other, by name and length: `ONE`, `VECTOR` (P,), `MATRIX` (P P,) or a `Size`.

    >>> memory = Memory(mean=VECTOR, power=ONE)
    >>> memory.size(2), memory.begins["power"].at(2)
    (3, 2)
    >>> memory.filled(2, power=1.0)
    array([0., 0., 1.])
    """

    def __init__(self, **sizes: Size) -> None:
        self.sizes: Mapping[str, Size] = sizes
        self.begins: dict[str, Size] = {}
        self.end = Size(0, 0, 0)
        for name, size in sizes.items():
            self.begins[name] = self.end
            self.end = Size(*(begin + length for begin, length in zip(self.end, size, strict=True)))

    def size(self, P: int) -> int:
        """Return how many numbers all blocks have."""
        return self.end.at(P)

    def of(self, memory: Any, name: str, P: int) -> Any:
        """Return the view of one block of ``memory`` (M,)."""
        begin = self.begins[name].at(P)
        return memory[begin : begin + self.sizes[name].at(P)]

    def filled(self, P: int, **values: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Return a memory (M,) of zeros but for the blocks given by name: a number, or as many as the block has."""
        memory = np.zeros(self.size(P))
        for name, value in values.items():
            self.of(memory, name, P)[:] = value
        return memory


#: The memory of an optimizer that keeps nothing between two updates.
NOTHING = Memory()


def place(begin, P):
    """Return where a block with this `Size` before it begins."""
    return begin.squares * P * P + begin.entries * P + begin.ones


def block(memory, begin, P):
    """Return ``memory`` from a block on, by its place in `Memory.begins`."""
    return memory[place(begin, P) :]


_GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # increment of SplitMix64, 2^64 over the golden ratio [number]
_MIX1 = np.uint64(0xBF58476D1CE4E5B9)  # its first multiplier [number]
_MIX2 = np.uint64(0x94D049BB133111EB)  # its second multiplier [number]
_S30, _S27, _S31, _S32 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(32)  # its shifts, half a word [bits]


def draw_below(seed, position, bound):
    """Return a whole number in 0 .. bound-1, the ``position``-th of the stream ``seed``; bound < 2^31."""
    z = np.uint64(seed) + (np.uint64(position) + np.uint64(1)) * _GOLDEN
    z = (z ^ (z >> _S30)) * _MIX1
    z = (z ^ (z >> _S27)) * _MIX2
    z = z ^ (z >> _S31)
    # the high half of the draw times the bound, shifted down: uneven by at most bound / 2^32
    return np.int64(((z >> _S32) * np.uint64(bound)) >> _S32)
