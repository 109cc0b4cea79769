"""Data of the time plots for the script of the report: thinned, and packed as base64 of float32."""

from __future__ import annotations

import base64
import math
from typing import Any

import numpy as np

from replant.arguments import FloatArray
from replant.report.diagnostics import Excitation
from replant.report.figures import style
from replant.report.html import captions
from replant.report.html.report_data import Material
from replant.runs.result import Clock
from replant.runs.thinning import POINTS, Thinned, thin

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
    if history is None or not history.samples.size or captions.beyond_scale(material):
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
