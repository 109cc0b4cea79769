"""The tables and drawn figures (SVG) of a report."""

from __future__ import annotations

import html
import io
import math
import platform
import re
from collections.abc import Iterable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from replant.data.logs import Log
from replant.data.logs.recording import digest
from replant.plotting.diagrams import blank_figure
from replant.plotting.numbers import MINUS, complex_number, duration, number, off_by, uncertain
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
from replant.report.figures.responses import regions
from replant.report.material import Material
from replant.report.page import Html, facts, words
from replant.runs.result import Result

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


UNCERTAIN = "Estimate ± standard deviation."
NO_STD = "This estimator gives no standard deviations."
PACKAGES = ("replant", "numpy", "scipy", "matplotlib")


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


def coefficients(material: Material) -> str:
    """Return the table of coefficients with units, standard deviations and, if known, true values."""
    result, known = material.result, material.uncertainty
    stds: Sequence[float | None] = [None] * result.structure.size if known is None else known.std.tolist()
    labels = style.symbols(result.structure, material.plant_label, material.output_label)
    headings = ["coefficient", "estimate" if known is None else "estimate ± std"]
    rows = [
        [label, uncertain(value, std)]
        for label, value, std in zip(labels, result.parameters.tolist(), stds, strict=True)
    ]
    if material.truth is not None:
        headings += ["true", "off by"]
        for row, value, true in zip(rows, result.parameters.tolist(), material.truth, strict=True):
            row += [number(float(true)), off_by(value, float(true)).replace("-", MINUS)]
    note = NO_STD if known is None else UNCERTAIN
    return table(headings, rows, "Coefficients") + f'<p class="note">{note}</p>'


def poles(material: Material) -> str:
    """Return the tables of poles, with frequency, damping and time constant, and of zeros."""
    result, known = material.result, material.uncertainty
    modes = result.transfer_function.modes
    spreads: Sequence[tuple[float | None, ...]] = [(None, None, None)] * len(modes)
    if known is not None:
        spreads = [(each.frequency_std, each.damping_std, each.time_constant_std) for each in known.modes]
    rows = [
        [complex_number(mode.pole), *map(uncertain, (mode.frequency, mode.damping, mode.time_constant), spread)]
        for mode, spread in zip(modes, spreads, strict=True)
    ]
    headings = ("pole [rad/s]", "frequency [Hz]", "damping", "time constant [s]")
    return table(headings, rows, "Poles") + _zeros(result)


def _zeros(result: Result) -> str:
    zeros = [zero for zero in result.transfer_function.zeros.tolist() if zero.imag >= 0]
    if not zeros:
        return '<p class="note">No zeros.</p>' if result.structure.zeros == 0 else ""
    spread = {root: covariance for root, covariance in regions(result) if np.isfinite(covariance).all()}
    rows = []
    for zero in sorted(zeros, key=abs):
        known = spread.get(zero)
        std = None if known is None else math.sqrt(max(float(np.trace(known)), 0.0))
        frequency = abs(zero) / math.tau
        rows.append([complex_number(zero), number(frequency) if std is None else uncertain(abs(zero), std)])
    return table(("zero [rad/s]", "frequency [Hz]" if not spread else "distance from 0 ± std [rad/s]"), rows, "Zeros")


def origin(material: Material) -> str:
    """Return facts about the record, the use of its samples, and the versions of the software."""
    log, result = material.log, material.result
    rejected = ", ".join(f"{count:,} {reason}" for reason, count in result.rejected.items() if count) or "none"
    return facts(
        [
            *of_record(log),
            ("used", f"{result.samples:,} samples"),
            ("rejected", rejected),
            *([("residual tests, excitation", f"of the newest {log.input.size:,} samples")] if log.earlier else []),
            ("computed in", f"{number(result.elapsed, 3)} s"),
            ("versions", versions()),
        ]
    )


def of_record(log: Log) -> list[tuple[str, str]]:
    """Return what is to be said of a record, as names and words."""
    return [
        ("file", log.path.name or "none: the record is simulated"),
        ("SHA-256", fingerprint(log.path)),
        ("input, output", f"{log.input_name}, {log.output_name}"),
        *([("reference", log.reference_name)] if log.reference_name else []),
        ("record", f"{len(log):,} samples, {lasts(log)}"),
    ]


def lasts(log: Log) -> str:
    """Return in words how long a record lasts, and its sampling time.

    Examples
    --------
    >>> signal = np.zeros(3)
    >>> lasts(Log(signal, signal, 0.5, np.array([0.0, 0.5, 9.5]), "u", "y", Path("log.csv")))
    '10 s on an irregular clock, usually at 0.5 s'
    """
    clock = "at" if log.stamps is None else "on an irregular clock, usually at"
    return f"{duration(log.duration)} {clock} {number(log.dt, 6)} s"


def fingerprint(path: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal; a remark if there is no file."""
    return digest(path) or "none: there is no file"


def versions() -> str:
    """Return the versions of the software that computed the result."""
    found = []
    for package in PACKAGES:
        try:
            found.append(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            continue
    return ", ".join([*found, f"Python {platform.python_version()}"])
