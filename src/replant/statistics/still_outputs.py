"""Outputs that stand still: runs of equal samples, and the step of a sensor's scale, which makes them by right."""

from __future__ import annotations

import numpy as np

from replant.arguments import BoolArray, FloatArray, IntArray

SECTIONS = 8
"""Parts of a record of which one at least tells how often neighbours are equal by chance [count].
Derivation: of a sensor that fails for up to seven eighths of the record one part is left.
"""


def still_runs(y: FloatArray) -> IntArray:
    """Return the runs of samples (K,) equal to the bit, (R, 2): where each begins and ends.

    Examples
    --------
    >>> still_runs(np.array([0.0, 1.0, 1.0, 2.0])).tolist()
    [[0, 1], [1, 3], [3, 4]]
    """
    begins = np.flatnonzero(np.concatenate([[True], y[1:] != y[:-1]]))
    return np.column_stack([begins, np.append(begins[1:], y.size)])


def usual_step(y: FloatArray) -> float:
    """Return the step of a sensor's scale, the median distance of the values (K,) that it gave; 0 of a single one.

    The steps of a scale that was rounded to a few digits, or read from a table, are not equal.  Of a scale without
    steps it is next to nothing.

    Examples
    --------
    >>> usual_step(np.array([0.0, 0.33, 0.67, 0.33, 1.0, 4.0])).__round__(2)
    0.34
    """
    values = np.unique(y[np.isfinite(y)])
    return float(np.median(np.diff(values))) if values.size > 1 else 0.0


def tie_share(equal: BoolArray) -> float:
    """Return the share of equal neighbours (K - 1,) in the part of the record with the fewest: the sensor may fail."""
    return min(float(part.mean()) for part in np.array_split(equal, SECTIONS))


def never_ties(y: FloatArray) -> bool:
    """Return whether noise keeps any two samples (K,) in a row from being equal, but for those of a sensor that fails.

    >>> never_ties(np.sin(np.arange(100.0))), never_ties(np.repeat(np.arange(50.0), 2))
    (True, False)
    """
    return y.size >= 2 * SECTIONS and tie_share(y[1:] == y[:-1]) * y.size < SECTIONS
