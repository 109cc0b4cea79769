r"""Faults of the recording, not of the plant: other causes of a model that is not trusted, or should not be.

    glitches  a few values of the input far from all others that did not reach the plant: a bad cable, an error code
    drift     a straight line on the output: a sensor that warms up, a load that grows

Each leads to a model that explains little, and to tests that name wrong causes.  It is accepted as the cause if a model
of the record without it has more evidence, also than one with one more mode, and is trusted.  Each number that was
removed has the price of a fitted one.

A trusted model may be wrong if the free initial state explains a part of the response to the input.  A step test with
few samples before the step determines both from nearly the same samples: its gain is ten times less certain than if the
record is known to begin at rest.  If it does, the gain from rest, :math:`g_r`, is efficient, and the free one,
:math:`g_f`, differs by chance alone (Hausman):

.. math:: (g_f - g_r)^2 / (\sigma_f^2 - \sigma_r^2) \sim \chi^2_1

A record counts as beginning at rest if the output neither rises nor falls before the input moves, and the model from
rest is trusted.

Source: Hausman (1978), "Specification tests in econometrics", Econometrica 46.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.simulation.model_run import run_model
from replant.estimation.solver.refined_estimate import without_nuisances
from replant.estimation.solver.srivc import refine
from replant.estimation.solver.srivc_steps import Problem
from replant.fitting.model_fields import has_rest
from replant.fitting.structure_evidence import Evidence, with_fewer_poles
from replant.logs.column_roles import seem_swapped
from replant.logs.conditioning import outputs_from_rest
from replant.model.structure import Structure
from replant.model.uncertainty import Uncertainty, dc_gain_slope
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.levels import ALPHA, MATTERS
from replant.numerics.linear_algebra import chi2_quantile, inner, products, pseudo_inverse, quiet, sum_of_squares
from replant.numerics.projections import WEAKEST, amounts_of
from replant.numerics.robust import far_out
from replant.verdict.assess import MOST_SAMPLES, assess_record
from replant.verdict.estimate_tests import without_longer
from replant.verdict.other_columns import OtherColumn, with_other_columns
from replant.verdict.reasons import POOREST_FIT
from replant.verdict.sensor_and_excitation import FROM_REST
from replant.verdict.verdict import Assessment, percent

# that of the stated intervals, in which the gain from rest should lie
LEVEL = 0.05  # chance of a false alarm if the record begins at rest [probability]

# with less, the gain from rest is hardly more certain, and the test has no power
SHARE = 0.5  # least share of the information on the gain that the initial state takes, for a test [part]


SWAPPED = "the input follows the output, and the output does not follow the input: are input and output swapped?"


class Supposed(NamedTuple):
    """A record without a possible cause, and the record as it was given, with the same outputs."""

    given: Record
    without: Record
    numbers: int  # that were removed
    reason: str  # text before the fit of the model without the cause
    advice: str


def judged_further(
    verdict: Assessment, structure: Structure, parameters: FloatArray, covariance: FloatArray | None, record: Record,
    zero: float, columns: tuple[OtherColumn, ...],
) -> Assessment:  # fmt: skip
    """Return the verdict on a model (P,) of a whole record, of u - ``zero``, with the results of other models of it."""
    if covariance is not None:  # noise biases an estimate without one
        verdict = with_fewer_poles(verdict, structure, parameters, record)
        verdict = with_other_cause(verdict, structure, parameters, record, zero)
    verdict = with_other_columns(verdict, columns)
    if verdict.status != "trusted" and record.r is None and seem_swapped(record.u, _outputs(record)):
        return replace(verdict, reasons=(SWAPPED, *verdict.reasons))
    if covariance is None or verdict.status not in ("trusted", "converging"):
        return verdict
    gain = gain_from_rest(structure, parameters, covariance, record, trusted=verdict.status == "trusted")
    if gain is None:
        return verdict
    reason = FROM_REST.format(gain, structure.transfer_function(parameters).dc_gain)
    return replace(verdict, status="converging", reasons=(reason, *without_longer(verdict).reasons))


@quiet
def with_other_cause(
    verdict: Assessment, structure: Structure, parameters: FloatArray, record: Record, zero: float
) -> Assessment:
    """Return the verdict on a model (P,), or another cause as its only reason; the record has u - ``zero``."""
    record = record.last(MOST_SAMPLES)
    if verdict.status == "trusted" or len(record.parts) > 1 or record.r is not None:
        return verdict
    for cause in (partial(_glitches, record, zero), partial(_drift, structure, record)):
        supposed = cause()
        reason = "" if supposed is None else _reason(supposed, structure, parameters)
        if reason:
            return replace(verdict, status="inconsistent", reasons=(reason,))  # the other reasons are due to it
    return verdict


def _reason(supposed: Supposed, structure: Structure, parameters: FloatArray) -> str:
    """Return the reason that names a cause, if a model without it has more evidence and is trusted; else empty."""
    at_rest, other = not structure.delay, supposed.without
    found = Evidence(other, at_rest=at_rest).of(structure, (), afresh=True)
    if found is None or found.fit < POOREST_FIT:
        return ""
    (theta,), (covariance,) = found.models, found.covariances()
    theta, covariance = theta[: structure.size], covariance[: structure.size, : structure.size]
    dt = other.usual if math.isfinite(other.usual) else other.dt
    # a wrong structure proves nothing about the input that reached the plant; this takes less time than a search
    if assess_record(structure, theta, other, dt, covariance).status != "trusted":
        return ""
    price = 0.5 * supposed.numbers * math.log(other.u.size)
    given = Evidence(supposed.given, at_rest=at_rest).of(structure, [without_nuisances(structure, parameters)])
    if given is not None and not found.evidence - price > given.evidence - math.log(ALPHA):
        return ""
    # one more mode must not explain the record as well, as its slow pole may act like a line
    more = replace(structure, poles=structure.poles + 1, zeros=structure.zeros + 1)
    richer = Evidence(supposed.given, at_rest=at_rest).of(more, (), afresh=True)
    if richer is not None and not found.evidence - price > richer.evidence:
        return ""
    return f"{supposed.reason} a model explains {found.fit:.1f} %: {supposed.advice}"


def _glitches(record: Record, zero: float) -> Supposed | None:
    """Return the record without the rows of few values of the input far from all others; None if there are none."""
    glitches, low, high = far_out(record.u)
    count, kept = int(glitches.sum()), ~glitches
    if not count:
        return None
    t = np.cumsum(np.broadcast_to(record.intervals, kept.shape))[kept]
    usual = float(np.median(record.intervals))
    without = replace(
        record, u=record.u[kept], y=record.y[kept], intervals=np.diff(t, prepend=t[:1] - usual), usual=usual,
        measured=None if record.measured is None else record.measured[kept],
    )  # fmt: skip
    values = "a value of the input lies" if count == 1 else f"{count:,} values of the input lie"
    reason = (
        f"{values} far from its others, {low + zero:.3g} to {high + zero:.3g}, and the output does not answer: without "
        f"{'it' if count == 1 else 'them'}"
    )
    given = replace(record, measured=record.is_measured & kept)
    return Supposed(given, without, count, reason, "make the cells empty")


def _drift(structure: Structure, record: Record) -> Supposed | None:
    """Return the record without a straight line on its output; None if that explains little."""
    t = np.cumsum(np.broadcast_to(record.intervals, record.u.shape))
    known = record.is_measured
    of_input, of_output = _line(t, record.u, np.ones_like(known)), _line(t, record.y, known)
    power = max(float(np.var(record.y[known])), np.finfo(float).tiny)
    if not MATTERS * power < float(np.var(of_output)) < math.inf:
        return None
    # the plant responds to the line of its input: the line of the output minus this response is a drift
    found = refine(structure, replace(_less(record, of_output), u=record.u - of_input), (), afresh=True)
    slow = 0.0 if found is None else float(found.theta[structure.poles - 1])
    if found is None or slow == 0.0:
        return None
    drift = of_output - float(found.theta[structure.size - 1]) / slow * of_input
    nearly = _less(record, drift)
    found = refine(structure, nearly, [found.theta], afresh=True)
    run = None if found is None else run_model(structure, found.theta[: structure.size], nearly, record.dt)
    if run is not None:  # plus the line in the residual that no other coefficients explain
        columns = np.column_stack([t - t.mean(), run.zeta, run.nuisances])[known]
        drift = drift + amounts_of(columns, run.error[known])[0] * (t - t.mean())
    part = float(np.var(drift)) / power
    if not MATTERS < part < math.inf:
        return None
    reason = f"the output drifts along a straight line, {percent(min(part, 1.0))} of its power: beside it"
    return Supposed(record, _less(record, drift), 1, reason, "use --detrend, or rp.detrend(log)")


def _outputs(record: Record) -> FloatArray:
    """Return the outputs (K,), NaN where there is none."""
    return np.where(record.is_measured, record.y, np.nan)


def _less(record: Record, drift: FloatArray) -> Record:
    """Return a record minus a drift (K,) of its output."""
    return replace(record, y=np.where(record.is_measured, record.y - drift, record.y))


def _line(t: FloatArray, signal: FloatArray, known: BoolArray) -> FloatArray:
    """Return the straight line (K,) that fits the known samples of a signal (K,) best, with mean zero over these."""
    since = t - t[known].mean()
    slope = inner(since[known], signal[known]) / max(sum_of_squares(since[known]), np.finfo(float).tiny)
    return np.asarray(slope * since)


@quiet
def gain_from_rest(
    structure: Structure, theta: FloatArray, covariance: FloatArray, record: Record, *, trusted: bool = True
) -> float | None:
    """Return the gain from rest if it rejects that of a model (P,), or the model is not trusted; else None."""
    if not has_rest(structure.transfer_function(theta), record.span) or len(record.parts) > 1 or record.r is not None:
        return None
    if not _rests(record) or not _is_taken(structure, theta, record):
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
    if not trusted:
        return at_rest
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
    if y.size < 3:  # too few to test
        return True
    along = np.asarray(np.linspace(-1.0, 1.0, y.size), np.float64)
    slope = inner(along, y) / sum_of_squares(along)
    left = sum_of_squares(y - y.mean() - slope * along) / (y.size - 2)
    ratio = slope**2 * sum_of_squares(along) / left if left > 0.0 else math.inf if slope else 0.0
    return bool(special.fdtrc(1.0, y.size - 2.0, ratio) >= LEVEL)


def _is_taken(structure: Structure, theta: FloatArray, record: Record) -> bool:
    """Return whether the initial state takes most of the record's information on the gain."""
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
    """Return a record extended by rest before it; None if no output is known before the input moves."""
    output = outputs_from_rest(record.u, _outputs(record))
    if output is None:
        return None
    count = output.size - record.u.size
    u, measured = np.concatenate([np.full(count, record.u[0]), record.u]), np.isfinite(output)
    intervals = record.intervals
    if intervals.size > 1:
        intervals = np.concatenate([np.full(count, float(np.median(intervals))), intervals])
    y = np.where(measured, output, 0.0)
    return replace(record, u=u, y=y, intervals=intervals, measured=measured, before=None)
