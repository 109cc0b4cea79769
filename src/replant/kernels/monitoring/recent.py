"""The ring of raw samples as a whole: its signals in order, and the variance of a column."""

import math

from replant.kernels.native import Matrix, Reals, kernel
from replant.kernels.schema import DOUBTED, INPUT, OUTPUT, STEP, Doubt


def place_of(ring, end, rows, i):
    """Return the place of the i-th of the newest ``rows`` rows, which end before ``end``."""
    k = end - rows + i
    return k if k >= 0 else k + ring.shape[0]


@kernel("ring.shape[0] >= u.size and 0 <= end <= ring.shape[0] and y.size == u.size and ring.shape[1] > STEP")
def unroll(ring: Matrix, end: int, dt: float, u: Reals, y: Reals):
    """Write the newest inputs and outputs (K,) of a ring, oldest first, up to the row before ``end``.

    Return how many of them came after another interval than ``dt``, or without an output.
    """
    odd = 0
    for i in range(u.size):
        k = place_of(ring, end, u.size, i)
        u[i], y[i] = ring[k, INPUT], ring[k, OUTPUT]
        if not math.isfinite(y[i]) or (i > 0 and ring[k, STEP] != dt):
            odd += 1
        elif ring.shape[1] > DOUBTED and ring[k, DOUBTED] == Doubt.MISSING:
            odd += 1
    return odd


@kernel("0 < rows <= ring.shape[0] and 0 <= end <= ring.shape[0] and 0 <= column < ring.shape[1]")
def variance(ring: Matrix, end: int, rows: int, column: int):
    """Return the variance of a column in the newest rows of a ring, up to that before ``end``."""
    mean, total = 0.0, 0.0
    for i in range(rows):
        mean += ring[place_of(ring, end, rows, i), column]
    mean /= rows
    for i in range(rows):
        away = ring[place_of(ring, end, rows, i), column] - mean
        total += away * away
    return total / rows
