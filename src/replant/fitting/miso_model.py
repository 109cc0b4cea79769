"""RowModel: an identified plant of several inputs and one output."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError, shown
from replant.estimation.simulation.fitted_run import fit_percent
from replant.estimation.simulation.miso import Point, Row, RowRecord, evaluate, noise_of
from replant.estimation.simulation.model_run import model_output, runs_away
from replant.fitting import model_json
from replant.fitting.model import AnyModel, Model, html, usual_interval
from replant.fitting.model_fields import RowFields, has_rest, unnamed
from replant.fitting.responses import Bode, StepResponse
from replant.fitting.validation import Validation
from replant.logs.log import Log
from replant.model import interop
from replant.model.interop import without_unit
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import FloatArray, array_of_reals, no_output, vector
from replant.numerics.autoregression import Autoregression
from replant.numerics.limits import increasing
from replant.numerics.linear_algebra import quiet, sum_of_squares
from replant.plotting.diagrams import ABOVE_LEGEND
from replant.plotting.style import axes_for, title
from replant.verdict.miso_tests import lacking
from replant.verdict.verdict import Verdict, conclude

UNSEEN = "the inputs explain no more of this record than the model says"


class RowModel(AnyModel, RowFields):
    r"""An identified plant of several inputs and one output, in the units of its signals.

    .. math:: y = \mathrm{output\_level} + \sum_i G_i(s)\,(u_i - \mathrm{input\_levels}_i)

    Parameters
    ----------
    structures : tuple of Structure
        One per input.
    parameters : (P,) array
        In physical units: a_{n-1} .. a_0, b_m .. b_0 of the first input, then of the next, see `names`.
    dt : float
        Sampling time in s of the record that the model was made from.
    covariance : (P, P) array or None
        Of the parameters, jointly.
    noise : NoiseModel or None
        Of the residual.
    input_hold : {"zoh", "foh"}
        What the inputs do between samples.
    input_names : tuple of str
        By default u1, u2, ..; with the units in brackets at the end.
    output_name : str
    input_levels : (q,) array
        Working point: with the inputs there, the output rests at ``output_level``.
    output_level : float
    simulated_fit, one_step_fit : float
        Fit in percent to the record that the model was made from; NaN if unknown.
    rejected : tuple of (str, int)
        How many samples were left out, by reason.
    verdict : Verdict
    provenance : Provenance

    Examples
    --------
    >>> from replant import Structure
    >>> model = RowModel((Structure(1), Structure(1, delay=0.2)), [1.0, 2.0, 3.0, 4.0], dt=0.1)
    >>> print(*model.transfer_functions, sep=", ")
    2 / (s + 1), 4 / (s + 3) exp(-0.2 s)
    >>> model.simulate([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0]]).round(4)
    array([0.    , 0.    , 0.1903])
    """

    LAYOUT = model_json.OF_SEVERAL

    def of_input(self, which: int | str) -> Model:
        """Return the model of one input, the others at rest: for its responses, plots and conversions.

        ``which`` is its name, or its number from 0; any other raises an InvalidArgumentError.
        """
        number = number_of(which, self.input_names)
        rows = self.places[number]
        return Model(
            self.structures[number], self.parameters[rows], self.dt,
            covariance=None if self.covariance is None else self.covariance[rows, rows],
            noise=self.noise, input_hold=self.input_hold,
            input_level=float(self.input_levels[number]), output_level=self.output_level,
            input_name=self.input_names[number], output_name=self.output_name, verdict=self.verdict,
            provenance=self.provenance,
        )  # fmt: skip

    def _inputs_of(self, log: Log) -> FloatArray:
        return in_order(log, self.input_names)

    def _deviations(self, u: Any) -> FloatArray:
        columns = self._columns(u)
        return np.where(np.isfinite(columns), columns - self.input_levels, np.nan)

    def _run(self, u: FloatArray, y: FloatArray, stamps: FloatArray | None, dt: float) -> tuple[FloatArray, bool]:
        if not self._runs_away(y, stamps, dt):
            ready = RowRecord.of(u, y, dt, stamps, self.input_hold)
            return ready.simulated(*evaluated(self, ready)), False
        known = np.isfinite(u).all(axis=1) & np.isfinite(y)
        v, predicted = np.where(known[:, None], u - self.input_levels, np.nan), np.zeros(y.size)
        for number, each in enumerate(self._over_common_denominator()):  # the predictor is linear in inputs and output
            measured = np.where(known, 0.0 if number else y, np.nan)
            hold = self.input_hold
            predicted += model_output(each, v[:, number].copy(), measured, dt, input_hold=hold, t=stamps).output
        return predicted, True

    def _runs_away(self, output: FloatArray, stamps: FloatArray | None, dt: float) -> bool:
        span = dt * (output.size - 1) if stamps is None else float(np.ptp(stamps))
        return any(runs_away(g.den, span) for g in self.transfer_functions)

    def _over_common_denominator(self) -> Iterator[TransferFunction]:
        for number, g in enumerate(self.transfer_functions):
            others = [each.den for each in (*self.transfer_functions[:number], *self.transfer_functions[number + 1 :])]
            num, den = g.num, g.den
            for other in others:
                num, den = (np.asarray(np.polymul(each, other), np.float64) for each in (num, den))
            yield TransferFunction(num, den, g.delay)

    def plot(self, axes: Any = None) -> Any:
        """Draw step response, magnitude and phase from each input, into 3 q ``axes`` if given.

        Returned are axes (3, q) of matplotlib.
        """
        count = len(self.structures)
        drawn = axes_for("axes", axes, 3 * count, (1.0 + 3.4 * count, 6.8), nrows=3, ncols=count)
        for number, name in enumerate(self.input_names):
            model, (step, *bode) = self.of_input(number), drawn[number::count]
            title(model.step().plot(step), f"{name} → {self.output_name}", ABOVE_LEGEND)
            model.bode().plot(bode)
        return np.array(drawn, dtype=object).reshape(3, count)

    def _columns(self, u: Any) -> FloatArray:
        columns = np.asarray(array_of_reals("u", u), np.float64)
        if columns.ndim != 2 or columns.shape[1] != len(self.structures):
            raise InvalidArgumentError(
                f"u must have a column for each of {len(self.structures)} inputs, {', '.join(self.input_names)}: got "
                f"shape {shown(columns.shape)}"
            )
        return columns

    @quiet
    def validate(self, log: Log | Any, y: Any = None, t: Any = None) -> Validation:
        """Compare the model with another record; offset and initial states are estimated, nothing else.

        The verdict tests whether filters of the inputs explain more of the residual than chance and the model's own
        uncertainty.

        Parameters
        ----------
        log : Log or (K, q) array
            The record, or its inputs.  Those of a log are found by their names, those of an array are in the order of
            the model's.
        y : (K,) array, optional
            Measured output, where ``log`` is an array.
        t : (K,) array, optional
            Time stamps in s, where ``log`` is an array; without them samples are `dt` apart.

        Returns
        -------
        Validation
            Without correlations and error by frequency.

        Raises
        ------
        InvalidArgumentError
            If the record is too short, its inputs are not those of the model, or the model is unstable, whose
            simulation runs away.
        """
        columns, output, stamps, dt = self._record(log, y, t)
        if self._runs_away(output, stamps, dt):
            raise InvalidArgumentError("the simulation of an unstable model runs away: compare model.predict(u, y)")
        ready = RowRecord.of(columns, output, dt, stamps, self.input_hold)
        row, point, noise = evaluated(self, ready)
        simulated = ready.simulated(row, point, noise)
        size = self.parameters.size
        found = list(lacking(row, point, noise, np.zeros((size, size)) if self.covariance is None else self.covariance))
        clock = np.asarray(dt * np.arange(output.size), np.float64) if stamps is None else stamps
        return Validation(
            fit_percent(ready.explained(row, output), simulated), one_step_percent(row, point),
            self._offset(ready, row, point), simulated, output - simulated, clock, None, None,
            Verdict(*conclude(found, UNSEEN)), row.count, False,
        )  # fmt: skip

    def _offset(self, ready: RowRecord, row: Row, point: Point) -> float:
        """Return by how much a record's working point lies above the model's."""
        if not all(has_rest(g, ready.record.span) for g in self.transfer_functions):
            return math.nan
        at, level = ready.levels(row, point)
        gains = np.array([g.dc_gain for g in self.transfer_functions])
        return float(level - self.output_level - gains @ (at - self.input_levels))

    def _record(self, log: Any, y: Any, t: Any) -> tuple[FloatArray, FloatArray, FloatArray | None, float]:
        if isinstance(log, Log):
            if y is not None or t is not None:
                raise InvalidArgumentError("a log has its own output and time: leave out y and t")
            return self._columns(in_order(log, self.input_names)), log.output, log.stamps, log.dt
        if y is None:
            raise no_output(log, "the inputs and the output")
        columns, output = self._columns(log), vector("y", y)
        if output.size != len(columns):
            raise InvalidArgumentError(f"u has {len(columns)} rows and y {output.size} samples: give one row for each")
        stamps = None if t is None else increasing(t, output.size)
        return columns, output, stamps, self.dt if stamps is None else usual_interval(stamps, self.dt)

    def of_log(self, input_names: tuple[str, ...], output_name: str, source: str, sha256: str = "") -> RowModel:
        """Return the same model with the names of its signals, and the name and digest of the log's file."""
        made = dataclasses.replace(self.provenance, source=source, sha256=sha256)
        return dataclasses.replace(self, input_names=input_names, output_name=output_name, provenance=made)

    def to_control(self, pade: int | None = None) -> Any:
        """Return the row as `control.TransferFunction` of one output, q inputs; see `TransferFunction.to_control`."""
        return interop.control_matrix([[g.to_control(pade) for g in self.transfer_functions]])

    def to_scipy(self) -> tuple[Any, ...]:
        """Return G(s) from each input as `scipy.signal.TransferFunction`."""
        return tuple(g.to_scipy() for g in self.transfer_functions)

    def to_sympy(self) -> tuple[Any, ...]:
        """Return G(s) from each input as an expression of SymPy in the symbol s."""
        return tuple(g.to_sympy() for g in self.transfer_functions)

    def step(self, duration: float | None = None) -> tuple[StepResponse, ...]:
        """Return the response to a unit step of each input, see `Model.step`."""
        return tuple(each.step(duration) for each in self._models)

    def bode(self, frequency: Any = None) -> tuple[Bode, ...]:
        """Return magnitude and phase from each input, see `Model.bode`."""
        return tuple(each.bode(frequency) for each in self._models)

    @property
    def _models(self) -> list[Model]:
        return [self.of_input(number) for number in range(len(self.structures))]

    def _repr_html_(self) -> str:
        return html(self, self._models)

    def __repr__(self) -> str:
        fit = "" if math.isnan(self.simulated_fit) else f", fit {self.simulated_fit:.1f} %"
        lines = [f"\n  {name}: {g}" for name, g in zip(self.input_names, self.transfer_functions, strict=True)]
        signals = f"{', '.join(self.input_names)} -> {self.output_name}"
        return f"<RowModel {signals}{fit}, {self.verdict.status}{''.join(lines)}>"


def one_step_percent(row: Row, point: Point) -> float:
    """Return the fit in percent of the output of a row predicted one step ahead, by its whitened error."""
    left = np.concatenate([each.y[each.measured] for each in row.stretches])
    spread = math.sqrt(sum_of_squares(left - left.mean()))
    return 100.0 * (1.0 - math.sqrt(point.cost) / spread) if spread > 0.0 else math.nan


def number_of(which: int | str, names: tuple[str, ...]) -> int:
    """Return the place of a signal that is given by its name or by its number from 0."""
    number = names.index(which) if which in names else which
    if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < len(names):
        raise InvalidArgumentError(f"which must be one of {', '.join(names)}, or its number from 0, got {shown(which)}")
    return number


def in_order(log: Log, names: tuple[str, ...]) -> FloatArray:
    """Return the inputs (K, q) of a log in the order of a model's names; unchanged if log or model has no names."""
    given, wanted = (tuple(map(without_unit, each)) for each in (log.input_names, names))
    if names == unnamed(len(names)) and set(given) != set(wanted):
        return log.inputs
    missing = [name for name in wanted if name not in given]
    # the first input of a log is called u if it was not named: it is the only one whose name is missing
    if given[0] == "u" and len(missing) == 1:
        given, missing = (missing[0], *given[1:]), []
    if missing:
        raise InvalidArgumentError(
            f"the log has no input {missing[0]}, but {', '.join(log.input_names)}: name its inputs as the model does, "
            "or give arrays, whose columns are in the model's order"
        )
    is_match = len(given) == len(wanted) == len(set(given))
    return log.inputs[:, [given.index(name) for name in wanted]] if is_match else log.inputs


@quiet
def evaluated(model: RowModel, ready: RowRecord) -> tuple[Row, Point, Autoregression]:
    """Return the row of a prepared record, the model's point on it, and the noise model of its residual."""
    row = Row(model.structures, ready.record, ready.inputs, model.input_names)
    if row.count <= row.nuisances:
        raise InvalidArgumentError(f"the record has {row.count} usable samples, a validation needs {row.nuisances + 1}")
    free = evaluate(row, model.parameters, Autoregression.white(1.0, row.count))
    noise = noise_of(row, free)
    return row, evaluate(row, model.parameters, noise, free), noise
