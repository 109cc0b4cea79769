"""Layout of an optimizer's memory, and the random stream that draws the rows of a batch.

The file of a loop declares its named blocks.  The declaration gives the places that the loop uses (`Memory.begins` and
`block`), the length of the memory, and its content before the first sample (`Memory.filled`).  The size of a block is a
polynomial in P, the number of entries of theta.

The random stream is SplitMix64, which is counter-based: a draw is a pure function of (seed, position).  So saving and
resuming need two numbers, and results do not depend on the chunking.

Source: Steele, Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np


class Size(NamedTuple):
    """squares P^2 + entries P + ones: the length or the begin of a block."""

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
        """Return the total size of all blocks."""
        return self.end.at(P)

    def of(self, memory: Any, name: str, P: int) -> Any:
        """Return the view of one block of ``memory`` (M,)."""
        begin = self.begins[name].at(P)
        return memory[begin : begin + self.sizes[name].at(P)]

    def filled(self, P: int, **values: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Return a memory (M,) of zeros, except for the blocks given by name: a number, or an array of their size."""
        memory = np.zeros(self.size(P))
        for name, value in values.items():
            self.of(memory, name, P)[:] = value
        return memory


#: The memory of an optimizer without memory.
NOTHING = Memory()


def place(begin, P):
    """Return the begin of a block, given as a `Size`, for P entries."""
    return begin.squares * P * P + begin.entries * P + begin.ones


def block(memory, begin, P):
    """Return ``memory`` from the begin of a block on, as given by `Memory.begins`."""
    return memory[place(begin, P) :]


_GOLDEN = np.uint64(0x9E3779B97F4A7C15)  # increment of SplitMix64, 2^64 over the golden ratio [number]
_MIX1 = np.uint64(0xBF58476D1CE4E5B9)  # its first multiplier [number]
_MIX2 = np.uint64(0x94D049BB133111EB)  # its second multiplier [number]
_S30, _S27, _S31, _S32 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(32)  # its shifts, half a word [bits]


def draw_below(seed, position, bound):
    """Return the ``position``-th integer, from 0 to bound - 1, of the stream ``seed``; bound < 2^31."""
    z = np.uint64(seed) + (np.uint64(position) + np.uint64(1)) * _GOLDEN
    z = (z ^ (z >> _S30)) * _MIX1
    z = (z ^ (z >> _S27)) * _MIX2
    z = z ^ (z >> _S31)
    # the high half of the draw times the bound, shifted down: not uniform by at most bound / 2^32
    return np.int64(((z >> _S32) * np.uint64(bound)) >> _S32)
