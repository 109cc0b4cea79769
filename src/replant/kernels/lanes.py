"""SIMD lanes: `LANES` float64, one for each member of an ensemble, as the native library has them.

A kernel written for one identifier is translated, without a change, to one that steps several: ``theta[i]`` is the i-th
parameter of all members, and each of ``+ - * /``, ``sqrt`` and ``max`` is two to eight instructions, depending on the
processor.  IEEE 754 rounds every lane by itself, so a member gets the same bits as in the kernel for one identifier.
Compilers do not vectorise over members by themselves: the loop over members would have to be the innermost one of every
sum, with all intermediate values in memory and a check that no two arrays overlap.

There is no branch on a vector.  `if_less` and `if_at_most` choose between two, lane by lane; what else depends on the
data of one member is done by itself, where `all_within` finds a lane out of range.

The interpreter does not run kernels with lanes: their bits are those of the members one by one.
"""

from typing import Any

# while an instruction waits for the first half, the second is under way, and what is the same for all, loops and
# counters, is spread over more
LANES = 16  # members side by side: twice as many as the widest processors take at once [count]


def _compiled(*_: Any) -> Any:
    raise NotImplementedError("lanes are compiled: the interpreter steps the members of an ensemble one by one")


def vectors(array):
    """Return the float64 array (..., LANES), in C order, as an array (...) of vectors, of the same memory."""
    return _compiled(array)


def members(ints, reals):
    """Return the fields of all members: whole numbers are those of the first, the others vectors."""
    return _compiled(ints, reals)


def member(ints, reals, lane):
    """Return the fields of one member, by the rows of ``ints`` and the lanes of ``reals``."""
    return _compiled(ints, reals, lane)


def all_within(vector, limit):
    """Say whether the magnitude of every lane is at most this float64; that of NaN is not."""
    return _compiled(vector, limit)


def if_less(one, other, chosen, else_chosen):
    """Return, lane by lane, the third vector where the first is less than the second, else the fourth; NaN is not."""
    return _compiled(one, other, chosen, else_chosen)


def if_at_most(one, other, chosen, else_chosen):
    """Return, lane by lane, the third vector where the first is at most the second, else the fourth; NaN is not."""
    return _compiled(one, other, chosen, else_chosen)


def load(matrix, row, column):
    """Return `LANES` neighbours in a row of a matrix, from this one on, as a vector."""
    return _compiled(matrix, row, column)


def store(matrix, row, column, vector):
    """Write a vector to `LANES` neighbours in a row of a matrix, from this one on."""
    _compiled(matrix, row, column, vector)


def gathered(cube, places, further):
    """Return the numbers of an array that lie at `LANES` places, all so much further on, as a vector."""
    return _compiled(cube, places, further)


def prefetch(matrix, row, column):
    """Ask the memory for one element of a matrix, a number or a vector, ahead of its use."""


def copy(target, source):
    """Let the numbers or vectors of an array take the place of those of another one, which is as long."""
    target[:] = source
