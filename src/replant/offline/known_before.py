r"""What is known before a change: a model with the information about it, and the noise that its residual had.

A supposition of what has changed forgets some directions V of the information M:

.. math:: M_0(V) = M - M V (V^T M V)^{-1} V^T M.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.model.structure import Structure
from replant.offline.prior import Prior
from replant.offline.residual_likelihood import WEAKEST
from replant.offline.srivc_steps import Problem
from replant.statistics.autoregression import LEAST, Autoregression, sums_of
from replant.statistics.linear_algebra import least_norm, quiet

UNTOLD = 4.0
"""Residual beyond which a sample is not what the model tells [standard deviations].
Level: a normal deviate beyond 4 has the chance 6e-5.
"""


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
    filters: bool = True

    @classmethod
    @quiet
    def before(
        cls,
        structure: Structure,
        record: Record,
        begin: int,
        mean: FloatArray,
        information: FloatArray,
        usual: float,
        *,
        filters: bool = True,
    ) -> Known | None:
        """Return what a model and the information about it tell before a sample of a record; None where they do not.

        Parameters
        ----------
        structure : Structure
        record : Record
        begin : int
            The samples before it tell offset, state and noise.
        mean : (T,) array
        information : (T, T) array
        usual : float
            Variance of the residual, where too few samples are before to tell it.
        filters : bool
            Whether estimates are filtered by the noise model.
        """
        problem = Problem(structure, record)
        first = record.first(begin)
        told = first.count > LEAST + mean.size
        if not (problem.is_usable(mean) and np.isfinite(information).all()):
            return None
        model = with_nuisances(structure, record, mean, slice(0, begin) if told else slice(None))
        error = problem.run_whole(model).ahead
        if not np.isfinite(error).all():
            return None
        if not told:
            return cls(mean, information, error, Autoregression.white(usual, 1.0), usual, filters)
        sums, count = sums_of(error[:begin], first.rough_predecessors)
        noise = Autoregression.white(float(error[:begin] @ error[:begin]), first.count)
        if count >= LEAST and np.isfinite(sums).all() and noise.power > 0.0:
            noise = Autoregression.of_sums(sums, count)
        white = noise.whiten_known(error[:begin], first.rough_predecessors)
        return cls(mean, information, error, noise, float(white @ white) / (first.count - mean.size), filters)

    def onset(self, record: Record, earliest: int) -> int:
        """Return the first sample, from ``earliest`` on, that is not what the model tells; ``earliest`` without one."""
        white = self.noise.whiten_known(self.error[earliest:], record.rough_predecessors[earliest:])
        untold = np.flatnonzero(np.abs(white) > UNTOLD * math.sqrt(self.variance))
        return earliest + int(untold[0]) if untold.size else earliest

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
