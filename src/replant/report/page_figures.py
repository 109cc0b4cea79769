"""The figures of a report: each as a picture (SVG), and what is drawn over time also as data for the browser."""

from __future__ import annotations

import base64
import html
import io
import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from replant.arguments import FloatArray
from replant.plotting import style
from replant.plotting.over_time import SHOWN_SMALL, Curve, Panel, draw_panels, within_reason
from replant.plotting.style import blank_figure
from replant.plotting.thinning import POINTS, thin
from replant.report import figures
from replant.report.material import Material

HALF, WHOLE = 4.5, 7.4  # half and whole width of the page [inches]
MOST_TRANSIENTS = 6  # transients in a picture, so that each fits on a sheet of paper [count]
PARAMETER_POINTS = 120_000  # points of all transients together [count]
LARGEST = 3e38  # what float32 holds [number]
HEIGHTS = {"output": 280, "input": 130, "residual": 140, "eigenvalue": 140, "condition": 140}  # of a chart [px]
HEIGHT = 170  # of any other chart [px]

# the variables of the page's style sheet, by the figures' colours
_VARIABLES = {
    style.MEASURED: "measured", style.MODEL: "model", style.RESIDUAL: "residual", style.INPUT: "input",
    style.TRUTH: "truth", style.INK: "ink", style.MUTED: "muted", style.GRID: "grid",
}  # fmt: skip
_VARIABLES |= {colour: f"line-{i}" for i, colour in enumerate(style.COLOURS) if colour not in _VARIABLES}
_LOOK: Any = {"svg.fonttype": "none", "font.size": 10.0, "axes.titlesize": 10.0, "legend.fontsize": 9.5}


def variable(colour: str) -> str:
    """Return the variable of the page's style sheet for a colour of the figures."""
    return _VARIABLES[colour]


def look() -> Any:
    """Return the matplotlib context in which the pictures of a page are made."""
    import matplotlib as mpl

    return mpl.rc_context(_LOOK)


def svg(figure: Any, name: str, words: str = "", *, themed: bool = True) -> str:
    """Return a matplotlib figure as an ``svg`` element, with a text alternative."""
    import matplotlib as mpl

    buffer = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    for size in ("width", "height"):
        text = re.sub(rf'(<svg[^>]*?) {size}="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\1{name}-", text)
    text = re.sub(r'(?<= d=")[^"]*', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), text)
    for colour, name_there in _VARIABLES.items() if themed else ():
        text = re.sub(rf"{colour}\b", f"var(--{name_there})", text, flags=re.IGNORECASE)
    return text.replace("<svg", f'<svg role="img" aria-label="{html.escape(words)}"', 1) if words else text


def time_picture(section: str, drawn: Sequence[Panel], words: str) -> str:
    """Return the panels of a section as a picture, or as several."""
    if section == "parameters":
        parts = [drawn[first : first + MOST_TRANSIENTS] for first in range(0, len(drawn), MOST_TRANSIENTS)]
        return "".join(_transients(part, f"parameters{k}", words) for k, part in enumerate(parts))
    height, ratios = (4.7, (1, 2.2, 1)) if section == "fit" else (2.7, (1, 1))
    axes = blank_figure(WHOLE, height).subplots(len(drawn), 1, sharex=True, height_ratios=ratios)
    draw_panels(axes, drawn)
    if section == "fit":
        style.legend(axes[1])
    else:
        for axis in axes:
            axis.set_ylabel(axis.get_ylabel().replace(" ", "\n"))
    return svg(axes[0].figure, section, words)


def _transients(drawn: Sequence[Panel], name: str, words: str) -> str:
    rows = -(-len(drawn) // 2)
    grid = blank_figure(WHOLE, 0.5 + 1.6 * rows).subplots(rows, 2, squeeze=False)
    axes = list(grid.flat[: len(drawn)])
    draw_panels(axes, drawn, SHOWN_SMALL, titled=True)
    style.legend(axes[0])
    for axis in grid.flat[len(drawn) :]:
        axis.set_axis_off()
    return svg(axes[0].figure, name, words)


def poles(material: Material, words: str) -> str:
    """Return poles and zeros."""
    axis = blank_figure(HALF, 4.2).subplots()
    figures.draw_poles_and_zeros(material.result, truth=material.true_plant, ax=axis)
    return svg(axis.figure, "poles", words)


def bode(material: Material, words: str) -> str:
    """Return the Bode diagram."""
    axes = blank_figure(HALF, 4.2).subplots(2, 1, sharex=True, height_ratios=(3, 2))
    figures.draw_bode(material.result, material.log.dt, truth=material.true_plant, axes=axes, **material.labels)
    return svg(axes[0].figure, "bode", words)


def step(material: Material, words: str) -> str:
    """Return the step response."""
    axis = blank_figure(WHOLE, 2.6).subplots()
    figures.draw_step(material.result, truth=material.true_plant, ax=axis, **material.labels)
    return svg(axis.figure, "step", words)


def correlations(material: Material, words: tuple[str, str]) -> tuple[str, str]:
    """Return the residual's autocorrelation, and its cross-correlation with the input."""
    axes = [blank_figure(HALF, 2.3).subplots() for _ in range(2)]
    figures.draw_correlations(material.correlations, material.log.dt, axes=axes)
    return svg(axes[0].figure, "auto", words[0]), svg(axes[1].figure, "cross", words[1])


def spectrum(material: Material, words: str) -> str:
    """Return the spectrum of the residual and of its model."""
    axis = blank_figure(HALF, 2.9).subplots()
    residual = material.on_grid(material.residual)
    figures.draw_spectrum(material.result.noise, residual, material.log.dt, ax=axis)
    return svg(axis.figure, "spectrum", words)


def charts(material: Material) -> dict[str, list[dict[str, Any]]]:
    """Return what is drawn over time as data for the browser; none of a section that words stand in for."""
    found = {}
    for section, drawn in material.panels.items():
        few = any(panel.words or len(panel.curves[0].t) < (2 if panel.is_log else 0) for panel in drawn)
        size = sum(1 + (curve.std is not None) for panel in drawn for curve in panel.curves if curve.kind != "constant")
        points = max(200, PARAMETER_POINTS // max(size, 1)) if section == "parameters" else POINTS
        found[section] = [] if few else [_chart(panel, points) for panel in drawn]
    for chart in found["parameters"][1:]:
        chart["quiet"] = True  # one legend serves all
    return found


def _chart(panel: Panel, points: int) -> dict[str, Any]:
    limits = panel.limits if panel.limits and all(map(math.isfinite, panel.limits)) else None
    drawn = thin(panel.curves[0].t, points)
    curves = [entry for curve in panel.curves for entry in _entries(curve, panel, points)]
    chart: dict[str, Any] = {
        "name": panel.name,
        "label": panel.label,
        "height": HEIGHTS.get(panel.name, HEIGHT),
        **_times(drawn.among(panel.curves[0].t)),
        "empty": not any(np.isfinite(curve.values).any() for curve in panel.curves),
        "curves": curves,
        "limits": limits and [math.log10(limit) for limit in limits] if panel.is_log else limits,
    }
    if panel.left_out is not None and panel.gaps is not None:
        chart |= {"left_out": panel.left_out.tolist(), "gaps": panel.gaps.tolist()}
    return chart


def _times(t: FloatArray) -> dict[str, Any]:
    """Return when points are: evenly spaced ones in three numbers."""
    start, step = (float(t[0]) if t.size else 0.0), (float(t[1] - t[0]) if t.size > 1 else 1.0)
    even = {"start": start, "step": step, "count": t.size}
    if np.allclose(t, start + step * np.arange(t.size), rtol=0.0, atol=1e-3 * step):
        return even
    return even | {"times": base64.b64encode(t.astype("<f8").tobytes()).decode("ascii")}


def _entries(curve: Curve, panel: Panel, points: int) -> list[dict[str, Any]]:
    """Return a curve, and its band, as data for the browser."""
    scaled = np.log10 if panel.is_log else np.asarray
    entry = {"label": curve.label, "role": variable(curve.colour)}
    if curve.kind == "constant":
        return [entry | {"kind": "constant", "value": float(scaled(curve.values)[0])}]
    values = within_reason(curve.values, panel.limits) if panel.limits else curve.values
    kind = "decades" if panel.is_log else curve.kind
    found = [entry | {"kind": kind} | packed(thin(scaled(values), points).values)]
    if curve.std is not None and np.isfinite(curve.std).any():
        found.append(entry | {"label": curve.band, "kind": "band"} | packed(thin(curve.std, points).values))
    return found


def packed(values: FloatArray) -> dict[str, Any]:
    """Return values (V,) as base64 of little-endian float32, and the offset that was taken off to keep their digits."""
    finite = values[np.isfinite(values)]
    offset = float(0.5 * finite.min() + 0.5 * finite.max()) if finite.size else 0.0
    if not abs(offset) < LARGEST:
        offset = 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        moved = np.clip(values - offset, -LARGEST, LARGEST)
    return {"data": base64.b64encode(moved.astype("<f4").tobytes()).decode("ascii"), "offset": offset}
