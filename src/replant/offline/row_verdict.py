"""The verdict of a row: what each input is worth, and what the inputs leave."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from replant.arguments import FloatArray
from replant.assessment.estimate_tests import MOST_UNCERTAIN
from replant.assessment.score_test import ALPHA, MATTERS
from replant.assessment.verdict import Finding, Verdict, conclude, figure, percent
from replant.engine.record import Record
from replant.model.structure import Structure
from replant.offline.refined import relative_uncertainty
from replant.offline.row_start import start
from replant.offline.row_steps import Point, Row, Stretch, refine
from replant.simulation.auxiliary_model import AuxiliaryModel
from replant.statistics.autoregression import Autoregression
from replant.statistics.linear_algebra import chi2_quantile
from replant.statistics.projections import orthogonal, products, widening, without

FILTERS = 8  # first-order filters of each input that its transfer function is tested against [count]
LATER = 10  # later inputs that a residual is tested against [samples]


def judged(
    row: Row, record: Record, point: Point, noise: Autoregression, covariance: FloatArray, others: list[Finding]
) -> Verdict:
    """Return the verdict of a point, with other findings about it."""
    findings = [*_at_rest(row), *_uncertain(row, record, point, covariance)]
    if not findings:
        findings += [*_useless(row, point, noise), *_lacking(row, point, noise)]
    return Verdict(
        *conclude(findings + others, "each input is told apart, and the inputs explain no more of the output")
    )


def _at_rest(row: Row) -> Iterator[Finding]:
    for i in range(len(row.structures)):
        if not any(np.ptp(stretch.inputs[i].u) > 0.0 for stretch in row.stretches):
            yield Finding("not excited", f"input u{i + 1} does not move: move it, or leave it out")


def _uncertain(row: Row, record: Record, point: Point, covariance: FloatArray) -> Iterator[Finding]:
    """Inputs that move together, and else transfer functions that the record does not tell."""
    ends = np.cumsum([each.size for each in row.structures]).tolist()
    places = [slice(*rows) for rows in zip([0, *ends], ends, strict=False)]
    phi, blamed = np.concatenate(point.phi), set()
    slopes = np.zeros((len(places), point.theta.size))  # of the gains b0/a0
    for number, (structure, rows) in enumerate(zip(row.structures, places, strict=True)):
        a0, b0 = point.theta[rows][structure.poles - 1], point.theta[rows][-1]
        slopes[number, rows.start + structure.poles - 1], slopes[number, rows.stop - 1] = -b0 / a0**2, 1.0 / a0
    gains = slopes @ covariance @ slopes.T
    std = np.sqrt(np.maximum(np.diag(gains), 0.0))
    sizes = np.array(
        [abs(point.theta[k][-1] / point.theta[k][s.poles - 1]) for s, k in zip(row.structures, places, strict=True)]
    )
    for i, j in itertools.combinations(range(len(places)), 2):
        if not std[i] * std[j] > 0.0:
            continue
        correlation = min(abs(gains[i, j]) / (std[i] * std[j]), 1.0)
        alone = math.sqrt(1.0 - correlation**2)  # what a deviation would be if the other gain were known
        # most of the variance comes of the other gain, which is enough to make this one uncertain
        if alone**2 < 0.5 and any(alone * std[k] <= MOST_UNCERTAIN * sizes[k] < std[k] for k in (i, j)):
            blamed |= {i, j}
            yield Finding(
                "converging",
                f"inputs u{i + 1} and u{j + 1} move together: their gains correlate by {correlation:.3f}, and only a "
                "sum of them is known; move one of them alone",
            )
    for i, (structure, rows) in enumerate(zip(row.structures, places, strict=True)):
        of_it = replace(record, y=record.y, before=None)
        part = relative_uncertainty(structure, point.theta[rows], covariance[rows, rows], phi[:, rows], of_it)
        if i not in blamed and not part <= MOST_UNCERTAIN:
            yield Finding(
                "converging",
                f"input u{i + 1}: a coefficient is known to {percent(part)} only; move the input more, or record more",
            )


def _useless(row: Row, point: Point, noise: Autoregression) -> Iterator[Finding]:
    """Inputs without which the record is as likely, by the Bayesian information criterion."""
    count = len(row.structures)
    useless = [i for i in range(count) if count > 1 and _is_left_out(row, point, noise, i)]
    if len(useless) > 1 and not _is_left_out(row, point, noise, *useless):
        named = " and ".join(f"u{i + 1}" for i in useless)
        yield Finding(
            "inconsistent", f"inputs {named} move together, and any of them explains what all do: move one alone"
        )
        return
    for i in useless:
        yield Finding("inconsistent", f"input u{i + 1} explains nothing of the output: leave it out")


def _is_left_out(row: Row, point: Point, noise: Autoregression, *left_out: int) -> bool:
    """Return whether the record is as likely without some of the inputs."""
    less = [k for k in range(len(row.structures)) if k not in left_out]
    power = sum(float(np.sum(row.whitened(noise, each.y, each) ** 2)) for each in row.stretches)
    if less:
        others = row.of_inputs(less)
        begins = start(others.structures, others.record, others.inputs, noise)
        power = min((refine(others, begin.theta, noise, begin).cost for begin in begins), default=power)
    size = sum(row.structures[i].size for i in left_out)
    return row.count * math.log(max(power, 1e-300) / max(point.cost, 1e-300)) < size * math.log(row.count)


def _lacking(row: Row, point: Point, noise: Autoregression) -> Iterator[Finding]:
    """What filters of the inputs could explain of the residual."""
    span = sum(each.inputs[0].span for each in row.stretches)
    model = AuxiliaryModel(Structure(1), row.dt)
    cutoffs = np.geomspace(5.0 / span, 1.0 / row.dt, FILTERS)

    def columns(stretch: Stretch) -> FloatArray:
        runs = [model.run(np.array([p, p, 0.0, 0.0]), record).output for record in stretch.inputs for p in cutoffs]
        return np.column_stack([*runs, *(record.u for record in stretch.inputs)])

    significance, power = _explained(row, point, noise, columns)
    whole = sum(float(np.sum(row.whitened(noise, each.y, each) ** 2)) for each in row.stretches)
    part = power / max(whole, 1e-300)
    if significance > 1.0 and part > MATTERS:
        yield Finding(
            "inconsistent",
            f"the inputs could explain a further {percent(part)} of the output's power ({figure(significance)} times "
            "the limit of chance): try more poles or zeros, or another dead time",
        )


def controlled(row: Row, point: Point, noise: Autoregression) -> Iterator[Finding]:
    """Inputs that answer to the residual."""
    for i in range(len(row.structures)):

        def later(stretch: Stretch, i: int = i) -> FloatArray:
            u = np.append(stretch.inputs[i].u, np.full(LATER, stretch.inputs[i].u[-1]))
            return np.column_stack([u[lag : lag + stretch.y.size] for lag in range(1, LATER + 1)])

        if _explained(row, point, noise, later)[0] > 1.0:
            yield Finding(
                "inconsistent",
                f"input u{i + 1} answers to disturbances of the output: a controller makes it, and the transfer "
                "functions may be off; move the inputs from outside",
            )


def _explained(
    row: Row, point: Point, noise: Autoregression, columns: Callable[[Stretch], FloatArray]
) -> tuple[float, float]:
    """Return a score statistic over its limit, and the power of the whitened error that columns explain beyond chance.

    The columns are whitened, and freed of what slopes, offset and initial states explain.
    """
    parts = []
    for stretch, phi in zip(row.stretches, point.phi, strict=True):
        white = row.whitened(noise, columns(stretch), stretch)
        _, _, free = row.signals(point.theta, stretch, np.zeros(row.nuisances - 1))
        parts.append((without(white, row.whitened(noise, free, stretch)), phi))
    white, phi = (np.concatenate(each) for each in zip(*parts, strict=True))
    error = np.concatenate(point.error)
    lengths = np.sqrt(np.einsum("ij,ij->j", white, white))
    if not lengths.any():
        return 0.0, 0.0
    left = without(white[:, lengths > 0.0], phi) / lengths[lengths > 0.0]
    basis = left @ orthogonal(products(left, left))
    if not basis.shape[1]:
        return 0.0, 0.0
    variance = point.cost / max(row.count - point.theta.size - row.nuisances * len(row.stretches), 1)
    power = float(np.sum(products(basis, error[:, None]) ** 2))
    chance = basis.shape[1] * variance
    limit = variance * chi2_quantile(1.0 - ALPHA, basis.shape[1]) * widening(basis, error)
    return power / max(limit, 1e-300), power - chance
