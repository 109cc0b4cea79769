"""Projections on columns, among them Laguerre functions, by least squares, also generalised."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from replant.kernels.schema import LAGUERRE
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.linear_algebra import combined, least_norm, products, quiet

TAKEN_AWAY = 1e-9  # length of a column, something taken off, that is rounding: a million times it [part of it before]
LEFT = 1e-6  # length left of a column below which it cannot be told from known ones: the root of rounding [part of it]
WEAKEST = 1e-13  # eigenvalue of scaled sums of a direction that is not there: a hundred roundings [part of the largest]
STRETCHES = 16  # of the record, whose scores tell their scatter: of two columns and more to a quarter [count]
WIDER = 4.0  # scatter of the scores beyond which it is no chance [standard deviations]


def lengths_of(columns: FloatArray) -> FloatArray:
    """Return the Euclidean length of each column (P,); 1 for a zero column, so that columns can be divided by it."""
    lengths = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    return np.where(lengths > 0.0, lengths, 1.0)


def orthogonal(matrix: FloatArray) -> FloatArray:
    """Return T (P, R) with T' M T = 1 for a symmetric matrix M (P, P) of rank R; R is 0 where M is not finite."""
    if not np.isfinite(matrix).all():
        return np.zeros((len(matrix), 0))
    try:
        values, vectors = np.linalg.eigh(matrix)
    except np.linalg.LinAlgError:
        return np.zeros((len(matrix), 0))
    kept = values > WEAKEST * max(float(values[-1]), np.finfo(float).tiny)
    return np.asarray(vectors[:, kept] / np.sqrt(values[kept]))


class Equations(NamedTuple):
    """Normal equations M x = v, decomposed once for any damping."""

    values: FloatArray  # (R,), ascending: eigenvalues of M with a diagonal of ones
    vectors: FloatArray  # (P, R): its eigenvectors, in the units of x

    @classmethod
    def of(cls, matrix: FloatArray) -> Equations:
        """Decompose a symmetric matrix M (P, P); R is 0 where that fails."""
        lengths = np.sqrt(np.diag(matrix))
        units = np.where(lengths > 0.0, lengths, 1.0)
        scaled = matrix / np.outer(units, units)
        try:
            values, vectors = np.linalg.eigh(scaled if np.isfinite(scaled).all() else scaled[:0, :0])
        except np.linalg.LinAlgError:
            return cls(np.zeros(0), np.zeros((len(matrix), 0)))
        return cls(values, vectors / units[:, None] if values.size else np.zeros((len(matrix), 0)))

    @quiet
    def solved(self, vector: FloatArray, damping: float = 0.0) -> FloatArray:
        """Return x (P,) for v (P,), M plus a part of its diagonal; it does not move in undetermined directions."""
        values = self.values + damping
        weights = np.where(values > WEAKEST * values.max(initial=0.0), 1.0 / values, 0.0)
        return np.asarray(self.vectors @ (weights * (self.vectors.T @ vector)))


def without(columns: FloatArray, nuisances: FloatArray) -> FloatArray:
    """Return columns (K, C) minus their least-squares projection onto the nuisances (K, N)."""
    weights = weights_by(products(nuisances, nuisances), products(nuisances, columns))
    return np.asarray(columns - combined(nuisances, weights))


def weights_by(square: FloatArray, told: FloatArray) -> FloatArray:
    """Return the weights (N, ...) of columns that explain most, by the sums N'N (N, N) and N'x (N, ...)."""
    lengths = np.sqrt(np.diag(square))
    units = np.where(lengths > 0.0, lengths, 1.0)
    basis = orthogonal(square / np.outer(units, units)) / units[:, None]
    return np.asarray(basis @ (basis.T @ told))


def amounts_of(columns: FloatArray, signal: FloatArray, weakest: float = WEAKEST) -> FloatArray:
    """Return the amounts (P,) of columns (K, P), of any length, that explain most of a signal (K,)."""
    lengths = lengths_of(columns)
    return np.asarray(least_norm(columns / lengths, signal, weakest)[0] / lengths)


def widening(columns: FloatArray, rest: FloatArray, variance: float, basis: FloatArray | None = None) -> float:
    """Return by how much colour of a residual's rest (K,) widens its scores, what columns (K, R) explain of it.

    Of a white rest the squares of the scores of a stretch have the mean of those of the columns there, times its
    variance.  1 where more may be chance.  Columns (K, C) that are not orthonormal are made so by a basis (C, R).
    """
    count = columns.shape[1] if basis is None else basis.shape[1]
    if not (count and variance > 0.0):
        return 1.0
    parts = zip(np.array_split(columns, STRETCHES), np.array_split(rest, STRETCHES), strict=True)
    scores = np.array([products(part, left) for part, left in parts])
    scores = scores if basis is None else scores @ basis
    wider = float(np.sum(scores**2)) / (count * variance)
    chance = WIDER * math.sqrt(2.0 / (STRETCHES * count))
    return wider if wider > 1.0 + chance else 1.0


# seven from one end to the other are a factor of two apart in memory
POLES = tuple((1.0 - np.geomspace(0.8, 0.01, 7)).tolist())  # tried: memories of 12 to 1200 samples [per sample]


def laguerre(r: FloatArray, pole: float) -> FloatArray:
    """Return the states (K, 12) of the functions with this pole, driven by r - mean r (K,)."""
    from replant.kernels.filters.autoregressions import all_pole

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

    def explained(pole: float) -> float:
        states = laguerre(r, pole)
        centred = states - states.mean(axis=0)
        amounts = orthogonal(products(centred, centred)).T @ products(centred, targets)
        return float(np.sum(amounts**2))

    return float(max(POLES, key=explained))


SWEEPS = 2
"""Times that the weights are found again with the colour of what is left [count].
Origin: the colour of what the first weights leave is nearly right; more change nothing on the benchmarks.
Sensitivity: halved or doubled, nothing changes on these records.
"""

DEPENDENT = 1e-10  # singular value of functions that depend on each other: rounding [part of the largest]


def weights_of(functions: FloatArray, signal: FloatArray) -> FloatArray:
    """Return the weights (L,) of functions (K, L) that make a signal (K,), whatever the colour of what is left."""
    weights = amounts_of(functions, signal, DEPENDENT)
    for _ in range(SWEEPS):
        colour = Autoregression.of(signal - combined(functions, weights))
        if colour.order == 0:
            break
        weights = amounts_of(colour.whiten(functions), colour.whiten(signal), DEPENDENT)
    return weights


def explained_power(functions: FloatArray, signal: FloatArray) -> float:
    """Return the variance of what functions (K, L) explain of a signal (K,), less what they explain by chance."""
    # the weights have the covariance C = variance of the innovation times (F' F)^-1 of the whitened functions F: by
    # chance functions f explain the trace of C times the covariance of f
    part = combined(functions, weights_of(functions, signal))
    noise = Autoregression.of(signal - part)
    white = noise.whiten(signal - part)
    filtered = noise.whiten(functions)
    spread = combined(functions - functions.mean(axis=0), orthogonal(products(filtered, filtered)))
    chance = float(np.mean(white**2)) * float(np.sum(spread**2)) / len(spread)
    return max(float(part.var()) - chance, 0.0)
