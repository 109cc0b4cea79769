"""The residual's correlations with itself and with the input, with their confidence limits."""

from __future__ import annotations

from typing import Any

import numpy as np

from replant.arguments import FloatArray, instance
from replant.limits import duration
from replant.plotting.diagrams import given_axes
from replant.report.figures import style
from replant.runs.thinning import thin
from replant.statistics.residuals import BAND_95, BAND_99, Correlations

WIDE = 0.2  # correlation that can be seen on an axis that reaches to 1 [number]
FEW = 60  # lags that can be told apart as stems [count]


def draw_correlations(found: Correlations | None, dt: float, *, axes: Any = None) -> Any:
    """Draw the residual's autocorrelation and its cross-correlation with the input, with 95 and 99 % limits.

    For a model that explains the record, 95 % of the lags lie within the inner limits.  Cross-correlation at negative
    lags, where the input follows the residual, indicates feedback.

    Parameters
    ----------
    found : Correlations or None
        From `replant.statistics.residuals.correlations`.
    dt : float
        Sampling time in s.
    axes : two matplotlib axes, optional
        Drawn into; without them a figure is made.

    Returns
    -------
    array of two axes
    """
    found = instance("found", found, Correlations, None)
    dt = duration("dt", dt)
    if axes is None:
        axes = style.new_axes(1, 2, (9.6, 3.4))
    left, right = given_axes("axes", axes, 2)
    left.set_title("residual with itself", loc="left", color=style.INK, fontsize="medium")
    right.set_title("input with later residual", loc="left", color=style.INK, fontsize="medium")
    for axis in (left, right):
        style.tidy(axis)
        axis.set_xlabel("lag [s]")
        axis.set_ylabel("correlation")
        if found is None:
            style.say(axis, "too few samples, or a constant signal")
    if found is not None:
        lags = found.auto.size - 1
        _correlation(left, found.auto, 0, found.auto_std, dt)
        near = reach(found.auto, found.auto_std)
        if near is not None:
            left.set_ylim(-near, near)
        _correlation(right, found.cross, -lags, found.cross_std, dt)
    return np.array([left, right], dtype=object)


def reach(auto: FloatArray, std: float) -> float | None:
    """Return half the height of an autocorrelation's axis, if its limits would be too small beside the 1 at lag 0.

    None if they can be seen on an axis that reaches to 1.

    Examples
    --------
    >>> reach(np.array([1.0, 0.5]), 0.01), reach(np.array([1.0, -0.02]), 0.01)
    (None, 0.0412...)
    """
    near = max(float(np.abs(auto[1:]).max(initial=0.0)), BAND_99 * std)
    return 1.6 * near if near < WIDE else None


def _correlation(axis: Any, values: FloatArray, first: int, std: float, dt: float) -> None:
    axis.axhspan(-BAND_99 * std, BAND_99 * std, color=style.MEASURED, alpha=0.22, lw=0, label="99 %")
    axis.axhspan(-BAND_95 * std, BAND_95 * std, color=style.MEASURED, alpha=0.35, lw=0, label="95 %")
    axis.axhline(0.0, color=style.MUTED, lw=0.8)
    if values.size <= FEW:
        lags = dt * (first + np.arange(values.size))
        axis.vlines(lags, 0.0, values, color=style.RESIDUAL, lw=1.6)
        axis.plot(lags, values, "o", color=style.RESIDUAL, ms=3.5)
    else:
        drawn = thin(values, 1200)
        axis.plot(dt * first + drawn.times(dt), drawn.values, color=style.RESIDUAL, lw=1.2)
        for limit in (-BAND_95 * std, BAND_95 * std):  # drawn again, because the curve may cover the bands
            axis.axhline(limit, color=style.INK, lw=0.8, ls=(0, (4, 3)))
    axis.set_xlim(dt * (first - 0.5), dt * (first + values.size - 0.5))
    style.legend(axis, 2)
