"""Poles and zeros in the complex plane, with their 95 % regions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from replant.arguments import FloatArray
from replant.model.uncertainty import Uncertainty
from replant.report.figures import style
from replant.runs.result import Result

UNSTABLE = 1e12
"""How far the right half-plane is shaded: as far as anybody may look [rad/s]."""

RADIUS_95 = 2.448
"""Radius of the 95 % ellipse of two normal variables [standard deviations].
Level: 95 %: the square root of the quantile of chi squared with two degrees of freedom.
"""


def draw_poles_and_zeros(result: Result, *, ax: Any = None) -> Any:
    """Draw poles (crosses) and zeros (circles), with their 95 % confidence ellipses if a covariance is known.

    Parameters
    ----------
    result : Result
    ax : matplotlib axes, optional
        Drawn into; without it a figure is made.

    Returns
    -------
    axes
    """
    axis = style.new_axes(1, 1, (5.2, 4.8))[0, 0] if ax is None else ax
    model = result.transfer_function
    axis.set_xlabel("real part [rad/s]")
    axis.set_ylabel("imaginary part [rad/s]")
    style.tidy(axis)
    roots = np.concatenate([model.poles, model.zeros])
    if not (np.isfinite(roots).all() and np.abs(roots).max() < style.FARTHEST):
        style.say(axis, "not finite, or too large to draw")
        return axis
    axis.axvspan(0.0, UNSTABLE, color=style.GRID, alpha=0.45, lw=0)
    axis.axhline(0, color=style.MUTED, lw=0.8)
    axis.axvline(0, color=style.MUTED, lw=0.8)
    _limits(axis, roots)
    drawn = False
    for root, covariance in regions(result):
        drawn |= _region(axis, root, covariance, label="" if drawn else "95 % region")
    axis.plot(model.poles.real, model.poles.imag, "x", color=style.MODEL, ms=9, mew=2.0, label="poles", clip_on=False)
    if model.zeros.size:
        axis.plot(
            model.zeros.real, model.zeros.imag, "o", color=style.RESIDUAL, ms=8, mew=1.8, mfc="none", label="zeros",
            clip_on=False,
        )  # fmt: skip
    style.legend(axis, 3)
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
            mirror = np.array([[1.0, -1.0], [-1.0, 1.0]])
            found.append((mode.mode.pole.conjugate(), mode.covariance * mirror))
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

    Parameters
    ----------
    num : (m + 1,) array
        Numerator N, descending powers of s.
    covariance : (m + 1, m + 1) array
        Of ``num``.
    zero : complex
        In rad/s.

    Examples
    --------
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


def _limits(axis: Any, roots: Any) -> None:
    """Show every root and the imaginary axis, with room around them."""
    low, high = min(float(roots.real.min()), 0.0), max(float(roots.real.max()), 0.0)
    width, height = high - low, 2.0 * float(np.abs(roots.imag).max())
    width = max(width, 0.1 * height) or 1.0
    height = max(height, 0.5 * width)
    axis.set_xlim(low - 0.3 * width, high + 0.3 * width)
    axis.set_ylim(-0.65 * height, 0.65 * height)


def _region(axis: Any, root: complex, covariance: FloatArray, label: str) -> bool:
    """Draw the 95 % ellipse, or the interval of a real root; return whether there is something to draw."""
    if not np.isfinite(covariance).all() or not (np.diag(covariance) > 0.0).any():
        return False
    if root.imag == 0.0:
        reach = 1.96 * math.sqrt(max(float(covariance[0, 0]), 0.0))
        axis.plot(
            [root.real - reach, root.real + reach], [0.0, 0.0], color=style.MODEL, alpha=0.35, lw=7,
            solid_capstyle="butt", label=label or None,
        )  # fmt: skip
        return True
    values, vectors = np.linalg.eigh(covariance)
    angle = np.linspace(0.0, math.tau, 181)
    unit = np.stack([np.cos(angle), np.sin(angle)]) * RADIUS_95 * np.sqrt(np.maximum(values, 0.0))[:, None]
    outline = vectors @ unit
    axis.fill(
        root.real + outline[0], root.imag + outline[1], facecolor=style.MODEL, alpha=0.3, lw=0, label=label or None
    )
    return True
