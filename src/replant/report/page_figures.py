"""The figures of a report: each with its caption and as a picture (SVG), what is drawn over time also as data."""

from __future__ import annotations

import base64
import html
import io
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from replant.model.interop import unit_of
from replant.numerics.arguments import FloatArray
from replant.numerics.residuals import Correlations
from replant.plotting import style
from replant.plotting.diagrams import reach_of
from replant.plotting.numbers import complex_number, gain_unit, number, percent
from replant.plotting.over_time import POINTS, SHOWN_SMALL, Curve, Panel, draw_panels, thin, within_reason
from replant.plotting.style import blank_figure
from replant.report.contents import Material
from replant.report.panels import first_estimate

HALF, WHOLE = 4.5, 7.4  # half and whole width of the page [inches]
MOST_TRANSIENTS = 6  # transients in a picture, so that each fits on a sheet of paper [count]
PARAMETER_POINTS = 120_000  # points of all transients together [count]
LARGEST = 3e38  # what float32 holds [number]
HEIGHTS = {"output": 280, "input": 130, "residual": 140, "eigenvalue": 140, "condition": 140}  # of a chart [px]
HEIGHT = 170  # of any other chart [px]

# the variables of the page's style sheet, by the figures' colours
VARIABLES = {
    style.MEASURED: "measured", style.MODEL: "model", style.RESIDUAL: "residual", style.INPUT: "input",
    style.TRUTH: "truth", style.INK: "ink", style.MUTED: "muted", style.GRID: "grid",
}  # fmt: skip
VARIABLES |= {colour: f"line-{i}" for i, colour in enumerate(style.COLOURS) if colour not in VARIABLES}
_LOOK: Any = {"svg.fonttype": "none", "font.size": 10.0, "axes.titlesize": 10.0, "legend.fontsize": 9.5}


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
    for colour, name_there in VARIABLES.items() if themed else ():
        text = re.sub(rf"{colour}\b", f"var(--{name_there})", text, flags=re.IGNORECASE)
    return text.replace("<svg", f'<svg role="img" aria-label="{html.escape(words)}"', 1) if words else text


def time_picture(section: str, drawn: Sequence[Panel], words: str) -> str:
    """Return the panels of a section as a picture, or as several."""
    if section == "parameters":
        parts = [drawn[first : first + MOST_TRANSIENTS] for first in range(0, len(drawn), MOST_TRANSIENTS)]
        return "".join(_transients(part, f"parameters{k}", words) for k, part in enumerate(parts))
    ratios = [2.2 if panel.name.startswith("output") else 1.0 for panel in drawn]
    height = 0.5 + sum(ratios) if section == "fit" else 2.7
    axes = blank_figure(WHOLE, height).subplots(len(drawn), 1, sharex=True, height_ratios=ratios)
    draw_panels(axes, drawn)
    if section == "fit":
        for axis, panel in zip(axes, drawn, strict=True):
            if len(panel.curves) > 1:
                style.legend(axis)
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


def picture(
    name: str, words: str, size: tuple[float, float], draw: Callable[[Any], object], rows: int = 1, **layout: Any
) -> str:
    """Return what ``draw`` puts into an axis, or into several below each other, as an ``svg`` element."""
    axes = blank_figure(*size).subplots(rows, 1, sharex=True, squeeze=False, **layout)[:, 0]
    draw(axes if rows > 1 else axes[0])
    return svg(axes[0].figure, name, words)


SEEN = 0.01  # part of the record below which a stretch cannot be seen in a picture [part of the record]


def of_fit(material: Material) -> str:
    """Return the caption of input, output and residual over time."""
    residual = material.residual[np.isfinite(material.residual)]
    fit = percent(material.result.simulation.fit)
    if residual.size == 0:
        return "Input and measured output over time; the model's output is not finite."
    size = number(float(np.sqrt(np.mean(np.square(residual, dtype=np.longdouble)))), 3)
    unit = unit_of(material.log.output_name)
    newest = f" over the newest {material.log.output.size:,} samples" if material.log.earlier else ""
    hidden = " Where the model's output is not visible, it lies outside the axes."
    beyond = hidden if material.result.simulation.fit < 0 else ""
    return (
        f"The model, {material.result.simulation.how}, has a fit of {fit}; the "
        f"root mean square of the residual is {size}{' ' + unit if unit else ''}{newest}.{beyond}"
    )


def of_transients(material: Material) -> str:
    """Return the caption of the parameter estimates over time."""
    if (np.abs(material.result.parameters) > style.FARTHEST).any():
        return "Each parameter's estimate over time; estimates that diverged are not drawn."
    history = material.result.history
    banded = history is not None and history.std is not None and bool(np.isfinite(history.std).any())
    band = ", with bands of two standard deviations" if banded else ""
    true = ", with the true values" if material.truth is not None else ""
    said = f"Each parameter's estimate over time{band}{true}. The axes are scaled to the last 90 % of the record."
    begin, rows = (0, 0) if history is None else (first_estimate(history), history.samples.size)
    if history is None or begin == rows or begin < SEEN * rows:
        return said
    held = number(float(material.clock.after(history.samples[begin])), 3)
    return f"{said} The first estimate is made from the first {held} s."


def of_excitation(material: Material) -> str:
    """Return the caption of the excitation over time."""
    found = material.excitation
    if found is None:
        return "Excitation over time: there are no regressors."
    window = number(found.window * material.log.dt, 3)
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
    region = " Coloured: 95 % confidence regions." if material.result.uncertainty is not None else ""
    diamonds = " Diamonds: the true poles." if material.truth is not None else ""
    heads = f"Pole{'s' if model.poles.size > 1 else ''} at {poles} rad/s{tail}"
    return f"{heads}. Grey: the right half-plane, in which poles are unstable.{region}{diamonds}"


def of_bode(material: Material) -> str:
    """Return the caption of the Bode diagram."""
    band = " with bands of two standard deviations" if material.result.uncertainty is not None else ""
    gain = number(material.result.transfer_function.dc_gain)
    unit = gain_unit(material.plant_label, material.log.output_name)
    gain += f" {unit}" if unit else ""
    return f"Bode diagram of G(s): magnitude and phase{band}; the DC gain is {gain}.{_dashed(material)}"


def _dashed(material: Material) -> str:
    return " Dashed: the true plant." if material.truth is not None else ""


def of_step(material: Material) -> str:
    """Return the caption of the step response."""
    band = " with a band of two standard deviations" if material.result.uncertainty is not None else ""
    return (
        f"Step response of G(s){band}: what the output makes of a unit step of the input, from rest.{_dashed(material)}"
    )


def of_auto(material: Material) -> str:
    """Return the caption of the residual's autocorrelation."""
    return correlation_in_words(material.correlations) + _of_samples(material)


def correlation_in_words(found: Correlations | None, name: str = "") -> str:
    """Return how far the residual is correlated with itself, or with the input of a name."""
    what = f"{name} with the later residual" if name else "Residual with itself"
    if found is None:
        return f"{what}: too few samples, or a constant signal."
    lags = f"{number(100 * found.outside[bool(name)], 2)} % of the lags{' from 0 on' if name else ''}"
    more = "a part of the response is missing" if name else "the noise is coloured, or dynamics are missing"
    beyond = not name and reach_of(found.auto, found.auto_std)
    hidden = " The value 1 at lag 0 lies outside the axes." if beyond else ""
    return f"{what}: {lags} lie outside the limits, 5 % by chance. More: {more}.{hidden}"


def _of_samples(material: Material) -> str:
    """Return how samples of an irregular clock are taken where a figure needs a regular one."""
    if not material.clock.irregular:
        return ""
    dt = number(material.log.dt, 4)
    return f" The clock is irregular: samples are taken as {dt} s apart, and lost ones as unknown."


def of_cross(material: Material) -> str:
    """Return the caption of the cross-correlation of input and residual."""
    return correlation_in_words(material.correlations, "Input") + _of_samples(material)


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


def charts_of(panels: Mapping[str, Sequence[Panel]]) -> dict[str, list[dict[str, Any]]]:
    """Return the panels of each section as data for the browser; none of one that words stand in for."""
    found = {}
    for section, drawn in panels.items():
        few = any(panel.words or len(panel.curves[0].t) < (2 if panel.is_log else 0) for panel in drawn)
        size = sum(1 + (curve.std is not None) for panel in drawn for curve in panel.curves if curve.kind != "constant")
        points = max(200, PARAMETER_POINTS // max(size, 1)) if section == "parameters" else POINTS
        found[section] = [] if few else [_chart(panel, points) for panel in drawn]
    for chart in found.get("parameters", ())[1:]:
        chart["quiet"] = True  # one legend serves all
    return found


def _chart(panel: Panel, points: int) -> dict[str, Any]:
    limits = panel.limits if panel.limits and all(map(math.isfinite, panel.limits)) else None
    drawn = thin(panel.curves[0].t, points)
    curves = [entry for curve in panel.curves for entry in _entries(curve, panel, points)]
    chart: dict[str, Any] = {
        "name": panel.name,
        "label": panel.label,
        "height": HEIGHTS.get(panel.name.rstrip("0123456789"), HEIGHT),
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
    entry = {"label": curve.label, "role": VARIABLES[curve.colour]}
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
