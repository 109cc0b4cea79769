r"""A model's run over a record: its output, simulated or predicted, its residual, and the signals of the tests.

The residual of B/A is :math:`e = A/D\, y - B/D\, u`.  If A is stable, D is A: e is then the measured minus the
simulated output.  Else D is A with its unstable poles reflected: the residual of a right model is as white as the
noise, without a simulation that diverges.  The predicted output, which makes e zero, depends on past outputs; it then
replaces the simulated output.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.simulation.auxiliary_model import SLOWEST, AuxiliaryModel
from replant.estimation.simulation.fitted_run import (
    FittedRun,
    Simulation,
    fit_percent,
    simulate,
    triangle_of,
    weights_of,
)
from replant.kernels.schema import LARGEST
from replant.model.state_space import Response
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.autoregression import places_on_grid
from replant.numerics.linear_algebra import combined, quiet, roots
from replant.numerics.residuals import ErrorSums, OutputSums

PER_COEFFICIENT = 10  # samples held out for each, else a model explains a tenth of the noise by chance [samples]
LONGEST = 3.0  # longest delay tested for other dynamics: a response has decayed to a twentieth [slowest time constants]


@dataclass(frozen=True, eq=False)
class ModelRun:
    """A model B/A run over a record of K samples, offset and initial state fitted."""

    structure: Structure
    parameters: FloatArray  # (P,)
    u: FloatArray  # (K,)
    error: FloatArray  # (K,): of a stable model measured minus simulated output
    forced: FloatArray  # (K,): simulated by the input alone, without offset and state; of an unstable model y - e
    states: FloatArray  # (K, S): s^i/D u, highest i first: n of them, and one more if G(s) is biproper
    zeta: FloatArray  # (K, n + m + 1): derivatives of the simulated output: -s^i/D of itself, and s^j/D u
    nuisances: FloatArray  # (K, n + 1): outputs by a unit offset and by unit initial states
    # (K, n + m + 1): derivatives of the output with offset and state, for any choice of the input's zero
    slopes: FloatArray
    is_direct: bool = False  # whether the output depends on the input of the same sample
    instruments: FloatArray | None = (
        None  # (K, n + m + 1): the derivatives with the parts of u and y that a reference explains
    )

    def dynamics(self, rows: slice, dt: float, span: float, *, feedback: bool = False) -> FloatArray:
        """Return columns (J, C) that show other dynamics in some rows of a record, in feedback by the past alone."""
        begin, end, _ = rows.indices(self.error.size)
        index = np.arange(begin, end) - (1 if self.is_direct and feedback else 0)

        def late(signal: FloatArray, delay: int) -> FloatArray:
            return np.asarray(signal[np.maximum(index - delay, 0)])

        poles = self.structure.poles
        slowest = float(np.abs(roots(np.concatenate([[1.0], self.parameters[:poles]])).real).min())
        longest = LONGEST / max(slowest, 1.0 / span) / dt
        columns, delay = [late(self.states, 0), late(self.zeta[:, :poles], 0)], 1
        if not (feedback or self.is_direct):  # a direct path, or an output that is recorded after its input has acted
            columns.append(late(self.u - self.u.mean(), 0)[:, None])
        room = index.size // PER_COEFFICIENT - 2 * poles - 4
        # input, simulated output and their states, delayed by powers of two samples
        while delay == 1 or (delay <= min(longest, index.size / PER_COEFFICIENT) and room > 1):
            columns += [late(self.u, delay)[:, None], late(self.forced, delay)[:, None]]
            delay, room = 2 * delay, room - 2
        return np.hstack(columns)


@quiet
def run_model(
    structure: Structure, parameters: FloatArray, record: Record, dt: float, by_reference: FloatArray | None = None
) -> ModelRun | None:
    """Run a model over a record; None if its signals are not finite, or too large."""
    n = structure.poles
    # with as many zeros as there can be, the columns hold every s^i/A u; the derivatives along b are the last of them
    full = Structure(n, n - 1 + structure.is_biproper, structure.delay, feedthrough=structure.is_biproper)
    model = AuxiliaryModel(full, dt, record.input_hold)
    theta = np.zeros(model.entries)
    theta[full.denominator] = parameters[structure.denominator]
    own = slice(full.coefficients - structure.zeros - 1, full.coefficients)
    theta[own] = parameters[structure.numerator]
    whole = record.joined
    known = whole.u.size - record.u.size
    done = model.run(theta, whole).since(known)
    slopes_of_a = done.zeta[:, full.denominator]
    columns = np.hstack([slopes_of_a, done.phi[:, n:]])
    if not (np.isfinite(columns).all() and np.isfinite(done.output).all() and np.abs(columns).max() < LARGEST):
        return None
    states, nuisances = done.phi[:, full.numerator], done.phi[:, full.coefficients :]
    zeta = np.hstack([slopes_of_a, done.phi[:, own]])
    weights = weights_of(triangle_of(nuisances, done.error))
    error = done.error - combined(nuisances, weights)
    theta[full.coefficients :] = weights
    slopes = np.hstack([model.run(theta, whole).since(known).zeta[:, full.denominator], done.phi[:, own]])
    direct = structure.delay < dt if record.input_hold == "foh" else structure.is_biproper and structure.delay == 0.0
    instruments = None
    if by_reference is not None:
        apart = AuxiliaryModel(full, dt, record.input_hold, reference=True)
        by_reference = np.pad(by_reference, ((known, 0), (0, 0)), mode="edge")
        theta[full.coefficients :] = 0.0
        made = apart.run(theta, whole, by_reference).since(known).zeta
        instruments = np.hstack([made[:, full.denominator], made[:, own]])
    signals = error, done.output, states, zeta, nuisances, slopes
    return ModelRun(structure, parameters, record.u, *signals, direct, instruments)


@quiet
def responses(model: TransferFunction, inputs: FloatArray, record: Record, dt: float, hold: str) -> FloatArray:
    """Return the outputs (K, C) of a model for inputs (K, C) on a record's clock, from rest after each gap."""
    outputs = np.empty_like(inputs)
    for rows in record.parts:
        intervals = None if record.intervals.size == 1 else record.intervals[rows]
        for column, u in enumerate(inputs[rows].T):
            outputs[rows, column] = Response(model, dt, hold).take(np.ascontiguousarray(u), intervals).output
    return outputs


def model_output(
    model: TransferFunction, u: FloatArray, y: FloatArray, dt: float, *, input_hold: str = "zoh",
    t: FloatArray | None = None, begins: Sequence[int] = (),
) -> Simulation:  # fmt: skip
    """Return the output of a model for a record, simulated, or predicted if it runs away; offset and state fitted."""
    span = dt * (u.size - 1) if t is None else float(t[-1] - t[0])
    if not runs_away(model.den, span):
        return simulate(model, u, y, dt, input_hold=input_hold, t=t, begins=begins)
    output = predicted(model, dt, input_hold, u, y, t)[0]
    return Simulation(output, 0.0, fit_percent(y, output), is_prediction=True)


def predicted(
    model: TransferFunction, dt: float, input_hold: str, u: FloatArray, y: FloatArray, t: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the output (K,) predicted one step ahead, NaN where there is none, and the measured one (K,)."""
    kept, output = np.isfinite(u) & np.isfinite(y), np.full(u.size, np.nan)
    if kept.sum() <= 1:  # nothing is predicted from one sample
        return output, output
    clock = dt * np.arange(u.size) if t is None else t
    intervals = np.diff(clock[kept], prepend=clock[kept][:1] - dt)
    if t is None and kept.all():
        intervals = np.array([dt])
    n, m = model.den.size - 1, model.num.size - 1
    parameters = np.concatenate([model.den[1:], model.num])
    structure = Structure(n, m, model.delay, feedthrough=n == m)
    error = prediction_error(structure, parameters, Record(u[kept], y[kept], intervals, input_hold), dt)
    if error is not None:
        output[kept] = y[kept] - error
    return output, np.where(kept, y, np.nan)


@quiet
def runs_away(denominator: FloatArray, span: float) -> bool:
    """Return whether a model's free response grows more than e-fold in ``span`` s: a simulation is meaningless."""
    fastest = float(roots(denominator).real.max())
    return math.isfinite(fastest) and fastest * span > 1.0


@quiet
def prediction_error(structure: Structure, parameters: FloatArray, record: Record, dt: float) -> FloatArray | None:
    """Return the one-step error (K,), offset and initial state fitted, also if unstable; None if not finite."""
    model = AuxiliaryModel(structure, dt, record.input_hold, margin=SLOWEST / record.span)
    theta, known = np.zeros(model.entries), structure.coefficients
    theta[:known] = parameters[:known]
    done = model.run(theta, record)
    theta[known:] = weights_of(triangle_of(done.phi[:, known:], done.error))
    done = model.run(theta, record)
    return done.ahead if np.isfinite(done.ahead).all() else None


class Score:
    """Runs a model over a record batch by batch, and keeps the sums that give its fits to the output.

    A record of any length needs one pass: the initial state is fitted over the first batch, the offset over all of
    them.  The autoregression D(q) e = w of the residual e and the sum of w^2 follow from the sums of the products
    :math:`e_{k-i} e_{k-j}`: the fit one step ahead needs no second pass either.
    """

    def __init__(
        self, model: TransferFunction, dt: float, input_hold: str = "zoh", begins: Sequence[int] = (),
        *, predicts: bool = False,
    ) -> None:  # fmt: skip
        self._run = FittedRun(model, dt, input_hold, begins)
        # for a model that runs away the output is predicted, offset and initial state fitted to each batch
        self._take = partial(predicted, model, dt, input_hold) if predicts else self._run.take
        self._dt, self._last = dt, math.nan
        self._batches, self._failed = 0, False
        self._error, self._output = ErrorSums(), OutputSums()

    def take(self, u: FloatArray, y: FloatArray, t: FloatArray | None = None) -> FloatArray:
        """Take the next samples (K,), stamped ``t`` (K,); return the model's output, `shift` not yet added."""
        if u.size == 0:
            return np.zeros(0)
        # NaN in u is replaced by the last input; NaN in y is left out, and
        # so are the outputs that depend on inputs before the record
        intervals = None  # since the sample before each stamp
        if t is not None:
            intervals = np.diff(t, prepend=t[0] - self._dt if math.isnan(self._last) else self._last)
            self._last = float(t[-1])
        with np.errstate(over="ignore", invalid="ignore"):
            modelled, y = self._take(u, y, t)
            self._batches += 1
            known = np.asarray(np.isfinite(y))
            self._failed = self._failed or not bool(np.isfinite(modelled[known]).all())
            if not self._failed:
                self._output.take(y[known])
                self._error.take(*_spread(np.where(known, y - modelled, 0.0), known, intervals, self._dt))
        return modelled

    @property
    def usable(self) -> bool:
        """Whether there is something to compare: a finite modelled output, and a measured output."""
        return not self._failed and self._output.count > 0

    @property
    def shift(self) -> float:
        """Offset of the whole record minus that of the first batch; NaN if the score is not usable."""
        if not self.usable:
            return math.nan
        return self._error.mean if self._batches > 1 else 0.0  # with one batch the offset is the least-squares solution

    @property
    def offset(self) -> float:
        """The estimated constant between measured and simulated output."""
        return self._run.offset + self.shift if self.usable else 0.0

    @property
    def simulated(self) -> float:
        """Fit in percent, from the input alone."""
        return self._fit(self._error.power(self.shift)) if self.usable else -math.inf

    @property
    def one_step(self) -> float:
        """Fit in percent, one step ahead: each residual predicted from the residuals before it."""
        return self._fit(self._error.innovation(self.shift)) if self.usable else math.nan

    def _fit(self, power: float) -> float:
        spread = self._output.spread
        if spread == 0.0:
            return math.nan
        with np.errstate(over="ignore", invalid="ignore"):
            return float(100.0 * (1.0 - np.sqrt(max(power, 0.0)) / np.sqrt(spread)))


def _spread(
    error: FloatArray, known: BoolArray, intervals: FloatArray | None, dt: float
) -> tuple[FloatArray, BoolArray]:
    """Return residuals, and which are known, with one unknown residual for each lost sample."""
    if intervals is None:
        return error, known
    places = places_on_grid(intervals, dt)
    size = int(places[-1]) + 1
    spread, there = np.zeros(size), np.zeros(size, bool)
    spread[places], there[places] = error, known
    return spread, there
