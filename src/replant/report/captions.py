"""The data and captions of the interactive plots of a report."""

from __future__ import annotations

import base64
import math
from typing import Any

import numpy as np

from replant.arguments import FloatArray
from replant.plotting.numbers import complex_number, number, percent
from replant.report.figures import style
from replant.report.figures.over_time import reach
from replant.report.findings import Excitation
from replant.report.material import Material
from replant.runs.result import Clock
from replant.runs.thinning import POINTS, Thinned, thin

SEEN = 0.01  # part of the record below which a stretch cannot be seen in a picture [part of the record]


def of_fit(material: Material) -> str:
    """Return the caption of input, output and residual over time."""
    residual = material.residual[np.isfinite(material.residual)]
    fit = percent(material.result.simulation.fit)
    if residual.size == 0:
        return "Input and measured output over time; the model's output is not finite."
    size = number(float(np.sqrt(np.mean(np.square(residual, dtype=np.longdouble)))), 3)
    unit = style.unit_of(material.output_label)
    hidden = " Where the model's output is not visible, it lies outside the axes."
    beyond = hidden if material.result.simulation.fit < 0 else ""
    return (
        f"The model, {material.result.simulation.how}, has a fit of {fit}; the "
        f"root mean square of the residual is {size}{' ' + unit if unit else ''}{_newest(material)}.{beyond}"
    )


def _newest(material: Material) -> str:
    """Return which samples the figures are of, if not of the whole record."""
    return f" over the newest {material.y.size:,} samples" if material.log.earlier else ""


def of_transients(material: Material) -> str:
    """Return the caption of the parameter estimates over time."""
    if beyond_scale(material):
        return "Each parameter's estimate over time; estimates that diverged are not drawn."
    history = material.result.history
    banded = history is not None and history.std is not None and bool(np.isfinite(history.std).any())
    band = ", with bands of two standard deviations" if banded else ""
    true = ", with the true values" if material.truth is not None else ""
    said = f"Each parameter's estimate over time{band}{true}. The axes are scaled to the last 90 % of the record."
    begin, rows = (0, 0) if history is None else (style.first_estimate(history), history.samples.size)
    if history is None or begin == rows or begin < SEEN * rows:
        return said
    held = number(float(material.clock.after(history.samples[begin])), 3)
    return f"{said} The first estimate is made from the first {held} s."


def beyond_scale(material: Material) -> bool:
    """Return whether the last estimate of a parameter is too large for a plot."""
    return bool((np.abs(material.result.parameters) > style.FARTHEST).any())


def of_excitation(material: Material) -> str:
    """Return the caption of the excitation over time."""
    found = material.excitation
    if found is None:
        return "Excitation over time: there are no regressors."
    window = number(found.window * material.dt, 3)
    poorest = int(np.argmin(found.smallest))
    when = number(float(material.clock.after(found.samples[poorest])), 3)
    windows = f"{found.window:,} samples" if material.clock.irregular else f"{window} s"
    return (
        f"Excitation in windows of {windows}: the smallest eigenvalue of the scaled information matrix is at most "
        f"{number(float(found.smallest.max()), 2)} and at least {number(float(found.smallest[poorest]), 2)}, in the "
        f"window up to {when} s. Where it is small, the input does not excite every parameter."
    )


def of_poles(material: Material) -> str:
    """Return the caption of poles and zeros."""
    model = material.result.transfer_function
    poles = ", ".join(complex_number(mode.pole) for mode in model.modes)
    zeros = ", ".join(complex_number(zero) for zero in model.zeros.tolist() if zero.imag >= 0)
    tail = f"; zero{'s' if model.zeros.size > 1 else ''} at {zeros} rad/s" if zeros else ""
    region = " Coloured: 95 % confidence regions." if material.uncertainty is not None else ""
    diamonds = " Diamonds: the true poles." if material.truth is not None else ""
    heads = f"Pole{'s' if model.poles.size > 1 else ''} at {poles} rad/s{tail}"
    return f"{heads}. Grey: the right half-plane, in which poles are unstable.{region}{diamonds}"


def of_bode(material: Material) -> str:
    """Return the caption of the Bode diagram."""
    band = " with bands of two standard deviations" if material.uncertainty is not None else ""
    gain = number(material.result.transfer_function.dc_gain)
    unit = style.gain_unit(material.plant_label, material.output_label)
    gain += f" {unit}" if unit else ""
    return f"Bode diagram of G(s): magnitude and phase{band}; the DC gain is {gain}.{_dashed(material)}"


def _dashed(material: Material) -> str:
    return " Dashed: the true plant." if material.truth is not None else ""


def of_step(material: Material) -> str:
    """Return the caption of the step response."""
    band = " with a band of two standard deviations" if material.uncertainty is not None else ""
    return (
        f"Step response of G(s){band}: what the output makes of a unit step of the input, from rest.{_dashed(material)}"
    )


def of_auto(material: Material) -> str:
    """Return the caption of the residual's autocorrelation."""
    found = material.correlations
    if found is None:
        return "Autocorrelation of the residual: too few samples, or a constant signal."
    return (
        f"Residual with itself: {number(100 * found.outside[0], 2)} % of the lags lie outside the limits, 5 % by "
        "chance. More: the noise is coloured, or dynamics are missing."
        + (" The value 1 at lag 0 lies outside the axes." if reach(found.auto, found.auto_std) else "")
        + _of_samples(material)
    )


def _of_samples(material: Material) -> str:
    """Return how samples of an irregular clock are taken where a figure needs a regular one."""
    if not material.clock.irregular:
        return ""
    return f" The clock is irregular: samples are taken as {number(material.dt, 4)} s apart, and lost ones as unknown."


def of_cross(material: Material) -> str:
    """Return the caption of the cross-correlation of input and residual."""
    found = material.correlations
    if found is None:
        return "Correlation of the input with the residual: too few samples, or a constant signal."
    return (
        f"Input with the later residual: {number(100 * found.outside[1], 2)} % of the lags from 0 on lie outside the "
        "limits, 5 % by chance. More: a part of the response is missing." + _of_samples(material)
    )


def of_spectrum(material: Material) -> str:
    """Return the caption of the noise's spectrum."""
    noise = material.result.noise
    if noise is None:
        return "Power spectral density of the residual; this method has no model of the noise." + _of_samples(material)
    if noise.is_white:
        return "Power spectral density of the residual: the noise is modelled as white." + _of_samples(material)
    share = percent(noise.variance / noise.residual_variance) if noise.residual_variance > 0.0 else "0 %"
    return (
        f"Power spectral density of the residual and of its model, an autoregression of order {noise.order}. Once the "
        f"past is known {share} of the residual's power is left." + _of_samples(material)
    )


PARAMETER_POINTS = 120_000  # points of all transients together [count]
LARGEST = 3e38  # what float32 holds [number]


def charts(material: Material) -> dict[str, list[dict[str, Any]]]:
    """Return the time plots of a report by section: "fit", "parameters", "excitation"."""
    return {
        "fit": _fit_charts(material),
        "parameters": _parameter_charts(material),
        "excitation": _excitation_charts(material.excitation, material.clock),
    }


def _fit_charts(material: Material) -> list[dict[str, Any]]:
    u, y, model, residual, start, step, times = material.over_time
    unit = style.unit_of(material.output_label)
    hold = "line" if material.filter is not None and material.filter.input_hold == "foh" else "step"
    limits = style.output_limits(y, model)
    drawn = within_reason(model, limits)
    charts = [
        _chart(
            "input", material.input_label, 130, step, [_curve(u, "input", "input", hold)],
            style.output_limits(u), start, times,
        ),
        _chart(
            "output", material.output_label, 280, step,
            [_curve(y, "measured", "measured"), _curve(drawn, "model", "model, from the input alone")],
            limits, start, times,
        ),
    ]  # fmt: skip
    name = f"residual [{unit}]" if unit else "residual"
    limits = style.residual_limits(residual, y)
    drawn = within_reason(residual, limits)
    curves = [_curve(drawn, "residual", "measured − model")]
    charts.append(_chart("residual", name, 140, step, curves, limits, start, times))
    left_out = material.result.left_out_over_time(material.dt).tolist()
    gaps = material.clock.gaps.mean(axis=1).tolist()
    return [chart | {"left_out": left_out, "gaps": gaps} for chart in charts]


def _parameter_charts(material: Material) -> list[dict[str, Any]]:
    history, structure = material.result.history, material.result.structure
    if history is None or not history.samples.size or beyond_scale(material):
        return []
    labels = style.symbols(structure, material.plant_label, material.output_label)
    first, stride = float(history.samples[0]), _stride(history.samples)
    points = max(200, PARAMETER_POINTS // (structure.size * (1 if history.std is None else 2)))
    charts = []
    for i, (name, label) in enumerate(zip(structure.names, labels, strict=True)):
        true = None if material.truth is None else float(material.truth[i])
        values, std = style.estimates(history)[:, i], None if history.std is None else history.std[:, i]
        limits = style.settled_limits(values, style.near_the_end(values, std, true))
        curves = [_curve(within_reason(values, limits), "model", "estimate", points=points)]
        if std is not None and np.isfinite(std).any():
            curves.append(_curve(np.where(np.isfinite(std), std, np.nan), "model", "± 2σ", "band", points=points))
        if true is not None and math.isfinite(true):
            curves.append({"label": "true", "role": "truth", "kind": "constant", "value": true})
        times = material.clock.after(history.samples) if material.clock.irregular else None
        charts.append(
            _chart(f"parameter-{name}", label, 170, material.dt * stride, curves, limits, first * material.dt, times)
        )
    for chart in charts[1:]:
        chart["quiet"] = True  # one legend serves all
    return charts


def _excitation_charts(found: Excitation | None, clock: Clock) -> list[dict[str, Any]]:
    if found is None or found.samples.size < 2:
        return []
    smallest = np.log10(np.clip(found.smallest, style.NO_EXCITATION, None))
    condition = np.log10(np.clip(found.condition, None, style.NO_CONDITION))
    first, stride = float(found.samples[0]) * clock.dt, _stride(found.samples) * clock.dt
    times = clock.after(found.samples) if clock.irregular else None
    eigenvalue = [_curve(smallest, "input", "1 at best", "decades")]
    number = [_curve(condition, "residual", "1 at best", "decades")]
    return [
        _chart("eigenvalue", "smallest eigenvalue", 140, stride, eigenvalue, _decades(smallest), first, times),
        _chart("condition", "condition number", 140, stride, number, _decades(condition, 0), first, times),
    ]


def _chart(
    name: str,
    label: str,
    height: int,
    step: float,
    curves: list[dict[str, Any]],
    limits: tuple[float, float] | None = None,
    start: float = 0.0,
    times: FloatArray | None = None,
) -> dict[str, Any]:
    """Return one chart; before thinning, the points of its curves are ``step`` s apart, or at ``times`` (V,) in s."""
    thinned = next(curve for curve in curves if "data" in curve)
    chart = {
        "name": name,
        "label": label,
        "height": height,
        "start": start + step * thinned["first"],
        "step": step * thinned["every"],
        "count": thinned["count"],
        "empty": not any(curve.get("finite", True) for curve in curves),
        "curves": curves,
        "limits": limits if limits and all(map(math.isfinite, limits)) else None,
    }
    if times is not None:
        drawn = Thinned(np.empty(thinned["count"]), thinned["first"], thinned["every"]).among(times)
        chart["times"] = base64.b64encode(drawn.astype("<f8").tobytes()).decode("ascii")
    return chart


def _curve(signal: FloatArray, role: str, label: str, kind: str = "line", points: int = POINTS) -> dict[str, Any]:
    drawn = thin(signal, points)
    data, offset = packed(drawn.values)
    return {
        "label": label, "role": role, "kind": kind, "data": data, "offset": offset,
        "first": drawn.first, "every": drawn.step, "count": drawn.values.size,
        "finite": bool(np.isfinite(drawn.values).any()),
    }  # fmt: skip


def within_reason(signal: FloatArray, limits: tuple[float, float]) -> FloatArray:
    """Return a signal clipped to a hundred times the height of the plot: a canvas cannot draw further."""
    span = 100.0 * (limits[1] - limits[0])
    return np.where(np.isfinite(signal), np.clip(signal, limits[0] - span, limits[1] + span), np.nan)


def packed(values: FloatArray) -> tuple[str, float]:
    """Return values (V,) as base64 of little-endian float32, and the offset that was taken off to keep their digits.

    Examples
    --------
    >>> text, offset = packed(np.array([101325.25, 101325.5]))
    >>> (np.frombuffer(base64.b64decode(text), "<f4") + offset).tolist()
    [101325.25, 101325.5]
    """
    finite = values[np.isfinite(values)]
    offset = float(0.5 * finite.min() + 0.5 * finite.max()) if finite.size else 0.0
    if not abs(offset) < LARGEST:
        offset = 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        moved = np.clip(values - offset, -LARGEST, LARGEST)
    return base64.b64encode(moved.astype("<f4").tobytes()).decode("ascii"), offset


def _stride(samples: Any) -> float:
    return float(samples[1] - samples[0]) if samples.size > 1 else 1.0


def _decades(logarithms: FloatArray, lowest: float = -math.inf) -> tuple[float, float]:
    return max(lowest, math.floor(float(logarithms.min()) - 0.05)), math.ceil(float(logarithms.max()) + 0.05)
