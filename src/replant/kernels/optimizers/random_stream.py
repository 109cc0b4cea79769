"""A seeded, counter-based random stream: SplitMix64, whose whole state is the seed and a position.

Being a pure function of (seed, position) it costs nothing to save, to resume or to run in any chunking.

Source: Steele, Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014.
"""

import numpy as np

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
"""Increment of SplitMix64, 2^64 over the golden ratio [number]."""
_MIX1 = np.uint64(0xBF58476D1CE4E5B9)
"""Its first multiplier [number]."""
_MIX2 = np.uint64(0x94D049BB133111EB)
"""Its second multiplier [number]."""
_S30, _S27, _S31, _S32 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(32)
"""Its shifts, and half of the word [bits]."""


def draw_below(seed, position, bound):
    """Return a whole number in 0 .. bound-1, the ``position``-th of the stream ``seed``; bound < 2^31.

    The high half of the draw times ``bound``, shifted down: uneven by at most bound / 2^32.
    """
    z = np.uint64(seed) + (np.uint64(position) + np.uint64(1)) * _GOLDEN
    z = (z ^ (z >> _S30)) * _MIX1
    z = (z ^ (z >> _S27)) * _MIX2
    z = z ^ (z >> _S31)
    return np.int64(((z >> _S32) * np.uint64(bound)) >> _S32)
