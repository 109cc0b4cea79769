"""Static figures for a page, as SVG with selectable text and with the colours of the page, light or dark."""

from __future__ import annotations

import html
import io
import re
from typing import Any

from replant.plotting.diagrams import blank_figure
from replant.report.figures import (
    draw_bode,
    draw_correlations,
    draw_excitation,
    draw_fit,
    draw_poles_and_zeros,
    draw_spectrum,
    draw_step,
    style,
)
from replant.report.figures.over_time import draw_transients
from replant.report.html.report_data import Material

HALF, WHOLE = 4.5, 7.4  # half and whole width of the page [inches]
MOST_TRANSIENTS = 6  # transients in a picture, so that each fits on a sheet of paper [count]

# the variables of the page's style sheet, by the figures' colours
_VARIABLES = {
    style.MEASURED: "measured",
    style.MODEL: "model",
    style.RESIDUAL: "residual",
    style.INPUT: "input",
    style.TRUTH: "truth",
    style.INK: "ink",
    style.MUTED: "muted",
    style.GRID: "grid",
}
_VARIABLES |= {colour: f"line-{i}" for i, colour in enumerate(style.COLOURS) if colour not in _VARIABLES}
_SETTINGS: Any = {"svg.fonttype": "none", "font.size": 10.0, "axes.titlesize": 10.0, "legend.fontsize": 9.5}


def variable(colour: str) -> str:
    """Return the variable of the page's style sheet for a colour of the figures.

    Examples
    --------
    >>> variable(style.MODEL)
    'model'
    """
    return _VARIABLES[colour]


def look() -> Any:
    """Return the matplotlib context in which the pictures below are made."""
    import matplotlib as mpl

    return mpl.rc_context(_SETTINGS)


def fit_picture(material: Material) -> str:
    """Return input, output and residual over time."""
    axes = blank_figure(WHOLE, 4.7).subplots(3, 1, sharex=True, height_ratios=(1, 2.2, 1))
    labels = {"input_label": material.input_label, "output_label": material.output_label}
    draw_fit(material.result, material.u, material.y, material.dt, axes=axes, **labels)
    return svg(axes[0].figure, "fit")


def transient_pictures(material: Material) -> list[str]:
    """Return the parameter estimates over time, a few in each picture."""
    count = material.result.structure.size
    labels = {"input_label": material.figure_label, "output_label": material.output_label}
    pictures = []
    for first in range(0, count, MOST_TRANSIENTS):
        shown = min(MOST_TRANSIENTS, count - first)
        rows = -(-shown // 2)
        grid = blank_figure(WHOLE, 0.5 + 1.6 * rows).subplots(rows, 2, squeeze=False)
        spare = blank_figure(1, 1).subplots(count, 1, squeeze=False).ravel()
        axes = [*spare[:first], *grid.flat[:shown], *spare[first + shown :]]
        draw_transients(material.result, material.dt, truth=material.truth, axes=axes, **labels)
        for axis in grid.flat[shown:]:
            axis.set_axis_off()
        pictures.append(svg(grid[0, 0].figure, f"parameters{first}"))
    return pictures


def excitation_picture(material: Material) -> str:
    """Return smallest eigenvalue and condition number over time."""
    axes = blank_figure(WHOLE, 2.7).subplots(2, 1, sharex=True)
    draw_excitation(material.excitation, material.dt, axes=axes, clock=material.clock)
    return svg(axes[0].figure, "excitation")


def poles_picture(material: Material) -> str:
    """Return poles and zeros."""
    axis = blank_figure(HALF, 4.2).subplots()
    draw_poles_and_zeros(material.result, truth=material.true_plant, ax=axis)
    return svg(axis.figure, "poles")


def bode_picture(material: Material) -> str:
    """Return the Bode diagram."""
    axes = blank_figure(HALF, 4.2).subplots(2, 1, sharex=True, height_ratios=(3, 2))
    labels = {"input_label": material.figure_label, "output_label": material.output_label}
    draw_bode(material.result, material.dt, truth=material.true_plant, axes=axes, **labels)
    return svg(axes[0].figure, "bode")


def step_picture(material: Material) -> str:
    """Return the step response."""
    axis = blank_figure(WHOLE, 2.6).subplots()
    labels = {"input_label": material.figure_label, "output_label": material.output_label}
    draw_step(material.result, truth=material.true_plant, ax=axis, **labels)
    return svg(axis.figure, "step")


def correlation_pictures(material: Material) -> tuple[str, str]:
    """Return the residual's autocorrelation, and its cross-correlation with the input."""
    left, right = (blank_figure(HALF, 2.3).subplots() for _ in range(2))
    draw_correlations(material.correlations, material.dt, axes=(left, right))
    return svg(left.figure, "auto"), svg(right.figure, "cross")


def spectrum_picture(material: Material) -> str:
    """Return the spectrum of the residual and of its model."""
    axis = blank_figure(HALF, 2.9).subplots()
    draw_spectrum(material.result.noise, material.on_grid(material.residual), material.dt, ax=axis)
    return svg(axis.figure, "spectrum")


def svg(figure: Any, name: str, *, themed: bool = True) -> str:
    """Return a matplotlib figure as an ``svg`` element."""
    import matplotlib as mpl

    buffer = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    text = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\1{name}-", text)
    text = re.sub(r'(?<= d=")[^"]*', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), text)
    for colour, name_there in _VARIABLES.items() if themed else ():
        text = re.sub(rf"{colour}\b", f"var(--{name_there})", text, flags=re.IGNORECASE)
    return text


def described(picture: str, words: str) -> str:
    """Return an ``svg`` element as an image with a text alternative."""
    return picture.replace("<svg", f'<svg role="img" aria-label="{html.escape(words)}"', 1)
