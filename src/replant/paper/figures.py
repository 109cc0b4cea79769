"""Figures 1-4 and 6-8 of the article, computed from its experiments; tables and figures to reproduce, by name.

Figures 1-4 show estimates over time for rows of one table, with a panel for each parameter; rows with a buffer are run
with the first seed.  Figures 7 and 8 and the actuator's table come from one experiment, which is run once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from replant.fitting.fit_result import FitResult
from replant.paper import actuator as rig
from replant.paper.actuator import GAINS, Actuator, Record
from replant.paper.tables import TABLES, Curve, Table, TableResult, curve, reproduce, transients
from replant.plotting.numbers import symbol
from replant.plotting.style import BLUE, FONT, GREY, NAVY, ORANGE, SKY, TRUE, VERMILION, blank_figure, tidy


@dataclass(frozen=True)
class Line:
    """One curve of a figure: the row of the table, its label in the legend, and its style."""

    row: str
    label: str
    style: Mapping[str, Any]


@dataclass(frozen=True)
class Figure:
    """A figure of the article: some rows of a table, over time."""

    name: str
    title: str
    table: Table
    lines: tuple[Line, ...]
    units: Mapping[str, str]  # unit of each parameter if input and output have the same unit
    columns: int = 1  # columns of panels
    settled: float = 0.0  # part of the record after which curves set the limits; larger earlier values are cut off


Transients = Mapping[str, Mapping[str, Curve]]  # curves by label, then by parameter


def compute(figure: Figure, on_run: Callable[[], None] = lambda: None) -> Transients:
    """Run the experiments of a figure; return its curves by label and parameter."""
    curves = {}
    for line in figure.lines:
        experiment = figure.table.row(line.row).experiment
        trace = experiment.identifier().update_many(*experiment.plant.record())
        curves[line.label] = transients(trace, experiment.plant.dt)
        on_run()
    return curves


def draw(figure: Figure, curves: Transients) -> Any:
    """Return a matplotlib figure of the curves of `compute`, with the true values dashed."""
    plant = figure.table.row(figure.lines[0].row).experiment.plant
    rows = -(-len(plant.true) // figure.columns)
    canvas = blank_figure(7.0, 1.0 + 2.1 * rows)
    axes = canvas.subplots(rows, figure.columns, sharex=True, squeeze=False)
    for axis, (name, true) in zip(axes.flat, plant.true.items(), strict=True):
        drawn = [(line.label, curves[line.label][name], line.style) for line in figure.lines]
        draw_panel(axis, drawn, true)
        if figure.settled:
            limit(axis, [curve for _, curve, _ in drawn], true, figure.settled * plant.duration)
        axis.set_ylabel(f"{symbol(name)} [{figure.units[name]}]")
        axis.set_xlim(0.0, plant.duration)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    canvas.align_ylabels()
    legend_above(canvas, figure.title, 3)
    return canvas


def _line(row: str, color: str, ls: Any, label: str = "") -> Line:
    return Line(row, label or row, {"color": color, "ls": ls, "lw": 1.3})


_FIRST_ORDER = {"a0": "1/s", "b0": "1/s"}
_SECOND_ORDER = {"a1": "1/s", "a0": "1/s²", "b1": "1/s", "b0": "1/s²"}
_DOTTED = (0, (1, 1))  # dashes of a dotted line [line widths]
_AMPLITUDES = {"10": _DOTTED, "1": "-", "0.1": (0, (6, 1.5, 1, 1.5))}

#: Figures 1 to 4 by name.
FIGURES = {
    figure.name: figure
    for figure in (
        Figure(
            "fig1",
            "Figure 1: $G_1(s)$ identified with and without a buffer",
            TABLES["table1"],
            (
                _line("AMSGrad, with buffer (batch 10)", BLUE, "-"),
                _line("AMSGrad, no buffer", BLUE, _DOTTED),
                _line("Gradient, with buffer (batch 10)", ORANGE, "-"),
                _line("Gradient, no buffer", ORANGE, _DOTTED),
            ),
            _FIRST_ORDER,
        ),
        Figure(
            "fig2",
            "Figure 2: amplitude of the input",
            TABLES["table2"],
            tuple(
                _line(f"{name}, amplitude {size}", color, ls)
                for name, color in (("AMSGrad", BLUE), ("Gradient", ORANGE))
                for size, ls in _AMPLITUDES.items()
            ),
            _FIRST_ORDER,
        ),
        Figure(
            "fig3",
            "Figure 3: scaling of the signals, AMSGrad on $G_2(s)$",
            TABLES["table3"],
            (_line("one", ORANGE, "-"), _line("adjusted", BLUE, "-")),
            _SECOND_ORDER,
            columns=2,
        ),
        Figure(
            "fig4",
            "Figure 4: a drifting output, AMSGrad with and without a bias in the regressor (the start is cut off)",
            TABLES["table4"],
            (_line("without", ORANGE, "-", "without bias"), _line("with", BLUE, "-", "with bias")),
            _FIRST_ORDER,
            settled=0.1,
        ),
    )
}


UNITS = {"a2": "1/s", "a1": "1/s²", "a0": "1/s³", "b1": "mm/(kV² s²)", "b0": "mm/(kV² s³)"}
#: Windows of Figures 6c and 6d, as parts of the record: a few steps, and the ringing after one of them.
WINDOWS = {"c": (151.7 / 240.0, 157.7 / 240.0), "d": (155.1 / 240.0, 156.6 / 240.0)}
#: The two columns of Figures 7 and 8.
COLUMNS = {"fig7": ("Gradient", "IntegralCost"), "fig8": ("AMSGrad", "Adam")}
TOLD_APART = 0.01  # smallest visible distance of two curves [part of the true value]
_MEASURED = {"color": GREY, "lw": 2.6, "alpha": 0.5}
_MODEL = {"exact": {"color": VERMILION, "lw": 0.9}, "gbt": {"color": BLUE, "lw": 0.9, "ls": (0, (3, 1.5))}}
_NAMES = {"gbt": "the article's filters", "exact": "exact filters"}
_VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "no buffer": {"color": SKY, "lw": 0.9},
    "small gain": {"color": VERMILION, "lw": 1.0, "ls": (0, (6, 1.5, 1, 1.5))},
    "very small gain": {"color": NAVY, "lw": 1.2},
}
_LABELS = {name: name if name == "no buffer" else f"buffer, {name}" for name in GAINS}
_LIMIT = {"color": "#555555", "ls": (0, (1, 1.5)), "lw": 1.0}


def draw_record(record: Record, offline: Mapping[str, FitResult]) -> Any:
    """Return Figure 6: (a) the input, (b) measured output and simulated outputs, (c, d) two windows of (b)."""
    canvas = blank_figure(7.0, 8.4)
    axes = canvas.subplots(4, 1, height_ratios=(1, 1.5, 1.5, 1.5))
    duration, whole = record.u.size * record.rig.dt, (0.0, 1.0)
    for axis, letter, window in zip(axes, "abcd", (whole, whole, *WINDOWS.values()), strict=True):
        if letter == "a":
            _draw(axis, record.u, record, window, color="black", lw=0.8)
            axis.set_ylabel("input [kV]")
        else:
            _draw(axis, record.y, record, window, label="measured", **_MEASURED)
            for filters, words in _NAMES.items():
                label = f"{words}: simulated fit {offline[filters].simulation.fit:.1f} %"
                _draw(axis, offline[filters].simulation.output, record, window, label=label, **_MODEL[filters])
            axis.set_ylabel("displacement [mm]")
        axis.set_title(f"({letter})", loc="left")
        axis.set_xlim(window[0] * duration, window[1] * duration)
        tidy(axis)
    axes[-1].set_xlabel("time [s]")
    canvas.align_ylabels()
    legend_above(canvas, "Figure 6: the actuator's record and its model by least squares, offline", 3)
    return canvas


def draw_transients(name: str, actuator: Actuator, filters: str = "gbt") -> Any:
    """Return Figure 7 or 8: each coefficient's estimate over time, one column for each optimizer.

    True values are dashed.  The estimate of normalised least squares with the same filters, to which these optimizers
    converge, is dotted, except where it coincides with the true value.
    """
    true = actuator.record.true
    canvas = blank_figure(7.0, 9.2)
    axes = canvas.subplots(len(true), 2, sharex=True, sharey="row")
    for column, method in zip(axes.T, COLUMNS[name], strict=True):
        column[0].set_title(method, loc="left", fontweight="bold")
        column[-1].set_xlabel("time [s]")
    for panels, goal, (coefficient, value) in zip(axes, actuator.goals[filters].tolist(), true.items(), strict=False):
        for axis, method in zip(panels, COLUMNS[name], strict=True):
            runs = [(variant, actuator.row(method, variant, filters)) for variant in GAINS]
            drawn = [(_LABELS[variant], (row.curves or {})[coefficient], _VARIANTS[variant]) for variant, row in runs]
            draw_panel(axis, drawn, value)
            if abs(goal / value - 1.0) > TOLD_APART:
                axis.axhline(goal, label="least squares, normalised", **_LIMIT)
        panels[0].set_ylabel(f"{symbol(coefficient)} [{UNITS[coefficient]}]")
        _limit(panels, value)
    axes[0, 0].set_xlim(0.0, actuator.record.u.size * actuator.record.rig.dt)
    canvas.align_ylabels()
    title = f"Figure {name[3:]}: transients on the actuator, {_NAMES[filters]} (some overshoots are cut off)"
    legend_above(canvas, title, 2)
    return canvas


def _limit(panels: Any, true: float) -> None:
    """Set the limits of a row of panels: the start and all later estimates, cut off far from the true value."""
    shown = [line.get_ydata()[len(line.get_ydata()) // 20 :] for axis in panels for line in axis.get_lines()]
    low, high = min(0.0, *(float(np.min(part)) for part in shown)), max(float(np.max(part)) for part in shown)
    low, high = max(low, -0.4 * true), min(high, 1.8 * true)
    panels[0].set_ylim(low - 0.06 * (high - low), high + 0.06 * (high - low))


def _draw(axis: Any, signal: Any, record: Record, window: tuple[float, float], **style: Any) -> None:
    """Draw a window, in parts of the record, of a signal (K,)."""
    begin, end = (round(part * signal.size) for part in window)
    shown = curve(np.asarray(signal[begin:end]), record.rig.dt)
    axis.plot(begin * record.rig.dt + shown.t, shown.values, **style)


def draw_panel(axis: Any, curves: Iterable[tuple[str, Curve, Mapping[str, Any]]], true: float) -> None:
    """Draw labelled curves and the true value."""
    for label, drawn, style in curves:
        axis.plot(drawn.t, drawn.values, label=label, **style)
    axis.axhline(true, label="true value", **TRUE)
    tidy(axis)


def limit(axis: Any, curves: Sequence[Curve], true: float, begin: float) -> None:
    """Set the limits of an axis to the range of the curves from a time on, with a margin."""
    shown = np.concatenate([curve.values[curve.t >= begin] for curve in curves] + [[true]])
    low, high = float(shown.min()), float(shown.max())
    margin = 0.5 * (high - low) or 0.1 * abs(true)
    axis.set_ylim(low - margin, high + margin)


def legend_above(canvas: Any, title: str, columns: int) -> None:
    """Write a title above all panels, and below it one legend of all curves."""
    from matplotlib.lines import Line2D

    entries: dict[str, Any] = {}
    for axis in canvas.axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    handles, labels = list(entries.values()), list(entries)
    # the legend is filled by columns; blank entries at its end keep matplotlib from distributing the others evenly
    blanks = -len(handles) % columns
    handles += [Line2D([], [], ls="none")] * blanks
    labels += [""] * blanks
    canvas.legend(
        handles, labels, title=title, loc="outside upper left", ncols=columns, frameon=False, alignment="left"
    )


ACTUATOR = "actuator"
ACTUATOR_FIGURES = ("fig6", "fig7", "fig8")
#: Names for `replant reproduce`, in the article's order; "actuator" is a table that the article does not have.
NAMES = (*TABLES, *FIGURES, *ACTUATOR_FIGURES, ACTUATOR)
DOTS = 150  # resolution of the PNG [1/inch]


@dataclass(frozen=True, eq=False)
class Outcome:
    """The results by name."""

    tables: dict[str, TableResult] = field(default_factory=dict)
    transients: dict[str, Transients] = field(default_factory=dict)
    record: rig.Record | None = None  # of the actuator
    offline: Mapping[str, FitResult] = field(default_factory=dict)  # the offline fits of the actuator, by filters
    actuator: rig.Actuator | None = None  # None if at most Figure 6, which needs only the offline fits, was requested


def is_figure(name: str) -> bool:
    """Return whether ``name`` is a figure."""
    return name in FIGURES or name in ACTUATOR_FIGURES


def steps(names: Sequence[str]) -> int:
    """Return the number of runs that ``names`` need, which is the number of calls of ``on_run`` by `run`."""
    count = sum(len(TABLES[name].rows) for name in names if name in TABLES)
    count += sum(len(FIGURES[name].lines) for name in names if name in FIGURES)
    return count + (rig.RUNS if _needs_runs(names) else len(rig.FILTERS) if "fig6" in names else 0)


def run(
    names: Sequence[str], on_run: Callable[[str], None] = lambda name: None, executor: Executor | str | None = None
) -> Outcome:
    """Run the experiments that ``names`` need, tables on ``executor``; call ``on_run`` after each with its name."""
    tables = {
        name: reproduce(TABLES[name], on_row=partial(on_run, name), executor=executor)
        for name in names
        if name in TABLES
    }
    curves = {name: compute(FIGURES[name], partial(on_run, name)) for name in names if name in FIGURES}
    if _needs_runs(names):
        actuator = rig.reproduce_actuator(on_run=partial(on_run, ACTUATOR))
        return Outcome(tables, curves, actuator.record, actuator.offline, actuator)
    if "fig6" in names:
        record = rig.measure_rig()
        return Outcome(tables, curves, record, rig.fit_offline(record, partial(on_run, ACTUATOR)))
    return Outcome(tables, curves)


def drawings(outcome: Outcome, names: Sequence[str]) -> Iterator[tuple[str, Any]]:
    """Draw figures by name, Figures 7 and 8 with both kinds of filters; yield file name and figure."""
    for name in names:
        if name in FIGURES:
            yield name, draw(FIGURES[name], outcome.transients[name])
        elif name == "fig6" and outcome.record is not None:
            yield name, draw_record(outcome.record, outcome.offline)
        elif name in ACTUATOR_FIGURES and outcome.actuator is not None:
            yield name, draw_transients(name, outcome.actuator, "gbt")
            yield f"{name}-exact", draw_transients(name, outcome.actuator, "exact")


def save(outcome: Outcome, names: Sequence[str], folder: Path) -> Iterator[tuple[str, Any, list[Path]]]:
    """Save figures as PNG and SVG; yield name, figure and paths, to be used at once, while the fonts are set."""
    import matplotlib as mpl

    with mpl.rc_context(FONT):
        for name, canvas in drawings(outcome, names):
            paths = [folder / f"{name}.png", folder / f"{name}.svg"]
            canvas.savefig(paths[0], dpi=DOTS)
            canvas.savefig(paths[1], metadata={"Date": None})
            yield name, canvas, paths


def _needs_runs(names: Sequence[str]) -> bool:
    return any(name in names for name in ("fig7", "fig8", ACTUATOR))
