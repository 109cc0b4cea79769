"""Generalised least squares: weights of functions in a signal whose rest is coloured, by its own autoregression."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.statistics.autoregression import Autoregression
from replant.statistics.linear_algebra import least_norm
from replant.statistics.projections import lengths_of

SWEEPS = 2
"""Times that the weights are found again with the colour of what is left [count].
Origin: the colour of what the first weights leave is nearly right; more change nothing on the benchmarks.
Sensitivity: not measured.
"""

DEPENDENT = 1e-10
"""Singular value of the scaled functions below which they depend on each other [part of the largest].
Derivation: some hundred thousand times the precision of float64.
"""


def weights_of(functions: FloatArray, signal: FloatArray) -> FloatArray:
    """Return the weights (L,) of functions (K, L) that make a signal (K,), whatever the colour of what is left.

    Examples
    --------
    >>> noise = np.cumsum(np.random.default_rng(0).standard_normal(1000))
    >>> function = np.sin(np.arange(1000.0))[:, None]
    >>> weights_of(function, 2.0 * function[:, 0] + noise).round(1)
    array([2.])
    """
    weights = _least_squares(functions, signal)
    for _ in range(SWEEPS):
        colour = Autoregression.of(signal - functions @ weights)
        if colour.order == 0:
            break
        weights = _least_squares(colour.whiten(functions), colour.whiten(signal))
    return weights


def _least_squares(columns: FloatArray, target: FloatArray) -> FloatArray:
    lengths = lengths_of(columns)
    return np.asarray(least_norm(columns / lengths, target, DEPENDENT)[0] / lengths)
