"""Poles and zeros in the complex plane, with their 95 % regions."""

from __future__ import annotations

from typing import Any

import numpy as np

from replant.arguments import FloatArray
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
