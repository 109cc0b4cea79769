"""U-D factors of a covariance, P = U D U', from an information matrix or from a covariance.

Source: Bierman (1977), "Factorization Methods for Discrete Sequential Estimation", chapter 3.
"""

from __future__ import annotations

import contextlib

import numpy as np

from replant.arguments import FloatArray
from replant.statistics.linear_algebra import quiet

LEAST_PIVOT = 1e-13
"""Floor of a pivot of the equilibrated information: a direction that the data do not determine gets a large, finite
variance [part of the diagonal].
Derivation: some hundred times the precision of float64.
"""


@quiet
def factor_information(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return U (T, T), unit upper triangular, and D (T,) with U D U' = information^-1.

    The information matrix (T, T) is equilibrated, so that the units of the parameters do not matter, and factored by
    Cholesky's L D L'.  A direction that the data do not determine has a pivot that is rounding error: the pivot is
    floored, and the entries below it, rounding errors as well, are taken as zero.  The direction then has a large,
    finite variance.  The factors are not finite where the information is not.

    Examples
    --------
    >>> upper, diagonal = factor_information(np.array([[2.0, 1.0], [1.0, 2.0]]))
    >>> np.allclose((upper * diagonal) @ upper.T, np.linalg.inv([[2.0, 1.0], [1.0, 2.0]]))
    True
    """
    size = information.shape[0]
    scale = np.sqrt(np.maximum(np.diag(information), 0.0))
    scale[~(scale > 0.0)] = 1.0
    rest = information / np.outer(scale, scale)
    lower, pivots = np.eye(size), np.empty(size)
    for j in range(size):
        pivots[j] = np.maximum(rest[j, j], LEAST_PIVOT)
        if rest[j, j] <= LEAST_PIVOT:
            continue
        lower[j + 1 :, j] = rest[j + 1 :, j] / pivots[j]
        rest = rest - pivots[j] * np.outer(lower[:, j], lower[:, j]) * (np.arange(size) > j)[:, None]
    # S = C L V L' C  =>  S^-1 = C^-1 L'^-1 V^-1 L^-1 C^-1 = U D U' with U = C^-1 L'^-1 C
    inverse = _inverse(lower, determined=bool((pivots > LEAST_PIVOT).all()))
    upper = np.triu(inverse.T / scale[:, None] * scale[None, :])
    np.fill_diagonal(upper, 1.0)
    return upper, 1.0 / (pivots * scale**2)


def _inverse(lower: FloatArray, *, determined: bool) -> FloatArray:
    """Return the inverse of a unit lower triangular matrix (T, T).

    Forward substitution always succeeds.  Where the data determine every direction the general solver is taken: it
    keeps the bits of earlier versions.
    """
    if determined:
        with contextlib.suppress(np.linalg.LinAlgError):
            return np.asarray(np.linalg.inv(lower), np.float64)
    inverse = np.eye(len(lower))
    for i in range(1, len(lower)):
        inverse[i, :i] = -lower[i, :i] @ inverse[:i, :i]
    return inverse


@quiet
def compose(upper: FloatArray, diagonal: FloatArray) -> FloatArray:
    """Return U D U' (T, T) of U (T, T) and D (T,).

    Examples
    --------
    >>> compose(np.eye(2), np.array([1.0, 4.0]))
    array([[1., 0.],
           [0., 4.]])
    """
    return np.asarray((upper * diagonal) @ upper.T)


@quiet
def factor_covariance(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return U and D with U D U' = covariance (T, T).

    Examples
    --------
    >>> upper, diagonal = factor_covariance(np.array([[2.0, 1.0], [1.0, 2.0]]))
    >>> np.allclose(compose(upper, diagonal), [[2.0, 1.0], [1.0, 2.0]])
    True
    """
    size = covariance.shape[0]
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    rest = covariance / np.outer(scale, scale)
    upper, diagonal = np.eye(size), np.empty(size)
    for j in reversed(range(size)):
        diagonal[j] = np.maximum(rest[j, j], LEAST_PIVOT)
        if rest[j, j] <= LEAST_PIVOT:
            continue
        upper[:j, j] = rest[:j, j] / diagonal[j]
        rest = rest - diagonal[j] * np.outer(upper[:, j], upper[:, j]) * (np.arange(size) < j)[:, None]
    return upper * scale[:, None] / scale[None, :], diagonal * scale**2


@quiet
def larger(coloured: FloatArray, white: FloatArray) -> FloatArray:
    """Return the covariance of an estimate under coloured noise, with at least the variances under white noise.

    Where the residual is white both agree; where they differ, the larger variance is the safe one.  A coloured variance
    of zero, relative to the white one, means that the autoregression explains the residual to rounding; the white
    covariance is then returned.
    """
    if not (np.diag(coloured) > np.finfo(float).eps * np.diag(white)).all():
        return white
    stretch = np.sqrt(np.maximum(np.diag(white) / np.diag(coloured), 1.0))
    return np.asarray(coloured * np.outer(stretch, stretch))
