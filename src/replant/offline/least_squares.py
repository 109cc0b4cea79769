"""Least squares on regressors, scaled and rank-revealing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.statistics.linear_algebra import least_norm, quiet

RANK_TOLERANCE = 1e-10
"""Singular value of the scaled regressor below which it counts as zero [part of the largest].
Derivation: some hundred thousand times the precision of float64.
"""


@dataclass(frozen=True, eq=False)
class Solution:
    """The solution of a least-squares problem.

    Attributes
    ----------
    parameters : (P,) array
        If the data do not determine all of them, the solution of least norm in scaled parameters.
    rank : int
        How many directions the data determine, at most P.
    condition : float
        Of the scaled regressors: largest over smallest singular value.
    """

    parameters: FloatArray
    rank: int
    condition: float


@quiet
def least_squares(phi: FloatArray, target: FloatArray) -> Solution:
    """Minimise ||target - phi theta|| over the rows that are finite; phi (K, P), target (K,).

    Examples
    --------
    >>> least_squares(np.array([[1.0, 0.0], [0.0, 2.0], [1.0, 2.0]]), np.array([1.0, 4.0, 5.0])).parameters
    array([1., 2.])
    """
    kept = np.isfinite(target) & np.isfinite(phi).all(axis=1)
    phi, target = phi[kept], target[kept]
    if phi.shape[0] == 0:
        return Solution(np.zeros(phi.shape[1]), 0, np.inf)
    lengths = np.abs(phi).max(axis=0)
    lengths[lengths == 0.0] = 1.0
    lengths *= np.linalg.norm(phi / lengths, axis=0)
    lengths[lengths == 0.0] = 1.0
    scaled, rank, singular = least_norm(phi / lengths, target, RANK_TOLERANCE)
    condition = float(singular[0] / singular[-1]) if singular.size == phi.shape[1] and singular[-1] > 0 else np.inf
    return Solution(scaled / lengths, rank, condition)
