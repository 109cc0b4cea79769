"""The Bode diagram, with a band of +-2 sigma."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from replant.arguments import FloatArray, instance
from replant.identified.responses import Bode, frequencies
from replant.limits import duration
from replant.model.transfer_function import TransferFunction
from replant.plotting.diagrams import TRUE, given_axes
from replant.report.figures import style
from replant.report.figures.poles import usable_uncertainty
from replant.runs.result import Result

WIDEST_DB, WIDEST_DEGREES = 60.0, 180.0
"""Half-width at which a band is cut, in dB and in degrees: beyond it nothing is known anyway [dB, degrees]."""


def draw_bode(
    result: Result,
    dt: float,
    *,
    truth: TransferFunction | None = None,
    axes: Any = None,
    input_label: str = "input",
    output_label: str = "output",
) -> Any:
    """Draw magnitude and phase over angular frequency up to the Nyquist frequency, with a band of +-2 sigma if known.

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

    Returns
    -------
    array of two axes
    """
    result = instance("result", result, Result)
    dt = duration("dt", dt)
    if axes is None:
        axes = style.new_axes(2, 1, (6.2, 4.8), sharex=True, height_ratios=(3, 2))
    top, bottom = given_axes("axes", axes, 2)
    unit = style.gain_unit(style.plant_input(result, input_label), output_label)
    top.set_ylabel(f"magnitude [dB re {unit}]" if unit else "magnitude [dB]")
    bottom.set_ylabel("phase [°]")
    bottom.set_xlabel("frequency [rad/s]")
    omega = frequencies(result.transfer_function, dt)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        response = result.transfer_function.response(omega)
        magnitude = 20.0 * np.log10(np.abs(response))
    for axis in (top, bottom):
        style.tidy(axis)
    if not np.isfinite(magnitude).all():
        for axis in (top, bottom):
            style.say(axis, "the response of G(s) is not finite")
        return np.array([top, bottom], dtype=object)
    phase = np.degrees(np.unwrap(np.angle(response)))
    phase -= 360.0 * round(float(phase[0]) / 360.0)
    _band(result, omega, magnitude, phase, top, bottom)
    top.semilogx(omega, magnitude, color=style.MODEL, lw=1.8, label="model")
    bottom.semilogx(omega, phase, color=style.MODEL, lw=1.8)
    if truth is not None:
        true = Bode.of(truth, None, dt, omega)
        top.semilogx(omega, 20.0 * np.log10(true.magnitude), label="true", **TRUE)
        bottom.semilogx(omega, np.degrees(true.phase), **TRUE)
    style.legend(top, 3)
    finish_bode(top, bottom, omega, magnitude, phase)
    return np.array([top, bottom], dtype=object)


def _band(result: Result, omega: FloatArray, magnitude: FloatArray, phase: FloatArray, top: Any, bottom: Any) -> None:
    known = usable_uncertainty(result)
    if known is None:
        return
    relative, angle = known.response(omega)
    if not (np.isfinite(relative).all() and np.isfinite(angle).all()):
        return
    decibels = np.minimum(style.SIGMAS * 20.0 / math.log(10.0) * relative, WIDEST_DB)
    degrees = np.minimum(style.SIGMAS * np.degrees(angle), WIDEST_DEGREES)
    look = {"color": style.MODEL, "alpha": 0.22, "lw": 0}
    top.fill_between(omega, magnitude - decibels, magnitude + decibels, label="± 2σ", **look)
    bottom.fill_between(omega, phase - degrees, phase + degrees, **look)


def finish_bode(top: Any, bottom: Any, omega: FloatArray, magnitude: FloatArray, phase: FloatArray) -> None:
    """Set limits and ticks of a Bode diagram, so that all of ``magnitude`` in dB and ``phase`` in degrees is seen."""
    from matplotlib.ticker import MaxNLocator, MultipleLocator

    span = float(np.ptp(phase))
    bottom.yaxis.set_major_locator(MultipleLocator(45 if span < 200 else 90) if span < 700 else MaxNLocator(5))
    bottom.set_ylim(min(float(phase.min()), 0.0) - 25.0, max(float(phase.max()), 0.0) + 25.0)
    room = max(0.1 * float(np.ptp(magnitude)), 3.0)
    top.set_ylim(float(magnitude.min()) - room, float(magnitude.max()) + room)
    for axis in (top, bottom):
        axis.set_xlim(float(omega[0]), float(omega[-1]))
        style.logarithmic(axis.xaxis)
