"""Draw what a model says: Bode diagram, step response, poles and zeros, and the spectrum of its noise."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from replant.arguments import FloatArray, instance
from replant.identified.responses import Bode, StepResponse, frequencies
from replant.limits import duration
from replant.model.noise import NoiseModel
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.plotting.diagrams import TRUE, RootColours, draw_roots, given_axes, mirrored
from replant.report.figures import style
from replant.runs.result import Result

COLOURS = RootColours(style.MODEL, style.RESIDUAL, style.MUTED, style.GRID)


def draw_poles_and_zeros(result: Result, *, truth: TransferFunction | None = None, ax: Any = None) -> Any:
    """Draw poles (crosses) and zeros (circles), with their 95 % confidence ellipses if a covariance is known.

    Parameters
    ----------
    result : Result
    truth : TransferFunction, optional
        The true plant of a simulated record.
    ax : matplotlib axes, optional
        Drawn into; without it a figure is made.

    Returns
    -------
    axes
    """
    axis = style.new_axes(1, 1, (5.2, 4.8))[0, 0] if ax is None else given_axes("ax", ax, 1)[0]
    model = result.transfer_function
    axis.set_xlabel("real part [rad/s]")
    axis.set_ylabel("imaginary part [rad/s]")
    style.tidy(axis)
    roots = np.concatenate([model.poles, model.zeros])
    if not (np.isfinite(roots).all() and np.abs(roots).max() < style.FARTHEST):
        style.say(axis, "not finite, or too large to draw")
        return axis
    draw_roots(axis, model.poles, model.zeros, regions(result), COLOURS)
    if truth is not None:
        look: Any = {"ls": "none", "marker": "D", "ms": 11, "mfc": "none", "mew": 0.9, "color": TRUE["color"]}
        axis.plot(truth.poles.real, truth.poles.imag, label="true poles", **look)
    style.legend(axis, 4)
    return axis


def regions(result: Result) -> list[tuple[complex, FloatArray]]:
    """Return each pole and zero with the covariance (2, 2) of its real and imaginary part; empty where unknown."""
    known = usable_uncertainty(result)
    if known is None:
        return []
    found = []
    with np.errstate(all="ignore"):  # at a double root the region is unbounded
        modes = known.modes
    for mode in modes:
        found.append((mode.mode.pole, mode.covariance))
        if mode.mode.pole.imag > 0:
            found.append((mode.mode.pole.conjugate(), mirrored(mode.covariance)))
    numerator = known.covariance[result.structure.numerator, result.structure.numerator]
    num = result.transfer_function.num
    return found + [(zero, zero_covariance(num, numerator, zero)) for zero in result.transfer_function.zeros.tolist()]


def usable_uncertainty(result: Result) -> Uncertainty | None:
    """Return the uncertainty of a result; None if it has no covariance, or one that is not finite."""
    if result.covariance is None or not np.isfinite(result.covariance).all():
        return None
    return Uncertainty(result.structure, result.parameters, result.covariance)


def zero_covariance(num: FloatArray, covariance: FloatArray, zero: complex) -> FloatArray:
    """Return the covariance (2, 2) of a zero's real and imaginary part: N(z) = 0 gives dz/db_i = -z^i / N'(z).

    >>> zero_covariance(np.array([2.0, 4.0]), np.diag([0.0, 0.16]), -2.0)   # b0 / b1, b0 off by 0.4
    array([[0.04, 0.  ], [0.  , 0.  ]])
    """
    steepness = complex(np.polyval(np.polyder(num), zero))
    size = covariance.shape[0]
    if steepness == 0.0 or num.size != size:
        return np.full((2, 2), np.inf)
    slope = -(complex(zero) ** np.arange(size - 1, -1, -1)) / steepness
    parts = np.stack([slope.real, slope.imag])
    return np.asarray(parts @ covariance @ parts.T) + 0.0


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


def draw_step(
    result: Result,
    *,
    truth: TransferFunction | None = None,
    ax: Any = None,
    input_label: str = "input",
    output_label: str = "output",
) -> Any:
    """Draw the output by a unit step of the input of G(s), until it has settled, with its band of +-2 sigma.

    Parameters
    ----------
    result : Result
    truth : TransferFunction, optional
        The true plant of a simulated record.
    ax : matplotlib axes, optional
        Drawn into; without it a figure is made.
    input_label, output_label : str
        With the unit in brackets at the end, if it is known.

    Returns
    -------
    axes
    """
    axis = style.new_axes(1, 1, (6.2, 3.4))[0, 0] if ax is None else given_axes("ax", ax, 1)[0]
    unit = style.gain_unit(style.plant_input(result, input_label), output_label)
    axis.set_ylabel(f"step response [{unit}]" if unit else "step response")
    axis.set_xlabel("time [s]")
    style.tidy(axis)
    with np.errstate(all="ignore"):
        step = result.model.step()
    if not (np.isfinite(step.output).all() and np.abs(step.output).max() < style.FARTHEST):
        style.say(axis, "the response of G(s) is not finite")
        return axis
    shown = [step.output, np.zeros(1)]
    if step.std is not None and np.isfinite(step.std).all():
        low, high = step.output - style.SIGMAS * step.std, step.output + style.SIGMAS * step.std
        axis.fill_between(step.time, low, high, color=style.MODEL, alpha=0.22, lw=0, label="± 2σ")
        shown += [low, high]
    axis.axhline(0.0, color=style.MUTED, lw=0.8)
    axis.plot(step.time, step.output, color=style.MODEL, lw=1.8, label="model")
    if truth is not None:
        axis.plot(step.time, StepResponse.of(truth, None, step.time).output, label="true", **TRUE)
    axis.set_xlim(0.0, float(step.time[-1]))
    axis.set_ylim(*style.output_limits(np.concatenate(shown[:2]), *shown[2:]))
    style.legend(axis, 3)
    return axis


SEGMENTS = 8
"""Stretches of the record, half overlapping, over whose periodograms the measured spectrum is the mean [count]."""
SHORTEST = 64  # samples that a stretch needs [samples]
POINTS = 300  # points of the model's curve [count]
ABOVE_LEGEND = 20.0
"""Distance of the title from the axis: the legend is between them, as side by side they touch [points]."""
DECADES = 3.0  # decades below half the sampling rate that are shown [decades]


def periodogram(residual: FloatArray, dt: float) -> tuple[FloatArray, FloatArray] | None:
    """Return angular frequencies in rad/s and the two-sided power spectral density of a residual (K,), per Hz.

    By Welch's method with a Hann window.  None where fewer than `SHORTEST` samples are finite; a sample that is not
    counts as zero.

    Examples
    --------
    >>> noise = np.random.default_rng(0).standard_normal(10_000)
    >>> omega, density = periodogram(noise, 0.1)
    >>> bool(abs(density.mean() - 0.1) < 0.01)  # white noise: its variance times dt
    True
    """
    known = np.isfinite(residual)
    if known.sum() < SHORTEST:
        return None
    filled = np.where(known, residual - residual[known].mean(), 0.0)
    length = max(2 * filled.size // (SEGMENTS + 1), SHORTEST)
    window = np.hanning(length)
    begins = range(0, filled.size - length + 1, max(length // 2, 1))
    powers = [np.abs(np.fft.rfft(window * filled[begin : begin + length])) ** 2 for begin in begins]
    density = np.mean(powers, axis=0) * dt / np.sum(window**2)
    omega = np.asarray(2.0 * math.pi * np.fft.rfftfreq(length, dt), np.float64)
    return omega[1:-1], np.asarray(density[1:-1])


def draw_spectrum(noise: NoiseModel | None, residual: FloatArray, dt: float, *, ax: Any = None) -> Any:
    """Draw the power spectral density of the residual and of its model, over the angular frequency.

    Parameters
    ----------
    noise : NoiseModel or None
    residual : (K,) array
        Measured minus simulated output; NaN for samples that are left out.
    dt : float
        Sampling time in s.
    ax : matplotlib axis, optional
        Drawn into; without it a figure is made.

    Returns
    -------
    axis
    """
    if ax is None:
        ax = style.new_axes(1, 1, (4.8, 3.4))[0, 0]
    ax.set_title("spectrum of the noise", loc="left", color=style.INK, fontsize="medium", pad=ABOVE_LEGEND)
    style.tidy(ax)
    ax.set_xlabel("angular frequency [rad/s]")
    ax.set_ylabel("power per Hz")
    found = periodogram(residual, dt)
    if found is None or not (found[1] > 0.0).any():
        style.say(ax, "too few samples, or no residual")
        return ax
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.plot(*found, color=style.MEASURED, lw=1.6, label="residual")
    if noise is not None and noise.variance > 0.0:
        highest = math.pi / dt
        omega = np.geomspace(max(found[0][0], highest * 10.0**-DECADES), highest, POINTS)
        label = "white noise" if noise.is_white else f"model of order {noise.order}"
        ax.plot(omega, noise.spectrum(omega), color=style.MODEL, lw=1.4, label=label)
    style.legend(ax, 2)
    return ax
