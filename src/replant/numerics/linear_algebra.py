"""Linear algebra that neither raises nor warns, U-D factors of a covariance, quantiles of chi-square.

A record may be constant, of size 1e300, or explained by half of the requested poles.  Then its matrices are singular,
its sums overflow, or an iteration does not converge.  The caller takes this as "no model".

Sums over samples are formed in blocks too small for BLAS to start threads: on a busy machine threads wait for each
other a thousand times longer than the work takes.

Source: Bierman (1977), "Factorization Methods for Discrete Sequential Estimation", chapter 3.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from replant.numerics.arguments import FloatArray, IntArray

SMALL = 1 << 17  # most multiplications of a matrix product in one thread [count]
SMALL_VECTOR = 1 << 13  # the same for a matrix and a vector, and for two vectors [count]
ROWS = 1 << 11  # samples factored at once: so many of a few columns stay in one thread [samples]

# 4 MB: the signals of a search in 30,000 samples with models of four poles
KEPT = 1 << 19  # size of an array up to which its memory is kept [numbers]

NO_EDGES = np.zeros(0, np.int64)

_own = threading.local()

Array = TypeVar("Array", FloatArray, npt.NDArray[np.complex128])

#: Silences NumPy's warnings around computations whose results are checked for being finite afterwards.
quiet = np.errstate(over="ignore", divide="ignore", invalid="ignore")


def sums_of_products(columns: FloatArray, edges: IntArray = NO_EDGES) -> FloatArray:
    """Return X' X (E + 1, P, P) of the rows X of columns (K, P) before, between and after E ascending edges."""
    from replant.kernels.filters import sums

    size = columns.shape[1]
    found, width = np.empty((edges.size + 1, size, size)), sums.WIDTH
    sums.products(columns, edges, found, np.empty((size, width)), np.empty((size * size, width)))
    return found


def products(a: Array, b: Array) -> Array:
    """Return a' b of columns a (K, P) and columns b (K, Q) or a signal b (K,)."""
    rows = _rows(a.shape[1], b[:1].size)
    if len(a) <= rows:
        return a.T @ b
    total = a[:rows].T @ b[:rows]
    for begin in range(rows, len(a), rows):
        total += a[begin : begin + rows].T @ b[begin : begin + rows]
    return total


def combined(columns: FloatArray, weights: FloatArray) -> FloatArray:
    """Return columns (K, P) times weights (P, Q), or (P,)."""
    rows = _rows(columns.shape[1], weights[:1].size)
    if len(columns) <= rows:
        return np.asarray(columns @ weights)
    found = np.empty((len(columns), *weights.shape[1:]))
    for begin in range(0, len(columns), rows):
        np.matmul(columns[begin : begin + rows], weights, out=found[begin : begin + rows])
    return found


def _rows(one: int, other: int) -> int:
    """Return how many rows of a product with so many columns stay in one thread."""
    return max((SMALL if min(one, other) > 1 else SMALL_VECTOR) // max(one * other, 1), 1)


def inner(a: FloatArray, b: FloatArray) -> float:
    """Return the inner product of two signals (K,)."""
    return float(np.einsum("k,k->", a, b))


def sum_of_squares(signal: FloatArray) -> float:
    """Return the sum of squares of a signal (K,)."""
    return inner(signal, signal)


@quiet
def roots(polynomial: FloatArray) -> npt.NDArray[np.complex128]:
    """Return the roots of a polynomial in descending powers; NaN if they overflow."""
    try:
        if polynomial.size < 2 or polynomial[0] == 0.0 or polynomial[-1] == 0.0:
            return np.roots(polynomial).astype(np.complex128)
        if polynomial.size == 2:
            root = -polynomial[1] / polynomial[0]
            return np.array([root if np.isfinite(root) else complex(np.nan, np.nan)], np.complex128)
        companion = np.eye(polynomial.size - 1, k=-1)  # as np.roots, without its search for zeros at both ends
        companion[0] = -polynomial[1:] / polynomial[0]
        return np.linalg.eigvals(companion).astype(np.complex128)
    except np.linalg.LinAlgError:
        return np.full(np.trim_zeros(polynomial, "f").size - 1, complex(np.nan, np.nan))


@lru_cache(maxsize=64)  # the steps of a row ask for those of one model up to four times
def poles_of(denominator: bytes) -> npt.NDArray[np.complex128]:
    """Return the roots of s^n + a' (s^(n-1) .. 1), not to be changed, by the bytes of a (n,)."""
    poles = roots(np.append(1.0, np.frombuffer(denominator)))
    poles.flags.writeable = False
    return poles


@quiet
def real_coefficients(denominator: FloatArray, least: float) -> FloatArray:
    """Return the coefficients (n,) of prod(s + abs(pole)): a scale for those of the denominator."""
    magnitudes = np.abs(roots(np.concatenate([[1.0], denominator])))
    return np.asarray(np.poly(-np.maximum(magnitudes, least))[1:])


@quiet
def eigenvalues(symmetric: FloatArray) -> FloatArray:
    """Return the eigenvalues (T,) of a symmetric matrix (T, T), ascending; NaN if the matrix is not finite."""
    if not np.isfinite(symmetric).all():
        return np.full(len(symmetric), np.nan)
    try:
        return np.asarray(np.linalg.eigvalsh(symmetric))
    except np.linalg.LinAlgError:
        return np.full(len(symmetric), np.nan)


@quiet
def solve(matrix: FloatArray, right: FloatArray) -> FloatArray | None:
    """Return the solution (T,), after equilibration of rows and columns; None if singular or not finite."""
    size = _units(matrix)
    scaled = matrix / np.outer(size, size)
    if not (np.isfinite(scaled).all() and np.isfinite(right).all()):
        return None
    try:
        solution = np.linalg.solve(scaled, right / size)
    except np.linalg.LinAlgError:
        return None
    result = np.asarray(solution / size)
    return result if np.isfinite(result).all() else None


@quiet
def least_norm(columns: FloatArray, target: FloatArray, tolerance: float) -> tuple[FloatArray, int, FloatArray]:
    """Return the least-squares solution of least norm (P,), rank and singular values; zeros if there is none."""
    nothing = np.zeros(columns.shape[1]), 0, np.zeros(0)
    if not (np.isfinite(columns).all() and np.isfinite(target).all()):
        return nothing
    try:
        found, _, rank, singular = np.linalg.lstsq(*_folded(columns, target), rcond=tolerance)
    except np.linalg.LinAlgError:
        return nothing
    if not np.isfinite(found).all():
        return nothing
    return np.asarray(found, np.float64), int(rank), np.asarray(singular, np.float64)


def _folded(columns: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return fewer equations with the same least-squares solution: the stacked triangles of blocks of rows."""
    while len(columns) > max(ROWS, 4 * (columns.shape[1] + 1)):
        both = np.column_stack([columns, target])
        both = np.concatenate([np.linalg.qr(both[k : k + ROWS], mode="r") for k in range(0, len(both), ROWS)])
        columns, target = both[:, : columns.shape[1]], both[:, columns.shape[1] :].reshape(len(both), *target.shape[1:])
    return columns, target


@quiet
def pseudo_inverse(symmetric: FloatArray, tolerance: float) -> FloatArray:
    """Return the pseudo-inverse of a symmetric matrix (T, T); NaN if it is not finite."""
    if np.isfinite(symmetric).all():
        try:
            return np.asarray(np.linalg.pinv(symmetric, rcond=tolerance, hermitian=True))
        except np.linalg.LinAlgError:
            pass
    return np.full_like(symmetric, np.nan)


@quiet
def inverse_of(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a square matrix (T, T), after equilibration of rows and columns; NaN if singular."""
    scales = np.outer(_units(matrix), _units(matrix))
    try:
        return np.asarray(np.linalg.inv(matrix / scales) / scales)
    except np.linalg.LinAlgError:
        return np.full_like(matrix, np.nan)


def _units(matrices: FloatArray) -> FloatArray:
    """Return the square roots (..., T) of the absolute diagonals, as units of rows and columns; 1 for zero."""
    units = np.sqrt(np.abs(np.diagonal(matrices, axis1=-2, axis2=-1)))
    return np.where(units > 0.0, units, 1.0)


LEAST_PIVOT = 1e-13  # floor of a pivot of the equilibrated information: some hundred roundings [part of the diagonal]


@quiet
def factor_information(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return U (..., T, T), unit upper triangular, and D (..., T) with U D U' = information^-1.

    The matrix is equilibrated, so that the units of the parameters do not matter.  A direction that the data do not
    determine gets a large, finite variance.  The result is not finite if the information is not.
    """
    scale = np.sqrt(np.maximum(np.diagonal(information, axis1=-2, axis2=-1), 0.0))
    scale[~(scale > 0.0)] = 1.0
    lower, pivots = _cholesky(information / (scale[..., :, None] * scale[..., None, :]))
    # S = C L V L' C  =>  S^-1 = C^-1 L'^-1 V^-1 L^-1 C^-1 = U D U' with U = C^-1 L'^-1 C
    inverse, diagonal = _inverse(lower), range(scale.shape[-1])
    upper = np.triu(inverse.swapaxes(-2, -1) / scale[..., :, None] * scale[..., None, :])
    upper[..., diagonal, diagonal] = 1.0
    return upper, 1.0 / (pivots * scale**2)


def _cholesky(rest: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return L (..., T, T), unit lower triangular, and D (..., T) with L D L' = an equilibrated matrix, overwritten.

    The pivot of an undetermined direction is rounding error: it is floored, and the entries below it, also rounding
    errors, are set to zero.
    """
    size = rest.shape[-1]
    lower, pivots = np.zeros_like(rest), np.empty(rest.shape[:-1])
    lower[..., range(size), range(size)] = 1.0
    for j in range(size):
        pivot = np.maximum(rest[..., j, j, None], LEAST_PIVOT)
        column = np.where(rest[..., j, j, None] <= LEAST_PIVOT, 0.0, rest[..., j + 1 :, j] / pivot)
        rest[..., j + 1 :, j + 1 :] -= pivot[..., None] * (column[..., :, None] * column[..., None, :])
        lower[..., j + 1 :, j], pivots[..., j] = column, pivot[..., 0]
    return lower, pivots


def _inverse(lower: FloatArray) -> FloatArray:
    """Return the inverses of unit lower triangular matrices (..., T, T) by forward substitution."""
    inverse = np.zeros_like(lower)
    for i in range(lower.shape[-1]):
        inverse[..., i, i] = 1.0
        inverse[..., i, :i] = -(lower[..., i, None, :i] @ inverse[..., :i, :i])[..., 0, :]
    return inverse


@quiet
def compose(upper: FloatArray, diagonal: FloatArray) -> FloatArray:
    """Return U D U' (..., T, T) of U (..., T, T) and D (..., T)."""
    return np.asarray((upper * diagonal[..., None, :]) @ upper.swapaxes(-2, -1))


@quiet
def factor_covariance(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return U and D with U D U' = covariance (T, T)."""
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    # U D U' is L D L' of the matrix with its rows and columns in reverse order
    lower, pivots = _cholesky((covariance / np.outer(scale, scale))[::-1, ::-1])
    upper = np.ascontiguousarray(lower[::-1, ::-1])
    return upper * scale[:, None] / scale[None, :], pivots[::-1] * scale**2


@quiet
def larger(coloured: FloatArray, white: FloatArray) -> FloatArray:
    """Return a coloured covariance with at least the variances under white noise; the white one if one vanishes."""
    if not (np.diag(coloured) > np.finfo(float).eps * np.diag(white)).all():
        return white
    stretch = np.sqrt(np.maximum(np.diag(white) / np.diag(coloured), 1.0))
    return np.asarray(coloured * np.outer(stretch, stretch))


def without_rounding(covariance: FloatArray) -> FloatArray:
    """Return a covariance freed from rounding errors: symmetric, with no correlation beyond one."""
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    bound = np.outer(spread, spread)
    return np.asarray(np.clip(0.5 * (covariance + covariance.T), -bound, bound))


def chi2_quantile(probability: float, degrees: int) -> float:
    r"""Return the quantile x of chi-square, :math:`P(\nu / 2, x / 2) = p`, at this ``probability`` p."""
    from scipy.special import gammaincinv

    return 2.0 * float(gammaincinv(degrees / 2.0, probability))


@contextmanager
def borrowed(rows: int, columns: int) -> Iterator[FloatArray]:
    """Lend an array (rows, columns) of any content; a nested call, as in a signal handler, gets another one."""
    # the system clears new memory page by page: in a search in 30,000 samples this takes as long as the search itself,
    # so each thread keeps its memory
    size = rows * columns
    room = vars(_own).pop("room", None)
    if room is None or room.size < size:
        room = np.empty(size)
    try:
        yield room[:size].reshape(rows, columns)
    finally:
        if room.size <= KEPT:
            _own.room = room
