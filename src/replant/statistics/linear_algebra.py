"""Linear algebra that neither raises nor warns: a problem without a solution gives NaN or None.

A record may be constant, of size 1e300, or explained by half of the poles asked for.  Its matrices are then singular,
its sums leave float64, or an iteration does not converge.  The caller takes this as "no model".
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from replant.arguments import FloatArray

#: Silences NumPy's warnings around computations whose results are checked for being finite afterwards.
quiet = np.errstate(over="ignore", divide="ignore", invalid="ignore")


@quiet
def roots(polynomial: FloatArray) -> npt.NDArray[np.complex128]:
    """Return the roots of a polynomial in descending powers; NaN where they leave float64.

    Examples
    --------
    >>> roots(np.array([1.0, 3.0, 2.0])).real, roots(np.array([1e-300, 1e300]))
    (array([-2., -1.]), array([nan+nanj]))
    """
    try:
        return np.roots(polynomial).astype(np.complex128)
    except np.linalg.LinAlgError:
        return np.full(np.trim_zeros(polynomial, "f").size - 1, complex(np.nan, np.nan))


@quiet
def real_coefficients(denominator: FloatArray, least: float) -> FloatArray:
    """Return the coefficients (n,) of prod(s + abs(pole)).

    It is the size that those of the denominator would have if all poles were real.

    >>> real_coefficients(np.array([0.2, 4.0]), 0.1).round(9)
    array([4., 4.])
    """
    magnitudes = np.abs(roots(np.concatenate([[1.0], denominator])))
    return np.asarray(np.poly(-np.maximum(magnitudes, least))[1:])


@quiet
def eigenvalues(symmetric: FloatArray) -> FloatArray:
    """Return the eigenvalues (T,) of a symmetric matrix (T, T), ascending; NaN where the matrix is not finite.

    Examples
    --------
    >>> eigenvalues(np.diag([2.0, 1.0])), eigenvalues(np.array([[np.inf]]))
    (array([1., 2.]), array([nan]))
    """
    if not np.isfinite(symmetric).all():
        return np.full(len(symmetric), np.nan)
    try:
        return np.asarray(np.linalg.eigvalsh(symmetric))
    except np.linalg.LinAlgError:
        return np.full(len(symmetric), np.nan)


@quiet
def solve(matrix: FloatArray, right: FloatArray) -> FloatArray | None:
    """Return the solution (T,) of ``matrix`` x = ``right``, rows and columns equilibrated; None where singular.

    None as well where the matrix (T, T), the right side (T,) or the solution is not finite.

    Examples
    --------
    >>> solve(np.array([[2.0, 0.0], [0.0, 4.0]]), np.array([1.0, 1.0])), solve(np.zeros((1, 1)), np.ones(1))
    (array([0.5 , 0.25]), None)
    """
    size = np.sqrt(np.abs(np.diag(matrix)))
    size[~(size > 0.0)] = 1.0
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
    """Return the least-squares solution of least norm (P,), the rank, and the singular values of the columns.

    Without a solution these are zeros, 0, and an empty array.

    >>> least_norm(np.array([[1.0, 1.0], [1.0, 1.0]]), np.array([2.0, 2.0]), 1e-12)[:2]
    (array([1., 1.]), 1)
    """
    nothing = np.zeros(columns.shape[1]), 0, np.zeros(0)
    if not (np.isfinite(columns).all() and np.isfinite(target).all()):
        return nothing
    try:
        found, _, rank, singular = np.linalg.lstsq(columns, target, rcond=tolerance)
    except np.linalg.LinAlgError:
        return nothing
    if not np.isfinite(found).all():
        return nothing
    return np.asarray(found, np.float64), int(rank), np.asarray(singular, np.float64)


@quiet
def pseudo_inverse(symmetric: FloatArray, tolerance: float) -> FloatArray:
    """Return the pseudo-inverse of a symmetric matrix; NaN where the matrix is not finite."""
    if np.isfinite(symmetric).all():
        try:
            return np.asarray(np.linalg.pinv(symmetric, rcond=tolerance, hermitian=True))
        except np.linalg.LinAlgError:
            pass
    return np.full_like(symmetric, np.nan)


@quiet
def inverse_of(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a square matrix (T, T) whose rows and columns have units of their own; NaN if singular.

    Examples
    --------
    >>> inverse_of(np.array([[2.0, 0.0], [0.0, 1e-9]]))
    array([[5.e-01, 0.e+00],
           [0.e+00, 1.e+09]])
    """
    size = np.sqrt(np.abs(np.diag(matrix)))
    size[~(size > 0.0)] = 1.0
    scales = np.outer(size, size)
    try:
        return np.asarray(np.linalg.inv(matrix / scales) / scales)
    except np.linalg.LinAlgError:
        return np.full_like(matrix, np.nan)
