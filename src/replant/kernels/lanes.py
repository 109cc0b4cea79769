"""SIMD lanes: vectors of `LANES` float64 in the native library, one lane for each member of an ensemble.

The translator turns a kernel written for one identifier, unchanged, into one that steps several: ``theta[i]`` is then
the i-th parameter of all members, and each of ``+ - * /``, ``sqrt`` and ``max`` is two to eight instructions, depending
on the processor.  IEEE 754 rounds every lane separately, so a member gets the same bits as in the kernel for one
identifier.  Compilers do not vectorise over members by themselves: the loop over members would have to be the innermost
one of every sum, with all intermediate values in memory and a check that no two arrays overlap.

A kernel cannot branch on a vector.  `if_less` and `if_at_most` choose between two vectors, lane by lane; any other
decision on the data of one member is made for that member alone, after `all_within` has found a lane out of range.

The interpreter does not run kernels with lanes: it steps the members one by one, with the same bits.
"""

from typing import Any

# two instructions for each operation hide part of their latency, and loops and counters are shared by more members
LANES = 16  # members side by side: twice as many as the widest vector registers hold [count]


def _compiled(*_: Any) -> Any:
    raise NotImplementedError("lanes are compiled: the interpreter steps the members of an ensemble one by one")


def vectors(array):
    """Return the float64 array (..., LANES), in C order, as an array (...) of vectors, of the same memory."""
    return _compiled(array)


def members(ints, reals):
    """Return the fields of all members: integers are those of the first member, reals are vectors."""
    return _compiled(ints, reals)


def member(ints, reals, lane):
    """Return the fields of one member, by the rows of ``ints`` and the lanes of ``reals``."""
    return _compiled(ints, reals, lane)


def all_within(vector, limit):
    """Return whether the magnitude of every lane is at most ``limit``, a float64; false for NaN."""
    return _compiled(vector, limit)


def if_less(one, other, chosen, else_chosen):
    """Return, lane by lane, ``chosen`` if ``one`` < ``other``, else ``else_chosen`` (also for NaN)."""
    return _compiled(one, other, chosen, else_chosen)


def if_at_most(one, other, chosen, else_chosen):
    """Return, lane by lane, ``chosen`` if ``one`` <= ``other``, else ``else_chosen`` (also for NaN)."""
    return _compiled(one, other, chosen, else_chosen)


def load(matrix, row, column):
    """Return `LANES` consecutive numbers in a row of a matrix, from this column on, as a vector."""
    return _compiled(matrix, row, column)


def store(matrix, row, column, vector):
    """Write a vector to `LANES` consecutive numbers in a row of a matrix, from this column on."""
    _compiled(matrix, row, column, vector)


def gathered(cube, places, further):
    """Return the numbers of an array at `LANES` places, each shifted by ``further``, as a vector."""
    return _compiled(cube, places, further)


def prefetch(matrix, row, column):
    """Prefetch one element of a matrix, a number or a vector, into the cache."""


def copy(target, source):
    """Copy the numbers or vectors of one array to another of the same length."""
    target[:] = source
