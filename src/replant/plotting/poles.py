"""Poles and zeros in the complex plane with their 95 % regions, as model and report draw them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from replant.arguments import FloatArray
from replant.plotting.palette import BLUE, GREY, VERMILION

UNSTABLE = 1e12  # how far the right half-plane is shaded: as far as anybody may look [rad/s]
RADIUS_95 = 2.448
"""Radius of the 95 % ellipse of two normal variables [standard deviations].
Level: 95 %: the square root of the quantile of chi squared with two degrees of freedom.
"""
REACH_95 = 1.96
"""Half-width of the 95 % interval of a normal variable [standard deviations].
Level: 95 %.
"""

ComplexArray = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class RootColours:
    """Colours of a plot of poles and zeros: its markers, the axes, and the unstable half-plane."""

    pole: str = BLUE
    zero: str = VERMILION
    line: str = GREY
    half: str = "#dddddd"


PLAIN = RootColours()


def draw_roots(
    axis: Any,
    poles: ComplexArray,
    zeros: ComplexArray,
    regions: Sequence[tuple[complex, FloatArray]],
    colours: RootColours = PLAIN,
) -> None:
    """Draw poles (crosses) and zeros (circles) in rad/s, with 95 % regions; the right half-plane is shaded."""
    axis.axvspan(0.0, UNSTABLE, color=colours.half, alpha=0.45, lw=0)
    axis.axhline(0.0, color=colours.line, lw=0.8)
    axis.axvline(0.0, color=colours.line, lw=0.8)
    _limits(axis, np.concatenate([poles, zeros]))
    drawn = False
    for root, covariance in regions:
        drawn |= _region(axis, root, covariance, colours.pole, label="" if drawn else "95 % region")
    marks = {"mfc": "none", "clip_on": False}
    axis.plot(poles.real, poles.imag, "x", color=colours.pole, ms=9, mew=2.0, label="poles", **marks)
    if zeros.size:
        axis.plot(zeros.real, zeros.imag, "o", color=colours.zero, ms=8, mew=1.8, label="zeros", **marks)


def mirrored(covariance: FloatArray) -> FloatArray:
    """Return the covariance (2, 2) of a root's conjugate.

    Examples
    --------
    >>> mirrored(np.array([[4.0, 1.0], [1.0, 2.0]]))
    array([[ 4., -1.],
           [-1.,  2.]])
    """
    return np.asarray(covariance * np.array([[1.0, -1.0], [-1.0, 1.0]]))


def _limits(axis: Any, roots: ComplexArray) -> None:
    """Show every root and the imaginary axis, with room around them."""
    roots = roots[np.isfinite(roots)]
    low, high = float(np.min(roots.real, initial=0.0)), float(np.max(roots.real, initial=0.0))
    width, height = high - low, 2.0 * float(np.max(np.abs(roots.imag), initial=0.0))
    width = max(width, 0.1 * height) or 1.0
    height = max(height, 0.5 * width)
    axis.set_xlim(low - 0.3 * width, high + 0.3 * width)
    axis.set_ylim(-0.65 * height, 0.65 * height)


def _region(axis: Any, root: complex, covariance: FloatArray, colour: str, label: str) -> bool:
    """Draw the 95 % ellipse, or the interval of a real root; return whether there is something to draw."""
    if not np.isfinite(covariance).all() or not (np.diag(covariance) > 0.0).any():
        return False
    if root.imag == 0.0:
        reach = REACH_95 * math.sqrt(max(float(covariance[0, 0]), 0.0))
        ends = [root.real - reach, root.real + reach]
        axis.plot(ends, [0.0, 0.0], color=colour, alpha=0.35, lw=7, solid_capstyle="butt", label=label or None)
        return True
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, math.tau, 181)
    unit = np.stack([np.cos(angle), np.sin(angle)]) * RADIUS_95 * np.sqrt(np.maximum(values, 0.0))[:, None]
    outline = vectors @ unit
    axis.fill(root.real + outline[0], root.imag + outline[1], facecolor=colour, alpha=0.3, lw=0, label=label or None)
    return True
