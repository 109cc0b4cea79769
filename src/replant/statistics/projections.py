"""Products of columns summed over the samples, and projections made from them.

The sums are formed in blocks that are too small for BLAS to start threads: on a busy machine threads wait for each
other many times longer than the work takes.
"""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.statistics.chi2 import chi2_quantile

SMALL = 1 << 17  # multiplications that stay in one thread [count]

TAKEN_AWAY = 1e-9
"""Length of a column, what others explain or a filter takes off it, below which only rounding is left [part of its
length before].
Derivation: some million times the precision of float64.
Sensitivity: halved or doubled, nothing changes on these records.
"""

WEAKEST = 1e-13
"""Eigenvalue of scaled sums below which a direction counts as not there [part of the largest].
Derivation: some hundred times the precision of float64.
"""

SHIFTS = 9
"""Shifts of a residual against columns, by which `widening` is measured [count].
Derivation: the median of nine is known to a fifth where there are a dozen columns.
"""

GOLDEN = 0.6180339887498949
"""Distance of two shifts, so that no period meets several of them [part of the record].
Derivation: the golden ratio.
"""


def products(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a' b (P, Q) of columns a (K, P) and b (K, Q).

    Examples
    --------
    >>> columns = np.arange(6.0).reshape(3, 2)
    >>> products(columns, columns)
    array([[20., 26.],
           [26., 35.]])
    """
    rows = max(16, SMALL // (a.shape[1] * b.shape[1]))
    total = np.zeros((a.shape[1], b.shape[1]))
    for begin in range(0, len(a), rows):
        total += a[begin : begin + rows].T @ b[begin : begin + rows]
    return total


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


def without(columns: FloatArray, nuisances: FloatArray) -> FloatArray:
    """Return columns (K, C) minus their least-squares projection onto the nuisances (K, N)."""
    nuisances = nuisances / lengths_of(nuisances)
    basis = orthogonal(products(nuisances, nuisances))
    weights = basis @ (basis.T @ products(nuisances, columns))
    return np.asarray(columns - np.einsum("ij,jk->ik", nuisances, weights))


def widening(basis: FloatArray, left: FloatArray) -> float:
    """Return by how much colour widens the part of a residual that unrelated columns explain; 1 where it is white.

    The part, over the residual's variance, is chi-square where the residual is white.  Where it is not quite, the part
    is compared with that of the same residual shifted against the columns, so far that they have nothing to do with
    each other: the median over `SHIFTS` shifts, over that of chi-square.

    >>> noise = np.random.default_rng(0).standard_normal((3, 5000))
    >>> slow = np.array([np.convolve(each, 0.95 ** np.arange(100))[:5000] for each in noise])
    >>> columns = np.linalg.qr(slow[:2].T)[0]
    >>> widening(columns, slow[2]) > 3.0
    True
    """
    if not basis.shape[1] or not left.any():
        return 1.0
    places = (np.arange(1, SHIFTS + 1) * GOLDEN % 1.0 * left.size).astype(int)
    parts = [float(np.sum(products(basis, np.roll(left, place)[:, None]) ** 2)) for place in places]
    usual = float(left @ left) / left.size * chi2_quantile(0.5, basis.shape[1])
    return max(1.0, float(np.median(parts)) / usual)
