"""Figures 1-4 of the article, computed from the experiments of its tables.

Each figure shows the estimates over time, one panel for each parameter, for some rows of one table.  A row with a
buffer is run with the first of the table's seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from replant.paper.drawing.curves import Curve, transients
from replant.paper.drawing.panels import draw_panel, legend_above, limit
from replant.paper.tables.experiment import trace
from replant.paper.tables.published import TABLES, Table
from replant.plotting.diagrams import BLUE, ORANGE, blank_figure, symbol


@dataclass(frozen=True)
class Line:
    """One curve of a figure: the row of the table, its label in the legend, and its style."""

    row: str
    label: str
    style: Mapping[str, Any]


@dataclass(frozen=True)
class Figure:
    """A figure of the article: some rows of a table, over time.

    Attributes
    ----------
    name, title : str
    table : Table
    lines : tuple of Line
    units : dict
        Of each parameter, where input and output have the same unit.
    columns, legend_columns : int
        Of panels, and of the legend.
    settled : float
        The limits are set by the curves from this part of the record on; larger values before it are cut off.
    """

    name: str
    title: str
    table: Table
    lines: tuple[Line, ...]
    units: Mapping[str, str]
    columns: int = 1
    legend_columns: int = 3
    settled: float = 0.0


Transients = Mapping[str, Mapping[str, Curve]]
"""Curves by label, then by parameter."""


def compute(figure: Figure, on_run: Callable[[], None] = lambda: None) -> Transients:
    """Run the experiments of a figure; return its curves by label and parameter.

    Examples
    --------
    >>> curves = compute(FIGURES["fig4"])
    >>> list(curves), list(curves["with bias"])
    (['without bias', 'with bias'], ['a0', 'b0', 'bias'])
    """
    curves = {}
    for line in figure.lines:
        experiment = figure.table.row(line.row).experiment
        curves[line.label] = transients(trace(experiment), experiment.plant.dt)
        on_run()
    return curves


def draw(figure: Figure, curves: Transients) -> Any:
    """Return a matplotlib figure of curves that `compute` returned, with the true values dashed."""
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
    legend_above(canvas, figure.title, figure.legend_columns)
    return canvas


def _style(color: str, ls: Any, lw: float = 1.3) -> dict[str, Any]:
    return {"color": color, "ls": ls, "lw": lw}


def _amplitudes() -> Sequence[Line]:
    dashes = {"10": (0, (1, 1)), "1": "-", "0.1": (0, (6, 1.5, 1, 1.5))}
    return [
        Line(f"{name}, amplitude {size}", f"{name}, amplitude {size}", _style(color, ls))
        for name, color in (("AMSGrad", BLUE), ("Gradient", ORANGE))
        for size, ls in dashes.items()
    ]


_FIRST_ORDER = {"a0": "1/s", "b0": "1/s"}
_SECOND_ORDER = {"a1": "1/s", "a0": "1/s²", "b1": "1/s", "b0": "1/s²"}
_DOTTED = (0, (1, 1))  # dashes of a dotted line [line widths]

#: Figures 1 to 4 by name.
FIGURES = {
    figure.name: figure
    for figure in (
        Figure(
            "fig1",
            "Figure 1: $G_1(s)$ identified with and without a buffer",
            TABLES["table1"],
            (
                Line("AMSGrad, with buffer (batch 10)", "AMSGrad, with buffer (batch 10)", _style(BLUE, "-")),
                Line("AMSGrad, no buffer", "AMSGrad, no buffer", _style(BLUE, _DOTTED)),
                Line("Gradient, with buffer (batch 10)", "Gradient, with buffer (batch 10)", _style(ORANGE, "-")),
                Line("Gradient, no buffer", "Gradient, no buffer", _style(ORANGE, _DOTTED)),
            ),
            _FIRST_ORDER,
        ),
        Figure(
            "fig2",
            "Figure 2: amplitude of the input",
            TABLES["table2"],
            tuple(_amplitudes()),
            _FIRST_ORDER,
        ),
        Figure(
            "fig3",
            "Figure 3: scaling of the signals, AMSGrad on $G_2(s)$",
            TABLES["table3"],
            (Line("one", "one", _style(ORANGE, "-")), Line("adjusted", "adjusted", _style(BLUE, "-"))),
            _SECOND_ORDER,
            columns=2,
        ),
        Figure(
            "fig4",
            "Figure 4: a drifting output, AMSGrad with and without a bias in the regressor (the start is cut off)",
            TABLES["table4"],
            (Line("without", "without bias", _style(ORANGE, "-")), Line("with", "with bias", _style(BLUE, "-"))),
            _FIRST_ORDER,
            settled=0.1,
        ),
    )
}
