"""Plots of responses: over time, Bode, Nyquist, poles; matplotlib's own style, so that they fit a notebook."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from replant.arguments import FloatArray
from replant.plotting.palette import BLUE, VERMILION, blank_figure, given_axes, open_frame
from replant.plotting.poles import draw_roots, mirrored

SIGMAS = 2.0  # half-width of every band [standard deviations]
WIDEST_DB, WIDEST_DEGREES = 60.0, 180.0
"""Half-width at which a band is cut: beyond it nothing is known anyway [dB, degrees]."""

ComplexArray = npt.NDArray[np.complex128]


def draw_over_time(time: FloatArray, output: FloatArray, std: FloatArray | None, what: str, ax: Any = None) -> Any:
    """Draw an output over time in s with a band of +-2 standard deviations; return the axes."""
    axis = blank_figure(6.2, 3.4).subplots() if ax is None else given_axes("ax", ax, 1)[0]
    if std is not None:
        low, high = output - SIGMAS * std, output + SIGMAS * std
        axis.fill_between(time, low, high, color=BLUE, alpha=0.22, lw=0, label="± 2σ")
    axis.plot(time, output, color=BLUE, lw=1.6, label="model")
    axis.set_xlim(float(time[0]), float(time[-1]))
    axis.set_xlabel("time [s]")
    axis.set_ylabel(what)
    axis.legend(frameon=False)
    open_frame(axis)
    return axis


def draw_bode(
    frequency: FloatArray,
    magnitude: FloatArray,
    phase: FloatArray,
    relative_std: FloatArray | None,
    phase_std: FloatArray | None,
    ax: Any = None,
) -> Any:
    """Draw magnitude in dB and phase in degrees over frequency in rad/s, with bands of +-2 standard deviations."""
    axes = blank_figure(6.2, 4.8).subplots(2, 1, sharex=True) if ax is None else given_axes("ax", ax, 2)
    top, bottom = np.asarray(axes, dtype=object).ravel()
    drawn = frequency > 0.0  # no other has a place on a logarithmic axis
    frequency, magnitude, phase = frequency[drawn], magnitude[drawn], phase[drawn]
    relative_std, phase_std = (None if std is None else std[drawn] for std in (relative_std, phase_std))
    with np.errstate(divide="ignore"):
        decibels, degrees = 20.0 * np.log10(magnitude), np.degrees(phase)
    for axis, values, std, widest, unit in (
        (top, decibels, relative_std, WIDEST_DB, 20.0 / math.log(10.0)),
        (bottom, degrees, phase_std, WIDEST_DEGREES, 180.0 / math.pi),
    ):
        if std is not None:
            band = np.minimum(SIGMAS * unit * std, widest)
            axis.fill_between(frequency, values - band, values + band, color=BLUE, alpha=0.22, lw=0, label="± 2σ")
        axis.semilogx(frequency, values, color=BLUE, lw=1.6, label="model")
        open_frame(axis)
    top.set_ylabel("magnitude [dB]")
    top.legend(frameon=False)
    bottom.set_ylabel("phase [°]")
    bottom.set_xlabel("frequency [rad/s]")
    if frequency.size and frequency[0] != frequency[-1]:
        bottom.set_xlim(float(frequency[0]), float(frequency[-1]))
    return np.array([top, bottom], dtype=object)


def draw_nyquist(
    response: ComplexArray, relative_std: FloatArray | None, phase_std: FloatArray | None, ax: Any = None
) -> Any:
    """Draw a frequency response in the complex plane, with regions of 2 standard deviations; return the axes."""
    axis = blank_figure(5.0, 4.6).subplots() if ax is None else given_axes("ax", ax, 1)[0]
    if relative_std is not None and phase_std is not None:
        angle = np.linspace(0.0, math.tau, 61)
        every = max(1, response.size // 60)
        chosen = zip(response[::every], relative_std[::every], phase_std[::every], strict=True)
        for number, (middle, relative, turn) in enumerate(chosen):
            # along the radius and across it; that the two errors are correlated is left out
            ellipse = middle * (1.0 + SIGMAS * (relative * np.cos(angle) + 1j * turn * np.sin(angle)))
            label = "" if number else "2σ"
            axis.fill(ellipse.real, ellipse.imag, color=BLUE, alpha=0.16, lw=0, label=label or None)
    axis.plot(response.real, response.imag, color=BLUE, lw=1.6, label="model")
    axis.plot([-1.0], [0.0], "+", color=VERMILION, ms=9, mew=1.6, label="-1")
    axis.set_xlabel("real part")
    axis.set_ylabel("imaginary part")
    axis.legend(frameon=False)
    open_frame(axis)
    return axis


def draw_poles(
    poles: ComplexArray, zeros: ComplexArray, regions: list[tuple[complex, FloatArray]], ax: Any = None
) -> Any:
    """Draw poles (crosses) and zeros (circles) in rad/s, with 95 % regions of the poles; return the axes."""
    axis = blank_figure(5.2, 4.6).subplots() if ax is None else given_axes("ax", ax, 1)[0]
    both = [(pole.conjugate(), mirrored(covariance)) for pole, covariance in regions if pole.imag]
    draw_roots(axis, poles, zeros, [*regions, *both])
    axis.set_xlabel("real part [rad/s]")
    axis.set_ylabel("imaginary part [rad/s]")
    axis.legend(frameon=False)
    open_frame(axis)
    return axis
