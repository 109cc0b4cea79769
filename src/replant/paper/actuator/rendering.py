"""Rendering: the actuator's table as JSON, as Markdown and for the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby
from typing import TYPE_CHECKING

from replant.paper.actuator.experiment import (
    DEFAULT,
    NORMALISED,
    NOTES,
    OFFLINE,
    Actuator,
    Row,
)

if TYPE_CHECKING:
    from rich.table import Table as RichTable

Texts = tuple[str, ...]
TITLE = "The actuator: twelve online runs, least squares, and replant's default"
LEGEND = (
    "a2 to b0: error of the last estimate, in percent of the true value.",
    "filter: gbt is the article's, Tustin's rule and one sample late; exact has no discretisation error; own is the "
    "default's.",
    "normalised: each row of the regression is divided by m of (13), as in the online runs.",
    "J_sum: the article's index (21), summed over the coefficients; a1, the largest coefficient, dominates the sum.",
    "replant's default begins to learn with a model of the first tenth of the record; until then provisional models of "
    "fewer samples count in its J, and 0 before the first of them.",
    "in 10%: time in s from which on every coefficient stays within 10 % of its true value.",
    "rough: standard deviation over the last tenth of the record about the best straight line, in percent of the true "
    "value; the largest of the coefficients.",
    "free: fit in percent of the last model, simulated from the input alone.",
)


def as_json(actuator: Actuator) -> dict[str, dict[str, dict[str, float | None]]]:
    """Return {row: {index: {ours, published}}}; ``published`` is None, because the article has no such table.

    Indices: J_* (21), error_* [%], settled_* [s], roughness_* [%] by coefficient, J_sum, settled, roughness, and
    free_run [%].  None where there is no figure.
    """
    return {
        row.label: {name: {"ours": _finite(value), "published": None} for name, value in _figures(row).items()}
        for row in actuator.rows
    }


def as_markdown(actuator: Actuator) -> str:
    """Return the tables as a Markdown section: the summary table, then every measure by coefficient."""
    parts = [f"## {TITLE}", _markdown(*summary_table(actuator))]
    parts.append("\n".join(f"* {line}" for line in (*LEGEND, *NOTES, *summary(actuator))))
    for title, headings, rows in measure_tables(actuator):
        parts += [f"### {title}", _markdown(headings, rows)]
    return "\n\n".join(parts) + "\n"


def summary_table(actuator: Actuator) -> tuple[Texts, list[Texts]]:
    """Return headings and rows of the table, as text."""
    return ("method", *_headings(actuator)), [(row.label, *_fields(row)) for row in actuator.rows]


def measure_tables(actuator: Actuator) -> Iterator[tuple[str, Texts, list[Texts]]]:
    """Return title, headings and rows of a table for each measure, by coefficient."""
    names = tuple(actuator.record.true)
    for title, prefix, write in (
        ("Index J of each coefficient", "J", _scientific),
        ("Time [s] from which on it stays within 10 %", "settled", _short),
        ("Roughness [%] of each coefficient", "roughness", _short),
    ):
        rows: list[Texts] = [
            (row.label, *(write(_figures(row)[f"{prefix}_{name}"]) for name in names))
            for row in actuator.rows
            if row.measures is not None
        ]
        yield title, ("method", *names), rows


def as_rich(actuator: Actuator) -> RichTable:
    """Return a table for the terminal, 80 columns wide: a section for each run, a line for each filter."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, show_lines=True, pad_edge=False, padding=0)
    for heading in ("method", "filter"):
        table.add_column(heading, no_wrap=True)
    for heading in _headings(actuator):
        table.add_column(heading, justify="right", no_wrap=True)
    for (method, variant), group in groupby(actuator.rows, lambda row: (row.method, row.variant)):
        rows = list(group)
        columns = zip(*((row.filters, *_fields(row)) for row in rows), strict=True)
        style = "bold" if method == DEFAULT else ""
        name = f"{method}\n{variant}" if variant else method
        table.add_row(Text(name, style), *(Text("\n".join(column), style) for column in columns))
    return table


def summary(actuator: Actuator) -> list[str]:
    """Return the conclusions: the effect of discretisation, the best of the optimizers, and the default."""
    best, bettered = (
        {name: min(abs(row.errors[name]) for row in actuator.online_rows(filters)) for name in actuator.record.true}
        for filters in ("gbt", "exact")
    )
    default = actuator.row(DEFAULT, "default", "own").errors
    gbt, exact = (actuator.row(OFFLINE, NORMALISED, filters).errors for filters in ("gbt", "exact"))
    worst = {name: max(abs(row.errors[name]) for row in actuator.elsewhere) for name in default}
    return [
        f"Normalised least squares, to which every optimizer converges, is off by {_listed(gbt)} with the article's "
        f"filters, by {_listed(exact)} with exact ones.",
        f"Smallest final error of the article's twelve runs, for each coefficient: "
        f"{_listed(best)}; of the same runs with exact filters, {_listed(bettered)}.",
        f"Final error of replant's default: {_listed(default)}.",
        f"On {len(actuator.elsewhere)} other records of the same rig, with other voltages and other noise, it was at "
        f"most {_listed(worst)}: the creep, which resembles the slow mode, affects a0 and b0.",
    ]


def _headings(actuator: Actuator) -> tuple[str, ...]:
    return ("J_sum", *actuator.record.true, "in 10%", "rough", "free")


def _fields(row: Row) -> tuple[str, ...]:
    errors = [_short(value) for value in row.errors.values()]
    if row.measures is None:
        return ("", *errors, "", "", _short(row.free_run))
    measures = row.measures
    settled = "never" if measures.all_settled is None else _short(measures.all_settled)
    return (_scientific(measures.index_sum), *errors, settled, _short(measures.roughest), _short(row.free_run))


def _figures(row: Row) -> dict[str, float | None]:
    figures: dict[str, float | None] = {f"error_{name}": value for name, value in row.errors.items()}
    if row.measures is not None:
        found = row.measures
        parts: Iterable[tuple[str, Mapping[str, float | None], float | None]] = (
            ("J", found.index, None),
            ("settled", found.settled, found.all_settled),
            ("roughness", found.roughness, found.roughest),
        )
        for prefix, by_name, overall in parts:
            figures |= {f"{prefix}_{name}": value for name, value in by_name.items()}
            figures["J_sum" if prefix == "J" else prefix] = found.index_sum if prefix == "J" else overall
    return figures | {"free_run": row.free_run}


def _markdown(headings: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    headings = list(headings)
    lines = ["| " + " | ".join(headings) + " |", "|---" + "|--:" * (len(headings) - 1) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def _short(value: float | None) -> str:
    """Return a figure in five characters if possible.

    Examples
    --------
    >>> [_short(value) for value in (-0.001, 6.406, -101.76, 2.79e12, -math.inf, None)]
    ['0.00', '6.41', '-102', '2.79e12', 'none', 'never']
    """
    if value is None:
        return "never"
    if not math.isfinite(value):
        return "none"
    size = abs(value)
    if size >= 1e5:
        return _scientific(value)
    text = f"{value:.{0 if size >= 99.95 else 1 if size >= 9.995 else 2}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def _scientific(value: float | None) -> str:
    return "none" if value is None else f"{value:.2e}".replace("e+", "e")


def _listed(errors: Mapping[str, float]) -> str:
    """Return errors by name, each with two digits.

    Examples
    --------
    >>> _listed({"a1": -0.00123, "a0": 102.4})
    'a1 0.0012 %, a0 102 %'
    """
    sizes = {name: abs(error) for name, error in errors.items()}
    return ", ".join(f"{name} {size:.0f} %" if size >= 10.0 else f"{name} {size:.2g} %" for name, size in sizes.items())


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None
