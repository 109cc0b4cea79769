"""The recursion of a row: a joint update between two solutions of the record, during which the filters do not change.

If filters are changed but keep their states, the states are wrong for the new filters: estimates were then off by 17 to
63 standard deviations, with unchanged filters by .02 to .4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from replant.estimation.engine.record import SAME, Record
from replant.estimation.engine.state import GAP
from replant.estimation.simulation.auxiliary_model import Branches, records_of
from replant.estimation.simulation.miso import Point, Row, Stretch
from replant.estimation.simulation.miso_exogenous import Law, with_moved
from replant.estimation.solver.change_contest import HARMLESS
from replant.fitting.miso_solve import RowEstimate
from replant.kernels.filters.autoregressions import JITTER
from replant.kernels.schema import LAGS
from replant.model.noise import NoiseModel
from replant.model.structure import Structure
from replant.numerics.arguments import BoolArray, FloatArray, IntArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import (
    chi2_quantile,
    combined,
    compose,
    factor_covariance,
    factor_information,
    products,
    quiet,
    sum_of_squares,
)

# the prior then hardly counts, and float64 keeps half of its digits
DIFFUSE = 1e3  # prior standard deviation of offset and initial states after a gap [sizes of the output]

# the sum exceeds h within n samples with probability n exp(-h): within 1 / `ALPHA` samples with `ALPHA`
SURPRISE = -2.0 * math.log(ALPHA)  # limit of Page's sum above which the innovations have grown [nats]

DYING = 100  # samples after which a response to an initial state has shown how large it is [samples]


@dataclass(frozen=True, eq=False)
class Instruments:
    """The state that makes instruments, if references move inputs."""

    law: Law  # how inputs follow signals from outside
    is_moved: BoolArray  # (q,): which inputs references move
    models: Branches  # driven by the part of the inputs from outside
    origin: FloatArray  # (q,): subtracted from that part
    tail: FloatArray  # (LAGS, P + N): instruments of the newest samples

    @classmethod
    def of(cls, row: Row, stretch: Stretch, models: Branches, columns: FloatArray) -> Instruments | None:
        """Return the state after a record's last stretch, given its instruments (K, P + N); None without references."""
        outside = row.outside
        if outside is None:
            return None
        return cls(outside.law, outside.is_moved, models, outside.inputs[stretch.rows][0], _newest(columns))

    def take(
        self,
        u: FloatArray,
        r: FloatArray,
        coefficients: list[FloatArray],
        weights: FloatArray,
        intervals: FloatArray,
        free: FloatArray,
    ) -> tuple[Instruments, FloatArray]:
        """Return the state after K samples of inputs and references, and the instruments (LAGS + K, P + N)."""
        law, explained = self.law.follow(np.column_stack([r, u[:, ~self.is_moved]]))
        models, outside = self.models.copy(), with_moved(u, self.is_moved, explained)
        records = records_of(outside - self.origin, intervals)
        _, slopes, _ = models.run(coefficients, weights, records, on=True)
        rows = np.vstack([self.tail, np.column_stack([*slopes, free])])
        return replace(self, law=law, models=models, tail=rows[-LAGS:].copy()), rows

    def begun_at(self, u: FloatArray, coefficients: list[FloatArray], weights: FloatArray) -> Instruments:
        """Return the state for a stretch that begins at inputs (q,)."""
        models = self.models.copy()
        models.begin(coefficients, weights)
        return replace(self, models=models, origin=u.copy())


@dataclass(frozen=True, eq=False)
class RowRecursion:
    """An estimate that follows the samples; `take` returns the next one."""

    # the model of the filters: coefficients (P,); constant and initial states (N,), see `Branches`
    theta: FloatArray
    nuisances: FloatArray
    noise: Autoregression
    dt: float  # usual interval in s
    size: float  # standard deviation of the output
    power: float  # variance of the error
    scale: FloatArray  # (P,): ratio of a standard deviation to that with a white whitened error
    models: Branches
    origin: FloatArray  # (q,): inputs at the begin of the stretch, which are subtracted
    level: float  # mean of the output, which is subtracted
    waits: float  # time in s until outputs depend on inputs of the stretch alone: the dead time; -1: begins next
    tail: FloatArray  # (LAGS, P + N + 1): regressor and error of the newest samples
    # (P + N,), (P + N, P + N), (P + N,), (4,) and (3,): see `replant.kernels.step.miso.learn`
    delta: FloatArray
    factor: FloatArray
    diagonal: FloatArray
    counts: IntArray
    squares: FloatArray
    instruments: Instruments | None = None  # where references move inputs

    @classmethod
    @quiet
    def of(cls, row: Row, found: RowEstimate, level: float, newest: int) -> RowRecursion:
        """Return the recursion that continues after the last stretch of a record; ``level``: the output's mean."""
        point, stretch, theta = found.point, row.stretches[-1], found.point.theta
        weights = point.nuisances[-1]
        outputs, slopes, free = row.signals(theta, stretch, weights)
        columns = np.hstack([slopes, free])
        error = np.where(stretch.measured, stretch.y - outputs.sum(axis=1) - combined(free, weights), 0.0)
        made = row.instruments(theta, stretch, weights)
        zeta = columns if made is None else np.hstack([made, free])
        white = row.whitened(found.noise, zeta, stretch)
        information = products(white, white)
        for each in point.zeta[:-1]:  # earlier stretches have offsets and initial states of their own
            information[: theta.size, : theta.size] += products(each, each)
        factor, diagonal = factor_information(information)
        variance = point.cost / max(row.count - columns.shape[1], 1)
        plain = np.diag(compose(factor, diagonal))[: theta.size] * variance
        scale = np.sqrt(np.diag(found.covariance) / np.where(plain > 0.0, plain, 1.0))
        known = min(int(stretch.known[-1]) + 1, LAGS) if stretch.measured[-1] else 0
        tail, ended = _newest(np.column_stack([columns, error])), row.ended(theta, stretch, weights)
        return cls(
            theta, weights, found.noise, row.dt, float(np.std(row.record.y[row.record.is_measured])),
            point.power / max(row.count - columns.shape[1], 1), scale,
            ended[0], row.inputs[stretch.rows][0], level, 0.0,
            tail, np.zeros(columns.shape[1]), factor, diagonal, np.array([known, row.count, 0, 0]),
            # the last: innovations as large as those of the newest samples raise no alarm
            np.array([point.cost, 0.0, _variance_of(point, stretch, newest)]),
            Instruments.of(row, stretch, ended[-1], zeta),
        )  # fmt: skip

    @property
    def structures(self) -> tuple[Structure, ...]:
        """The structure of each branch."""
        return self.models.structures

    @property
    def parameters(self) -> FloatArray:
        """The estimate (P,)."""
        return np.asarray(self.theta + self.delta[: self.theta.size])

    def parameters_in(self, row: Row) -> FloatArray:
        """Return the estimate (P,) for a row, with poles that lie beyond the axis by chance put on it."""
        stable, moved = row.on_axis(self.parameters, lambda slope: self.covariance @ slope)
        return stable if moved <= chi2_quantile(1.0 - ALPHA, 1) else self.parameters

    @property
    def harmless(self) -> float:
        """Variance of an error that is negligible."""
        return (HARMLESS * self.size) ** 2

    @property
    def noise_model(self) -> NoiseModel:
        """The model of the noise as a `NoiseModel`."""
        return NoiseModel(self.noise.coefficients, self.variance, self.power, self.dt)

    @property
    def variance(self) -> float:
        """Variance of the whitened error."""
        return float(self.squares[0]) / max(int(self.counts[1]) - self.delta.size, 1)

    def used_to(self, point: Point, stretch: Stretch, newest: int) -> RowRecursion:
        """Return the recursion with the alarm set to the innovations' variance over the newest samples."""
        return replace(self, squares=np.array([self.squares[0], 0.0, _variance_of(point, stretch, newest)]))

    @property
    def surprising(self) -> int:
        """Number of samples since the innovations have grown significantly; 0 if they have not."""
        return int(self.counts[3]) if self.squares[1] > SURPRISE else 0

    @property
    def covariance(self) -> FloatArray:
        """Covariance (P, P) of the estimate."""
        size = self.theta.size
        white = compose(self.factor, self.diagonal)[:size, :size]
        return np.asarray(white * self.variance * self.scale * self.scale[:, None])

    @quiet
    def take(
        self, u: FloatArray, y: FloatArray, r: FloatArray, intervals: FloatArray, *, learns: bool = True
    ) -> tuple[RowRecursion, FloatArray, FloatArray, int]:
        """Take K samples; return the recursion after them, errors (K,), estimates (K, P) and the row of an alarm."""
        # alarm: first row with significantly larger innovations, or K; intervals: before each sample, in s
        taken, errors, estimates, alarm = self, np.empty(y.size), np.empty((y.size, self.theta.size)), y.size
        gaps = np.flatnonzero(intervals > GAP * self.dt).tolist()
        for begin, end in zip([0, *gaps], [*gaps, y.size], strict=True):
            rows = slice(begin, end)
            if begin < end:
                taken = taken._begun_at(u[begin]) if begin in gaps else taken
                given = u[rows], y[rows], r[rows], intervals[rows]
                taken, place = taken._take(*given, learns, errors[rows], estimates[rows])
                alarm = min(alarm, begin + place) if place < end - begin else alarm
        return taken, errors, estimates + self.theta, alarm

    def _take(
        self, u: FloatArray, y: FloatArray, r: FloatArray, intervals: FloatArray, learns: bool, errors: FloatArray,
        estimates: FloatArray,
    ) -> tuple[RowRecursion, int]:  # fmt: skip
        """Take samples with a gap at most before the first; write errors, estimates minus theta; return an alarm."""
        from replant.kernels.step.miso import learn

        models, waits = self.models.copy(), self.waits
        begins = waits < 0.0  # the first sample begins a stretch
        steps = np.concatenate([[0.0 if begins else intervals[0]], intervals[1:]])
        waits = max(each.delay for each in self.structures) if begins else waits
        left = np.subtract.accumulate(np.concatenate([[waits], steps]))[1:] if waits > 0.0 else np.zeros(y.size)
        measured = np.isfinite(y) & ~(left > SAME * intervals)
        usual = np.abs(intervals - self.dt) <= JITTER * self.dt
        usual[0] &= not begins
        records = records_of(u - self.origin, intervals)
        outputs, slopes, nuisances = models.run(self._coefficients, self.nuisances, records, on=True)
        error = np.where(measured, y - self.level, 0.0)
        for each in outputs:
            error = error - each
        rows = np.column_stack([*slopes, nuisances, np.where(measured, error, 0.0)])
        rows = np.vstack([self.tail, rows])
        instruments, zeta = self.instruments, np.zeros((0, self.delta.size))
        if instruments is not None:
            given = self._coefficients, self.nuisances, intervals, nuisances
            instruments, zeta = instruments.take(u, r, *given)
        new = replace(
            self, models=models, waits=max(float(left[-1]), 0.0), tail=rows[-LAGS:].copy(), delta=self.delta.copy(),
            factor=self.factor.copy(), diagonal=self.diagonal.copy(), counts=self.counts.copy(),
            squares=self.squares.copy(), instruments=instruments,
        )  # fmt: skip
        alarm = learn(
            rows, zeta, measured.astype(np.int64), usual.astype(np.int64), learns, self.noise.order, self.noise.models,
            self.noise.powers, new.delta, new.factor, new.diagonal, new.counts, new.squares, self.harmless, SURPRISE,
            errors, estimates, np.empty(4 * self.delta.size + 1),
        )  # fmt: skip
        return new, int(alarm)

    @property
    def slowest(self) -> int:
        """The number of the branch with the slowest pole."""
        return self.models.slowest(self._coefficients)

    @property
    def _coefficients(self) -> list[FloatArray]:
        return np.split(self.theta, np.cumsum([each.size for each in self.structures])[:-1].tolist())

    def _begun_at(self, u: FloatArray) -> RowRecursion:
        """Return the recursion at a new stretch from inputs (q,): constant and initial states are unknown."""
        pairs = zip(self.structures, self._coefficients, strict=True)
        gains = np.array([structure.transfer_function(theta).dc_gain for structure, theta in pairs])
        which, first = self.slowest, self.theta.size
        # what the inputs' moves make behind the branch of the constant: its own by b0, which an integrator has, too
        gains *= self._coefficients[which][self.structures[which].poles - 1]
        gains[which] = self._coefficients[which][-1]
        moved = float(gains @ (u - self.origin))
        weights = np.zeros(self.nuisances.size)
        weights[0] = self.nuisances[0] + self.delta[first] + (moved if np.isfinite(moved) else 0.0)
        models, still = self.models.copy(), Record(np.zeros(DYING), np.zeros(DYING), np.array([self.dt]))
        _, _, free = models.run(self._coefficients, weights, [still] * len(self.structures))
        models.begin(self._coefficients, weights)
        sizes = np.abs(free).max(axis=0)
        factor, diagonal = np.eye(self.delta.size), np.empty(self.delta.size)
        known = compose(self.factor, self.diagonal)[:first, :first]
        factor[:first, :first], diagonal[:first] = factor_covariance(known)
        deviations = DIFFUSE * self.size / np.where(sizes > 0.0, sizes, 1.0)
        diagonal[first:] = deviations**2 / max(self.variance, 1e-300)
        delta = np.concatenate([self.delta[:first], np.zeros(self.nuisances.size)])
        instruments = self.instruments
        if instruments is not None:
            instruments = instruments.begun_at(u, self._coefficients, weights)
        return replace(
            self, nuisances=weights, models=models, origin=u.copy(), waits=-1.0, delta=delta, factor=factor,
            diagonal=diagonal, instruments=instruments,
        )  # fmt: skip


def _variance_of(point: Point, stretch: Stretch, newest: int) -> float:
    """Return the variance of the whitened error over the newest samples of the last stretch."""
    return sum_of_squares(point.error[-1][-newest:]) / max(int(stretch.measured[-newest:].sum()), 1)


def _newest(rows: FloatArray) -> FloatArray:
    """Return the newest rows (LAGS, ...), after rows of zeros if there are fewer."""
    return np.vstack([np.zeros((LAGS, rows.shape[1])), rows])[-LAGS:]
