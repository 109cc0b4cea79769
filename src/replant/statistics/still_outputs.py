"""Outputs that stand still: runs of equal samples, and the step of a sensor's scale, which makes them by right."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray, IntArray


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
