"""Tests of what a row leaves: of what its inputs explain further, and of inputs that answer to it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from replant.estimation.simulation.auxiliary_model import AuxiliaryModel
from replant.estimation.simulation.miso import Point, Row
from replant.estimation.solver import feedback_test
from replant.estimation.solver.change_contest import HARMLESS
from replant.model.structure import Structure
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ALPHA, MATTERS
from replant.numerics.linear_algebra import chi2_quantile, combined, inverse_of, products, sum_of_squares
from replant.numerics.projections import orthogonal, widening, without
from replant.verdict.evidence import rounding_of
from replant.verdict.verdict import Finding, figure, percent

FILTERS = 8  # first-order filters of each input that its transfer function is tested against [count]


def lacking(row: Row, point: Point, noise: Autoregression, covariance: FloatArray | None = None) -> Iterator[Finding]:
    """What filters of the inputs could explain of the residual, of a model with a covariance of another record too."""
    signals = row.inputs if row.outside is None else row.outside.signals
    significance, part = _of_filters(row, point, noise, *signals.T, covariance=covariance)
    if significance > 1.0 and part > MATTERS:
        yield Finding(
            "inconsistent",
            f"the inputs could explain a further {percent(part)} of the output's power ({figure(significance)} times "
            "the limit of chance): try more poles or zeros, or another dead time",
        )


def moved(row: Row, point: Point, noise: Autoregression, covariance: FloatArray) -> Iterator[Finding]:
    """The input whose response has changed most since an estimate was made, if one has, beyond chance.

    A step from the estimate, d = (sum zeta phi')^-1 sum zeta e, is compared with its covariance and the estimate's.  By
    how much is the amplitude of phi_i' d_i beside that of the branch's output x_i.
    """
    phi, zeta, error = (np.concatenate(each) for each in (point.phi, point.zeta, point.error))
    if _is_rounding(row, point):
        return
    inverse = inverse_of(products(zeta, phi))
    step = inverse @ products(zeta, error)
    variance = point.cost / max(row.count - step.size - row.nuisances * len(row.stretches), 1)
    spread = variance * inverse @ products(zeta, zeta) @ inverse.T + covariance
    basis = combined(zeta, orthogonal(products(zeta, zeta)))
    limit = chi2_quantile(1.0 - ALPHA, step.size) * widening(basis, without(error[:, None], zeta)[:, 0], variance)
    if not float(step @ inverse_of(spread) @ step) > limit:  # nor where it is NaN: the samples do not tell
        return
    states, parts = np.zeros(row.nuisances - 1), []
    outputs = np.concatenate([row.whitened(noise, row.signals(point.theta, s, states)[0], s) for s in row.stretches])
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
    """The input whose part of the output differs most between the estimate and a model as likely, if that matters."""
    own = _parts(row, point.theta)
    size, name, largest = float(own.sum(axis=1).std()), "", 0.0
    for theta in rivals:
        parts = np.std(_parts(row, theta) - own, axis=0)
        if float(parts.max()) > largest:
            name, largest = row.names[int(parts.argmax())], float(parts.max())
    if largest > math.sqrt(MATTERS) * size:
        yield Finding(
            "converging",
            f"another model is as likely, with another response to input {name}: move that input more, or record more",
        )


def _parts(row: Row, theta: FloatArray) -> FloatArray:
    """Return what the inputs make of the measured outputs (K, q), each stretch from rest."""
    states = np.zeros(row.nuisances - 1)
    return np.concatenate([row.signals(theta, each, states)[0][each.measured] for each in row.stretches])


def _power(row: Row, noise: Autoregression) -> float:
    """Return the sum of squares of the whitened output."""
    return sum(float(np.sum(row.whitened(noise, each.y, each) ** 2)) for each in row.stretches)


def left_out(row: Row, point: Point, noise: Autoregression, others: Mapping[str, FloatArray]) -> Iterator[Finding]:
    """The column (K,) beside the inputs that could explain most of the residual, if one could."""
    found = [(*_of_filters(row, point, noise, signal), name) for name, signal in others.items() if _moves(signal)]
    for significance, part, name in sorted(found, reverse=True)[:1]:
        if significance > 1.0 and part > MATTERS:
            yield Finding(
                "inconsistent",
                f"column {name} could explain a further {percent(part)} of the output's power: make it an input, too",
            )


def _moves(signal: FloatArray) -> bool:
    return bool(np.isfinite(signal).all() and np.ptp(signal) > 0.0)


def controlled(row: Row, point: Point, noise: Autoregression) -> Iterator[Finding]:
    """Inputs that answer to the residual, beside those that references move."""
    free = range(len(row.structures)) if row.outside is None else np.flatnonzero(~row.outside.is_moved).tolist()
    # what is too small to matter, as what a filter that looks ahead puts into both, is not named
    least = HARMLESS**2 * _power(row, noise)
    for i in free:
        if _answers(row, point, i, row.inputs[:, i], least):
            yield Finding(
                "inconsistent",
                f"input {row.names[i]} answers to disturbances of the output: a controller makes it, and the transfer "
                "functions may be off; give what is applied from outside, as a set-point or a dither, as the reference",
            )


def answering(row: Row, point: Point) -> BoolArray:
    """Return which inputs (q,) answer to the residual by what does not come from outside of them."""
    found = np.zeros(len(row.structures), bool)
    if row.outside is not None:
        inside = row.inputs - row.outside.inputs  # of one in a loop only the noise is left
        for i in np.flatnonzero(row.outside.is_moved).tolist():
            found[i] = _answers(row, point, i, inside[:, i])
    return found


def _answers(row: Row, point: Point, number: int, signal: FloatArray, least: float = 0.0) -> bool:
    """Return whether a signal (K,) of an input answers the whitened residual, from the power ``least`` of that on."""
    if _is_rounding(row, point):
        return False
    left, signal = np.zeros(signal.size), signal - signal.mean()
    for stretch, error in zip(row.stretches, point.error, strict=True):
        left[stretch.rows] = error
    # where the structure is not right the other inputs explain some of the residual, and the input may follow them: the
    # answer must be one beside them, too
    others = [u - u.mean() for u in np.delete(row.inputs, number, axis=1).T]
    first = int(row.record.input_hold == "foh" and row.structures[number].delay < row.dt)  # a model with a direct path
    told = (feedback_test.answering(signal, left, row.record.inputs_before, first, each) for each in (others, ()))
    return all(answer.found and answer.part * point.cost > least for answer in told)


def _of_filters(
    row: Row, point: Point, noise: Autoregression, *signals: FloatArray, covariance: FloatArray | None = None
) -> tuple[float, float]:
    """Return what signals (K,), and filters of them, explain of the error: in limits of chance, and of the output."""
    if _is_rounding(row, point):
        return 0.0, 0.0
    model, span = AuxiliaryModel(Structure(1), row.dt), sum(each.inputs[0].span for each in row.stretches)
    cutoffs, parts = np.geomspace(5.0 / span, 1.0 / row.dt, FILTERS), []
    for stretch in row.stretches:
        given = [np.ascontiguousarray(each[stretch.rows] - each[stretch.rows][0]) for each in signals]
        records = [replace(stretch.inputs[0], u=each) for each in given]
        runs = [model.run(np.array([p, p, 0.0, 0.0]), record).output for record in records for p in cutoffs]
        _, _, free = row.signals(point.theta, stretch, np.zeros(row.nuisances - 1))
        columns = np.column_stack([*runs, *given])
        parts.append(without(*(row.whitened(noise, each, stretch) for each in (columns, free))))
    white, phi, error = (np.concatenate(each) for each in (parts, point.zeta, point.error))
    lengths = np.sqrt(np.einsum("ij,ij->j", white, white))
    if not lengths.any():
        return 0.0, 0.0
    # a model of this record explains what its instruments do; the error of one of another is larger, by its covariance
    left = white[:, lengths > 0.0] if covariance is not None else without(white[:, lengths > 0.0], phi)
    left = left / lengths[lengths > 0.0]
    basis = combined(left, orthogonal(products(left, left)))
    if not basis.shape[1]:
        return 0.0, 0.0
    known = point.theta.size if covariance is None else 0
    variance = point.cost / max(row.count - known - row.nuisances * len(row.stretches), 1)
    amounts, spread = products(basis, error[:, None])[:, 0], variance * np.eye(basis.shape[1])
    if covariance is not None:
        along = products(basis, phi)
        spread = spread + along @ covariance @ along.T
    statistic = float(amounts @ np.linalg.lstsq(spread, amounts, rcond=None)[0])
    limit = chi2_quantile(1.0 - ALPHA, basis.shape[1]) * widening(basis, error - combined(basis, amounts), variance)
    power = float(amounts @ amounts) - float(np.trace(spread))
    return statistic / max(limit, 1e-300), power / max(_power(row, noise), np.finfo(float).tiny)


def _is_rounding(row: Row, point: Point) -> bool:
    """Return whether the residual is rounding, of the log's numbers or of the sensor's steps: nothing is told by it."""
    output, error = (
        np.concatenate([each[stretch.measured] for each, stretch in zip(signals, row.stretches, strict=True)])
        for signals in ([stretch.y for stretch in row.stretches], point.residual)
    )
    return not float(error.std()) > rounding_of(output - error, output)
