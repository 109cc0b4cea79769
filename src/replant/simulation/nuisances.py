"""Nuisances: the offset and the initial state that explain most of what a model leaves, by least squares.

Of any number of samples a small triangle is kept, R of the QR decomposition of the nuisances beside what is left.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from replant.arguments import FloatArray
from replant.statistics.linear_algebra import least_norm, quiet

RANK_TOLERANCE = 1e-12
"""Singular value of the scaled nuisances below which it counts as zero [part of the largest].
Derivation: some thousand times the precision of float64.
"""

ROWS = 1 << 12
"""Samples that are taken into a triangle together: few enough for a cache, and for BLAS to start no threads [samples].
"""


@quiet
def triangle_of(*columns: FloatArray) -> FloatArray:
    """Return R (at most C, C) of columns side by side, each (K,) or (K, c), C together; rows with a NaN are left out.

    Examples
    --------
    >>> np.abs(triangle_of(np.ones(4), np.array([1.0, 3.0, np.nan, 5.0]))).round(4)
    array([[1.7321, 5.1962],
           [0.    , 2.8284]])
    """
    triangle = np.zeros((0, sum(each.shape[1] if each.ndim > 1 else 1 for each in columns)))
    for begin in range(0, len(columns[0]), ROWS):
        block = np.column_stack([each[begin : begin + ROWS] for each in columns])
        known = np.isfinite(block).all(axis=1)
        stacked = np.vstack([triangle, block if known.all() else block[known]])
        triangle = np.asarray(np.linalg.qr(stacked, mode="r"))
    return triangle


@quiet
def weights_of(triangle: FloatArray) -> FloatArray:
    """Return the weights (C - 1,) of a triangle's columns that explain its last one best.

    Of weights that explain it equally well those are taken whose scaled columns are shortest together; zeros where
    there is no solution.

    Examples
    --------
    >>> weights_of(triangle_of(np.ones(3), np.array([1.0, 3.0, 5.0]))).round(9)
    array([3.])
    """
    columns = triangle[:, :-1]
    lengths = _lengths(columns)
    # the columns are scaled: the sizes of a response that dies out and of one that grows differ by many decades
    return least_norm(columns / lengths, triangle[:, -1], RANK_TOLERANCE)[0] / lengths


@quiet
def common_offset(triangles: Sequence[FloatArray]) -> float:
    """Return the offset that, together with a state of each part of its own, explains what a model leaves of the parts.

    It is 0 where the states alone explain it as well, as those of an integrator do.
    """
    size = power = product = 0.0
    for triangle in triangles:
        own, rest = triangle[:, :-2], triangle[:, -2:]
        if not np.isfinite(triangle).all():
            continue
        left, values, _ = np.linalg.svd(own / _lengths(own), full_matrices=False)
        basis = left[:, values > RANK_TOLERANCE * values.max(initial=0.0)]
        for _ in range(2):  # once more, for what rounding left
            rest = rest - basis @ (basis.T @ rest)
        size += float(triangle[:, -2] @ triangle[:, -2])
        power, product = power + float(rest[:, 0] @ rest[:, 0]), product + float(rest[:, 0] @ rest[:, 1])
    return product / power if power > RANK_TOLERANCE**2 * size else 0.0


def _lengths(columns: FloatArray) -> FloatArray:
    """Return the length of each column (C,), 1 of one that is zero."""
    lengths = np.linalg.norm(columns, axis=0)
    return np.where(lengths == 0.0, 1.0, lengths)
