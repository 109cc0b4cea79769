r"""What is known before a change: a model with the information about it, and the noise that its residual had.

A supposition of what has changed forgets some directions V of the information M:

.. math:: M_0(V) = M - M V (V^T M V)^{-1} V^T M.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.model.structure import Structure
from replant.offline.prior import Prior
from replant.offline.refined import Refined
from replant.offline.residual_likelihood import WEAKEST, Stretch
from replant.offline.srivc_steps import Problem
from replant.statistics.autoregression import Autoregression
from replant.statistics.linear_algebra import inverse_of, least_norm, quiet


@dataclass(frozen=True, eq=False)
class Known:
    """What is known before a change.

    Attributes
    ----------
    mean : (T,) array
        The model.
    information : (T, T) array
        Of its coefficients; zero for the nuisances.
    error : (K,) array
        Of the model over a record, offset and initial state those of the samples before the change.
    noise : Autoregression
        D(q) of the error before.
    variance : float
        Of that error filtered by it, in the output's unit squared.
    filters : bool
        Whether estimates are filtered by it.
    """

    mean: FloatArray
    information: FloatArray
    error: FloatArray
    noise: Autoregression
    variance: float
    filters: bool

    @classmethod
    @quiet
    def before(cls, structure: Structure, record: Record, begin: int, found: Refined) -> Known | None:
        """Return what the estimate of the samples before one tells; None where it leaves float64."""
        size, information = structure.coefficients, np.zeros((found.theta.size, found.theta.size))
        information[:size, :size] = inverse_of(found.covariance[:size, :size])
        model = with_nuisances(structure, record, found.theta, slice(0, begin))
        error, first = Problem(structure, record).run_whole(model).ahead, record.first(begin)
        if not (np.isfinite(information).all() and np.isfinite(error).all()):
            return None
        noise = Stretch.of(first, slice(None)).colour(error[:begin])
        white = noise.whiten_known(error[:begin], first.rough_predecessors)
        variance = float(white @ white) / max(first.count - model.size, 1)
        return cls(found.theta, information, error, noise, variance, found.noise.filters > 0.0)

    def without(self, directions: FloatArray) -> Prior:
        """Return the prior in which directions (T, Q) are forgotten."""
        return Prior(self.mean, forget(self.information, directions), max(self.variance, np.finfo(float).tiny))


def with_nuisances(structure: Structure, record: Record, model: FloatArray, rows: slice = slice(None)) -> FloatArray:
    """Return a model (T,) with the offset and the initial state that rows of a record tell."""
    model, size = model.copy(), structure.coefficients
    model[size:] = 0.0
    done = Problem(structure, record).run_whole(model)
    model[size:] = least_norm(done.phi[rows, size:], done.error[rows], WEAKEST)[0]
    return model


@quiet
def forget(information: FloatArray, directions: FloatArray) -> FloatArray:
    """Return an information matrix (T, T) in which directions (T, Q) are forgotten.

    Examples
    --------
    >>> forget(np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([[1.0], [0.0]]))
    array([[0. , 0. ],
           [0. , 1.5]])
    """
    if directions.shape[1] == 0:
        return information
    along = information @ directions
    inside = np.linalg.pinv(directions.T @ along, rcond=WEAKEST, hermitian=True)
    return np.asarray(information - along @ inside @ along.T)
