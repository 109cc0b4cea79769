"""Discrete Laguerre functions of a signal: a few numbers that tell its past, for fast and slow plants alike."""

from __future__ import annotations

import math

import numpy as np

from replant.arguments import FloatArray
from replant.kernels.schema import LAGUERRE
from replant.statistics.projections import lengths_of, orthogonal, products

POLES = tuple((1.0 - np.geomspace(0.8, 0.01, 7)).tolist())
"""Poles that are tried: memories of 12 to 1200 samples [per sample].
Origin: seven from one end to the other are a factor of two apart in memory.
Sensitivity: not measured.
"""


def laguerre(r: FloatArray, pole: float) -> FloatArray:
    """Return the states (K, 12) of the functions with this pole, driven by r - mean r (K,).

    Examples
    --------
    >>> laguerre(np.array([1.0, -1.0]), 0.6)[:, :2].round(2)
    array([[ 0.8 , -0.48],
           [-0.32,  0.7 ]])
    """
    from replant.kernels.filters.series import all_pole

    model, states = np.array([1.0, -pole]), np.empty((LAGUERRE, r.size))
    states[0] = all_pole(model, math.sqrt(1.0 - pole * pole) * (r - r.mean())[None])[0]
    for i in range(1, LAGUERRE):
        before = states[i - 1]
        states[i] = all_pole(model, (np.concatenate([[0.0], before[:-1]]) - pole * before)[None])[0]
    return np.ascontiguousarray(states.T)


def best_pole(r: FloatArray, *signals: FloatArray) -> float:
    """Return the pole whose functions of r (K,) leave the least of the signals (K,) unexplained."""
    moved = [signal - signal.mean() for signal in signals]
    targets = np.column_stack([signal / lengths_of(signal[:, None]) for signal in moved])
    best, most = float(POLES[0]), -math.inf
    for pole in POLES:
        states = laguerre(r, pole)
        centred = states - states.mean(axis=0)
        amounts = orthogonal(products(centred, centred)).T @ products(centred, targets)
        explained = float(np.sum(amounts**2))
        if explained > most:
            best, most = float(pole), explained
    return best


def laguerre_states(r: FloatArray, *signals: FloatArray) -> FloatArray:
    """Return the states (K, 12), of the pole with which they leave the least of the signals (K,) unexplained."""
    return laguerre(r, best_pole(r, *signals))
