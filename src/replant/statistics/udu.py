"""U-D factors of a covariance, P = U D U', from an information matrix or from a covariance.

Source: Bierman (1977), "Factorization Methods for Discrete Sequential Estimation", chapter 3.
"""

from __future__ import annotations

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
    """Return U (..., T, T), unit upper triangular, and D (..., T) with U D U' = information^-1.

    The information matrices (..., T, T) are equilibrated, so that the units of the parameters do not matter, and
    factored by Cholesky's L D L'.  A direction that the data do not determine has a pivot that is rounding error: the
    pivot is floored, and the entries below it, rounding errors as well, are taken as zero.  The direction then has a
    large, finite variance.  The factors are not finite where the information is not.

    Examples
    --------
    >>> upper, diagonal = factor_information(np.array([[2.0, 1.0], [1.0, 2.0]]))
    >>> np.allclose((upper * diagonal) @ upper.T, np.linalg.inv([[2.0, 1.0], [1.0, 2.0]]))
    True
    """
    size = information.shape[-1]
    scale = np.sqrt(np.maximum(np.diagonal(information, axis1=-2, axis2=-1), 0.0))
    scale[~(scale > 0.0)] = 1.0
    rest = information / (scale[..., :, None] * scale[..., None, :])
    lower, pivots = np.zeros_like(rest), np.empty_like(scale)
    lower[..., range(size), range(size)] = 1.0
    for j in range(size):
        pivot = np.maximum(rest[..., j, j, None], LEAST_PIVOT)
        column = np.where(rest[..., j, j, None] <= LEAST_PIVOT, 0.0, rest[..., j + 1 :, j] / pivot)
        rest[..., j + 1 :, j + 1 :] -= pivot[..., None] * (column[..., :, None] * column[..., None, :])
        lower[..., j + 1 :, j], pivots[..., j] = column, pivot[..., 0]
    # S = C L V L' C  =>  S^-1 = C^-1 L'^-1 V^-1 L^-1 C^-1 = U D U' with U = C^-1 L'^-1 C
    inverse = _inverse(lower)
    upper = np.triu(inverse.swapaxes(-2, -1) / scale[..., :, None] * scale[..., None, :])
    upper[..., range(size), range(size)] = 1.0
    return upper, 1.0 / (pivots * scale**2)


def _inverse(lower: FloatArray) -> FloatArray:
    """Return the inverses of unit lower triangular matrices (..., T, T), by forward substitution, which succeeds."""
    inverse = np.zeros_like(lower)
    for i in range(lower.shape[-1]):
        inverse[..., i, i] = 1.0
        inverse[..., i, :i] = -(lower[..., i, None, :i] @ inverse[..., :i, :i])[..., 0, :]
    return inverse


@quiet
def compose(upper: FloatArray, diagonal: FloatArray) -> FloatArray:
    """Return U D U' (..., T, T) of U (..., T, T) and D (..., T).

    Examples
    --------
    >>> compose(np.eye(2), np.array([1.0, 4.0]))
    array([[1., 0.],
           [0., 4.]])
    """
    return np.asarray((upper * diagonal[..., None, :]) @ upper.swapaxes(-2, -1))


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
