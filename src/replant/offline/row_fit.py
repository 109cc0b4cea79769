"""fit of several inputs: a row of transfer functions, each with poles and a dead time of its own, and one output."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from replant.arguments import FloatArray, array_of_reals, iterable, vector
from replant.assessment import fit_percent
from replant.assessment.row_tests import controlled, left_out
from replant.assessment.verdict import Finding, Verdict
from replant.errors import InvalidArgumentError, shown
from replant.identified.fields import Provenance
from replant.identified.row_model import RowModel, one_step_percent
from replant.limits import duration, increasing
from replant.log import Log
from replant.model.noise import NoiseModel
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.offline.row_start import start
from replant.offline.row_steps import refine
from replant.offline.row_verdict import judged
from replant.offline.samples import Samples
from replant.simulation.row import Point, Row, RowRecord, noise_of
from replant.statistics.autoregression import Autoregression
from replant.statistics.linear_algebra import chi2_quantile, compose, factor_information, quiet
from replant.statistics.projections import products

GIVEN_UP = (
    "the structure leaves slow parts of the output, which a noise model would take for noise: none was used; try more "
    "poles, or a further input"
)

ROUNDS = 3  # times that the noise model is estimated [count]
SHORT = 12  # steps after each [count]

LOUD = 3.0
"""Power of a residual beside that of the quietest begin, beyond which the begin is not taken [ratio].
Origin: measured on random rows: whitened steps from a begin that lacks a slow branch leave ten times the power.
Sensitivity: not measured.
"""

SAME = 0.99
"""Level of the test that the estimates with and without the noise model are of one plant [probability].
Level: 99 %.
"""


@dataclass(frozen=True, eq=False, repr=False)
class RowFit:
    r"""The result of `fit` with several inputs.

    .. math:: y = \sum_i \frac{B_i(s)}{A_i(s)} e^{-s\,\mathrm{delay}_i} u_i + \mathrm{offset} + \mathrm{noise}

    Attributes
    ----------
    model : RowModel
        What is worth keeping: each G(s), working point, names, joint uncertainty, noise model, fit and verdict.
    output : (K,) array
        Simulated from the inputs alone, offset and initial states estimated; NaN where an input cannot be used.
    """

    model: RowModel
    output: FloatArray

    @property
    def transfer_functions(self) -> tuple[TransferFunction, ...]:
        """G(s) from each input."""
        return self.model.transfer_functions

    @property
    def parameters(self) -> FloatArray:
        """In physical units (P,): a_{n-1} .. a_0, b_m .. b_0 of the first input, then of the next."""
        return self.model.parameters

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in their order, each with that of its input."""
        return self.model.names

    @property
    def covariance(self) -> FloatArray:
        """Of the parameters (P, P), jointly."""
        assert self.model.covariance is not None, "a fit has a covariance"
        return self.model.covariance

    @property
    def uncertainty(self) -> tuple[Uncertainty, ...]:
        """Standard deviations of each G(s): of its parameters, poles, gain and response."""
        assert self.model.uncertainty is not None, "a fit has a covariance"
        return self.model.uncertainty

    @property
    def noise(self) -> NoiseModel:
        """The autoregression of the residual; white where the noise model had to be given up, see `verdict`."""
        assert self.model.noise is not None, "a fit has a noise model"
        return self.model.noise

    @property
    def fit(self) -> float:
        """Of ``output``, in percent."""
        return self.model.simulated_fit

    @property
    def samples(self) -> int:
        """Outputs used."""
        return self.model.provenance.samples

    @property
    def verdict(self) -> Verdict:
        """Whether to trust the row, and why in plain words."""
        return self.model.verdict

    def __repr__(self) -> str:
        pairs = zip(self.model.input_names, self.transfer_functions, strict=True)
        head = f"RowFit of {self.samples} samples, fit {self.fit:.2f} %, {self.verdict.status}"
        reasons = (f"  {reason}" for reason in self.verdict.reasons)
        return "\n".join([head, *(f"  {name}: {g}" for name, g in pairs), *reasons])


def is_row(u: Any, *orders: Any) -> bool:
    """Return whether several inputs are asked for: by columns, by a log of several, or by an entry for each."""
    columns = isinstance(u, np.ndarray) and u.ndim == 2
    logs = u if isinstance(u, list | tuple) else [u]
    several = any(isinstance(each, Log) and each.more_inputs for each in logs)
    return columns or several or any(isinstance(each, tuple) for each in orders)


@quiet
def fit_row(given: Samples, poles: Any, zeros: Any = 0, delay: Any = 0.0) -> RowFit:
    """Return the fit of a row to samples of several inputs, see `replant.offline.fit.fit`."""
    columns = _inputs(given.inputs)
    output, dt = vector("y", given.y), duration("dt", given.dt)
    if output.size != len(columns):
        raise InvalidArgumentError(f"u has {len(columns)} rows and y {output.size} samples: give one row for each")
    structures = structures_of(columns.shape[1], poles, zeros, delay)
    stamps = None if given.t is None else increasing(given.t, output.size)
    ready = RowRecord.of(columns, output, dt, stamps, given.input_hold, given.begins)
    record, inputs = ready.record, ready.inputs
    size = sum(each.size + each.poles for each in structures) + 1
    if record.count <= size:
        raise InvalidArgumentError(
            f"the record has {record.count} usable samples, fewer than the {size + 1} that {size} unknowns need: "
            "record more, or ask for fewer poles and zeros"
        )
    longest = max(each.delay for each in structures)
    if not longest < record.span:
        raise InvalidArgumentError(
            f"the dead time of {longest:g} s is no shorter than the record, which lasts {record.span:.6g} s"
        )
    begins = start(structures, record, inputs)
    if not begins:
        raise InvalidArgumentError("no model is found for this record: the inputs hardly move, or the output does not")
    row = Row(structures, record, inputs, given.input_names)
    free, point, noise = _likeliest(row, begins, partial(start, structures, record, inputs))
    covariance, others = _covariance(row, point), list(controlled(row, point, noise))
    rest = {name: signal[ready.used] for name, signal in given.others.items() if name not in given.more_inputs}
    # in feedback the estimate without a noise model is that which is off
    if not others and _differs(row, free, point):
        covariance = _covariance(row, free, noise_of(row, free))
        point, noise = free, Autoregression.white(1.0, row.count)
        others = [Finding("inconsistent", GIVEN_UP)]
    others += left_out(row, point, noise, rest)
    simulated = ready.simulated(row, point, noise)
    left = max(row.count - size, 1)
    levels, level = ready.levels(row, point)
    model = RowModel(
        structures,
        point.theta,
        dt,
        covariance=covariance,
        noise=NoiseModel(noise.coefficients, point.cost / left, point.power / left, dt),
        input_hold=given.input_hold,
        input_names=row.names,
        output_name=given.output_name,
        input_levels=levels,
        output_level=level,
        simulated_fit=fit_percent(output, simulated),
        one_step_fit=one_step_percent(row, point),
        verdict=judged(row, record, point, noise, covariance, others),
        provenance=Provenance("srivc", given.source, given.sha256, row.count),
    )
    return RowFit(model, simulated)


def structures_of(inputs: int, poles: Any, zeros: Any, delay: Any) -> tuple[Structure, ...]:
    """Return the structure of each of several inputs; a single number of zeros or dead time is that of all.

    >>> structures_of(2, (2, 1), 0, (0.0, 0.3))[1].delay
    0.3
    """
    if not iterable(poles):
        raise InvalidArgumentError(
            f"u has {inputs} inputs: give the number of poles of each, poles=({', '.join(['1'] * inputs)})"
        )
    given = {"poles": poles, "zeros": zeros, "delay": delay}
    each: dict[str, list[Any]] = {k: list(v) if iterable(v) else [v] * inputs for k, v in given.items()}
    for name, values in each.items():
        if len(values) != inputs:
            raise InvalidArgumentError(
                f"{name} has {len(values)} {'entry' if len(values) == 1 else 'entries'} and u {inputs} "
                f"{'input' if inputs == 1 else 'inputs'}: give one entry for each"
            )
    structures = tuple(Structure(*values) for values in zip(*each.values(), strict=True))
    total = sum(structure.poles for structure in structures)
    if total > Structure.MOST_POLES:
        raise InvalidArgumentError(f"poles must be at most {Structure.MOST_POLES} in all, got {total}")
    return structures


def _inputs(u: Any) -> FloatArray:
    columns = np.asarray(array_of_reals("u", u), np.float64)
    if columns.ndim != 2 or not columns.shape[1]:
        raise InvalidArgumentError(
            f"u must have a column for each input, shape (K, q), got shape {shown(columns.shape)}"
        )
    return columns


def _likeliest(row: Row, begins: list[Point], again: Callable[[Autoregression], list[Point]]) -> _Estimates:
    """Return the estimate without a noise model and the likeliest with one.

    The start is made again with the noise model: beside slow noise the first one may lack what is fast.  No estimate is
    taken whose residual is `LOUD` times the quietest: its noise model has taken a branch for noise.
    """
    white = Autoregression.white(1.0, row.count)
    free = min((refine(row, begin.theta, white, begin) for begin in begins), key=lambda point: point.cost)
    noise = noise_of(row, free)
    found = []
    for begin in [free, *(again(noise) if noise.order else [])]:
        point, model = refine(row, begin.theta, noise, begin, SHORT), noise
        for _ in range(ROUNDS - 1):
            model = noise_of(row, point)
            point = refine(row, point.theta, model, point, SHORT)
        found.append(_Estimates(free, point, model))
    quietest = min(each.point.power for each in found)
    return min((each for each in found if each.point.power <= LOUD * quietest), key=lambda each: each.point.cost)


class _Estimates(NamedTuple):
    """The estimate without a noise model, that with one, and the model."""

    free: Point
    point: Point
    noise: Autoregression


def _covariance(row: Row, point: Point, colour: Autoregression | None = None) -> FloatArray:
    """Return the covariance (P, P) of a point: s^2 M^-1, or M^-1 Q M^-1 where its error has a colour.

    Q is the sum of the squares of the slopes filtered by 1/D backwards in time, times the variance of D e.
    """
    size = point.theta.size + row.nuisances * len(row.stretches)
    inverse = compose(*factor_information(point.information))
    if colour is None:
        return np.asarray(inverse * point.cost / max(row.count - size, 1))
    backwards = [colour.colour(phi[::-1]) for phi in point.phi]
    squares = np.asarray(sum(products(each, each) for each in backwards))
    variance = colour.power / max(colour.count - size, 1.0)
    return np.asarray(variance * inverse @ squares @ inverse)


def _differs(row: Row, free: Point, point: Point) -> bool:
    """Return whether the estimate with a noise model leaves more than chance allows beside that without.

    Both are consistent where the structure is right: beyond the least power the one leaves at most chi-square of the
    number of parameters, in powers of as many samples as the residual has independent ones.  Where the structure is not
    right, an autoregression takes what it cannot explain for noise, and with it the slow branches.
    """
    independent = row.count / max(_duration(free), 1.0)
    return point.power > free.power * (1.0 + chi2_quantile(SAME, point.theta.size) / independent)


def _duration(point: Point) -> float:
    """Return the integrated correlation of a residual in samples, up to the first pair of lags that is not positive.

    Source: Geyer (1992), "Practical Markov Chain Monte Carlo", section 3.3.
    """
    sums = np.zeros(1 << int(np.ceil(np.log2(2 * max(each.size for each in point.residual)))))
    for residual in point.residual:
        sums += np.fft.irfft(np.abs(np.fft.rfft(residual, sums.size)) ** 2, sums.size)
    pairs = (sums[0 : sums.size // 2 : 2] + sums[1 : sums.size // 2 : 2]) / max(float(sums[0]), 1e-300)
    positive = int(np.argmax(pairs <= 0.0)) if (pairs <= 0.0).any() else pairs.size
    return 2.0 * float(pairs[:positive].sum()) - 1.0
