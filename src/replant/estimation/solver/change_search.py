r"""Search for a change of the plant within a record that one model explains.

A change that is small compared with the noise is not visible in the residual's power, nor with a model that has adapted
to it.  The sums of the score from each of some samples b on,

.. math:: g_b = \sum_{k \ge b} \zeta_k w_k, \quad C_b = M_b - M_b M^{-1} M_b,
    \quad M_b = \sum_{k \ge b} \zeta_k \zeta_k^T,

are normal with mean zero and covariance :math:`\sigma^2 C_b` if one model holds, so that
:math:`g_b^T C_b^{-1} g_b / \sigma^2` is chi-squared.  The nuisances of the samples from b on are projected out, as a
load changes them.  What is known from before the record is added to M: a change while the input rests, or no sample is
kept, shows against it alone.  If the largest statistic over all b is significant, suppositions of a change at b compete
(`replant.estimation.solver.change_contest`) with that of one model.

Source: Andrews (1993), "Tests for parameter instability and structural change with unknown change point", Econometrica
61.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.solver.change_contest import HARMLESS, Claim, Contest, decided, is_sure
from replant.estimation.solver.change_evidence import Known, with_nuisances
from replant.estimation.solver.refined_estimate import without_nuisances
from replant.estimation.solver.srivc import refine
from replant.estimation.solver.srivc_steps import Problem, least_since
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray, IntArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ALPHA, MATTERS
from replant.numerics.linear_algebra import borrowed, chi2_quantile, inverse_of, quiet, sums_of_products
from replant.numerics.projections import weights_by

# a change between two of them loses at most a thirty-second of its samples
BEGINS = 32  # samples tried as the begin of a change, evenly spread over the record [count]
# their variance is then known to a sixth, and a block is long compared with the colour that a noise model leaves
BLOCKS = 64  # blocks of samples, whose sums of scores give the scatter [count]


class PlantChange(NamedTuple):
    """A change of the plant within a record: no single G(s) explains it."""

    samples: int  # since the change
    goes_on: bool = False  # whether the plant also changes before or after it: it drifts, or is not linear


@quiet
def change_within(structure: Structure, record: Record, parameters: FloatArray) -> PlantChange | None:
    """Return the change of the plant within a record, perhaps a continual one; None if one G(s) may explain it."""
    if len(record.parts) > 1:
        return None
    model = without_nuisances(structure, parameters)
    begin = begin_of_change(structure, record, model)
    found = change_at(structure, record, model, begin) if begin else None
    # which of its coefficients have changed need not be sure
    if found is None or not is_sure([each for each in found.claims if not each.supposition.is_of_plant], found.claim):
        return None
    contest = found.claim.contest
    if found.goes_on and not contest.differ(found.claim.theta, contest.known.mean, math.sqrt(MATTERS)):
        return None
    return PlantChange(record.u.size - begin, found.goes_on)


class ClaimedChange(NamedTuple):
    """The accepted claim about a change of the plant, all claims, and whether the plant also changes elsewhere."""

    claim: Claim
    claims: list[Claim]
    goes_on: bool


@quiet
def change_at(structure: Structure, record: Record, model: FloatArray, begin: int) -> ClaimedChange | None:
    """Return the change of the plant at a sample; None if a model (T,) of all samples, or a load, explains them."""
    before = refine(structure, record.first(begin), [model], afresh=True)
    if before is None or not before.settled:
        return None
    size, information = structure.coefficients, np.zeros((model.size, model.size))
    information[:size, :size] = inverse_of(before.covariance[:size, :size])
    filters = before.noise.filters > 0.0
    known = Known.before(structure, record, begin, before.theta, information, before.variance, filters=filters)
    if known is None:
        return None
    contest = Contest(structure, record, begin, known)
    claims = contest.claims(again=True)
    claims += [contest.whole(with_nuisances(Problem(structure, record), model))] if claims else []
    found = decided(claims)
    if found is None or not found.supposition.is_of_plant:
        return None
    # a plant that changes continually is not a linear one that has changed; the change may lie near the sample
    away = least_since(structure)
    goes_on = begin_of_change(structure, record.first(max(begin - away, 1)), before.theta)
    goes_on = goes_on or begin_of_change(structure, contest.since.last(contest.since.u.size - away), found.theta)
    return ClaimedChange(found, claims, goes_on > 0)


@quiet
def begin_of_change(
    structure: Structure, record: Record, model: FloatArray, information: FloatArray | None = None
) -> int:
    """Return the most significant begin of a change, given a model (T,) of the record; 0 if it may be chance.

    ``information`` (T, T) is that of the samples before the record, if the model was found with these, too.
    """
    from replant.kernels.filters.sums import explain

    size, fewest = structure.coefficients, least_since(structure)
    if record.u.size < 3 * fewest:
        return 0
    bare = without_nuisances(structure, model[:size])
    with borrowed(record.u.size, bare.size + 1) as signals:
        beside = Problem(structure, record).scores(bare, signals)
        # the nuisances are fitted by these sums, as the residual is linear in them
        sums = sums_of_products(signals)[0]
        weights = weights_by(sums[size:-1, size:-1], sums[size:-1, -1])
        error, count = np.empty(len(signals)), max(record.count, 1)
        power = explain(signals, size, weights, error) / count
        if not math.sqrt(power) * beside >= HARMLESS * record.spread:  # or NaN
            return 0
        noise = Autoregression.of_residual(error, record.predecessors, count)
        white = noise.whiten_known(signals, record.predecessors)
        return surest_begin(white, size, fewest, record.count, information)[0]


def surest_begin(
    signals: FloatArray, size: int, fewest: int, count: int, information: FloatArray | None = None
) -> tuple[int, float]:
    """Return the most significant begin of a change of ``size`` entries, and statistic over limit; 0 by chance."""
    # signals (K, T + 1): whitened slopes, also of nuisances, and residual, of ``count`` outputs
    samples = len(signals)
    if samples < 3 * fewest:
        return 0, 0.0
    begins = np.unique(np.linspace(fewest, samples - fewest, BEGINS).astype(int))
    since = _sums(signals, begins)
    lengths = np.sqrt(np.diag(since[0]))
    variance = since[0, -1, -1] / max(count - lengths.size + 1, 1)
    if not (np.isfinite(lengths).all() and (lengths[:size] > 0.0).all() and variance > 0.0):
        return 0, 0.0
    if information is not None:  # M includes what is known from before
        since[0, :-1, :-1] += variance * information
    largest, begin = _worst(since, size, begins)
    limit = chi2_quantile(1.0 - ALPHA / begins.size, size) * variance
    if not largest > limit:  # the scatter of blocks only raises the limit
        return 0, 0.0
    limit *= _scatter(signals[:, :size] / lengths[:size] * signals[:, -1:] / math.sqrt(variance), begin)
    if not largest > limit:
        return 0, 0.0
    step = int(begins[1] - begins[0])
    while step > 1:
        ends = max(begin - step, fewest), min(begin + step, samples - fewest)
        nearer = np.unique(np.linspace(*ends, BEGINS).astype(int))
        begin, step = _worst(_sums(signals, nearer), size, nearer)[1], int(nearer[1] - nearer[0])
    return begin, largest / limit


def _scatter(products: FloatArray, begin: int) -> float:
    """Return the variance of the sums of scores (K, size) over blocks, over that of white noise; at least one."""
    away = []
    for part in (products[:begin], products[begin:]):
        count = max(BLOCKS * len(part) // len(products), 2)
        sums = np.stack([block.sum(axis=0) for block in np.array_split(part, count)])
        away.append((sums - sums.mean(axis=0)) * math.sqrt(count / (count - 1)))
    return max(float(np.mean(np.sum(np.concatenate(away) ** 2, axis=0))), 1.0)


def _sums(signals: FloatArray, begins: IntArray) -> FloatArray:
    """Return the sums of products (1 + B, T + 1, T + 1) of all samples, and from some ascending ones on."""
    return np.ascontiguousarray(np.cumsum(sums_of_products(signals, begins)[::-1], axis=0)[::-1])


def _worst(since: FloatArray, size: int, begins: IntArray) -> tuple[float, int]:
    """Return the largest statistic of `_sums`, and its sample."""
    from replant.kernels.filters import sums

    statistics, twice = np.empty(begins.size), 2 * (since.shape[1] - 1)
    sums.since_each(since, size, statistics, np.empty((twice, twice + 1)))
    worst = statistics.size - 1 - int(np.argmax(statistics[::-1]))  # of equal ones the last
    return float(statistics[worst]), int(begins[worst])
