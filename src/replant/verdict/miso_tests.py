"""The verdict on a row: whether each input is needed and identified, and what inputs or other columns could explain."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from replant.estimation.simulation.auxiliary_model import AuxiliaryModel
from replant.estimation.simulation.miso import Point, Row, Stretch, evaluate
from replant.estimation.solver.miso_steps import refine, start_without
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ALPHA, MATTERS
from replant.numerics.linear_algebra import chi2_quantile, combined, inverse_of, products, sum_of_squares
from replant.numerics.projections import orthogonal, widening, without
from replant.verdict.evidence import ALLOWED, COPY_OF, FEWEST, RESTED, STANDS_STILL, is_copy, moving, rounding_of
from replant.verdict.held_output import held_output_findings
from replant.verdict.loop import Reference
from replant.verdict.miso_certainty import unsure, untold
from replant.verdict.miso_evidence import faults_of_row, seen_by_each
from replant.verdict.verdict import Finding, Verdict, conclude, duration, figure, percent

GIVEN_UP = (
    "the structure leaves slow parts of the output, which a noise model would take for noise: none was used; try more "
    "poles, another dead time, a further input, or, where a controller makes an input, its reference"
)
FILTERS = 8  # first-order filters of each input whose outputs test its transfer function [count]


def judged(
    row: Row,
    point: Point,
    noise: Autoregression,
    covariance: FloatArray,
    faults: Sequence[Finding],
    others: Sequence[Finding] = (),
    *,
    is_of_record: bool = True,
) -> Verdict:
    """Return the verdict on a point, with the ``faults`` found before, and other findings."""
    others, general = [*faults, *others], [finding for finding in faults if finding.reason == GIVEN_UP]
    others = [finding for finding in others if finding.reason != GIVEN_UP]
    is_named = any(each.status == "inconsistent" and each.reason != GIVEN_UP for each in faults)
    still = not np.ptp(row.record.y[row.record.is_measured]) > 0.0
    if still:
        findings = [Finding("inconsistent", STANDS_STILL.format(f"the last {duration(row.record.span)}"))]
    else:
        findings = [*_copied(row), *untold(row, point, covariance)]
    if not findings:
        findings += _useless(row, point, noise, covariance)
        seen = seen_by_each(row, point, covariance)
        held = held_output_findings(*((acting.evidence, acting.runs) for _, acting in seen))
        # an estimate that runs with the samples may be older than a change
        outdated = [] if findings or is_of_record else list(_outdated(row, point, noise, covariance))
        named = [] if is_named or findings else list(faults_of_row(seen, in_time=not outdated))
        is_named = is_named or any(each.status == "inconsistent" for each in [*held, *named])
        others = [*held, *named, *others]
        # a named fault also lets other dynamics explain the residual: in feedback the input explains the noise
        general = general if is_named else [*lacking(row, point, noise), *general]
        known = [] if findings or general else list(unsure(row, point, covariance))
        findings += [*([] if findings or general or is_named else outdated), *known]  # from a wrong model all differ
    excited = not any(finding.status == "not excited" for finding in findings + others)
    # named faults come before general ones
    told = conclude(
        findings + others + general, "each input is told apart, and the inputs explain no more of the output"
    )
    verdict = Verdict(*told, excited=excited)
    rest = len(row.inputs) - max(moving(u) for u in row.inputs.T)
    if not excited or is_of_record or rest < max(min(RESTED, len(row.inputs) // 4), 2):
        return verdict
    reason = f"no input has moved for the last {duration(row.record.last(rest).span)}: move one to learn more"
    return replace(verdict, excited=False, reasons=(*verdict.reasons, reason))


def _copied(row: Row) -> Iterator[Finding]:
    """Yield findings on inputs that are copies of the output; if another input moves both, a controller makes one."""
    known, y = row.record.is_measured, row.record.y
    copies = [i for i, u in enumerate(row.inputs.T) if is_copy(u[known], y[known])]
    others = [i for i in range(len(row.structures)) if i not in copies]
    for i in copies:
        u, name = np.ascontiguousarray(row.inputs[:, i]), row.names[i]
        movers = (j for j in others if Reference.projected(np.ascontiguousarray(row.inputs[:, j]), u, y).strength > 1.0)
        if (by := next(movers, None)) is None:
            yield Finding("inconsistent", COPY_OF.format(f" {name}"))
            continue
        yield Finding(
            "inconsistent",
            f"input {name} is a copy of the output, sample for sample, and input {row.names[by]} moves both: a "
            "controller makes it of the output alone; move its set-point, and give it as the reference, or leave the "
            "input out",
        )


def _outdated(row: Row, point: Point, noise: Autoregression, covariance: FloatArray) -> Iterator[Finding]:
    """Yield the input whose response has changed most, by all samples, or the newest half, quarter and so on."""
    # over all samples the deviations before and after a change cancel: the estimate is a mean
    samples = row.record.u.size
    while samples >= FEWEST:
        newest = row.last(samples)
        if newest.count <= newest.nuisances + point.theta.size:
            return
        found = list(moved(newest, evaluate(newest, point.theta, noise), noise, covariance))
        if found:
            yield from found
            return
        samples //= 2


def _useless(row: Row, point: Point, noise: Autoregression, covariance: FloatArray) -> Iterator[Finding]:
    """Yield inputs that are not needed, by the Bayesian information criterion."""
    count = len(row.structures)
    if count == 1:
        return
    if row.outside is not None:  # in feedback likelihoods do not decide: the numerator is compared with zero
        useless = [i for i, beyond in enumerate(_beyond_nought(row, point, covariance)) if beyond < 1.0]
    else:
        useless = [i for i in range(count) if _is_left_out(row, point, noise, i)]
        if len(useless) > 1 and not _is_left_out(row, point, noise, *useless):
            named = " and ".join(row.names[i] for i in useless)
            yield Finding(
                "inconsistent",
                f"any of inputs {named} could be left out, but not all of them: they move together, or the output "
                "drifts as a slow plant would; move one alone, and record more",
            )
            return
    for i in useless:
        yield Finding("inconsistent", f"input {row.names[i]} explains nothing of the output: leave it out")


def _beyond_nought(row: Row, point: Point, covariance: FloatArray) -> Iterator[float]:
    """Yield, for each input, the distance of its numerator from zero as a statistic over the criterion's limit."""
    for structure, whole in zip(row.structures, row.places, strict=True):
        rows = slice(whole.stop - structure.zeros - 1, whole.stop)
        std = np.sqrt(np.maximum(np.diag(covariance[rows, rows]), np.finfo(float).tiny))
        b = point.theta[rows] / std
        scaled = covariance[rows, rows] / np.outer(std, std)
        known = bool(np.isfinite(scaled).all())  # a diverged branch may have a negative variance, by rounding
        statistic = float(b @ np.linalg.lstsq(scaled, b, rcond=None)[0]) if known else 0.0
        yield statistic / (structure.size * math.log(row.count))


def _is_left_out(row: Row, point: Point, noise: Autoregression, *left_out: int) -> bool:
    """Return whether the Bayesian information criterion prefers the model without some of the inputs."""
    less = [k for k in range(len(row.structures)) if k not in left_out]
    power = power_of_row(row, noise)
    if less:
        begins = start_without(row, point.theta, left_out, noise)
        others = row.of_inputs(less)
        power = min((refine(others, begin.theta, noise, begin).cost for begin in begins[:1]), default=power)
    size = sum(row.structures[i].size for i in left_out)
    return row.count * math.log(max(power, 1e-300) / max(point.cost, 1e-300)) < size * math.log(row.count)


def lacking(row: Row, point: Point, noise: Autoregression, covariance: FloatArray | None = None) -> Iterator[Finding]:
    """Yield what filters of the inputs could explain of the residual; ``covariance``: of a model of another record."""
    signals = row.inputs if row.outside is None else row.outside.signals
    significance, part = of_filters(row, point, noise, *signals.T, covariance=covariance)
    if not part > MATTERS:
        return
    reason = f"the inputs could explain a further {percent(part)} of the output's power"
    if significance > 1.0:
        reason += f" ({figure(significance)} times the limit of chance)"
        yield Finding("inconsistent", f"{reason}: try more poles or zeros, or another dead time")
    elif covariance is not None:
        exactly, _ = of_filters(row, point, noise, *signals.T, covariance=np.zeros_like(covariance))
        if exactly > 1.0:
            yield Finding("converging", f"{reason}, {ALLOWED}")


def moved(row: Row, point: Point, noise: Autoregression, covariance: FloatArray) -> Iterator[Finding]:
    """Yield the input whose response differs most from the estimate's, if that is significant and matters.

    The step from the estimate, d = (sum zeta phi')^-1 sum zeta e, is compared with its covariance plus the estimate's.
    The size of the change is the amplitude of phi_i' d_i over that of the branch's output x_i.
    """
    phi, zeta, error = (np.concatenate(each) for each in (point.phi, point.zeta, point.error))
    if is_rounding(row, point):
        return
    inverse = inverse_of(products(zeta, phi))
    step = inverse @ products(zeta, error)
    variance = point.cost / max(row.count - step.size - row.nuisances * len(row.stretches), 1)
    spread = variance * inverse @ products(zeta, zeta) @ inverse.T + covariance
    basis = combined(zeta, orthogonal(products(zeta, zeta)))
    limit = chi2_quantile(1.0 - ALPHA, step.size) * widening(basis, without(error[:, None], zeta)[:, 0], variance)
    if not float(step @ inverse_of(spread) @ step) > limit:  # also if NaN: the samples do not determine the step
        return
    parts = []
    outputs = np.concatenate([row.whitened(noise, row.signals(point.theta, s)[0], s) for s in row.stretches])
    for rows, output in zip(row.places, outputs.T, strict=True):
        parts.append(float(sum_of_squares(combined(phi[:, rows], step[rows]))) / max(sum_of_squares(output), 1e-300))
    part, name = max(zip(parts, row.names, strict=True))
    if part > MATTERS:
        yield Finding(
            "inconsistent",
            f"input {name}: over the newest {row.record.u.size:,} samples its response differs by "
            f"{percent(float(np.sqrt(part)))} from the estimate's, beyond chance: the plant has changed; if it stays "
            "so, learn it anew with reset",
        )


def of_rivals(row: Row, point: Point, rivals: Iterable[FloatArray]) -> Iterator[Finding]:
    """Yield the input whose part of the output differs most between the estimate and rival models, if that matters."""

    def parts(theta: FloatArray) -> FloatArray:
        """Return the parts (K, q) of the measured outputs by each input, each stretch from rest."""
        return np.concatenate([row.signals(theta, each)[0][each.measured] for each in row.stretches])

    own, name, largest = parts(point.theta), "", 0.0
    size = float(own.sum(axis=1).std())
    for theta in rivals:
        apart = np.std(parts(theta) - own, axis=0)
        if float(apart.max()) > largest:
            name, largest = row.names[int(apart.argmax())], float(apart.max())
    if largest > math.sqrt(MATTERS) * size:
        yield Finding(
            "converging",
            f"another model is as likely, with another response to input {name}: move that input more, or record more",
        )


def power_of_row(row: Row, noise: Autoregression) -> float:
    """Return the sum of squares of the whitened output."""
    return sum(float(np.sum(row.whitened(noise, each.y, each) ** 2)) for each in row.stretches)


def left_out(row: Row, point: Point, noise: Autoregression, others: Mapping[str, FloatArray]) -> Iterator[Finding]:
    """Yield the other column (K,) that explains the residual most significantly, if one does and that matters."""
    usable = {name: each for name, each in others.items() if np.isfinite(each).all() and np.ptp(each) > 0.0}
    found = [(*of_filters(row, point, noise, signal), name) for name, signal in usable.items()]
    for significance, part, name in sorted(found, reverse=True)[:1]:
        if significance > 1.0 and part > MATTERS:
            yield Finding(
                "inconsistent",
                f"column {name} could explain a further {percent(part)} of the output's power: make it an input, too",
            )


def of_filters(
    row: Row, point: Point, noise: Autoregression, *signals: FloatArray, covariance: FloatArray | None = None
) -> tuple[float, float]:
    """Return what signals (K,) and filters of them explain of the error: statistic over limit, part of the output."""
    if is_rounding(row, point):
        return 0.0, 0.0
    model, span = AuxiliaryModel(Structure(1), row.dt), sum(each.inputs[0].span for each in row.stretches)
    cutoffs = np.geomspace(5.0 / span, 1.0 / row.dt, FILTERS)

    def filtered(stretch: Stretch) -> FloatArray:
        given = [np.ascontiguousarray(each[stretch.rows] - each[stretch.rows][0]) for each in signals]
        records = [replace(stretch.inputs[0], u=each) for each in given]
        runs = [model.run(np.array([p, p, 0.0, 0.0]), record).output for record in records for p in cutoffs]
        return np.column_stack([*runs, *given])

    white, phi, error = beside_nuisances(row, point, noise, filtered), *map(np.concatenate, (point.zeta, point.error))
    lengths = np.sqrt(np.einsum("ij,ij->j", white, white))
    if not lengths.any():
        return 0.0, 0.0
    # a model of this record explains all that its instruments can; one of another record has errors by its covariance
    left = white[:, lengths > 0.0] if covariance is not None else without(white[:, lengths > 0.0], phi)
    left = left / lengths[lengths > 0.0]
    basis = combined(left, orthogonal(products(left, left)))
    if not basis.shape[1]:
        return 0.0, 0.0
    known = point.theta.size if covariance is None else 0
    variance = point.cost / max(row.count - known - row.nuisances * len(row.stretches), 1)
    amounts, spread = products(basis, error[:, None])[:, 0], variance * np.eye(basis.shape[1])
    power = sum_of_squares(amounts) - float(np.trace(spread))
    if covariance is not None:
        along = products(basis, phi)
        spread = spread + along @ covariance @ along.T
    statistic = float(amounts @ np.linalg.lstsq(spread, amounts, rcond=None)[0])
    limit = chi2_quantile(1.0 - ALPHA, basis.shape[1]) * widening(basis, error - combined(basis, amounts), variance)
    return statistic / max(limit, 1e-300), power / max(power_of_row(row, noise), np.finfo(float).tiny)


def beside_nuisances(
    row: Row, point: Point, noise: Autoregression, columns: Callable[[Stretch], FloatArray]
) -> FloatArray:
    """Return columns (K, C), made for each stretch, whitened and without the nuisances."""
    parts = []
    for stretch in row.stretches:
        _, _, free = row.signals(point.theta, stretch)
        parts.append(without(*(row.whitened(noise, each, stretch) for each in (columns(stretch), free))))
    return np.concatenate(parts)


def is_rounding(row: Row, point: Point) -> bool:
    """Return whether the residual is rounding, of the log's numbers or of the sensor: it carries no information."""
    output, error = (
        np.concatenate([each[stretch.measured] for each, stretch in zip(signals, row.stretches, strict=True)])
        for signals in ([stretch.y for stretch in row.stretches], point.residual)
    )
    return not float(error.std()) > rounding_of(output - error, output) or not np.ptp(output) > 0.0
