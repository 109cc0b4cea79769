"""A self-contained page: its frame and style, its pictures (SVG), and uPlot for zoomable plots.

uPlot is part of the package but not of the repository: `hatch_build.py` fetches it when the package is built.  If that
failed, the copy in the package uplot-python is used.
"""

from __future__ import annotations

import base64
import html
import importlib.util
import io
import json
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import datetime
from functools import cache
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from replant.errors import MissingDependencyError
from replant.numerics.arguments import FloatArray
from replant.plotting import style
from replant.plotting.over_time import POINTS, SHOWN_SMALL, Curve, Panel, draw_panels, thin
from replant.plotting.style import blank_figure

OWN = "uPlot.iife.min.js", "uPlot.min.css"
UPLOT_PYTHON = "uPlot.iife.js", "uPlot.min.css"


@cache
def uplot() -> tuple[str, str]:
    """Return uPlot's script and style sheet."""
    own = resources.files("replant.report").joinpath("assets", "uplot")
    places = [(own, OWN)]
    spec = importlib.util.find_spec("uplot")  # finds the files without an import
    places += [(Path(folder, "static"), UPLOT_PYTHON) for folder in (spec and spec.submodule_search_locations) or ()]
    for folder, names in places:
        library, css = (folder.joinpath(name) for name in names)
        if library.is_file() and css.is_file():
            return library.read_text(encoding="utf-8"), css.read_text(encoding="utf-8")
    raise MissingDependencyError(
        "the report and the dashboard need uPlot, which was not fetched when replant was installed: "
        "install npm and then replant once more, or: pip install --no-deps uplot-python"
    )


#: The sign of each gravity ("none": no model yet), in a square of 24 by 24; they differ in shape as well as in colour.
SIGNS = {
    "good": '<circle cx="12" cy="12" r="11"/><path class="mark" d="M6.5 12.5l3.7 3.7 7.3-8"/>',
    "warn": '<path d="M12 1.5L23.5 22H.5z"/><path class="mark" d="M12 9v6M12 18v.6"/>',
    "bad": '<path d="M7.4 1h9.2L23 7.4v9.2L16.6 23H7.4L1 16.6V7.4z"/><path class="mark" d="M8 8l8 8M16 8l-8 8"/>',
    "none": '<path d="M12 1L23 12L12 23L1 12z"/><path class="mark" d="M7.5 12h.1M12 12h.1M16.5 12h.1"/>',
}


NO_BREAK = "\u00a0"  # no-break space


class Html(str):
    """Text that is already HTML; other text is escaped."""

    __slots__ = ()


def words(text: str) -> Html:
    r"""Return plain text as HTML, without line breaks after a plus-minus sign or before a percent sign."""
    return Html(html.escape(text.replace("± ", "±" + NO_BREAK).replace(" %", NO_BREAK + "%")))


@cache
def asset(name: str) -> str:
    """Return the text of a file in ``report/assets``."""
    return resources.files("replant.report").joinpath("assets", name).read_text(encoding="utf-8")


def script(*names: str) -> str:
    """Return JavaScript modules as one script; ``names`` must list imported modules first."""
    text = re.sub(r"^import .*\n|^export (?=const|function)", "", "".join(map(asset, names)), flags=re.MULTILINE)
    return f'(() => {{\n"use strict";\n{text}}})();\n'


def heading(title: str) -> str:
    """Return an escaped title, usually a file name, that may break after underscores."""
    return html.escape(title).replace("_", "_<wbr>")


def filled(name: str, fields: Mapping[str, str]) -> str:
    """Return a template in ``report/assets`` with its fields, which are HTML."""
    return Template(asset(name)).substitute(fields)


def write_page(
    path: Path, *, title: str, eyebrow: str, lede: str, body: str, css: str = "", data: Any = None,
    scripts: Sequence[str] = (),
) -> Path:  # fmt: skip
    """Write a page with ``data`` for its scripts into one self-contained file, and return its path."""
    told = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    given = f'<script type="application/json" id="data">{told}</script>\n' if scripts else ""
    parts = [text.replace("</script", "<\\/script") for text in scripts]
    text = filled("page.html", {
        "title": html.escape(title),
        "heading": heading(title),
        "eyebrow": html.escape(eyebrow),
        "lede": html.escape(lede),
        "body": body,
        "css": asset("palette.css") + asset("report.css") + css,
        "policy": "script-src 'unsafe-inline';" if scripts else "",
        "scripts": given + "".join(f"<script>\n{text}</script>\n" for text in parts),
        "date": datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"),
    })  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8", errors="backslashreplace")  # a file name may be no text
    return path


def icon(gravity: str) -> str:
    """Return the icon of a gravity: "good", "warn" or "bad"."""
    return f'<svg class="icon {gravity}" viewBox="0 0 24 24" aria-hidden="true">{SIGNS[gravity]}</svg>'


def section(name: str, *parts: str, anchor: str = "") -> str:
    """Return a section of a page."""
    title = f"<h2>{html.escape(name)}</h2>" if name else ""
    place = f' id="{html.escape(anchor)}"' if anchor else ""
    return f"<section{place}>{title}{''.join(parts)}</section>"


def folded(name: str, content: str) -> str:
    """Return a section that is folded under its name; in print it is unfolded."""
    return f'<details class="fold"><summary><h2>{html.escape(name)}</h2></summary>{content}</details>'


def facts(rows: Iterable[tuple[str, str]]) -> str:
    """Return a list of terms and descriptions."""
    return "<dl>" + "".join(f"<dt>{html.escape(key)}</dt><dd>{html.escape(text)}</dd>" for key, text in rows) + "</dl>"


def note(text: str) -> str:
    """Return a remark in small print."""
    return f'<p class="note">{words(text)}</p>'


def in_small(text: str) -> str:
    """Return a number with its standard deviation in small print."""
    value, sign, std = html.escape(text).partition(" ± ")
    return f"{value} <small>± {std}</small>" if sign and "(" not in value else html.escape(text)


def key_figures(entries: Iterable[tuple[str, str]]) -> str:
    """Return key figures with their names."""
    return "".join(f"<div><dd>{in_small(text)}</dd><dt>{html.escape(name)}</dt></div>" for text, name in entries)


def code(kind: str, text: str) -> str:
    """Return a listing; ``kind`` is "shell" or "python"."""
    return f'<pre class="{kind}" tabindex="0"><code>{html.escape(text)}</code></pre>'


def table(headings: Sequence[str], rows: Iterable[Sequence[str]], name: str, kind: str = "table") -> str:
    """Return a table whose first column holds the row headings."""
    head = "".join(f'<th scope="col">{_escaped(heading)}</th>' for heading in headings)
    body = "".join(
        f'<tr><th scope="row">{_escaped(first)}</th>' + "".join(f"<td>{_escaped(cell)}</td>" for cell in rest) + "</tr>"
        for first, *rest in rows
    )
    inner = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    return f'<div class="{kind}" role="region" tabindex="0" aria-label="{html.escape(name)}">{inner}</div>'


def _escaped(cell: str) -> str:
    return cell if isinstance(cell, Html) else words(cell)


HALF, WHOLE = 4.5, 7.4  # half and whole width of the page [inches]
MOST_TRANSIENTS = 6  # most transients in a picture, so that it fits on a sheet of paper [count]
PARAMETER_POINTS = 120_000  # most points of all transients together [count]
LARGEST = 3e38  # bound of float32 [number]
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
    """Return the matplotlib context for the pictures of a page."""
    import matplotlib as mpl

    return mpl.rc_context(_LOOK)


def svg(figure: Any, name: str, said: str = "", *, themed: bool = True) -> str:
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
    return text.replace("<svg", f'<svg role="img" aria-label="{html.escape(said)}"', 1) if said else text


def time_picture(name: str, drawn: Sequence[Panel], said: str) -> str:
    """Return the panels of a section as a picture, or as several."""
    if name == "parameters":
        parts = [drawn[first : first + MOST_TRANSIENTS] for first in range(0, len(drawn), MOST_TRANSIENTS)]
        return "".join(_transients(part, f"parameters{k}", said) for k, part in enumerate(parts))
    ratios = [2.2 if panel.name.startswith("output") else 1.0 for panel in drawn]
    height = 0.5 + sum(ratios) if name == "fit" else 2.7
    axes = blank_figure(WHOLE, height).subplots(len(drawn), 1, sharex=True, height_ratios=ratios)
    draw_panels(axes, drawn)
    for axis, panel in zip(axes, drawn, strict=True):
        if name != "fit":
            axis.set_ylabel(panel.label.replace(" ", "\n"))
        elif len(panel.curves) > 1:
            style.legend(axis)
    return svg(axes[0].figure, name, said)


def _transients(drawn: Sequence[Panel], name: str, said: str) -> str:
    axes = style.in_two_columns(len(drawn), WHOLE, 0.5, 1.6)
    draw_panels(axes, drawn, SHOWN_SMALL, titled=True)
    style.legend(axes[0])
    return svg(axes[0].figure, name, said)


def picture(
    name: str, said: str, size: tuple[float, float], draw: Callable[[Any], object], rows: int = 1, **layout: Any
) -> str:
    """Return as an ``svg`` element what ``draw`` draws into one axis or ``rows`` axes below each other."""
    axes = blank_figure(*size).subplots(rows, 1, sharex=True, squeeze=False, **layout)[:, 0]
    draw(axes if rows > 1 else axes[0])
    return svg(axes[0].figure, name, said)


def charts_of(panels: Mapping[str, Sequence[Panel]]) -> dict[str, list[dict[str, Any]]]:
    """Return the panels of each section as data for the browser; a section with an empty panel gives none."""
    found = {}
    for name, drawn in panels.items():
        few = any(panel.words or len(panel.curves[0].t) < (2 if panel.is_log else 0) for panel in drawn)
        size = sum(1 + (curve.std is not None) for panel in drawn for curve in panel.curves if curve.kind != "constant")
        points = max(200, PARAMETER_POINTS // max(size, 1)) if name == "parameters" else POINTS
        found[name] = [] if few else [_chart(panel, points) for panel in drawn]
    for chart in found.get("parameters", ())[1:]:
        chart["quiet"] = True  # without a legend: the first chart has it for all
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
    """Return the times of points; evenly spaced ones as three numbers."""
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
    values = curve.values
    if panel.limits:  # a canvas cannot draw beyond about a hundred heights of the panel
        far = 100.0 * (panel.limits[1] - panel.limits[0])
        inside = np.clip(values, panel.limits[0] - far, panel.limits[1] + far)
        values = np.where(np.isfinite(values), inside, np.nan)
    kind = "decades" if panel.is_log else curve.kind
    found = [entry | {"kind": kind} | packed(thin(scaled(values), points).values)]
    if curve.std is not None and np.isfinite(curve.std).any():
        found.append(entry | {"label": curve.band, "kind": "band"} | packed(thin(curve.std, points).values))
    return found


def packed(values: FloatArray) -> dict[str, Any]:
    """Return values (V,) as base64 of little-endian float32, and the offset subtracted to preserve their digits."""
    finite = values[np.isfinite(values)]
    offset = float(0.5 * finite.min() + 0.5 * finite.max()) if finite.size else 0.0
    if not abs(offset) < LARGEST:
        offset = 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        moved = np.clip(values - offset, -LARGEST, LARGEST)
    return {"data": base64.b64encode(moved.astype("<f4").tobytes()).decode("ascii"), "offset": offset}
