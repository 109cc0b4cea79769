"""The plot of a validation: both outputs, the residual's correlations, the error by frequency."""

from __future__ import annotations

from typing import Any

import numpy as np

from replant.arguments import FloatArray
from replant.plotting.palette import BLUE, GREY, VERMILION, blank_figure, given_axes, open_frame
from replant.statistics.correlations import BAND_95


def draw_validation(validation: Any, axes: Any = None) -> Any:
    """Draw a validation; return four axes of matplotlib."""
    if axes is None:
        figure = blank_figure(9.0, 6.4)
        grid = figure.add_gridspec(2, 3)
        axes = [figure.add_subplot(grid[0, :]), *(figure.add_subplot(grid[1, column]) for column in range(3))]
    outputs, auto, cross, frequency = given_axes("axes", axes, 4)
    time = validation.time
    outputs.plot(time, validation.output + validation.residual, color=GREY, lw=2.4, alpha=0.7, label="measured")
    outputs.plot(time, validation.output, color=VERMILION, lw=1.2, label=f"model, fit {validation.fit:.1f} %")
    outputs.set_xlabel("time [s]")
    outputs.set_xlim(float(time[0]), float(time[-1]))
    outputs.legend(frameon=False)
    found = validation.correlations
    lags = 0 if found is None else found.auto.size - 1
    _stems(auto, np.arange(1, lags + 1), None if found is None else (found.auto[1:], found.auto_std))
    _stems(cross, np.arange(-lags, lags + 1), None if found is None else (found.cross, found.cross_std))
    auto.set_title("residual with itself", fontsize="medium")
    cross.set_title("input with later residual", fontsize="medium")
    frequency.set_title("error by frequency", fontsize="medium")
    frequency.set_xlabel("frequency [rad/s]")
    by_frequency = validation.by_frequency
    if by_frequency is None:
        frequency.text(0.5, 0.5, "not known", transform=frequency.transAxes, ha="center", va="center", color=GREY)
    else:
        frequency.plot(by_frequency.frequency, 100.0 * by_frequency.error, color=BLUE, lw=1.2, label="error")
        limit = 100.0 * by_frequency.limit
        frequency.plot(by_frequency.frequency, limit, color=GREY, lw=1.2, ls="--", label="95 % limit")
        frequency.set_ylabel("part of |G| [%]")
        frequency.legend(frameon=False)
    for axis in (outputs, auto, cross, frequency):
        open_frame(axis)
    return np.array([outputs, auto, cross, frequency], dtype=object)


def _stems(axis: Any, lags: Any, found: tuple[FloatArray, float] | None) -> None:
    axis.set_xlabel("lag [samples]")
    if found is None:
        axis.text(0.5, 0.5, "too few samples", transform=axis.transAxes, ha="center", va="center", color=GREY)
        return
    values, std = found
    axis.axhspan(-BAND_95 * std, BAND_95 * std, color=GREY, alpha=0.3, lw=0, label="95 %")
    axis.plot(lags, values, color=BLUE, lw=1.2)
    axis.legend(frameon=False)
