"""Other causes of a model that is not trusted: what the recording has, and the plant has not.

    glitches  a few values of the input far from all others, which the plant has not seen: a bad cable, an error code
    drift     a straight line on the output: a sensor that warms up, a load that grows

Each leaves a model that explains little, and tests that name causes which are not there.  Whether it is the cause is
asked of the record: without it another model has more evidence, also than one with one more mode, and is trusted.  What
was taken off is paid for as numbers that were fitted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.simulation.model_run import run_model
from replant.estimation.solver.refined_estimate import without_nuisances
from replant.estimation.solver.srivc import refine
from replant.fitting.structure_evidence import Evidence
from replant.model.structure import Structure
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.levels import ALPHA, MATTERS
from replant.numerics.linear_algebra import inner, quiet, sum_of_squares
from replant.numerics.projections import amounts_of
from replant.numerics.robust import far_out
from replant.verdict.assess import MOST_SAMPLES, assess_record
from replant.verdict.reasons import POOREST_FIT
from replant.verdict.verdict import Assessment, percent


class Supposed(NamedTuple):
    """A record without what may be the cause, beside the same outputs of the record as it came."""

    given: Record
    without: Record
    numbers: int  # that were taken off
    reason: str  # before the fit of the model without
    advice: str


@quiet
def with_other_cause(
    verdict: Assessment, structure: Structure, parameters: FloatArray, record: Record, zero: float
) -> Assessment:
    """Return the verdict on a model (P,), and where another cause is found, that alone; its record has u - ``zero``."""
    record = record.last(MOST_SAMPLES)
    if verdict.status == "trusted" or len(record.parts) > 1 or record.r is not None:
        return verdict
    for supposed in _causes(structure, record, zero):
        reason = "" if supposed is None else _reason(supposed, structure, parameters)
        if reason:
            return replace(verdict, status="inconsistent", reasons=(reason,))  # others are of a model that it has made
    return verdict


def _causes(structure: Structure, record: Record, zero: float) -> Iterator[Supposed | None]:
    """Yield what may be the cause, each where the ones before it are not; None for what is not there."""
    yield _glitches(record, zero)
    yield _drift(structure, record)


def _reason(supposed: Supposed, structure: Structure, parameters: FloatArray) -> str:
    """Return that a cause is one, as a model without it has more evidence and is trusted; empty where none is."""
    at_rest, other = not structure.delay, supposed.without
    given = Evidence(supposed.given, at_rest=at_rest).of(structure, [without_nuisances(structure, parameters)])
    found = Evidence(other, at_rest=at_rest).of(structure, (), afresh=True)
    # nor does one more mode explain the record as well, whose slow pole may do what a line does
    more = replace(structure, poles=structure.poles + 1, zeros=structure.zeros + 1)
    richer = Evidence(supposed.given, at_rest=at_rest).of(more, (), afresh=True)
    price = 0.5 * supposed.numbers * math.log(other.u.size)
    others = [each.evidence + sure for each, sure in ((given, -math.log(ALPHA)), (richer, 0.0)) if each is not None]
    if found is None or found.fit < POOREST_FIT or not found.evidence - price > max(others, default=-math.inf):
        return ""
    theta, covariance = found.found.theta[: structure.size], found.found.covariance[: structure.size, : structure.size]
    dt = other.usual if math.isfinite(other.usual) else other.dt
    # of a wrong structure none tells what the plant has seen
    if assess_record(structure, theta, other, dt, covariance).status != "trusted":
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
    """Return the record without a straight line on its output; None where that explains little."""
    t = np.cumsum(np.broadcast_to(record.intervals, record.u.shape))
    known = record.is_measured
    of_input, of_output = _line(t, record.u, np.ones_like(known)), _line(t, record.y, known)
    power = max(float(np.var(record.y[known])), np.finfo(float).tiny)
    if not MATTERS * power < float(np.var(of_output)) < math.inf:
        return None
    # the plant answers to the line of its input: what its gain leaves of the output's is a drift
    found = refine(structure, replace(_less(record, of_output), u=record.u - of_input), (), afresh=True)
    slow = 0.0 if found is None else float(found.theta[structure.poles - 1])
    if found is None or slow == 0.0:
        return None
    drift = of_output - float(found.theta[structure.size - 1]) / slow * of_input
    nearly = _less(record, drift)
    found = refine(structure, nearly, [found.theta], afresh=True)
    run = None if found is None else run_model(structure, found.theta[: structure.size], nearly, record.dt)
    if run is not None:  # and of what is left what no other coefficients explain
        columns = np.column_stack([t - t.mean(), run.zeta, run.nuisances])[known]
        drift = drift + amounts_of(columns, run.error[known])[0] * (t - t.mean())
    part = float(np.var(drift)) / power
    if not MATTERS < part < math.inf:
        return None
    reason = f"the output drifts along a straight line, {percent(min(part, 1.0))} of its power: beside it"
    return Supposed(record, _less(record, drift), 1, reason, "use --detrend, or rp.detrend(log)")


def _less(record: Record, drift: FloatArray) -> Record:
    """Return a record less a drift (K,) of its output."""
    return replace(record, y=np.where(record.is_measured, record.y - drift, record.y))


def _line(t: FloatArray, signal: FloatArray, known: BoolArray) -> FloatArray:
    """Return the straight line (K,), of mean zero, that explains most of the samples known of a signal (K,)."""
    since = t - t[known].mean()
    slope = inner(since[known], signal[known]) / max(sum_of_squares(since[known]), np.finfo(float).tiny)
    return np.asarray(slope * since)
