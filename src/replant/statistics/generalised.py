"""Generalised least squares: weights of functions in a signal whose rest is coloured, by its own autoregression."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.statistics.autoregression import Autoregression
from replant.statistics.linear_algebra import least_norm
from replant.statistics.projections import lengths_of, orthogonal, products

SWEEPS = 2
"""Times that the weights are found again with the colour of what is left [count].
Origin: the colour of what the first weights leave is nearly right; more change nothing on the benchmarks.
Sensitivity: halved or doubled, nothing changes on these records.
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


def explained_power(functions: FloatArray, signal: FloatArray) -> float:
    """Return the variance of what functions (K, L) explain of a signal (K,), less what they explain by chance.

    Weights found by generalised least squares have the covariance C = variance of the innovation times (F' F)^-1 of the
    whitened functions F.  By chance functions f explain the trace of C times the covariance of f.

    Examples
    --------
    >>> noise = np.cumsum(np.random.default_rng(0).standard_normal(1000))
    >>> functions = np.random.default_rng(1).standard_normal((1000, 5))
    >>> explained_power(functions, noise) < 0.2 < explained_power(functions, functions[:, 0] + noise)
    True
    """
    part = functions @ weights_of(functions, signal)
    noise = Autoregression.of(signal - part)
    white = noise.whiten(signal - part)
    filtered = noise.whiten(functions)
    spread = (functions - functions.mean(axis=0)) @ orthogonal(products(filtered, filtered))
    chance = float(np.mean(white**2)) * float(np.sum(spread**2)) / len(spread)
    return max(float(part.var()) - chance, 0.0)
