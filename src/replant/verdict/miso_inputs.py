"""Faults of the inputs of a row: inputs that a controller makes, and inputs with another dead time than the model's.

Dead times are found by steps: the output x of a branch changes by -dx/dt per second of dead time.  With that column and
the slopes, dead times are estimated together with the coefficients, one input at a time.  No noise model is used, as it
would explain the effect of a wrong dead time.  The likelihood, with the noise model of the final residual, decides
whether another dead time is significant.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from replant.estimation.simulation.miso import Point, Row, Stretch, evaluate, noise_of
from replant.estimation.solver import feedback_test
from replant.estimation.solver.change_contest import HARMLESS
from replant.estimation.solver.feedback_test import Feedback
from replant.estimation.solver.miso_steps import STEPS, refine
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ALPHA, LARGEST_PART, NEGLIGIBLE
from replant.numerics.linear_algebra import chi2_quantile, inner, products
from replant.numerics.projections import lengths_of, weights_by, widening, without
from replant.verdict.estimate_tests import FARTHEST
from replant.verdict.input_faults import EARLY, later, timing_finding
from replant.verdict.miso_certainty import relative_sizes
from replant.verdict.miso_tests import beside_nuisances, is_rounding, of_filters, power_of_row
from replant.verdict.verdict import Finding, percent

LATE = (
    "answers the residual of the same sample, along with it, where a controller opposes it: it acts at once, or its "
    "column is recorded late"
)
MOVED_UP = "move its column up by a row"
A_NAT = 1.0  # gain of the log-likelihood below which the steps end: twice its mean by chance [nats]


def controlled(row: Row, point: Point, noise: Autoregression) -> Iterator[Finding]:
    """Yield findings on inputs that answer the residual, except inputs that references move."""
    free = range(len(row.structures)) if row.outside is None else np.flatnonzero(~row.outside.is_moved).tolist()
    # an answer too small to matter, such as that of a non-causal filter of input and output, is not named
    least = HARMLESS**2 * power_of_row(row, noise)
    for i in free:
        answers = _answers(row, point, i, row.inputs[:, i])
        if not all(answer.found and answer.part * point.cost > least for answer in answers):
            continue
        theta = point.theta[row.places[i]]
        if all(answer.is_at_once and answer.is_direct(row.structures[i], theta) for answer in answers):
            yield from _direct(row, point, noise, i)
            continue
        yield Finding(
            "inconsistent",
            f"input {row.names[i]} answers to disturbances of the output: a controller makes it, and the transfer "
            "functions may be off; give what is applied from outside, as a set-point or a dither, as the reference",
        )


def answering(row: Row, point: Point) -> BoolArray:
    """Return which inputs (q,) that references move answer the residual with the part that these do not explain."""
    found = np.zeros(len(row.structures), bool)
    if row.outside is not None:
        inside = row.inputs - row.outside.inputs  # only the noise is left of an input in a loop
        for i in np.flatnonzero(row.outside.is_moved).tolist():
            found[i] = all(answer.found for answer in _answers(row, point, i, inside[:, i]))
    return found


def _answers(row: Row, point: Point, number: int, signal: FloatArray) -> tuple[Feedback, ...]:
    """Return how a signal (K,) of an input answers the whitened residual, beside the other inputs and by itself."""
    if is_rounding(row, point):
        return (Feedback(),)
    left, signal = np.zeros(signal.size), signal - signal.mean()
    for stretch, error in zip(row.stretches, point.error, strict=True):
        left[stretch.rows] = error
    # with a wrong structure the other inputs explain some of the residual, and this input may follow them: the answer
    # must also be found beside them
    others = [u - u.mean() for u in np.delete(row.inputs, number, axis=1).T]
    first = int(row.record.input_hold == "foh" and row.structures[number].delay < row.dt)  # a model with a direct path
    before = row.record.inputs_before
    return tuple(feedback_test.answering(signal, left, before, first, each) for each in (others, ()))


def _direct(row: Row, point: Point, noise: Autoregression, number: int) -> Iterator[Finding]:
    """Yield a finding that an input acts on the output of the same row, if that changes the coefficients."""

    def own(stretch: Stretch) -> FloatArray:
        return row.inputs[stretch.rows, number][:, None]

    _, _, steps = _beside(row, point, noise, own)
    size = relative_sizes(row, point, steps[0])[number]
    if size > FARTHEST:
        reason = f"input {row.names[number]} {LATE}; with a direct path a coefficient differs by {percent(size)}"
        yield Finding("inconsistent", f"{reason}: {MOVED_UP}")


def timing(row: Row, point: Point) -> Iterator[Finding]:
    """Yield findings on inputs with another dead time, if that changes the coefficients."""
    # in feedback later inputs answer the noise: see `miso_evidence`
    if row.outside is not None or is_rounding(row, point):
        return
    yield from _early(row, point)
    white = Autoregression.white(1.0, row.count)
    before = refine(row, point.theta, white, evaluate(row, point.theta, white))
    timed, after = _told(row, before, *_retimed(row, before, white))
    if timed is row or _is_of_other_dynamics(row, point, timed, after):
        return
    sizes = relative_sizes(row, before, after.theta - point.theta)
    for name, old, new, size in zip(row.names, row.structures, timed.structures, sizes, strict=True):
        if new.delay != old.delay and size > FARTHEST:
            off = new.delay - old.delay
            yield from timing_finding(f"input {name}", old.delay, off, row.dt, size, "inconsistent")


def _early(row: Row, point: Point) -> Iterator[Finding]:
    """Yield findings on inputs that act before their row, which no dead time can describe."""
    noise = noise_of(row, point)
    point = evaluate(row, point.theta, noise, point)
    weights, statistics, steps = _beside(row, point, noise, _later_of(row, point))
    for i in np.flatnonzero(statistics > 1.0).tolist():
        delay, off, size = row.structures[i].delay, float(weights[i]) * row.dt, relative_sizes(row, point, steps[i])[i]
        if delay + off <= -EARLY * row.dt and size > FARTHEST:
            yield from timing_finding(f"input {row.names[i]}", delay, off, row.dt, size, "inconsistent", MOVED_UP)


def _retimed(row: Row, point: Point, noise: Autoregression) -> tuple[Row, Point]:
    """Return the row with new dead times, found by steps of the most significant one at a time, and its point."""
    for _ in range(STEPS):
        weights, statistics, _ = _beside(row, point, noise, _later_of(row, point))
        i = int(np.argmax(statistics))
        delay = max(row.structures[i].delay + float(weights[i]) * row.dt, 0.0)
        if not delay < row.record.span:  # nor where it is NaN
            break
        timed = _with_delay(row, i, delay)
        if timed.count <= timed.nuisances + point.theta.size:
            break
        after = refine(timed, point.theta, noise)
        if not _gain(row, point, timed, after) > A_NAT:
            break
        row, point = timed, after
    return row, point


def _gain(row: Row, point: Point, timed: Row, after: Point) -> float:
    """Return the gain of the log-likelihood from one point to another, for the smaller number of samples."""
    costs = max(point.cost, 1e-300) / row.count, max(after.cost, 1e-300) / max(timed.count, 1)
    return 0.5 * min(row.count, timed.count) * math.log(costs[0] / costs[1])


def _told(row: Row, point: Point, timed: Row, after: Point) -> tuple[Row, Point]:
    """Return the row with its significant new dead times, and its point; the original row if there are none."""
    for i, (old, new) in enumerate(zip(row.structures, timed.structures, strict=True)):
        if old.delay == new.delay:
            continue
        noise = noise_of(timed, after)
        without_it = _with_delay(timed, i, old.delay)
        # from both: if the dead time has replaced a pole, that pole has diverged
        begins = (refine(without_it, theta, noise) for theta in (point.theta, after.theta))
        before, after = min(begins, key=lambda each: each.cost), refine(timed, after.theta, noise)
        if not 2.0 * _gain(without_it, before, timed, after) > chi2_quantile(1.0 - ALPHA, 1):
            timed, after = without_it, before
    return (row if timed.structures == row.structures else timed), after


def _with_delay(row: Row, number: int, delay: float) -> Row:
    each = enumerate(row.structures)
    structures = tuple(replace(structure, delay=delay) if i == number else structure for i, structure in each)
    return Row(structures, row.record, row.inputs, row.names)


def _is_of_other_dynamics(row: Row, point: Point, timed: Row, after: Point) -> bool:
    """Return whether other dynamics explain much beside the new dead times, as if a pole is missing."""
    noise = noise_of(timed, after)
    after, before = refine(timed, after.theta, noise), refine(row, point.theta, noise)
    (significance, left), (_, part) = (
        of_filters(each, at, noise, *row.inputs.T) for each, at in ((timed, after), (row, before))
    )
    return significance > 1.0 and left > NEGLIGIBLE and (left > LARGEST_PART or left > 0.5 * part)


def _later_of(row: Row, point: Point) -> Callable[[Stretch], FloatArray]:
    """Return the function that gives the change (K, q) of each branch's output if delayed by a sampling time."""

    def columns(stretch: Stretch) -> FloatArray:
        outputs, _, _ = row.signals(point.theta, stretch)
        record = stretch.inputs[0]
        return np.column_stack([later(record, output, row.dt, past=False) for output in outputs.T])

    return columns


def _beside(
    row: Row, point: Point, noise: Autoregression, columns: Callable[[Stretch], FloatArray]
) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    """Return weights (C,), statistics over their limit (C,) and steps (P,) for each of some columns by itself."""
    white = beside_nuisances(row, point, noise, columns)
    zeta, error = np.concatenate(point.zeta), np.concatenate(point.error)
    taken = weights_by(products(zeta, zeta), products(zeta, white))
    left = without(white, zeta)
    lengths, limit = lengths_of(left), chi2_quantile(1.0 - ALPHA, 1)
    variance = point.cost / max(row.count - point.theta.size - row.nuisances * len(row.stretches), 1)
    statistics, weights = np.zeros(lengths.size), np.zeros(lengths.size)
    for i, length in enumerate(lengths):
        basis = left[:, i : i + 1] / length
        amount = inner(basis[:, 0], error)
        wider = widening(basis, error - amount * basis[:, 0], variance)
        statistics[i] = amount**2 / max(variance * wider * limit, 1e-300)
        weights[i] = amount / length
    return weights, statistics, list(-(taken * weights).T)
