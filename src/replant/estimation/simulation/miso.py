"""A row of transfer functions over a record: outputs, slopes, offset and initial states.

With x_i = B_i/A_i u_i the slopes are dx_i/da_k = -s^k/A_i x_i and dx_i/db_k = s^k/A_i u_i, exact for a held input.
All branches share one error e = y - sum_i x_i.  Slopes and error are whitened by an autoregression D; a constant and
initial states are projected out of them, part by part.

The instruments zeta are the slopes themselves or, if references move inputs, the slopes with the external signals.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from replant.errors import InvalidArgumentError
from replant.estimation.engine.record import Record
from replant.estimation.simulation.auxiliary_model import AuxiliaryModel, Branches, records_of
from replant.estimation.simulation.miso_exogenous import Outside
from replant.model.preprocess import accepted
from replant.model.structure import Structure, places_of
from replant.numerics.arguments import BoolArray, FloatArray, IntArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ROUNDING
from replant.numerics.linear_algebra import combined, poles_of, products, quiet, sum_of_squares
from replant.numerics.projections import lengths_of, orthogonal

NEAR_AXIS = 1e-6  # distance from the axis of a pole that is put on it [1 / duration]
ROUNDS = 8  # moves of a first-order result until a branch is stable [count]


@dataclass(frozen=True, eq=False)
class Stretch:
    """A stretch without a gap; the offset and the initial states in it are its own."""

    rows: slice  # of the whole record
    inputs: tuple[Record, ...]  # one per input, whose outputs are zero
    y: FloatArray  # (K,): zero where not measured
    measured: BoolArray  # (K,): which outputs were measured, and depend on inputs of the stretch alone
    known: IntArray  # (K,): predecessors of each, see `Record.predecessors`
    outside: tuple[Record, ...] | None = None  # the external part of each input, if references move some


class Row:
    """The structure of a row, one branch per input, and a record for it with its inputs (K, q)."""

    def __init__(
        self,
        structures: tuple[Structure, ...],
        record: Record,
        inputs: FloatArray,
        names: tuple[str, ...] = (),
        outside: Outside | None = None,
        *,
        common: bool = False,  # whether all branches share one denominator, which theta then has once
    ) -> None:
        self.structures, self.is_common, self.record, self.inputs = structures, common, record, inputs
        self.outside = outside
        self.names = names or tuple(f"u{i}" for i in range(1, len(structures) + 1))
        self.dt = float(np.median(record.intervals[-(record.intervals.size // 2 + 1) :]))
        self._models = Branches(structures, self.dt, record.input_hold)
        self._twins = self._models.copy() if outside is not None else None  # they run the external parts
        self._shared = AuxiliaryModel(replace(structures[0], zeros=structures[0].poles - 1, delay=0.0), self.dt)
        self.nuisances = 1 + sum(each.poles for each in structures)
        self.stretches = tuple(self._stretches())
        self.places = places_of(structures)  # of the coefficients of each branch, each with its own denominator

    @classmethod
    def of_one(cls, structure: Structure, record: Record) -> Row:
        """Return the row of one input, that of the record."""
        return cls((replace(structure, bias=False),), record, record.u[:, None])

    def _stretches(self) -> Iterator[Stretch]:
        for rows in self.record.parts:
            part = self.record.part(rows)
            measured = part.is_measured.copy()
            measured[: max(part.unknown(each.delay) for each in self.structures)] = False
            if int(measured.sum()) <= self.nuisances:
                continue  # its offset and initial states explain all of it
            driving = [self.inputs] if self.outside is None else [self.inputs, self.outside.inputs]
            columns = [each[rows] - each[rows][0] for each in driving]
            given, *outside = (records_of(each, part.intervals, part.input_hold) for each in columns)
            known = replace(part, measured=measured).predecessors
            yield Stretch(rows, given, np.where(measured, part.y, 0.0), measured, known, *outside)

    def of_inputs(self, chosen: list[int]) -> Row:
        """Return the row with some of the inputs only."""
        structures, names = tuple(self.structures[i] for i in chosen), tuple(self.names[i] for i in chosen)
        outside = None if self.outside is None else self.outside.of_inputs(chosen)
        return Row(structures, self.record, self.inputs[:, chosen], names, outside)

    def over(self, record: Record, inputs: FloatArray | None = None) -> Row:
        """Return the row over another record, without references; of the same inputs, or of others."""
        return Row(self.structures, record, self.inputs if inputs is None else inputs, self.names)

    def part(self, rows: slice) -> Row:
        """Return the row of some of the samples."""
        return self.over(self.record.part(rows), self.inputs[rows])

    def parted(self, begin: int) -> tuple[Row, Row]:
        """Return the row before and since a sample."""
        return self.over(self.record.first(begin), self.inputs[:begin]), self.last(self.record.u.size - begin)

    def last(self, samples: int) -> Row:
        """Return the row over the newest samples."""
        outside = None if self.outside is None else self.outside.last(samples)
        return Row(self.structures, self.record.last(samples), self.inputs[-samples:], self.names, outside)

    @property
    def from_outside(self) -> Row:
        """The row driven by the external parts of its inputs alone: this one if no reference moves one."""
        return self if self.outside is None else self.over(self.record, self.outside.inputs)

    @property
    def count(self) -> int:
        """The number of outputs that are used."""
        return sum(int(each.measured.sum()) for each in self.stretches)

    def branches(self, theta: FloatArray) -> list[FloatArray]:
        """Return the coefficients of each branch, a_{n-1} .. a_0, b_m .. b_0."""
        if not self.is_common:
            return [theta[rows] for rows in self.places]
        poles = self.structures[0].poles
        sizes = np.cumsum([each.zeros + 1 for each in self.structures])[:-1].tolist()
        return [np.concatenate([theta[:poles], b]) for b in np.split(theta[poles:], sizes)]

    def slowest(self, theta: FloatArray) -> int:
        """Return the number of the branch with the slowest pole."""
        return self._models.slowest(self.branches(theta))

    def poles(self, theta: FloatArray) -> list[npt.NDArray[np.complex128]]:
        """Return the poles of each branch."""
        pairs = zip(self.structures, self.branches(theta), strict=True)
        return [poles_of(branch[structure.denominator].tobytes()) for structure, branch in pairs]

    def is_stable(self, theta: FloatArray) -> bool:
        """Whether all poles lie left of the imaginary axis."""
        return bool(np.isfinite(theta).all()) and all(poles.real.max() < 0.0 for poles in self.poles(theta))

    @quiet
    def on_axis(self, theta: FloatArray, along: Callable[[FloatArray], FloatArray]) -> tuple[FloatArray, float]:
        """Return theta (P,) with unstable poles put on the axis, and the square of the move in standard deviations.

        The estimate under the constraint c' theta = 0 is theta - C c (c' theta) / (c' C c); ``along`` returns C c.  The
        slope of a pole p by a_k is -p^k / A'(p).
        """
        theta, moved = theta.copy(), 0.0
        for rows, structure in zip(self.places, self.structures, strict=True):
            for _ in range(ROUNDS):
                a = theta[rows][structure.denominator]
                poles = poles_of(a.tobytes())
                pole = poles[np.argmax(poles.real)]
                if not pole.real >= 0.0:
                    break
                orders = np.arange(structure.poles, 0.0, -1.0)
                slope, powers = np.zeros(theta.size), pole ** (orders - 1.0)
                slope[rows][structure.denominator] = (-powers / ((orders * np.append(1.0, a[:-1])) @ powers)).real
                way = along(slope)
                variance = float(slope @ way)
                theta -= way * (pole.real + NEAR_AXIS / self.record.span) / variance
                moved += float(pole.real**2 / variance)
        return theta, moved

    def signals(
        self, theta: FloatArray, stretch: Stretch, weights: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the outputs (K, q) of the branches from rest, the slopes (K, P) and the nuisances (K, N).

        The slopes are those of runs with weights (N,) of the nuisances, see `Branches`, or from rest.
        """
        weights, branches = np.zeros(self.nuisances) if weights is None else weights, self.branches(theta)
        outputs, slopes, free = self._models.run(branches, weights, stretch.inputs)
        parts = self._models.parts(branches, weights, free)
        outputs = [each - part for each, part in zip(outputs, parts, strict=True)]
        if self.is_common:
            poles = self.structures[0].poles
            slopes = [np.sum([each[:, :poles] for each in slopes], axis=0), *(each[:, poles:] for each in slopes)]
        return np.column_stack(outputs), np.hstack(slopes), free

    def instruments(self, theta: FloatArray, stretch: Stretch, weights: FloatArray) -> FloatArray | None:
        """Return the slopes (K, P) with the external parts, and the same nuisances; None if all are external."""
        if self._twins is None or stretch.outside is None:
            return None
        return np.hstack(self._twins.run(self.branches(theta), weights, stretch.outside)[1])

    def ended(self, theta: FloatArray, stretch: Stretch, weights: FloatArray) -> list[Branches]:
        """Return the branches, and those of the instruments if there are any, in their states after a stretch."""
        driven = zip((self._models, self._twins), (stretch.inputs, stretch.outside), strict=True)
        ended = [(models.copy(), records) for models, records in driven if models is not None and records is not None]
        for models, records in ended:
            models.run(self.branches(theta), weights, records)
        return [models for models, _ in ended]

    def whitened(self, noise: Autoregression, signals: FloatArray, stretch: Stretch) -> FloatArray:
        """Return D signals (K, ...) of a stretch; zero where nothing was measured."""
        white = noise.whiten_known(signals, stretch.known)
        rows = stretch.measured if signals.ndim == 1 else stretch.measured[:, None]
        return np.asarray(np.where(rows, white, 0.0))

    def filtered(self, theta: FloatArray, stretch: Stretch, error: FloatArray) -> FloatArray:
        """Return s^k/A e (K, n), k = n - 1 .. 0, of the common denominator: it is subtracted from a model's slopes."""
        poles = self.structures[0].poles
        model = np.concatenate([theta[:poles], np.zeros(2 * poles + 1)])
        return self._shared.run(model, replace(stretch.inputs[0], u=error)).zeta[:, poles : 2 * poles]


@dataclass(frozen=True, eq=False)
class Point:
    """A model of a row and its residual, stretch by stretch; zero where nothing was measured."""

    theta: FloatArray  # (P,)
    error: list[FloatArray]  # (K,) each: whitened, offset and initial states projected out
    phi: list[FloatArray]  # (K, P) each: the same of the slopes
    zeta: list[FloatArray]  # (K, P) each: the same of the instruments; ``phi`` if all inputs are external
    residual: list[FloatArray]  # (K,) each: not whitened
    nuisances: list[FloatArray]  # (N,) each: weights of the nuisances, see `Branches`
    slowest: int  # the branch with the slowest pole
    cost: float  # sum of squares of ``error``

    @property
    def information(self) -> FloatArray:
        """Sum of phi phi' (P, P)."""
        return summed(self.phi, self.phi)

    @property
    def power(self) -> float:
        """Sum of squares of ``residual``."""
        return float(sum(sum_of_squares(each) for each in self.residual))


@quiet
def evaluate(
    row: Row, theta: FloatArray, noise: Autoregression, before: Point | None = None, *, pulled: bool = False
) -> Point:
    """Return the point of a model; ``pulled``: phi along a common denominator is of the measured output, not zeta."""
    error, phi, zeta, residual, nuisances = [], [], [], [], []
    slowest = row.slowest(theta)
    for number, stretch in enumerate(row.stretches):
        # of another slowest branch the weights have another meaning
        is_known = before is not None and before.slowest == slowest
        given = before.nuisances[number] if before is not None and is_known else np.zeros(row.nuisances)
        outputs, slopes, free = row.signals(theta, stretch, given)
        left = stretch.y - outputs.sum(axis=1)
        nuisance = free.shape[1]
        white = row.whitened(noise, np.column_stack([free, left, slopes]), stretch)
        basis, back = _basis(white[:, :nuisance])
        weights = back @ (products(basis, white[:, nuisance]))
        e = np.where(stretch.measured, left - combined(free, weights), 0.0)
        white[:, nuisance] -= combined(white[:, :nuisance], weights)
        made = _freed(white[:, nuisance:], basis)
        error.append(made[:, 0])
        phi.append(made[:, 1:])
        instruments = row.instruments(theta, stretch, given)
        zeta.append(phi[-1] if instruments is None else _freed(row.whitened(noise, instruments, stretch), basis))
        if pulled:
            phi[-1] = phi[-1].copy()
            seen = row.whitened(noise, row.filtered(theta, stretch, e), stretch)
            phi[-1][:, : seen.shape[1]] -= _freed(seen, basis)
        residual.append(e)
        nuisances.append(weights)
    cost = float(sum(sum_of_squares(each) for each in error))
    return Point(theta, error, phi, zeta, residual, nuisances, slowest, cost if math.isfinite(cost) else math.inf)


def summed(columns: list[FloatArray], others: list[FloatArray]) -> FloatArray:
    """Return the sum over all stretches of a' b of columns a (K, P) and columns b (K, Q), or a signal b (K,)."""
    return np.asarray(sum(products(a, b) for a, b in zip(columns, others, strict=True)))


def _freed(columns: FloatArray, basis: FloatArray) -> FloatArray:
    """Return columns (K, C) with an orthonormal basis (K, R) projected out."""
    return columns - combined(basis, products(basis, columns)) if basis.shape[1] else columns


def _basis(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return an orthonormal basis (K, R) of columns (K, N), and the map (N, R) from its weights to theirs."""
    lengths = lengths_of(columns)
    scaled = columns / lengths
    turned = orthogonal(products(scaled, scaled))
    return combined(scaled, turned), turned / lengths[:, None]


def is_exact(row: Row, point: Point) -> bool:
    """Return whether the residual of a point is only rounding."""
    return point.power <= ROUNDING * sum(sum_of_squares(each.y) for each in row.stretches)


def noise_of(row: Row, point: Point) -> Autoregression:
    """Return the autoregression of a point's residual, one for all stretches; rounding counts as white."""
    return Autoregression.white(point.power, row.count) if is_exact(row, point) else colour_of(row, point.residual)


def colour_of(row: Row, signals: list[FloatArray]) -> Autoregression:
    """Return the autoregression of a signal (K,) of each stretch, one for all."""
    return Autoregression.of_stretches(signals, [stretch.known for stretch in row.stretches], row.count)


@dataclass(frozen=True, eq=False)
class RowRecord:
    """A prepared record of several inputs, and what it was made from."""

    record: Record  # its input is the first one
    inputs: FloatArray  # (J, q)
    used: BoolArray  # (K,): the rows with all inputs, from the first output to the last: those of the record
    level: float  # mean of the output, which was subtracted
    outside: Outside | None = None  # if references move inputs

    @classmethod
    def of(
        cls,
        inputs: FloatArray,
        y: FloatArray,
        dt: float,
        stamps: FloatArray | None = None,
        input_hold: str = "zoh",
        begins: tuple[int, ...] = (),
    ) -> RowRecord:
        """Prepare inputs (K, q) and an output (K,), NaN where missing; ``begins`` as in `Record`."""
        # numbers whose squares would overflow count as missing
        measured, used = accepted(y)[1], accepted(inputs)[1].all(axis=1)
        used &= np.logical_or.accumulate(measured) & np.logical_or.accumulate(measured[::-1])[::-1]
        if not (used & measured).any():
            raise InvalidArgumentError("no row of u and y has all its numbers: there is nothing to fit")
        clock = np.arange(y.size) * dt if stamps is None else stamps
        regular = stamps is None and bool(used.all())
        intervals = np.array([dt]) if regular else np.diff(clock[used], prepend=clock[used][0] - dt)
        measured = measured[used]
        level = float(y[used][measured].mean())
        output = np.where(measured, y[used] - level, 0.0)
        places = np.searchsorted(np.flatnonzero(used), begins)
        record = Record(
            inputs[used][:, 0].copy(), output, intervals, input_hold, usual=dt,
            measured=None if measured.all() else measured,
            begins=tuple(sorted({int(place) for place in places if 0 < place < output.size})),
        )  # fmt: skip
        return cls(record, np.ascontiguousarray(inputs[used]), used, level)

    def simulated(self, row: Row, point: Point, noise: Autoregression) -> FloatArray:
        """Return the output (K,) of a point, offset and initial state estimated; NaN where earlier inputs act."""
        output = np.full(self.record.u.size, np.nan)
        done = evaluate(row, point.theta, noise, point)
        for stretch, weights in zip(row.stretches, done.nuisances, strict=True):
            outputs, _, free = row.signals(point.theta, stretch, weights)
            output[stretch.rows] = outputs.sum(axis=1) + combined(free, weights)
        whole = np.full(self.used.size, np.nan)
        # initial states, estimated from later outputs, do not give the response to inputs before record or gap
        answers = self.record.answers(max(each.delay for each in row.structures))
        whole[self.used] = np.where(answers, self.level + output, np.nan)
        return whole

    def explained(self, row: Row, output: FloatArray) -> FloatArray:
        """Return an output (K,) with NaN where the row does not use it: it is bad, or depends on earlier inputs."""
        measured = np.zeros(self.record.u.size, bool)
        for stretch in row.stretches:
            measured[stretch.rows] = stretch.measured
        known = np.zeros(self.used.size, bool)
        known[self.used] = measured
        return np.where(known, output, np.nan)

    def levels(self, row: Row, point: Point) -> tuple[FloatArray, float]:
        """Return the mean of each input, and the resting output there; its mean if a branch has no rest."""
        middles = self.inputs.mean(axis=0)
        each = zip(row.structures, row.branches(point.theta), strict=True)
        models = [structure.transfer_function(theta) for structure, theta in each]
        slowest = max(float(model.poles.real.max()) for model in models)
        if not slowest < -1.0 / max(self.record.span, 1e-300) or not row.stretches:
            return middles, self.level
        gains = np.array([model.dc_gain for model in models])
        counts = np.array([float(each.measured.sum()) for each in row.stretches])
        a0 = models[point.slowest].den[-1]  # a constant behind that branch in place of one before it
        offsets = [
            weights[0] / a0 + gains @ (middles - self.inputs[stretch.rows][0])
            for stretch, weights in zip(row.stretches, point.nuisances, strict=True)
        ]
        return middles, self.level + float(counts @ np.array(offsets) / counts.sum())
