"""A structure with fewer poles, and its models as ones with more: the other poles are infinitely fast.

Where a record tells fewer poles than are asked for, the least error may lie where the surplus ones are infinitely fast.
Of the coefficients that is infinity, and beyond it lie unstable poles: steps from slower poles end far from there.  The
model with fewer poles, the surplus ones beyond all frequencies, lies next to it and explains as much.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray

INFINITE = 300.0
"""Magnitude of a pole that delays by too little to be told from an infinitely fast one [1 / sampling time].
Origin: of 90 fits with a pole more than the one before, of random plants up to twice as fast as the sampling, 6
explained less by a point at 10, 1 at 30, none at 100, 300 and 1000; 8 without a start from fewer poles.
Sensitivity: not measured.
"""


def with_poles(structure: Structure, poles: int) -> Structure:
    """Return a structure with so many poles, no more than it has, and as many of its zeros as they allow."""
    return replace(structure, poles=poles, zeros=min(structure.zeros, poles - (not structure.feedthrough)))


def grown(less: Structure, theta: FloatArray, more: Structure, lag: float) -> FloatArray:
    """Return the coefficients of a model as one with more poles, of ``lag`` s each.

    >>> grown(Structure(1), np.array([2.0, 3.0]), Structure(2, zeros=1), 0.5)
    array([4., 4., 0., 6.])
    """
    a, b = np.concatenate([[1.0], theta[less.denominator]]), theta[less.numerator]
    for _ in range(more.poles - less.poles):
        a, b = np.convolve(a, [1.0, 1.0 / lag]), b / lag
    model = np.zeros(more.coefficients)
    model[more.denominator] = a[1:]
    b = b[-(more.zeros + 1) :]
    model[more.coefficients - b.size :] = b
    return model
