"""The spectrum of the noise: that of the residual as measured, and that of its model."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from replant.arguments import FloatArray
from replant.model.noise import NoiseModel
from replant.report.figures import style

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
