"""Figures of a result, drawn with matplotlib into given axes or into a new figure; the axes are returned.

Examples
--------
>>> import numpy as np
>>> from replant import Structure, TransferFunction
>>> from replant.online.runs.run import run_online
>>> from replant.estimation.settings import Request
>>> u = np.where(np.arange(2000) // 50 % 2 == 0, 1.0, -1.0)
>>> y = TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.1)
>>> result = run_online(Request(Structure(poles=1), 0.1), u, y)
>>> top, bottom = draw_bode(result, 0.1, input_label="voltage [V]", output_label="speed [rpm]")
>>> top.get_ylabel()
'magnitude [dB re rpm/V]'
>>> axis = draw_poles_and_zeros(result)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError
from replant.fitting.log_inspection import Inspection
from replant.fitting.model import Model
from replant.fitting.responses import Bode, frequencies
from replant.model.noise import NoiseModel
from replant.model.preprocess import accepted
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import FloatArray, instance, one_of, owned, record, text, vector
from replant.numerics.limits import duration, file_path
from replant.numerics.residuals import Correlations
from replant.online.runs.result import Clock, Result
from replant.plotting import diagrams, style
from replant.plotting.numbers import gain_unit
from replant.plotting.over_time import SHOWN_SMALL, draw_panels
from replant.plotting.style import INK, MEASURED, MODEL, MUTED, RESIDUAL, TRUTH, axes_for
from replant.report import panels
from replant.report.findings import Excitation

__all__ = [
    "INK",
    "MEASURED",
    "MODEL",
    "MUTED",
    "RESIDUAL",
    "TRUTH",
    "draw_bode",
    "draw_correlations",
    "draw_excitation",
    "draw_fit",
    "draw_outputs",
    "draw_overlay",
    "draw_poles_and_zeros",
    "draw_responses",
    "draw_spectrum",
    "draw_step",
    "draw_transients",
    "save_figures",
]


def draw_fit(
    result: Result,
    u: FloatArray,
    y: FloatArray,
    dt: float,
    *,
    axes: Any = None,
    input_label: str = "input",
    output_label: str = "output",
) -> Any:
    """Draw input, both outputs and the residual over time; return three axes; samples left out are shaded.

    Parameters
    ----------
    result : Result
    u, y : (K,) arrays
        Raw input and output.  For a record that is too long for memory, its newest samples; the overview is drawn.
    dt : float
        Sampling time in s.
    axes : three matplotlib axes, optional
        Drawn into; without them a figure is made.
    input_label, output_label : str
        With the unit in brackets at the end, if it is known.

    Raises
    ------
    InvalidArgumentError
        If ``u`` and ``y`` are not the record of the result.
    """
    result = instance("result", result, Result)
    input_label, output_label = _labels(input_label, output_label)
    axes = axes_for("axes", axes, 3, (9.0, 6.6), sharex=True, height_ratios=(1, 2, 1))
    dt, (u, y) = duration("dt", dt), (accepted(signal)[0] for signal in record(u, y))
    model = result.simulation.output
    if not u.size == y.size == model.size:
        raise InvalidArgumentError(
            f"u and y must be the record of the result, {model.size} samples long, got {u.size} and {y.size}"
        )
    inputs, outputs = panels.fit_panels(result, {input_label: u}, y, dt, output_label)
    drawn = draw_panels(axes, inputs + outputs)
    style.legend(axes[1])
    return drawn


def draw_transients(
    result: Result,
    dt: float,
    *,
    truth: Sequence[float] | None = None,
    axes: Any = None,
    input_label: str = "input",
    output_label: str = "output",
) -> Any:
    """Draw each parameter's estimate over time, its band of +-2 sigma, and the true value if known; return the axes.

    Parameters
    ----------
    result : Result
        Result of an online run.
    dt : float
        Sampling time in s.
    truth : (P,) sequence, optional
        True parameters.
    axes : P matplotlib axes, optional
        Drawn into; without them a figure is made.
    input_label, output_label : str
        With the unit in brackets at the end, if it is known.
    """
    result = instance("result", result, Result)
    dt, count = duration("dt", dt), result.structure.size
    input_label, output_label = _labels(input_label, output_label)
    true = None if truth is None else owned("truth", truth, (count,)).tolist()
    shown = panels.estimate_panels(result, dt, true, panels.plant_input(result, input_label), output_label)
    drawn = draw_panels(_for_parameters(axes, count, 1.3), shown, SHOWN_SMALL, titled=True)
    style.legend(drawn[0])
    return drawn


def _labels(input_label: str, output_label: str) -> tuple[str, str]:
    """Return the labels of input and output, checked."""
    return text("input_label", input_label), text("output_label", output_label)


def _model(result: Result, input_label: str, output_label: str) -> Model:
    """Return the model of a result with the labels of its mapped input and its output."""
    input_label, output_label = _labels(input_label, output_label)
    return replace(result.model, input_name=panels.plant_input(result, input_label), output_name=output_label)


def _several(results: Mapping[str, Result], reference: str | None = None) -> tuple[dict[str, Result], str]:
    """Return several results by name, checked, and the name of the one that the others are drawn beside."""
    if not isinstance(results, Mapping) or not results:
        raise ArgumentTypeError("results must be a dict of Result by the name of the method, of at least one")
    found = {text("results", name): instance(f"results[{name!r}]", result, Result) for name, result in results.items()}
    return found, next(iter(found)) if reference is None else one_of("reference", reference, tuple(found))


def _for_parameters(axes: Any, count: int, rest: float) -> list[Any]:
    """Return the given axes, or those of a new figure in two columns; ``rest`` is its height without the rows."""
    return style.in_two_columns(count, 9.0, rest, 1.9) if axes is None else style.given_axes("axes", axes, count)


def draw_overlay(
    results: Mapping[str, Result],
    dt: float,
    *,
    reference: str | None = None,
    axes: Any = None,
    input_label: str = "input",
    output_label: str = "output",
) -> Any:
    """Draw each parameter's estimate by several methods, with its band of +-2 sigma if known; return the axes.

    A fit of the whole record is a horizontal line; a method with an estimate only at the end is a dot.

    Parameters
    ----------
    results : dict of Result
        By the name of the method; all of the same structure.
    dt : float
        Sampling time in s.
    reference : str, optional
        The method whose last estimate sets the limits of the panels, by default the first; curves far beyond are cut
        off.
    axes : P matplotlib axes, optional
        Drawn into; without them a figure is made.
    input_label, output_label : str
        With the unit in brackets at the end, if it is known; ``input_label`` is that of the mapped input.
    """
    results, chosen = _several(results, reference)
    dt, (input_label, output_label) = duration("dt", dt), _labels(input_label, output_label)
    names = results[chosen].structure.names
    for name, result in results.items():
        if result.structure.names != names:
            raise InvalidArgumentError(
                f"results must have the same coefficients: {chosen!r} has {', '.join(names)}, {name!r} "
                f"{', '.join(result.structure.names)}"
            )
    axes = _for_parameters(axes, len(names), 1.7)
    drawn = panels.overlay_panels(results, dt, chosen, input_label, output_label)
    return draw_panels(axes, drawn, SHOWN_SMALL, titled=True)


def draw_outputs(
    results: Mapping[str, Result], y: FloatArray, dt: float, *, axes: Any = None, output_label: str = "output"
) -> Any:
    """Draw each method's simulated output over the measured one, whole and the last tenth; return two axes."""
    results, _ = _several(results)
    y, dt, output_label = vector("y", y), duration("dt", dt), text("output_label", output_label)
    for result in results.values():
        if result.simulation.output.size != y.size:
            raise InvalidArgumentError(
                f"y must be the record of the results, {result.simulation.output.size} samples long, got {y.size}"
            )
    axes = axes_for("axes", axes, 2, (9.0, 5.4))
    return draw_panels(axes, panels.output_panels(results, y, dt, output_label), SHOWN_SMALL)


def draw_excitation(found: Excitation | None, dt: float, *, axes: Any = None, clock: Clock | None = None) -> Any:
    """Draw how well the samples of each window of a record determine the parameters, and return both axes.

    Values that are rounding errors are drawn at the edge: eigenvalues below 1e-12, condition numbers above 1e10.

    Parameters
    ----------
    found : Excitation or None
        From `replant.report.findings.excitation`.
    dt : float
        Sampling time in s.
    axes : two matplotlib axes, optional
        For the smallest eigenvalue of the scaled information matrix, and for the condition number.
    clock : Clock, optional
        The times of the samples, if the clock is irregular.
    """
    found, clock = instance("found", found, Excitation, None), instance("clock", clock, Clock, None)
    dt = duration("dt", dt)
    axes = axes_for("axes", axes, 2, (9.0, 4.2), sharex=True)
    drawn = draw_panels(axes, panels.excitation_panels(found, clock or Clock(dt)))
    for axis in axes:
        axis.set_ylabel(axis.get_ylabel().replace(" ", "\n"))
    if len(axes[1].get_lines()) > 1:
        style.legend(axes[1])
    return drawn


def draw_correlations(found: Correlations | None, dt: float, *, axes: Any = None) -> Any:
    """Draw the residual's correlation with itself and with the input, with 95 and 99 % limits; return both axes.

    For a model that explains the record, 95 % of the lags lie within the inner limits.  Cross-correlation at negative
    lags, at which the input follows the residual, indicates feedback.

    Parameters
    ----------
    found : Correlations or None
        From `replant.numerics.residuals.correlations`.
    dt : float
        Sampling time in s.
    axes : two matplotlib axes, optional
        Drawn into; without them a figure is made.
    """
    found = instance("found", found, Correlations, None)
    return diagrams.draw_correlations(found, duration("dt", dt), axes)


def draw_poles_and_zeros(result: Result, *, truth: TransferFunction | None = None, ax: Any = None) -> Any:
    """Draw poles (crosses) and zeros (circles), with 95 % ellipses if a covariance is known; return the axes.

    Parameters
    ----------
    result : Result
    truth : TransferFunction, optional
        The true plant of a simulated record.
    ax : matplotlib axes, optional
        Drawn into; without it a figure is made.
    """
    result, truth = instance("result", result, Result), instance("truth", truth, TransferFunction, None)
    return panels.draw_poles_of(result.model, ax, truth)


def draw_bode(
    result: Result,
    dt: float,
    *,
    truth: TransferFunction | None = None,
    axes: Any = None,
    input_label: str = "input",
    output_label: str = "output",
) -> Any:
    """Draw magnitude and phase up to the Nyquist frequency, with a band of +-2 sigma if known; return both axes.

    Parameters
    ----------
    result : Result
    dt : float
        Sampling time in s.
    truth : TransferFunction, optional
        The true plant of a simulated record.
    axes : two matplotlib axes, optional
        Drawn into; without them a figure is made.
    input_label, output_label : str
        With the unit in brackets at the end, if it is known.
    """
    result, dt = instance("result", result, Result), duration("dt", dt)
    truth = instance("truth", truth, TransferFunction, None)
    return panels.draw_bode_of(_model(result, input_label, output_label), axes, truth, dt=dt)


def draw_responses(
    results: Mapping[str, Result],
    dt: float,
    *,
    reference: str | None = None,
    axes: Any = None,
    input_label: str = "input",
    output_label: str = "output",
) -> Any:
    """Draw magnitude and phase of each method's model, with bands of +-2 sigma if known; return both axes.

    The response of the ``reference``, by default the first, sets the limits; curves far beyond are cut off.
    """
    results, chosen = _several(results, reference)
    dt, unit = duration("dt", dt), gain_unit(*_labels(input_label, output_label))
    found = responses_of(results, dt, chosen)
    return diagrams.draw_bode(found, axes, reference=chosen, unit=unit, size=(9.0, 5.4))


def responses_of(results: Mapping[str, Result], dt: float, reference: str) -> dict[str, Bode]:
    """Return responses over the range of the reference's frequencies, with denser ones at each model's resonances."""
    span = frequencies(results[reference].transfer_function, dt)[[0, -1]]
    found = {}
    for name, result in results.items():
        omega = np.union1d(frequencies(result.transfer_function, dt), np.geomspace(span[0], span[1], 200))
        with np.errstate(all="ignore"):
            found[name] = result.model.bode(omega[(omega >= span[0]) & (omega <= span[1])])
    return found


def draw_step(
    result: Result,
    *,
    truth: TransferFunction | None = None,
    ax: Any = None,
    input_label: str = "input",
    output_label: str = "output",
) -> Any:
    """Draw the response to a unit step until it has settled, with its band of +-2 sigma, and return the axes.

    Parameters
    ----------
    result : Result
    truth : TransferFunction, optional
        The true plant of a simulated record.
    ax : matplotlib axes, optional
        Drawn into; without it a figure is made.
    input_label, output_label : str
        With the unit in brackets at the end, if it is known.
    """
    result, truth = instance("result", result, Result), instance("truth", truth, TransferFunction, None)
    return panels.draw_step_of(_model(result, input_label, output_label), ax, truth)


def draw_spectrum(noise: NoiseModel | None, residual: FloatArray, dt: float, *, ax: Any = None) -> Any:
    """Draw the power spectral density of the residual and of its model, and return the axes.

    Parameters
    ----------
    noise : NoiseModel or None
    residual : (K,) array
        Measured minus simulated output; NaN for samples that are left out.
    dt : float
        Sampling time in s.
    ax : matplotlib axis, optional
        Drawn into; without it a figure is made.
    """
    noise, dt = instance("noise", noise, NoiseModel, None), duration("dt", dt)
    return diagrams.draw_spectrum(noise, vector("residual", residual), dt, ax)


def save_columns(folder: Path, found: Inspection) -> Path | None:
    """Draw the columns of numbers as ``columns.png`` and return its path; None if there is none to draw."""
    shown = panels.column_panels(found)
    if not shown:
        return None
    axes = axes_for("axes", None, len(shown), (9.0, 0.8 + 1.5 * len(shown)), sharex=True)
    draw_panels(axes, shown)
    if found.clock is None or math.isnan(found.clock.dt):
        axes[-1].set_xlabel("sample")
    return style.saved(folder, {"columns": axes[0]})[0]


def save_figures(
    folder: Path,
    result: Result,
    u: FloatArray,
    y: FloatArray,
    dt: float,
    *,
    input_label: str = "input",
    output_label: str = "output",
    truth: Sequence[float] | None = None,
) -> list[Path]:
    """Draw the fit and the parameter estimates over time as PNG files, and return their paths.

    Parameters
    ----------
    folder : Path
        Created if missing.
    result : Result
    u, y : (K,) arrays
        Raw input and output.
    dt : float
        Sampling time in s.
    input_label, output_label : str
        With the unit in brackets at the end, if it is known.
    truth : (P,) sequence, optional
        True parameters, of a simulated plant.

    Raises
    ------
    InvalidArgumentError
        If ``u`` and ``y`` are not the record of the result.
    MissingDependencyError
        If matplotlib is not installed.
    """
    result = instance("result", result, Result)
    folder = Path(file_path("folder", folder))
    labels = {"input_label": input_label, "output_label": output_label}
    drawn = {"fit": draw_fit(result, u, y, dt, **labels)}
    style.title(drawn["fit"][1], f"simulated fit {result.simulation.fit:.1f} %")
    if result.history is not None and len(result.history.samples):
        drawn["parameters"] = draw_transients(result, dt, truth=truth, **labels)
    return style.saved(folder, {name: axes[0] for name, axes in drawn.items()})
