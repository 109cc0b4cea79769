"""Figures over time: the fit with its residual, the parameter estimates, and the excitation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from replant.arguments import FloatArray, instance, owned, record
from replant.assessment import WORST_CONDITION
from replant.errors import InvalidArgumentError
from replant.limits import duration
from replant.plotting.diagrams import given_axes
from replant.regressor.preprocess import accepted
from replant.report.diagnostics import Excitation
from replant.report.figures import style
from replant.runs.result import Clock, Result
from replant.runs.thinning import Thinned, thin


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
        From `replant.report.diagnostics.excitation`.
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
