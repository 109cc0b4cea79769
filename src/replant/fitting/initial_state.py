r"""Whether the free initial state of a record takes a part of the response to its input.

A step test with few samples before the step tells initial state and gain by nearly the same samples: its gain is known
ten times less well than if the record is known to begin at rest.  If it does begin at rest, the gain from rest,
:math:`g_r`, is efficient, and the free one, :math:`g_f`, differs by chance alone (Hausman):

.. math:: (g_f - g_r)^2 / (\sigma_f^2 - \sigma_r^2) \sim \chi^2_1

A record is taken to begin at rest where the output neither rises nor falls before the input moves, and where the model
from rest is trusted.

Source: Hausman (1978), "Specification tests in econometrics", Econometrica 46.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.solver.refined_estimate import without_nuisances
from replant.estimation.solver.srivc import refine
from replant.estimation.solver.srivc_steps import Problem
from replant.logs.conditioning import outputs_from_rest
from replant.model.structure import Structure
from replant.model.uncertainty import Uncertainty, dc_gain_slope
from replant.numerics.arguments import FloatArray
from replant.numerics.linear_algebra import chi2_quantile, inner, products, pseudo_inverse, quiet, sum_of_squares
from replant.numerics.projections import WEAKEST
from replant.verdict import assess_record

# that of the intervals that are stated, within which the gain from rest is to lie
LEVEL = 0.05  # chance to ask in vain where the record begins at rest [probability]

# where it takes less, the gain from rest is hardly better known, and the test says nothing
SHARE = 0.5  # of what the record tells of the gain, what the initial state takes where that is looked into [part]


@quiet
def gain_from_rest(structure: Structure, theta: FloatArray, covariance: FloatArray, record: Record) -> float | None:
    """Return the gain of the model from rest, where it is likelier than that of a model (P,); None where it is not."""
    if len(record.parts) > 1 or record.r is not None or not _rests(record):
        return None
    if not _is_taken(structure, theta, record):
        return None
    longer = _from_rest(record)
    found = None if longer is None else refine(structure, longer, [without_nuisances(structure, theta)])
    if longer is None or found is None:
        return None
    size = structure.size
    known = found.covariance[:size, :size]
    if assess_record(structure, found.theta[:size], longer, record.dt, known).status != "trusted":
        return None
    free, at_rest = (structure.transfer_function(each).dc_gain for each in (theta, found.theta[:size]))
    stds = (Uncertainty(structure, theta, covariance), Uncertainty(structure, found.theta[:size], known))
    more = stds[0].dc_gain_std ** 2 - stds[1].dc_gain_std ** 2
    return at_rest if more > 0.0 and (free - at_rest) ** 2 > chi2_quantile(1.0 - LEVEL, 1) * more else None


def _rests(record: Record) -> bool:
    """Return whether the output neither rises nor falls before the first move of the input."""
    from scipy import special  # slow to import

    moves = np.flatnonzero(record.u != record.u[0])
    if not moves.size:
        return False
    rows = slice(0, int(moves[0]))
    y = record.y[rows][record.is_measured[rows]]
    if y.size < 3:  # nothing to see
        return True
    along = np.asarray(np.linspace(-1.0, 1.0, y.size), np.float64)
    slope = inner(along, y) / sum_of_squares(along)
    left = sum_of_squares(y - y.mean() - slope * along) / (y.size - 2)
    ratio = slope**2 * sum_of_squares(along) / left if left > 0.0 else math.inf if slope else 0.0
    return bool(special.fdtrc(1.0, y.size - 2.0, ratio) >= LEVEL)


def _is_taken(structure: Structure, theta: FloatArray, record: Record) -> bool:
    """Return whether the initial state takes most of what the record tells of the gain."""
    problem = Problem(structure, record)
    model = problem.with_nuisances(without_nuisances(structure, theta))
    zeta, size = problem.run(model).zeta, model.size - structure.poles  # without the initial state
    information = products(zeta, zeta)
    lengths = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    scaled = information / np.outer(lengths, lengths)
    slope = np.zeros(model.size)
    slope[: structure.size] = dc_gain_slope(structure, theta)
    slope /= lengths
    free = float(slope @ pseudo_inverse(scaled, WEAKEST) @ slope)
    told = float(slope[:size] @ pseudo_inverse(scaled[:size, :size], WEAKEST) @ slope[:size])
    return told < (1.0 - SHARE) * free


def _from_rest(record: Record) -> Record | None:
    """Return a record with the rest before it; None where no output is known until the input moves."""
    output = outputs_from_rest(record.u, np.where(record.is_measured, record.y, np.nan))
    if output is None:
        return None
    count = output.size - record.u.size
    u, measured = np.concatenate([np.full(count, record.u[0]), record.u]), np.isfinite(output)
    intervals = record.intervals
    if intervals.size > 1:
        intervals = np.concatenate([np.full(count, float(np.median(intervals))), intervals])
    y = np.where(measured, output, 0.0)
    return replace(record, u=u, y=y, intervals=intervals, measured=measured, before=None)
