"""Draw several results or models beside each other: outputs, parameters, responses, poles."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from replant.arguments import FloatArray
from replant.identified.model import Model
from replant.identified.responses import frequencies
from replant.log import Log
from replant.plotting.diagrams import RADIUS_95, REACH_95, given_axes
from replant.report.figures import style
from replant.report.figures.responses import WIDEST_DB, WIDEST_DEGREES, finish_bode, usable_uncertainty
from replant.runs.result import Clock, Result
from replant.runs.thinning import thin

WIDEST = 1.5  # how far a panel reaches about the reference at the least [part of its size]
DEFAULT_SIZE = (9.0, 1.9, 1.7)  # width, height of a row, height of the rest [inches]


def draw_overlay(
    results: Mapping[str, Result],
    dt: float,
    *,
    reference: str | None = None,
    axes: Any = None,
    input_label: str = "input",
    output_label: str = "output",
) -> Any:
    """Draw each parameter's estimate over time by several methods, with its band of +-2 sigma if known.

    A fit of the whole record is a horizontal line; a method with an estimate only at the end is a dot.

    Parameters
    ----------
    results : dict of Result
        By the name of the method; all of the same structure.
    dt : float
        Sampling time in s.
    reference : str, optional
        The method whose last estimate sets the limits of the panels, by default the first: curves far beyond it are
        cut off.
    axes : P matplotlib axes, optional
        Drawn into; without them a figure is made.
    input_label, output_label : str
        With the unit in brackets at the end, if it is known; of the input after its map.

    Returns
    -------
    array of P axes
    """
    chosen = results[reference] if reference else next(iter(results.values()))
    structure = chosen.structure
    if axes is None:
        columns = 2 if structure.size > 1 else 1
        rows = -(-structure.size // columns)
        width, row, rest = DEFAULT_SIZE
        grid = style.new_axes(rows, columns, (width, rest + row * rows), sharex=True)
        for axis in grid.flat[structure.size :]:
            axis.set_axis_off()
        for axis in grid.flat[: structure.size][-columns:]:
            axis.tick_params(labelbottom=True)
        axes = grid.flat[: structure.size]
    axes = given_axes("axes", axes, structure.size)
    end = float(chosen.clock_of(dt).at(max(1, max(result.simulation.output.size for result in results.values()) - 1)))
    for i, (axis, label) in enumerate(zip(axes, style.symbols(structure, input_label, output_label), strict=True)):
        axis.set_title(label, loc="left", color=style.INK, fontsize="medium")
        style.tidy(axis)
        for number, (name, result) in enumerate(results.items()):
            _draw(axis, result, i, dt, end, name, *style.LINES[number % len(style.LINES)])
        axis.set_xlim(0.0, end)
        axis.set_ylim(*limits([result for result in results.values() if result is not chosen], chosen, i))
    style.label_time(axes)
    return np.array(axes, dtype=object)


def _draw(axis: Any, result: Result, i: int, dt: float, end: float, name: str, colour: str, dashes: Any) -> None:
    history, last = result.history, float(result.parameters[i])
    look: Any = {"color": colour, "ls": dashes, "lw": 1.4, "label": name}
    if history is None:
        if abs(last) <= style.FARTHEST:
            axis.plot([0.0, end], [last, last], **look)
        return
    begin = style.first_estimate(history)
    if begin == history.samples.size:  # only the solution at the end
        axis.plot([end], [last], marker="o", clip_on=False, **look)
        return
    t = result.clock_of(dt).after(history.samples[begin:])
    values = np.clip(history.parameters[begin:, i], -style.FARTHEST, style.FARTHEST)
    if (half := style.band(None if history.std is None else history.std[begin:, i])) is not None:
        low, high = (thin(values + sign * half, style.SHOWN_SMALL // 4) for sign in (-1.0, 1.0))
        axis.fill_between(low.among(t), low.values, high.values, color=colour, alpha=0.13, lw=0)
    drawn = thin(values, style.SHOWN_SMALL)
    axis.plot(drawn.among(t), drawn.values, **look)


def limits(others: Sequence[Result], reference: Result, i: int) -> tuple[float, float]:
    """Return the limits of a panel: the reference is shown completely, the others as far as they stay near it."""
    low, high = _settled(reference, i)
    middle = float(reference.parameters[i])
    ends = [abs(float(other.parameters[i]) - middle) for other in others]
    reach = max(WIDEST * abs(middle), high - low, 3.0 * float(np.median(ends)) if ends else 0.0)
    reach = min(reach, style.FARTHEST)
    for other in others:
        bottom, top = _settled(other, i)
        low, high = min(low, max(bottom, middle - reach)), max(high, min(top, middle + reach))
    return low, high


def _settled(result: Result, i: int) -> tuple[float, float]:
    last = float(result.parameters[i])
    values = np.full(1, last) if result.history is None else result.history.parameters[:, i]
    return style.settled_limits(values, [last])


def legend_columns(count: int, most: int) -> int:
    """Return how many columns, at most ``most``, give a legend of ``count`` entries rows of about equal length.

    Examples
    --------
    >>> legend_columns(5, 4), legend_columns(8, 4)
    (3, 4)
    """
    return -(-count // -(-count // most))


LAST = 10  # of a record one in so many samples, the last ones, is drawn apart [samples]
AROUND_DB, AROUND_DEGREES = 20.0, 90.0
"""How far the axes reach beyond the response of the reference at the most [dB, degrees]."""


def draw_outputs(
    results: Mapping[str, Result], y: FloatArray, dt: float, *, axes: Any = None, output_label: str = "output"
) -> Any:
    """Draw the output of each method's model, simulated from the input alone, over the measured one.

    The first axes show the whole record, the second its last tenth, where the curves can be told apart.

    Parameters
    ----------
    results : dict of Result
        By the name of the method; all of the same record.
    y : (K,) array
        Measured output.
    dt : float
        Sampling time in s.
    axes : two matplotlib axes, optional
        Drawn into; without them a figure is made.
    output_label : str
        With the unit in brackets at the end, if it is known.

    Returns
    -------
    array of two axes
    """
    axes = given_axes("axes", style.new_axes(2, 1, (9.0, 5.4)) if axes is None else axes, 2)
    clock = next(iter(results.values())).clock_of(dt)
    models = [result.simulation.output for result in results.values()]
    for axis, begin in zip(axes, (0, y.size - max(y.size // LAST, 2)), strict=True):
        axis.set_ylabel(output_label)
        style.tidy(axis)
        _curve(axis, y, clock, begin, color=style.MEASURED, lw=2.6, label="measured")
        for name, output, (colour, dashes) in zip(results, models, style.LINES, strict=False):
            _curve(axis, output, clock, begin, color=colour, ls=dashes, lw=1.1, label=name)
        axis.set_xlim(*(float(clock.at(place)) for place in (max(begin, 0), max(1, y.size - 1))))
        axis.set_ylim(*style.output_limits(y[begin:], *(output[begin:] for output in models)))
    style.label_time(axes)
    return np.array(axes, dtype=object)


def _curve(axis: Any, signal: FloatArray, clock: Clock, begin: int, **look: Any) -> None:
    drawn = thin(np.clip(signal[begin:], -style.FARTHEST, style.FARTHEST), style.SHOWN_SMALL)
    axis.plot(clock.at(begin + drawn.places), drawn.values, **look)


def draw_responses(
    results: Mapping[str, Result],
    dt: float,
    *,
    reference: str | None = None,
    axes: Any = None,
    input_label: str = "input",
    output_label: str = "output",
) -> Any:
    """Draw magnitude and phase of each method's model over angular frequency, with bands of +-2 sigma where known.

    Parameters
    ----------
    results : dict of Result
        By the name of the method.
    dt : float
        Sampling time in s.
    reference : str, optional
        The method whose response sets the limits of the axes, by default the first: curves far beyond it are cut off.
    axes : two matplotlib axes, optional
        Drawn into; without them a figure is made.
    input_label, output_label : str
        With the unit in brackets at the end, if it is known; of the input after its map.

    Returns
    -------
    array of two axes
    """
    chosen = results[reference] if reference else next(iter(results.values()))
    if axes is None:
        axes = style.new_axes(2, 1, (9.0, 5.4), sharex=True, height_ratios=(3, 2))
    top, bottom = given_axes("axes", axes, 2)
    unit = style.gain_unit(input_label, output_label)
    top.set_ylabel(f"magnitude [dB re {unit}]" if unit else "magnitude [dB]")
    bottom.set_ylabel("phase [°]")
    for axis in (top, bottom) if top.figure is not bottom.figure else (bottom,):
        axis.set_xlabel("frequency [rad/s]")
    for axis in (top, bottom):
        style.tidy(axis)
    span = frequencies(chosen.transfer_function, dt)[[0, -1]]
    drawn = {}
    for (name, result), (colour, dashes) in zip(results.items(), style.LINES, strict=False):
        drawn[name] = _response(result, dt, span, name, colour, dashes, top, bottom)
    known = drawn[reference or next(iter(results))] or next(filter(None, drawn.values()), None)
    if known is None:
        for axis in (top, bottom):
            style.say(axis, "no response is finite")
        return np.array([top, bottom], dtype=object)
    others = [curves for curves in drawn.values() if curves is not None]
    within = [
        np.concatenate([np.clip(curves[i], known[i].min() - reach, known[i].max() + reach) for curves in others])
        for i, reach in enumerate((AROUND_DB, AROUND_DEGREES))
    ]
    finish_bode(top, bottom, span, *within)
    return np.array([top, bottom], dtype=object)


def _response(
    result: Result, dt: float, span: FloatArray, name: str, colour: str, dashes: Any, top: Any, bottom: Any
) -> tuple[FloatArray, FloatArray] | None:
    """Draw a response; return its magnitude in dB and phase in degrees within ``span``, None where not finite."""
    omega = np.union1d(frequencies(result.transfer_function, dt), np.geomspace(span[0], span[1], 200))
    omega = omega[(omega >= span[0]) & (omega <= span[1])]
    with np.errstate(all="ignore"):
        response = result.transfer_function.response(omega)
        magnitude = 20.0 * np.log10(np.abs(response))
    if not np.isfinite(magnitude).all():
        return None
    phase = np.degrees(np.unwrap(np.angle(response)))
    phase -= 360.0 * round(float(phase[0]) / 360.0)
    uncertainty = usable_uncertainty(result)
    if uncertainty is not None:
        relative, angle = uncertainty.response(omega)
        decibels = np.minimum(style.SIGMAS * 20.0 / math.log(10.0) * relative, WIDEST_DB)
        degrees = np.minimum(style.SIGMAS * np.degrees(angle), WIDEST_DEGREES)
        for axis, values, half in ((top, magnitude, decibels), (bottom, phase, degrees)):
            axis.fill_between(omega, values - half, values + half, color=colour, alpha=0.13, lw=0)
    for axis, values in ((top, magnitude), (bottom, phase)):
        axis.semilogx(omega, values, color=colour, ls=dashes, lw=1.4, label=name)
    return magnitude, phase


def draw_models(
    models: Mapping[str, Model], results: Mapping[str, Result], log: Log, best: str, axes: Any = None
) -> Any:
    """Draw outputs, step responses, magnitudes and poles of all models; return four axes."""
    drawn = style.new_axes(2, 2, (11.0, 7.0)) if axes is None else axes
    output, step, magnitude, poles = given_axes("axes", drawn, 4)
    tail, phase = given_axes("axes", style.new_axes(2, 1, (4.0, 3.0)), 2)  # not shown
    draw_outputs(results, log.output, log.dt, axes=(output, tail), output_label=log.output_name)
    draw_steps(models, step)
    draw_responses(results, log.dt, reference=best, axes=(magnitude, phase))
    draw_poles_of(models, poles)
    output.legend(frameon=False, ncols=2)
    return np.array([output, step, magnitude, poles], dtype=object)


def draw_steps(models: Mapping[str, Model], axis: Any) -> None:
    """Draw the step response of each model with its band of two standard deviations."""
    longest = max(float(model.step().time[-1]) for model in models.values())
    for (name, model), (colour, dashes) in zip(models.items(), style.LINES, strict=False):
        step = model.step(longest)
        axis.plot(step.time, step.output, color=colour, ls=dashes, lw=1.4, label=name)
        if step.std is not None:
            reach = style.SIGMAS * np.minimum(step.std, np.ptp(step.output) or 1.0)
            axis.fill_between(step.time, step.output - reach, step.output + reach, color=colour, alpha=0.15, lw=0)
    axis.set_xlabel("time [s]")
    axis.set_ylabel("step response")
    style.tidy(axis)


def draw_poles_of(models: Mapping[str, Model], axis: Any) -> None:
    """Draw the poles of each model with their 95 % regions."""
    reach = 0.0
    for (name, model), (colour, _) in zip(models.items(), style.LINES, strict=False):
        found = model.poles()
        axis.plot(found.values.real, found.values.imag, "x", color=colour, ms=8, mew=2, label=name)
        reach = max(reach, float(np.abs(found.values).max()))
        for mode in found.uncertain:
            outline, is_real = _region(mode.mode.pole, mode.covariance), not mode.mode.pole.imag
            for side in (1.0,) if is_real else (1.0, -1.0):
                axis.plot(outline.real, side * outline.imag, color=colour, alpha=0.5, lw=5.0 if is_real else 1.2)
    axis.axvline(0.0, color=style.MUTED, lw=0.8)
    axis.set_xlim(-1.3 * reach, 0.5 * reach)
    axis.set_ylim(-1.1 * reach, 1.1 * reach)
    axis.set_xlabel("real part [rad/s]")
    axis.set_ylabel("imaginary part [rad/s]")
    style.tidy(axis)


def _region(pole: complex, covariance: Any) -> Any:
    """Return the outline (N,) of a pole's 95 % region; of a real pole its interval."""
    if not np.isfinite(covariance).all():
        return np.zeros(0, complex)
    if not pole.imag:
        return pole + REACH_95 * math.sqrt(max(float(covariance[0, 0]), 0.0)) * np.array([-1.0, 1.0])
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, math.tau, 91)
    unit = np.stack([np.cos(angle), np.sin(angle)]) * RADIUS_95 * np.sqrt(np.maximum(values, 0.0))[:, None]
    outline = vectors @ unit
    return pole + outline[0] + 1j * outline[1]
