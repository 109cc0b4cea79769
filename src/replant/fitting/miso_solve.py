"""The estimate of a row from a record: the likeliest with a noise model, unless that explains too much as noise.

With a noise model the estimate is efficient; without one, by the least output error, it is consistent for any noise.
If the two differ beyond chance, or the inputs explain more of the output, the structure is wrong: the estimate without
a noise model is returned.

If references move inputs, steps with instruments start at the likeliest model for the external parts of the inputs;
their estimate is consistent for any noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from replant.errors import InvalidArgumentError, shown
from replant.estimation.simulation.miso import Point, Row, RowRecord, colour_of, evaluate, noise_of
from replant.estimation.simulation.miso_exogenous import Outside
from replant.estimation.solver import solve
from replant.estimation.solver.miso_steps import (
    STEPS,
    ends_of,
    explained_by,
    instrumental,
    is_near,
    path,
    refine,
    start,
)
from replant.estimation.solver.srivc_steps import NEARLY_DONE
from replant.model.preprocess import accepted
from replant.model.structure import Structure
from replant.numerics.arguments import BoolArray, FloatArray, IntArray, array_of_reals
from replant.numerics.autoregression import Autoregression, duration_of
from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import (
    LEAST_PIVOT,
    chi2_quantile,
    combined,
    compose,
    factor_information,
    inverse_of,
    products,
)
from replant.verdict.loop import COPIED, NO_USE, STILL, Reference, fault_of
from replant.verdict.miso_inputs import answering, controlled, timing
from replant.verdict.miso_tests import GIVEN_UP, lacking, of_rivals
from replant.verdict.verdict import Finding

IDLE = "the reference explains nothing of any input: give the column that does, move it more, or leave it out"
SERVED = "input {} is moved by the reference: the estimate is made from what that explains of it"
OPEN = "no input answers to disturbances: the reference is not needed"
NOT_SOLVED = "the estimate made with the reference did not come to rest: record more, or move the reference more"

ROUNDS = 3  # times that the noise model is estimated [count]
SHORT = 12  # steps after each [count]

LOUD = 3.0
"""Power of a residual over the least one above which a solution is discarded [ratio].
Origin: measured on random rows: whitened steps from a start that lacks a slow branch leave ten times the power.
Sensitivity: not measured.
"""

MOST_BEYOND = 100.0  # logarithm of a ratio of costs beyond any real one, within float64 [number]

SAME = 0.99  # level of the test that estimates with and without the noise model are of one plant [probability]


def references_of(given: Any, samples: int) -> FloatArray | None:
    """Return references as columns (K, p), checked; None without any."""
    if given is None:
        return None
    columns, _ = accepted(np.asarray(array_of_reals("reference", given), np.float64))
    columns = columns[:, None] if columns.ndim == 1 else columns
    if columns.ndim != 2 or not columns.shape[1] or len(columns) != samples:
        raise InvalidArgumentError(
            f"reference must have one value for each of {samples} samples, or a column of them for each reference, got "
            f"shape {shown(columns.shape)}"
        )
    return columns


def held(references: FloatArray) -> FloatArray:
    """Return references (K, p) with unknown values interpolated linearly."""
    columns, index = references.copy(), np.arange(len(references))
    for column in columns.T:
        known = np.flatnonzero(np.isfinite(column))
        column[:] = np.interp(index, known, column[known]) if known.size else 0.0
    return columns


def with_outside(
    ready: RowRecord, references: FloatArray | None, names: Sequence[str], is_moved: BoolArray | None = None
) -> tuple[RowRecord, tuple[Finding, ...]]:
    """Return a record (J,) with the parts of its inputs that references (J, p) explain, and findings about these."""
    if references is None:
        return ready, ()
    each_of = [np.ascontiguousarray(each) for each in references.T]
    if all(fault_of(each, ready.inputs[:, 0]) == STILL for each in each_of):
        return ready, (NO_USE[STILL],)
    inputs, told = [np.ascontiguousarray(each) for each in ready.inputs.T], is_moved is not None
    if is_moved is None:
        is_moved = np.array(
            [bool(np.ptp(u)) and any(not Reference.tried(r, u, ready.record.y)[1] for r in each_of) for u in inputs]
        )
    if not is_moved.any() and told:
        return replace(ready, outside=None), (Finding("trusted", OPEN),)
    if not is_moved.any():
        if any(fault_of(r, u) == COPIED for r in each_of for u in inputs):
            return ready, (NO_USE[COPIED],)
        return ready, (Finding("not excited", IDLE),)
    outside = Outside.of(ready.inputs, references, is_moved)
    served = (Finding("trusted", SERVED.format(name)) for name, moves in zip(names, is_moved, strict=True) if moves)
    return replace(ready, outside=outside), tuple(served)


@dataclass(frozen=True, eq=False)
class RowEstimate:
    """An estimate of a row."""

    point: Point
    noise: Autoregression  # white if the noise model was rejected
    covariance: FloatArray  # (P, P)
    findings: tuple[Finding, ...] = ()
    rivals: tuple[FloatArray, ...] = ()  # other models (P,) that were found, and may be as likely


class RowSolution(NamedTuple):
    """An estimate, the row and record that it was made from, and the `Doubt` in each output (J,) of that."""

    row: Row
    found: RowEstimate
    doubt: IntArray


#: Gives the points to start from on a row, with a noise model.
Begin = Callable[[Row, Autoregression], list[Point]]
Again = Callable[[Autoregression], list[Point]]  # of a row that is known


def started(row: Row, noise: Autoregression) -> list[Point]:
    """Return new starts of a row."""
    return start(row.structures, row.record, row.from_outside.inputs, noise)


class Begins(NamedTuple):
    """The starts of a solution: models (P,) that were found with a noise model, or none."""

    noise: Autoregression | None = None
    models: tuple[FloatArray, ...] = ()

    def there(self, row: Row, _: Autoregression) -> list[Point]:
        """Return the models as starts, each with the noise model that it was found with."""
        noise, outside = self.noise, row.from_outside
        return [] if noise is None else [evaluate(outside, each, noise) for each in self.models]

    def afresh(
        self, row: Row, noise: Autoregression, *, also_white: bool = False, newest: int | None = None
    ) -> list[Point]:
        """Return also new starts; with white noise only if no colour is known, or ``also_white``."""
        if self.noise is not None and self.noise.order and not also_white and not noise.order:
            return self.there(row, noise)
        if newest is None:
            return [*started(row, noise), *self.there(row, noise)]
        # if only the colour of the noise is in doubt, a start from the newest samples finds other models
        outside, points = row.from_outside, started(row.last(min(newest, row.record.u.size)), noise)
        return [*(evaluate(outside, each.theta, noise) for each in points), *self.there(row, noise)]


def solve_record(
    structures: tuple[Structure, ...], ready: RowRecord, names: tuple[str, ...], begins_of: Begin
) -> RowSolution | None:
    """Return the estimate of a record, its bad outputs, as in `solve.solve`, found in turn; None without a start."""
    record, white = ready.record, Autoregression.white(1.0, ready.record.count)

    def solved(doubt: IntArray, before: RowSolution | None) -> RowSolution | None:
        row = Row(structures, solve.leaving_out(record, doubt), ready.inputs, names, ready.outside)

        def again(noise: Autoregression) -> list[Point]:
            known = None if before is None else before.found.point.theta
            return begins_of(row, noise) if known is None else [evaluate(row.from_outside, known, noise)]

        begins = [begin for begin in again(white) if math.isfinite(begin.cost)] if row.record.count else []
        return RowSolution(row, solve_row(row, begins, again), doubt) if begins else None

    def told(by: RowSolution, _: IntArray) -> IntArray:
        return doubts_of(by.row, ready, by.found.point, by.found.noise)

    ends = solve.in_turn(record.is_measured, solve.suspected(record, ready.inputs), solved, told)
    return None if ends is None else ends[0]


def solve_with(
    structures: tuple[Structure, ...], ready: RowRecord, references: FloatArray | None, names: tuple[str, ...],
    begins_of: Begin = started,
) -> tuple[RowRecord, RowSolution | None, tuple[Finding, ...]]:  # fmt: skip
    """Return a record with the parts that references (J, p) explain, its estimate, and findings about these."""
    ready, findings = with_outside(ready, references, names)
    solution = solve_record(structures, ready, names, begins_of)
    if ready.outside is None or solution is None:
        return ready, solution, findings
    answers = answering(solution.row, solution.found.point)
    # an input that moves with a reference, but does not respond to disturbances, is external: it is an instrument
    if not answers[ready.outside.is_moved].all():
        ready, findings = with_outside(ready, references, names, answers)
        solution = solve_record(structures, ready, names, begins_of)
    return ready, solution, findings


def doubts_of(row: Row, ready: RowRecord, point: Point, noise: Autoregression) -> IntArray:
    """Return the `Doubt` in each output (J,) of a record by a model of it."""
    modelled = ready.simulated(row, point, noise)[ready.used] - ready.level
    return solve.doubted(ready.record, modelled, noise.coefficients, ready.inputs)


def solve_row(row: Row, begins: list[Point], again: Again) -> RowEstimate:
    """Return the estimate from some starts; ``again`` gives the starts with a noise model."""
    if row.outside is not None:
        # from the known inputs, too: the external parts of several inputs may be weak, or move together
        known = row.over(row.record)
        starts = partial(started, known)
        more = likeliest(known, starts(Autoregression.white(1.0, row.count)), starts).ends
        return _by_instruments(row, (*likeliest(row.from_outside, begins, again).ends, *more))
    free, point, noise, rivals, _ = likeliest(row, begins, again)
    findings = tuple(controlled(row, point, noise))
    # with white noise the two are the same; in feedback the estimate without a noise model is the biased one
    if findings or not noise.order or not (differs(row, free, point) or any(lacking(row, point, noise))):
        findings = findings or tuple(timing(row, point))
        findings += tuple(of_rivals(row, point, rivals))
        return RowEstimate(point, noise, covariance_of(row, point), findings, rivals)
    white, findings = Autoregression.white(1.0, row.count), (*timing(row, free), Finding("inconsistent", GIVEN_UP))
    return RowEstimate(free, white, covariance_of(row, free, noise_of(row, free)), findings, rivals)


def _by_instruments(row: Row, begins: tuple[FloatArray, ...]) -> RowEstimate:
    """Return the estimate by instruments, with the noise model of its residual."""
    # the likelihood with the external parts does not distinguish roots, as an autoregression may explain all effects of
    # a load; the prediction error with the known inputs does
    roots = [_root_from(row, theta) for theta in begins]
    point, noise = min(roots, key=lambda root: (not _is_root(row, root[0]), root[0].cost))
    findings = list(controlled(row, point, noise))
    if not _is_root(row, point):
        findings.append(Finding("converging", NOT_SOLVED))
    rivals = _as_likely(row, point, [other for other, _ in roots if _is_root(row, other)])
    others = tuple(rival.theta for rival in rivals)
    # M^-1 Q M^-T, M = sum zeta phi': a noise model does not remove all colour of disturbances within the loop
    inverse = inverse_of(np.asarray(sum(products(zeta, phi) for zeta, phi in zip(point.zeta, point.phi, strict=True))))
    covariance = _coloured(row, point, colour_of(row, point.error), inverse, point.zeta)
    return RowEstimate(point, noise, covariance, tuple(findings), others)


def _is_root(row: Row, point: Point) -> bool:
    return explained_by(row, point) <= NEARLY_DONE


def _root_from(row: Row, theta: FloatArray) -> tuple[Point, Autoregression]:
    """Return the end of steps with instruments from a model, and the noise model of its residual."""
    before = evaluate(row, theta, Autoregression.white(1.0, row.count))
    noise = noise_of(row, before)
    point = instrumental(row, theta, noise, before, SHORT)
    for _ in range(STEPS):  # each noise model has its own root: after each step it is renewed
        before, noise = point, noise_of(row, point)
        point = instrumental(row, before.theta, noise, before, 1)
        if (point.theta == before.theta).all():
            break
    return point, noise


def likeliest(row: Row, begins: list[Point], again: Again) -> _Estimates:
    """Return the estimate without a noise model and the likeliest with one."""
    white = Autoregression.white(1.0, row.count)
    ends = ends_of(row, (path(row, begin.theta, white, begin) for begin in begins))
    free = min(ends, key=lambda point: point.cost)
    noise = noise_of(row, free)
    found = []
    others = _as_likely(row, free, ends, duration_of(noise.coefficients))
    # started again with the noise model: with slow noise the first start may lack fast dynamics
    begins = [*others, free, *(again(noise) if noise.order else [])]
    for point in ends_of(row, (path(row, begin.theta, noise, begin, SHORT) for begin in begins)):
        model = noise
        for _ in range(ROUNDS - 1):
            model = noise_of(row, point)
            point = refine(row, point.theta, model, point, SHORT)
        found.append(_Estimates(free, point, model))
    # the noise model of a loud one has explained a branch as noise
    quietest = min(each.point.power for each in found)
    quiet_ones = [each for each in found if each.point.power <= LOUD * quietest]
    best = min(quiet_ones, key=lambda each: each.point.cost, default=_Estimates(free, free, white))
    rivals = _as_likely(row, best.point, [each.point for each in quiet_ones])
    all_ends = best.point.theta, *(each.point.theta for each in found if each.point is not best.point)
    return best._replace(rivals=tuple(each.theta for each in rivals), ends=all_ends)


def _as_likely(row: Row, best: Point, points: list[Point], duration: float = 1.0) -> list[Point]:
    """Return the points that are not surely less likely than the best one, without those near it."""
    # without a noise model, ``duration`` samples of correlated noise count as one
    beyond = min(-2.0 * math.log(ALPHA) * duration / max(row.count, 1), MOST_BEYOND)
    limit = best.cost * math.exp(beyond)
    return [each for each in points if each.cost <= limit and not is_near(row, each, best)]


class _Estimates(NamedTuple):
    """The estimate without a noise model, that with one, the model, others that may be as likely, and all ends."""

    free: Point
    point: Point
    noise: Autoregression
    rivals: tuple[FloatArray, ...] = ()
    ends: tuple[FloatArray, ...] = ()


def covariance_of(row: Row, point: Point, colour: Autoregression | None = None) -> FloatArray:
    """Return the covariance (P, P) of a point: s^2 M^-1, or M^-1 Q M^-1 if its error has a colour."""
    upper, variances = factor_information(point.information)
    inverse = compose(upper, variances)
    white = np.asarray(inverse * point.cost / max(row.count - _unknowns(row, point), 1))
    if colour is None:
        return white
    coloured = _coloured(row, point, colour, inverse, point.phi)
    # of a direction that the samples do not determine M^-1 has a bound, and Q rounding errors
    if (variances * np.diag(point.information) < 0.5 / LEAST_PIVOT).all():
        return coloured
    stretch = np.sqrt(np.maximum(np.diag(white) / np.diag(coloured), 1.0))
    return np.asarray(coloured * np.outer(stretch, stretch))


def _coloured(
    row: Row, point: Point, colour: Autoregression, inverse: FloatArray, columns: Sequence[FloatArray]
) -> FloatArray:
    """Return M^-1 Q M^-T: Q is the squares of columns filtered by 1/D backwards in time, times the variance of D e."""
    # squares of the products: rounding errors leave no negative variance
    scattered = [combined(colour.colour(each[::-1]), np.ascontiguousarray(inverse.T)) for each in columns]
    variance = colour.power / max(colour.count - _unknowns(row, point), 1.0)
    return np.asarray(variance * sum(products(each, each) for each in scattered))


def _unknowns(row: Row, point: Point) -> int:
    return int(point.theta.size + row.nuisances * len(row.stretches))


def differs(row: Row, free: Point, point: Point) -> bool:
    """Return whether the residual of the estimate with a noise model exceeds that without by more than chance.

    If the structure is right, the excess over the least power is at most chi-square with the number of parameters, in
    units of the power per independent sample of the residual.  Else an autoregression explains the misfit as noise, and
    with it the slow branches.
    """
    independent = row.count / max(_duration(free), 1.0)
    return point.power > free.power * (1.0 + chi2_quantile(SAME, point.theta.size) / independent)


def _duration(point: Point) -> float:
    """Return the integrated correlation of a residual in samples, up to the first pair of lags that is not positive."""
    sums = np.zeros(1 << int(np.ceil(np.log2(2 * max(each.size for each in point.residual)))))
    for residual in point.residual:
        sums += np.fft.irfft(np.abs(np.fft.rfft(residual, sums.size)) ** 2, sums.size)
    # Geyer (1992), "Practical Markov Chain Monte Carlo", section 3.3
    pairs = (sums[0 : sums.size // 2 : 2] + sums[1 : sums.size // 2 : 2]) / max(float(sums[0]), 1e-300)
    positive = int(np.argmax(pairs <= 0.0)) if (pairs <= 0.0).any() else pairs.size
    return 2.0 * float(pairs[:positive].sum()) - 1.0
