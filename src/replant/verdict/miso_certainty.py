"""How well each transfer function of a row is known: inputs that rest, that move together, or move too little."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np

from replant.estimation.simulation.miso import Point, Row
from replant.model.uncertainty import cancelled_pole, dc_gain_slope
from replant.numerics.arguments import FloatArray
from replant.numerics.levels import ROUNDING
from replant.numerics.linear_algebra import combined, inner, least_norm, products, roots, sum_of_squares
from replant.numerics.projections import WEAKEST
from replant.verdict.estimate_tests import MINOR_SCATTER, MOST_SCATTER, MOST_UNCERTAIN
from replant.verdict.evidence import relative_size
from replant.verdict.verdict import Finding, percent


def untold(row: Row, point: Point, covariance: FloatArray) -> list[Finding]:
    """Return findings on inputs that rest, or that move together."""
    at_rest = [
        Finding("not excited", f"input {name} does not move: move it, or leave it out")
        for i, name in enumerate(row.names)
        if not any(np.ptp(stretch.inputs[i].u) > 0.0 for stretch in row.stretches)
    ]  # the covariance of such an input is not known, nor is that of the others
    return [*at_rest, *_alike(row), *([] if at_rest else _together(row, point, covariance))]


def _alike(row: Row) -> Iterator[Finding]:
    """Yield pairs of inputs that are one signal, scaled: different structures separate them, the samples do not."""
    signals = np.concatenate([row.inputs[each.rows] - row.inputs[each.rows].mean(axis=0) for each in row.stretches])
    powers = np.sum(signals**2, axis=0)
    for i, j in itertools.combinations(np.flatnonzero(powers > 0.0).tolist(), 2):
        apart = signals[:, j] - signals[:, i] * inner(signals[:, i], signals[:, j]) / powers[i]
        if sum_of_squares(apart) <= ROUNDING * powers[j]:
            yield Finding(
                "not excited",
                f"inputs {row.names[i]} and {row.names[j]} move together as one signal: what one of them does is not "
                "told from what the other does; move one of them alone, or leave it out",
            )


def _together(row: Row, point: Point, covariance: FloatArray) -> Iterator[Finding]:
    """Yield pairs of inputs of whose gains only a sum is known."""
    places = row.places
    slopes = np.zeros((len(places), point.theta.size))  # of the gains b0/a0
    for number, (structure, rows) in enumerate(zip(row.structures, places, strict=True)):
        slopes[number, rows] = dc_gain_slope(structure, point.theta[rows])
    gains = slopes @ covariance @ slopes.T
    std = np.sqrt(np.maximum(np.diag(gains), 0.0))
    each = zip(row.structures, row.branches(point.theta), strict=True)
    sizes = [abs(theta[-1] / theta[structure.poles - 1]) for structure, theta in each]
    for i, j in itertools.combinations(range(len(places)), 2):
        if not std[i] * std[j] > 0.0:
            continue
        correlation = min(abs(gains[i, j]) / (std[i] * std[j]), 1.0)
        alone = math.sqrt(1.0 - correlation**2)  # factor on a deviation if the other gain were known
        # most of the variance comes from the other gain, and is what makes this one uncertain
        if alone**2 < 0.5 and any(alone * std[k] <= MOST_UNCERTAIN * sizes[k] < std[k] for k in (i, j)):
            yield Finding(
                "converging",
                f"inputs {row.names[i]} and {row.names[j]} move together: their gains correlate by {correlation:.3f}, "
                "and only a sum of them is known; move one of them alone",
            )


def unsure(row: Row, point: Point, covariance: FloatArray) -> Iterator[Finding]:
    """Yield, for each input, that a zero may cancel a pole, or else that response or coefficients are not known."""
    driven, advice = row.from_outside, "move the input more, or record more"
    whole, parts = _scatter(driven, point, covariance)
    sizes = relative_sizes(driven, point, np.sqrt(np.maximum(np.diag(covariance), 0.0)))
    for i, (structure, rows) in enumerate(zip(row.structures, row.places, strict=True)):
        made, name = parts[i], f"input {row.names[i]}"
        pole = cancelled_pole(structure, point.theta[rows], covariance[rows, rows])
        if pole is not None:
            # if the modelled output is known well, that does not prevent trust
            status = "trusted" if whole <= MINOR_SCATTER else "converging"
            reason = f"a zero may cancel the pole near {pole.real + 0.0:.3g}"  # not -0
            yield Finding(status, f"{name}: {reason}: ask for one pole and zero fewer of it")
        elif not max(made, whole if made == max(parts) else 0.0) <= MOST_SCATTER:
            reason = f"the uncertainty of its transfer function amounts to {percent(made)} of its part of the output"
            yield Finding("converging", f"{name}: {reason}; {advice}")
        elif not sizes[i] <= MOST_UNCERTAIN and not made <= MINOR_SCATTER:
            yield Finding("converging", f"{name}: a coefficient is known to {percent(sizes[i])} only; {advice}")


def _scatter(row: Row, point: Point, covariance: FloatArray) -> tuple[float, list[float]]:
    """Return the relative standard deviation, by the estimate's error, of the modelled output, and by each input.

    The nuisances are estimated anew for each model.
    """
    runs = []
    for stretch, nuisances in zip(row.stretches, point.nuisances, strict=True):
        output, slopes, free = (each[stretch.measured] for each in row.signals(point.theta, stretch, nuisances))
        both = np.hstack([output, slopes])
        runs.append(both - combined(free, least_norm(free, both, WEAKEST)[0]))
    both = np.concatenate(runs)
    both -= both.mean(axis=0)
    outputs, slopes = both[:, : len(row.places)], both[:, len(row.places) :]
    spread = products(slopes, slopes) / len(slopes)

    def relative(rows: slice, output: FloatArray) -> float:
        made, variance = float(output.std()), float(np.trace(covariance[rows, rows] @ spread[rows, rows]))
        return math.sqrt(max(variance, 0.0)) / made if made > 0.0 else math.inf

    parts = [relative(rows, output) for rows, output in zip(row.places, outputs.T, strict=True)]
    return relative(slice(None), outputs.sum(axis=1)), parts


def relative_sizes(row: Row, point: Point, step: FloatArray) -> list[float]:
    """Return the largest relative change of a coefficient by a step (P,) for each input, see `relative_size`."""
    runs = [row.signals(point.theta, stretch) for stretch in row.stretches]
    outputs, slopes = (np.concatenate([run[part] for run in runs]) for part in (0, 1))
    sizes = []
    for structure, rows, output in zip(row.structures, row.places, outputs.T, strict=True):
        magnitudes = np.abs(roots(np.append(1.0, point.theta[rows][structure.denominator])))
        speeds = np.maximum(magnitudes, 1.0 / row.record.span)
        sizes.append(relative_size(step[rows], speeds, slopes[:, rows][:, structure.numerator], output))
    return sizes
