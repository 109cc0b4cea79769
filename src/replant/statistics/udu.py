"""The covariance in factors: P = U D U', from an information matrix or from a diagonal."""

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

    By Cholesky's L D L' of the equilibrated matrix, so that the units of the parameters do not matter.  A direction
    that the data do not tell has a pivot of rounding alone: it is floored, and what stands below it is taken for zero,
    rounding as well.  Not finite where the information is not.

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
    inverse = _inverse(lower, told=bool((pivots > LEAST_PIVOT).all()))
    upper = np.triu(inverse.T / scale[:, None] * scale[None, :])
    np.fill_diagonal(upper, 1.0)
    return upper, 1.0 / (pivots * scale**2)


def _inverse(lower: FloatArray, *, told: bool) -> FloatArray:
    """Return the inverse of a unit lower triangular matrix (T, T).

    Solved row by row it always has one.  Where the data tell every direction the general solver, which pivots, has no
    trouble either, and its bits are those that estimates have had so far.
    """
    if told:
        with contextlib.suppress(np.linalg.LinAlgError):
            return np.asarray(np.linalg.inv(lower), np.float64)
    inverse = np.eye(len(lower))
    for i in range(1, len(lower)):
        inverse[i, :i] = -lower[i, :i] @ inverse[:i, :i]
    return inverse


@quiet
def compose(upper: FloatArray, diagonal: FloatArray) -> FloatArray:
    """Return U D U'.

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
    """Return the first covariance, stretched where its variances are below the second's.

    Where the residual is white both agree; where they do not, the larger one is the honest one.
    """
    if not (np.diag(coloured) > np.finfo(float).eps * np.diag(white)).all():
        return white  # a colour that explains the residual to rounding is none
    stretch = np.sqrt(np.maximum(np.diag(white) / np.diag(coloured), 1.0))
    return np.asarray(coloured * np.outer(stretch, stretch))
