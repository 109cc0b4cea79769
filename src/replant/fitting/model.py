"""Model: an identified plant with its data; its text in one line, as LaTeX, and as HTML for notebooks."""

from __future__ import annotations

import dataclasses
import html as escaped
import math
import textwrap
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError, MissingDependencyError, shown
from replant.estimation.simulation.model_run import model_output
from replant.fitting import model_file, model_json
from replant.fitting.model_fields import Fields, ModelFields
from replant.fitting.responses import Bode, ImpulseResponse, Nyquist, PoleMap, StepResponse, time_of
from replant.fitting.validation import Validation, validate
from replant.logs.log import Log, check_one_reference
from replant.model.noise import NoiseModel
from replant.model.state_space import Response
from replant.model.transfer_function import TransferFunction, terms_of
from replant.numerics.arguments import FloatArray, no_output, record, vector, whole
from replant.numerics.autoregression import ahead
from replant.numerics.limits import increasing
from replant.numerics.linear_algebra import quiet
from replant.numerics.robust import last_known
from replant.plotting.numbers import with_std
from replant.plotting.style import axes_for, picture

WIDTH, COEFFICIENT_LINES, REASONS = 110, 3, 5  # characters of a line, lines of coefficients, reasons [count]
SAME_CLOCK = 0.1  # difference of intervals up to which the noise model is valid [part of the interval]


class AnyModel(model_file.Written, Fields):
    """What a `Model` and a `RowModel` have in common: the output that follows from the inputs."""

    noise: NoiseModel | None
    input_hold: str
    output_level: float
    validate: Callable[..., Validation]
    _inputs_of: Callable[[Log], FloatArray]
    _deviations: Callable[[Any], FloatArray]  # of raw inputs from the working point, (K, q); NaN where not finite
    # the checked inputs, the output, and its stamps and usual interval
    _record: Callable[[Any, Any, Any], tuple[FloatArray, FloatArray, FloatArray | None, float]]
    # from these the output that is simulated, offset and initial states estimated, or that is predicted, which is told
    _run: Callable[[FloatArray, FloatArray, FloatArray | None, float], tuple[FloatArray, bool]]

    @quiet
    def simulate(self, u: Any, t: Any = None, *, y: Any = None) -> FloatArray:
        """Return the output (K,) from the inputs alone, in absolute units.

        Without ``y`` the plant begins at rest at the first sample; one without a known rest (integrating, unstable, or
        slower than the record that it was made from) begins at its working point.  With ``y`` offset and initial states
        are estimated.  Between samples the inputs follow `input_hold`, at any interval.

        Parameters
        ----------
        u : (K,) array, (K, q) array of q inputs, or Log
            Raw inputs; one that is not finite is replaced by the last finite one.  Of a log, those of its inputs, if
            there are several found by their names, and its clock.
        t : (K,) array, optional
            Time stamps in s, strictly increasing; without them samples are `dt` apart.
        y : (K,) array, optional
            Measured output; NaN where there is none.

        Raises
        ------
        InvalidArgumentError
            If the arrays do not fit, or the stamps do not increase.

        Examples
        --------
        >>> from replant import Structure
        >>> model = Model(Structure(1), [1.0, 2.0], dt=1.0, input_level=3.0, output_level=10.0)
        >>> model.simulate([3.0, 4.0, 4.0]).round(3)
        array([10.   , 10.   , 11.264])
        >>> model.simulate([5.0, 5.0])
        array([14., 14.])
        """
        if isinstance(u, Log):
            u, t = self._inputs_of(u), clock_of_log(u, self.dt, t)
        if y is not None:
            columns, output, stamps, _ = self._record(u, y, t)
            return self._run(columns, output, stamps, self.dt)[0]
        return np.asarray(self.output_level + self.contributions(u, t).sum(axis=1))

    @quiet
    def contributions(self, u: Any, t: Any = None) -> FloatArray:
        """Return the response to each input (K, q), as deviations from the working point; see `simulate`."""
        if isinstance(u, Log):
            u, t = self._inputs_of(u), clock_of_log(u, self.dt, t)
        columns = self._deviations(u)
        stamps, rests = None if t is None else increasing(t, len(columns)), self.rests
        pairs = zip(self.transfer_functions, columns.T, strict=True)
        return np.column_stack([run_from(g, v, self.dt, self.input_hold, stamps, at_rest=rests) for g, v in pairs])

    @quiet
    def predict(self, u: Any, y: Any, horizon: int = 1, t: Any = None) -> FloatArray:
        """Return the output (K,) predicted ``horizon`` samples ahead, from the inputs and the past output.

        The residual of the simulated output is predicted by the noise model; without one this is the simulated output.
        Offset and initial states are estimated from the whole record.  With several inputs NaN where one is missing, or
        the output depends on inputs before the record or in a gap.

        Parameters
        ----------
        u : (K,) array, or (K, q) array of q inputs
            Raw inputs.
        y : (K,) array
            Measured output; NaN where there is none.
        horizon : int
            In samples, 1 or more.
        t : (K,) array, optional
            Time stamps in s, strictly increasing.

        Raises
        ------
        InvalidArgumentError
            If the arrays do not fit, the horizon is longer than 1 for an unstable model, whose simulation runs away, or
            the median interval of the stamps is not that of the noise model.
        """
        columns, output, stamps, dt = self._record(u, y, t)
        horizon = whole("horizon", horizon, 1)
        found, is_prediction = self._run(columns, output, stamps, dt)
        if is_prediction and horizon > 1:
            raise InvalidArgumentError(
                f"horizon must be 1 for an unstable model, got {shown(horizon)}: what it predicts runs away"
            )
        return found if is_prediction else with_noise(found, output, self.noise, horizon, dt)

    def score(self, log: Log | Any, y: Any = None, t: Any = None) -> float:
        """Return the simulated fit in percent to another record; see `validate`."""
        return self.validate(log, y, t).fit


class Model(AnyModel, ModelFields):
    r"""An identified plant in the units of its signals.

    .. math:: y = \mathrm{output\_level} + G(s)\,(\mathrm{map}(u) - \mathrm{input\_level})

    Parameters
    ----------
    structure : Structure
    parameters : (P,) array
        In physical units, in the order of ``structure.names``.
    dt : float
        Sampling time in s of the record that the model was made from.
    covariance : (P, P) array or None
        Of the parameters; None where the estimator gives none.
    noise : NoiseModel or None
        Of the residual, where the method has one.
    input_hold : {"zoh", "foh"}
        What the input does between samples.
    input_map : {"identity", "square"} or callable
        A static nonlinearity ahead of G(s).
    input_level, output_level : float
        Working point: with the mapped input at ``input_level``, the output rests at ``output_level``.
    input_name, output_name : str
        Names of the signals, with their units in brackets at the end.
    simulated_fit, one_step_fit : float
        Fit in percent to the record that the model was made from; NaN if unknown.
    rejected : tuple of (str, int)
        How many samples were left out, by reason.
    verdict : Verdict
    provenance : Provenance

    Examples
    --------
    >>> import replant as rp
    >>> u = np.repeat([1.0, 3.0, 2.0, 4.0, 1.0], 40)
    >>> y = 7.0 + rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u - 1.0, dt=0.1)
    >>> model = rp.fit(u, y, 0.1, poles=1).model
    >>> model
    <Model 2 / (s + 0.5): u -> y, fit 100.0 %, trusted>
    >>> model.simulate([1.0, 1.0, 2.0, 2.0]).round(3)          # in absolute units
    array([7.   , 7.   , 7.   , 7.195])
    """

    LAYOUT = model_json.VERSION

    def _inputs_of(self, log: Log) -> FloatArray:
        return log.input

    def _deviations(self, u: Any) -> FloatArray:
        return self.linear_input(u)[:, None]

    def _record(self, u: Any, y: Any, t: Any) -> tuple[FloatArray, FloatArray, FloatArray | None, float]:
        u, y = record(u, y)
        stamps = None if t is None else increasing(t, u.size)
        return u, y, stamps, self.dt if stamps is None else usual_interval(stamps, self.dt)

    def _run(self, u: FloatArray, y: FloatArray, stamps: FloatArray | None, dt: float) -> tuple[FloatArray, bool]:
        v = self.linear_input(u)
        found = model_output(self.transfer_function, v, y, dt, input_hold=self.input_hold, t=stamps)
        return found.output, found.is_prediction

    def of_log(self, input_name: str, output_name: str, source: str, sha256: str = "") -> Model:
        """Return the same model with the names of its signals, and the name and digest of the log's file."""
        made = dataclasses.replace(self.provenance, source=source, sha256=sha256)
        return dataclasses.replace(self, input_name=input_name, output_name=output_name, provenance=made)

    def step(self, duration: float | None = None) -> StepResponse:
        """Return the response to a unit step of the mapped input over ``duration`` s, by default until it settles."""
        return StepResponse.of(self.transfer_function, self.uncertainty, time_of(self.transfer_function, duration))

    def impulse(self, duration: float | None = None) -> ImpulseResponse:
        """Return the response to a unit impulse of the mapped input over ``duration`` s, by default until it settles.

        With as many zeros as poles the output contains an impulse: this raises an InvalidArgumentError.
        """
        return ImpulseResponse.of(self.transfer_function, self.uncertainty, time_of(self.transfer_function, duration))

    def bode(self, frequency: Any = None) -> Bode:
        """Return magnitude and phase at ``frequency`` (F,) in rad/s, by default about poles and zeros."""
        return Bode.of(self.transfer_function, self.uncertainty, self.dt, frequency)

    def nyquist(self, frequency: Any = None) -> Nyquist:
        """Return G(i omega) at ``frequency`` (F,) in rad/s, by default as for `bode`, with its standard deviations."""
        return Nyquist.of(self.transfer_function, self.uncertainty, self.dt, frequency)

    def poles(self) -> PoleMap:
        """Return poles and zeros in rad/s, with the covariances of the poles."""
        return PoleMap.of(self.transfer_function, self.uncertainty)

    def plot(self, axes: Any = None) -> Any:
        """Draw step response, poles, and Bode diagram, into four ``axes`` if given; return the axes of matplotlib."""
        step, poles, magnitude, phase = axes_for("axes", axes, 4, (9.0, 6.4), nrows=2, ncols=2)
        self.step().plot(step)
        self.poles().plot(poles)
        self.bode().plot((magnitude, phase))
        return np.array([step, poles, magnitude, phase], dtype=object)

    def validate(self, log: Log | Any, y: Any = None, t: Any = None, *, reference: Any = None) -> Validation:
        """Compare the model with another record; offset and initial state are estimated, nothing else.

        A difference counts as a change of the plant if neither noise nor the model's covariance explains it.

        Parameters
        ----------
        log : Log or (K,) array
            The record, or its raw input.
        y : (K,) array, optional
            Measured output, where ``log`` is an array.
        t : (K,) array, optional
            Time stamps in s, where ``log`` is an array; without them samples are `dt` apart.
        reference : (K,) array, optional
            Set-point or dither, where ``log`` is an array and a controller makes the input; see `replant.fit`.

        Returns
        -------
        Validation
            Fit, residual, error by frequency and verdict, by this record alone.

        Raises
        ------
        InvalidArgumentError
            If the record is too short, or has no input and output.
        """
        if isinstance(log, Log):
            if y is not None or t is not None or reference is not None:
                raise InvalidArgumentError("a log has its own output, time and reference: leave out y, t and reference")
            check_one_reference(len(log.reference_names))
            stamps = None if log.stamps is None else increasing(log.stamps, log.input.size)
            return validate(self, log.input, log.output, stamps, log.reference, log.dt)
        if y is None:
            raise no_output(log, "the input and the output")
        u, y, stamps, dt = self._record(log, y, t)
        return validate(self, u, y, stamps, None if reference is None else reference_of(reference, u.size), dt)

    def to_control(self, pade: int | None = None) -> Any:
        """Return G(s) as `control.TransferFunction`, in deviations from the working point.

        See `TransferFunction.to_control`.
        """
        return self.transfer_function.to_control(pade)

    def to_scipy(self) -> Any:
        """Return G(s) as `scipy.signal.TransferFunction`, in deviations from the working point."""
        return self.transfer_function.to_scipy()

    def to_sympy(self) -> Any:
        """Return G(s) as an expression of SymPy in the symbol s."""
        return self.transfer_function.to_sympy()

    def __repr__(self) -> str:
        fit = "" if math.isnan(self.simulated_fit) else f", fit {self.simulated_fit:.1f} %"
        return f"<Model {self.transfer_function}: {self.input_name} -> {self.output_name}{fit}, {self.verdict.status}>"

    def _repr_latex_(self) -> str:
        return f"$\\displaystyle {latex(self.transfer_function)}$"

    def _repr_html_(self) -> str:
        return html(self)


def clock_of_log(log: Log, dt: float, t: Any) -> FloatArray | None:
    """Return the time stamps of a log's samples; None if they are ``dt`` apart.  ``t``: stamps given beside it."""
    if t is not None:
        raise InvalidArgumentError("a log has its own time: leave out t")
    return log.stamps if log.stamps is not None or log.dt == dt else log.dt * np.arange(len(log), dtype=np.float64)


def run_from(
    g: TransferFunction, v: FloatArray, dt: float, input_hold: str, stamps: FloatArray | None, *, at_rest: bool
) -> FloatArray:
    """Return the response (K,) to the deviations of an input, which begins at rest or, without ``at_rest``, from 0.

    An input that is not finite is replaced by the last finite one.
    """
    v = last_known(v, 0.0)
    first = float(v[0]) if v.size and at_rest else 0.0
    intervals = None if stamps is None else np.diff(stamps, prepend=stamps[:1] - dt)
    # with the longest interval as the usual one, no interval counts as a lost sample
    usual = dt if intervals is None else float(intervals.max(initial=dt))
    moved = Response(g, usual, input_hold).take(v - first, intervals).output
    return np.asarray(moved + g.dc_gain * first if first else moved)


def with_noise(output: FloatArray, y: FloatArray, noise: NoiseModel | None, horizon: int, dt: float) -> FloatArray:
    """Return a simulated output (K,) plus its residual to ``y`` (K,), ``dt`` apart, as predicted by a noise model."""
    if noise is None:
        return output
    if not abs(dt / noise.dt - 1.0) < SAME_CLOCK:
        raise InvalidArgumentError(
            f"the noise model is that of samples {noise.dt:g} s apart, t is usually {dt:g} s: "
            "simulate instead, or identify at this sampling time"
        )
    residual = y - output
    return output + ahead(noise.coefficients, np.where(np.isfinite(residual), residual, 0.0), horizon)


def usual_interval(t: FloatArray, dt: float) -> float:
    """Return the median interval of time stamps (K,) in s; ``dt`` for fewer than two."""
    return float(np.median(np.diff(t))) if t.size > 1 else dt


def reference_of(reference: Any, samples: int) -> FloatArray:
    """Return a reference (K,), checked."""
    r = vector("reference", reference)
    if r.size != samples:
        raise InvalidArgumentError(f"reference must have one value for each of {samples} samples, got {r.size}")
    return r


def in_lines(kind: str, model: ModelFields, samples: int, reasons: tuple[str, ...], *, has_model: bool = True) -> str:
    """Return a result in at most twelve lines: G(s), coefficients, fit, and the reasons of the verdict."""
    count = model.parameters.size
    stds = [None] * count if model.uncertainty is None else model.uncertainty.std.tolist()
    values = zip(model.names, model.parameters.tolist(), stds, strict=True)
    known = [f"{name} {with_std(value, std)}" for name, value, std in values]
    fits = [(model.simulated_fit, "simulated"), (model.one_step_fit, "one step ahead")]
    fit = ", ".join(f"{value:.1f} % {how}" for value, how in fits if not math.isnan(value))
    shown = [*reasons[:REASONS], *([f"... {len(reasons) - REASONS} more"] if len(reasons) > REASONS else [])]
    signals = f"{model.input_name} -> {model.output_name}"
    estimated = [
        f"<{kind} {model.transfer_function}: {signals}",
        *textwrap.wrap(", ".join(known), WIDTH, max_lines=COEFFICIENT_LINES),
        f"fit {fit or 'unknown'}; {samples:,} samples",
    ]
    lines = [
        *(estimated if has_model else [f"<{kind} without a model: {signals}", f"{samples:,} samples"]),
        f"{model.verdict.status}: {shown[0] if shown else ''}",
        *shown[1:],
    ]
    return "\n  ".join(lines) + ">"


def latex(model: TransferFunction) -> str:
    r"""Return G(s) as mathematical text of LaTeX."""
    dead_time = rf"\, e^{{-{_number(model.delay)}\, s}}" if model.delay else ""
    return rf"G(s) = \frac{{{_polynomial(model.num)}}}{{{_polynomial(model.den)}}}{dead_time}"


CELL = 'style="padding: 0 1em 0 0; text-align: left"'  # without it a page may leave no room between two cells


def html(model: Any, parts: Sequence[ModelFields] = ()) -> str:
    """Return G(s), the coefficients with their standard deviations, the poles and the verdict as HTML.

    ``parts``: the model of each input, if there are several.
    """
    fit = "not known" if math.isnan(model.simulated_fit) else f"{model.simulated_fit:.1f} %"
    reasons = "".join(f"<li>{escaped.escape(reason)}</li>" for reason in model.verdict.reasons)
    figures = "".join(map(_figures, parts or [model]))
    return f"<div>{figures}<p>fit {fit}<br>verdict <b>{model.verdict.status}</b></p><ul>{reasons}</ul></div>"


def _figures(model: ModelFields) -> str:
    std = None if model.uncertainty is None else model.uncertainty.std
    rows = []
    for i, name in enumerate(model.names):
        known = "" if std is None else f"± {std[i]:.2g}" if math.isfinite(std[i]) else "± unknown"
        cells = (name, f"{model.parameters[i]:.5g}", known)
        rows.append("<tr>" + "".join(f"<td {CELL}>{cell}</td>" for cell in cells) + "</tr>")
    poles = ", ".join(f"{pole:.4g}" for pole in model.transfer_function.poles.tolist())
    signals = escaped.escape(f"{model.input_name} → {model.output_name}")
    return (
        f"<p><b>G(s)</b> = {escaped.escape(str(model.transfer_function))}<br>{signals}, dt {model.dt:g} s</p>"
        f"<table>{''.join(rows)}</table><p>poles {poles} rad/s</p>"
    )


def with_picture(model: Any) -> str:
    """Return a model as HTML with the picture of its responses; without matplotlib, as text alone."""
    try:
        return html(model) + picture(model.plot())
    except MissingDependencyError:
        return html(model)


def _polynomial(coefficients: FloatArray) -> str:
    return "".join(terms_of(coefficients, _number, r"\, ", "s^{{{}}}"))


def _number(value: float) -> str:
    mantissa, _, exponent = f"{value:.5g}".partition("e")
    return rf"{mantissa} \cdot 10^{{{int(exponent)}}}" if exponent else mantissa
