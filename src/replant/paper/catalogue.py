"""Catalogue of the article's tables and figures by name: runs the experiments behind the names, and draws the figures.

Figures 7 and 8 and the actuator's table come from one experiment, which is run once.  Figures 1-4 run the experiments
of the tables again, which gives the same estimates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from replant.fitting.fit_result import FitResult
from replant.paper import actuator as rig
from replant.paper.figures import FIGURES, Transients, compute, draw
from replant.paper.reproduction import TableResult, reproduce, runs
from replant.paper.tables import TABLES

ACTUATOR = "actuator"
ACTUATOR_FIGURES = ("fig6", "fig7", "fig8")
#: What `replant reproduce` reproduces, in the article's order; "actuator" is a table that the article does not have.
NAMES = (*TABLES, *FIGURES, *ACTUATOR_FIGURES, ACTUATOR)
DOTS = 150  # resolution of the PNG [1/inch]


@dataclass(frozen=True, eq=False)
class Outcome:
    """The results by name."""

    tables: dict[str, TableResult] = field(default_factory=dict)
    transients: dict[str, Transients] = field(default_factory=dict)
    record: rig.Record | None = None  # of the actuator
    offline: Mapping[str, FitResult] = field(default_factory=dict)  # the offline fits of the actuator, by filters
    actuator: rig.Actuator | None = None  # None if only Figure 6, which needs the offline fits alone, was asked for


def is_figure(name: str) -> bool:
    """Return whether ``name`` is a figure."""
    return name in FIGURES or name in ACTUATOR_FIGURES


def steps(names: Sequence[str]) -> int:
    """Return how many runs ``names`` need: how often `run` calls ``on_run``."""
    count = sum(runs(TABLES[name]) for name in names if name in TABLES)
    count += sum(len(FIGURES[name].lines) for name in names if name in FIGURES)
    return count + (rig.RUNS if _needs_runs(names) else len(rig.FILTERS) if "fig6" in names else 0)


def run(
    names: Sequence[str], on_run: Callable[[str], None] = lambda name: None, executor: Executor | str | None = None
) -> Outcome:
    """Run the experiments that ``names`` need; ``on_run`` is called after each run with the name that it belongs to.

    The runs of the tables are made on ``executor``, see `replant.fleet.fit`; the figures do not depend on it.
    """
    tables = {
        name: reproduce(TABLES[name], on_run=partial(on_run, name), executor=executor)
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
    """Draw the figures among ``names`` one by one; yield file name, without suffix, and matplotlib figure.

    Figures 7 and 8 are drawn twice: with the article's filters, and with exact ones.
    """
    from replant.paper.figures import draw_record, draw_transients

    for name in names:
        if name in FIGURES:
            yield name, draw(FIGURES[name], outcome.transients[name])
        elif name == "fig6" and outcome.record is not None:
            yield name, draw_record(outcome.record, outcome.offline)
        elif name in ACTUATOR_FIGURES and outcome.actuator is not None:
            yield name, draw_transients(name, outcome.actuator, "gbt")
            yield f"{name}-exact", draw_transients(name, outcome.actuator, "exact")


def save(outcome: Outcome, names: Sequence[str], folder: Path) -> Iterator[tuple[str, Any, list[Path]]]:
    """Draw figures as PNG and SVG files; yield name, matplotlib figure and paths of each.

    The caller uses a figure before it asks for the next one: the fonts are set only as long as the iteration runs.
    """
    from replant.plotting.style import font

    with font():
        for name, canvas in drawings(outcome, names):
            paths = [folder / f"{name}.png", folder / f"{name}.svg"]
            canvas.savefig(paths[0], dpi=DOTS)
            canvas.savefig(paths[1], metadata={"Date": None})
            yield name, canvas, paths


def _needs_runs(names: Sequence[str]) -> bool:
    return any(name in names for name in ("fig7", "fig8", ACTUATOR))
