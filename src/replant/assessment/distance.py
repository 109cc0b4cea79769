r"""How far an estimate lies from where a record would put it: one Gauss-Newton step on the output error.

The step :math:`(\sum \zeta\zeta^T)^{-1} \sum \zeta e` is that of refined instrumental variables at the estimate, so it
is zero for an estimate made from the same record.  Its covariance takes the residual's colour into account.  It tells
an estimate that noise has biased, that is frozen while the plant changes, or that lags behind.

Source: Soderstrom and Stoica (1983), "Instrumental Variable Methods for System Identification", chapter 4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.simulation.model_run import ModelRun
from replant.statistics.autoregression import Autoregression
from replant.statistics.linear_algebra import pseudo_inverse
from replant.statistics.projections import (
    lengths_of,
    orthogonal,
    products,
    without,
)
from replant.statistics.udu import larger

RANK_TOLERANCE = 1e-14
"""Eigenvalue of the step's covariance below which a direction counts as not there [part of the largest].
Derivation: some fifty times the precision of float64.
"""


@dataclass(frozen=True)
class Distance:
    """How far an estimate lies from where a record would put it.

    Attributes
    ----------
    step : (n + m + 1,) array
        From the estimate to there, to first order.
    statistic : float
        Of the test whether that is chance, over its limit.
    covariance : (n + m + 1, n + m + 1) array
        Of an estimate from this record alone, the residual's colour taken into account.
    """

    step: FloatArray
    statistic: float
    covariance: FloatArray


def distance(run: ModelRun, rows: slice, false_alarm: float) -> Distance:
    """Return the Gauss-Newton step that a record asks of an estimate, and whether it is more than chance."""
    from scipy.stats import chi2

    nuisances = np.hstack([run.nuisances[rows], np.ones((len(run.error[rows]), 1))])
    zeta = without(run.zeta[rows], nuisances)
    error = without(run.error[rows, None], nuisances)[:, 0]
    lengths = lengths_of(zeta)
    zeta = zeta / lengths
    basis = orthogonal(products(zeta, zeta))
    inverse = basis @ basis.T
    step = inverse @ products(zeta, error[:, None])[:, 0]
    left = error - np.einsum("ij,j->i", zeta, step)
    noise = Autoregression.of(left)
    innovation, coloured = noise.whiten(left), noise.colour(zeta)
    variance = float(innovation @ innovation) / max(innovation.size - len(step), 1)
    covariance = variance * inverse @ products(coloured, coloured) @ inverse
    covariance = larger(covariance, float(np.mean(left**2)) * inverse)
    square = float(step @ pseudo_inverse(covariance, RANK_TOLERANCE) @ step)
    statistic = math.inf if math.isnan(square) else square / float(chi2.ppf(1.0 - false_alarm, len(step)))
    return Distance(step / lengths, statistic, covariance / np.outer(lengths, lengths))
