"""The outputs and the frequency responses of several methods' models, in common axes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from replant.arguments import FloatArray
from replant.identified.responses import frequencies
from replant.plotting.diagrams import given_axes
from replant.report.figures import style
from replant.report.figures.bode import WIDEST_DB, WIDEST_DEGREES, finish_bode
from replant.report.figures.poles import usable_uncertainty
from replant.runs.result import Clock, Result
from replant.runs.thinning import thin

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
