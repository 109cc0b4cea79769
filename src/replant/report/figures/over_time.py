"""Draw signals over time: the columns of a log, fit, excitation, transients; and the correlations of a residual."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from replant.arguments import FloatArray, instance, owned, record
from replant.assessment import WORST_CONDITION
from replant.data.inspection import Inspection
from replant.data.inspection.columns import Column
from replant.errors import InvalidArgumentError
from replant.limits import duration
from replant.plotting.diagrams import given_axes
from replant.regressor.preprocess import accepted
from replant.report.figures import style
from replant.report.findings import Excitation
from replant.runs.result import Clock, Result
from replant.runs.thinning import Thinned, thin
from replant.statistics.residuals import BAND_95, BAND_99, Correlations

MOST = 12  # columns that are drawn [count]


def draw_columns(found: Inspection) -> Any:
    """Draw the columns of numbers of a log over time, or over samples where the log has no time column."""
    drawn = columns_drawn(found)
    axes = style.new_axes(len(drawn), 1, (9, 0.8 + 1.5 * len(drawn)), sharex=True)[:, 0]
    known = found.clock is not None and not math.isnan(found.clock.dt)
    dt = found.clock.dt if known and found.clock is not None else 1.0
    for axis, column in zip(axes, drawn, strict=True):
        curve = thin(found.contents.values[column.number], style.SHOWN)
        axis.plot(curve.times(dt), curve.values, color=_colour(column, found), lw=1.0)
        axis.set_ylabel(column.name)
        style.tidy(axis)
        axis.set_xlim(0.0, dt * max(1, column.rows - 1))
    axes[-1].set_xlabel("time [s]" if known else "sample")
    return np.array(axes, dtype=object)


def columns_drawn(found: Inspection) -> list[Column]:
    """Return the columns that are drawn: input, output and reference, then the others in the order of the file."""
    roles = found.roles
    first = [role.column for role in (roles.input, roles.output, roles.reference) if role is not None]
    times = [found.clock.column] if found.clock is not None else []
    rest = [column for column in found.record if column.number in found.contents.values and column not in times]
    return [*first, *(column for column in rest if column not in first and not math.isnan(column.low))][:MOST]


def save_columns(folder: Path, found: Inspection) -> Path | None:
    """Draw the columns as ``columns.png`` and return its path; None if there is none to draw."""
    if not columns_drawn(found):
        return None
    path = folder / "columns.png"
    draw_columns(found)[0].figure.savefig(path, dpi=130)
    return path


def _colour(column: Column, found: Inspection) -> str:
    roles = found.roles
    named = ((roles.input, style.INPUT), (roles.output, style.MEASURED), (roles.reference, style.TRUTH))
    return next((colour for role, colour in named if role is not None and role.column == column), style.RESIDUAL)


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


def draw_fit(
    result: Result,
    u: FloatArray,
    y: FloatArray,
    dt: float,
    *,
    axes: Any = None,
    input_label: str = "input",
    output_label: str = "output",
) -> Any:
    """Draw input, measured and simulated output, and the residual over time; samples left out are shaded.

    Parameters
    ----------
    result : Result
    u, y : (K,) arrays
        Raw input and output.  Of a record that is too long for memory, the newest samples: its overview is drawn.
    dt : float
        Sampling time in s.
    axes : three matplotlib axes, optional
        Drawn into; without them a figure is made.
    input_label, output_label : str
        With the unit in brackets at the end, if it is known.

    Returns
    -------
    array of three axes

    Raises
    ------
    InvalidArgumentError
        If ``u`` and ``y`` are not the record of the result.
    """
    result = instance("result", result, Result)
    if axes is None:
        axes = style.new_axes(3, 1, (9, 6.6), sharex=True, height_ratios=(1, 2, 1))
    top, middle, bottom = given_axes("axes", axes, 3)
    dt, (u, y) = duration("dt", dt), (accepted(signal)[0] for signal in record(u, y))
    model = result.simulation.output
    if not u.size == y.size == model.size:
        raise InvalidArgumentError(
            f"u and y must be the record of the result, {model.size} samples long, got {u.size} and {y.size}"
        )
    drawn_u, measured, modelled, residual = _shown(result, u, y)
    left_out, clock = result.left_out_over_time(dt), result.clock_of(dt)
    for axis in (top, middle, bottom):
        _shade(axis, left_out)
    _curve(top, drawn_u, clock, color=style.INPUT, lw=0.9)
    _curve(middle, measured, clock, color=style.MEASURED, lw=2.2, label="measured")
    _curve(middle, modelled, clock, color=style.MODEL, lw=1.0, label="model, from the input alone")
    middle.set_ylim(*style.output_limits(measured.values, modelled.values))
    style.legend(middle, 3)
    _curve(bottom, residual, clock, color=style.RESIDUAL, lw=0.8)
    bottom.set_ylim(*style.residual_limits(residual.values, measured.values))
    unit = style.unit_of(output_label)
    bottom.axhline(0, color=style.MUTED, lw=0.8)
    for axis, label in (
        (top, input_label),
        (middle, output_label),
        (bottom, "residual" + (f" [{unit}]" if unit else "")),
    ):
        axis.set_ylabel(label)
        style.tidy(axis)
        axis.set_xlim(0.0, float(clock.at(max(1, (result.overview.samples if result.overview else y.size) - 1))))
    bottom.set_xlabel("time [s]")
    return np.array([top, middle, bottom], dtype=object)


def _shown(result: Result, u: FloatArray, y: FloatArray) -> list[Thinned]:
    """Return input, measured and simulated output, and residual, thinned for drawing."""
    shown, model = result.overview, result.simulation.output
    if shown is None:
        return [thin(signal, style.SHOWN) for signal in (u, y, model, result.residual(y))]
    return [signal.again(style.SHOWN) for signal in (shown.input, shown.output, shown.model, shown.residual)]


def draw_transients(
    result: Result,
    dt: float,
    *,
    truth: Sequence[float] | None = None,
    axes: Any = None,
    input_label: str = "input",
    output_label: str = "output",
) -> Any:
    """Draw each parameter's estimate over time, its band of +-2 sigma, and the true value if known.

    Parameters
    ----------
    result : Result
        Of an online run.
    dt : float
        Sampling time in s.
    truth : (P,) sequence, optional
        True parameters.
    axes : P matplotlib axes, optional
        Drawn into; without them a figure is made.
    input_label, output_label : str
        With the unit in brackets at the end, if it is known.

    Returns
    -------
    array of P axes
    """
    result = instance("result", result, Result)
    dt, history, count = duration("dt", dt), result.history, result.structure.size
    true = None if truth is None else owned("truth", truth, (count,))
    if axes is None:
        columns = 2 if count > 1 else 1
        rows = -(-count // columns)
        grid = style.new_axes(rows, columns, (9, 1.3 + 1.9 * rows), sharex=True)
        for axis in grid.flat[count:]:
            axis.set_axis_off()
        for axis in grid.flat[:count][-columns:]:
            axis.tick_params(labelbottom=True)
        axes = grid.flat[:count]
    axes = given_axes("axes", axes, count)
    for i, (axis, label) in enumerate(
        zip(axes, style.symbols(result.structure, style.plant_input(result, input_label), output_label), strict=True)
    ):
        axis.set_title(label, loc="left", color=style.INK, fontsize="medium")
        style.tidy(axis)
        if history is None or not history.samples.size:
            style.say(axis, "no history")
            continue
        std = None if history.std is None else history.std[:, i]
        t = result.clock_of(dt).after(history.samples)
        _transient(axis, t, style.estimates(history)[:, i], std, None if true is None else float(true[i]))
    style.label_time(axes)
    if axes[0].get_legend_handles_labels()[0]:
        style.legend(axes[0], 3)
    return np.array(axes, dtype=object)


def _transient(axis: Any, t: FloatArray, values: FloatArray, std: FloatArray | None, true: float | None) -> None:
    axis.set_xlim(0.0, float(t[-1]))
    if abs(float(values[-1])) > style.FARTHEST:
        style.say(axis, "diverged: too large to draw")
        return
    if not np.isfinite(values).any():
        style.say(axis, "no estimate")
        return
    axis.set_ylim(*style.settled_limits(values, style.near_the_end(values, std, true)))  # before a curve sets others
    values = np.clip(values, -style.FARTHEST, style.FARTHEST)
    drawn = thin(values, style.SHOWN_SMALL)
    if (half := style.band(std)) is not None:
        low, high = (thin(values + sign * half, style.SHOWN_SMALL // 2) for sign in (-1.0, 1.0))
        look: Any = {"color": style.MODEL, "alpha": 0.22, "lw": 0, "label": "± 2σ"}
        axis.fill_between(low.among(t), low.values, high.values, **look)
    axis.plot(drawn.among(t), drawn.values, color=style.MODEL, lw=1.4, label="estimate")
    if true is not None:
        true = min(max(true, -style.FARTHEST), style.FARTHEST)
        axis.axhline(true, color=style.TRUTH, lw=1.1, ls=(0, (5, 3)), label="true")


def draw_excitation(found: Excitation | None, dt: float, *, axes: Any = None, clock: Clock | None = None) -> Any:
    """Draw how well the samples of each window of a record determine the parameters.

    Values that are rounding errors are drawn at the edge: eigenvalues below 1e-12, condition numbers above 1e10.

    Parameters
    ----------
    found : Excitation or None
        From `replant.report.findings.excitation`.
    dt : float
        Sampling time in s.
    axes : two matplotlib axes, optional
        For the smallest eigenvalue of the scaled information matrix, and for the condition number.
    clock : Clock, optional
        Of an irregular clock.

    Returns
    -------
    array of two axes
    """
    dt = duration("dt", dt)
    if axes is None:
        axes = style.new_axes(2, 1, (9, 4.2), sharex=True)
    top, bottom = given_axes("axes", axes, 2)
    top.set_ylabel("smallest\neigenvalue")
    bottom.set_ylabel("condition\nnumber")
    bottom.set_xlabel("time [s]")
    for axis in (top, bottom):
        style.tidy(axis)
        if found is None:
            style.say(axis, "no regressors")
    if found is None:
        return np.array([top, bottom], dtype=object)
    t = (clock or Clock(dt)).after(found.samples)
    _decades(top, t, np.clip(found.smallest, style.NO_EXCITATION, None), style.INPUT)
    _decades(bottom, t, np.clip(found.condition, None, style.NO_CONDITION), style.RESIDUAL, lowest=0.0)
    if found.condition.max() > WORST_CONDITION / 100:
        bottom.axhline(WORST_CONDITION, color=style.MODEL, lw=1.1, ls=(0, (5, 3)), label="limit for identification")
        style.legend(bottom, 1)
    return np.array([top, bottom], dtype=object)


def _decades(axis: Any, t: FloatArray, values: FloatArray, colour: str, lowest: float = -np.inf) -> None:
    axis.semilogy(t, values, color=colour, lw=1.4, marker="o" if t.size == 1 else None)
    low, high = np.floor(np.log10(values.min()) - 0.05), np.ceil(np.log10(values.max()) + 0.05)
    axis.set_ylim(10.0 ** max(low, lowest), 10.0**high)
    axis.set_xlim(0.0, float(t[-1]))
    style.logarithmic(axis.yaxis)


def _curve(axis: Any, drawn: Thinned, clock: Clock, **look: Any) -> None:
    t, gaps = clock.at(drawn.places), clock.gaps.mean(axis=1)
    places = np.searchsorted(t, gaps)  # no line runs through a gap
    axis.plot(np.insert(t, places, gaps), np.insert(drawn.values, places, np.nan), **look)


def _shade(axis: Any, left_out: FloatArray) -> None:
    """Shade the stretches (L, 2), in s, of samples that are left out."""
    if len(left_out):
        spans = [(begin, end - begin) for begin, end in left_out.tolist()]
        axis.broken_barh(spans, (0.0, 1.0), transform=axis.get_xaxis_transform(), color=style.MUTED, alpha=0.22, lw=0,
                         label="left out", zorder=0)  # fmt: skip
