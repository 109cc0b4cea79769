"""The actuator's table as JSON, Markdown and text, and the report of `replant reproduce`."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from replant.fitting.model_json import finite
from replant.paper.actuator import DEFAULT, NORMALISED, NOTES, OFFLINE, Actuator, Row
from replant.paper.figures import ACTUATOR_FIGURES, FIGURES, Outcome
from replant.paper.reproduction import SOURCE, Cell, TableResult, markdown_table, notes, summary
from replant.plotting.numbers import number, uncertain
from replant.report.contents import versions
from replant.report.page_figures import svg
from replant.report.page_frame import Html, code, facts, icon, section, table, write_page

if TYPE_CHECKING:
    from rich.table import Table as RichTable


Texts = tuple[str, ...]
ACTUATOR_TITLE = "The actuator: twelve online runs, least squares, and replant's default"
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
    """Return {row: {index: {ours, published}}}; ``published`` is None, as the article has no such table.

    Indices: J_* (21), error_* [%], settled_* [s], roughness_* [%] by coefficient, J_sum, settled, roughness, and
    free_run [%].
    """
    return {
        row.label: {
            name: {"ours": None if value is None else finite(value), "published": None}
            for name, value in _figures(row).items()
        }
        for row in actuator.rows
    }


def as_markdown(actuator: Actuator) -> str:
    """Return the tables as a Markdown section: the summary table, then every measure by coefficient."""
    parts = [f"## {ACTUATOR_TITLE}", markdown_table(*summary_table(actuator))]
    parts.append("\n".join(f"* {line}" for line in (*LEGEND, *NOTES, *actuator_summary(actuator))))
    for title, headings, rows in measure_tables(actuator):
        parts += [f"### {title}", markdown_table(headings, rows)]
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


def actuator_summary(actuator: Actuator) -> list[str]:
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
    if (found := row.measures) is not None:
        figures |= {f"J_{name}": value for name, value in found.index.items()}
        figures |= {f"settled_{name}": value for name, value in found.settled.items()}
        figures |= {f"roughness_{name}": value for name, value in found.roughness.items()}
        figures |= {"J_sum": found.index_sum, "settled": found.all_settled, "roughness": found.roughest}
    return figures | {"free_run": row.free_run}


def _short(value: float | None) -> str:
    """Return a figure in five characters if possible."""
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
    """Return errors by name, each with two digits."""
    sizes = {name: abs(error) for name, error in errors.items()}
    return ", ".join(f"{name} {size:.0f} %" if size >= 10.0 else f"{name} {size:.2g} %" for name, size in sizes.items())


TITLE = "The buffered optimization methods, reproduced"
LEDE = (
    "J. Bernat and J. Kolota (2023), The buffered optimization methods for online transfer function identification "
    "employed on DEAP actuator, Archives of Control Sciences 33(3), 565-587, doi 10.24425/acs.2023.146960"
)
_TRANSIENTS = "Each parameter's estimate over time, by method; true values dashed."
#: The caption of each figure, which is also its text alternative.
CAPTIONS = {
    **dict.fromkeys(FIGURES, _TRANSIENTS),
    "fig6": "The simulated actuator: its input, its output over the whole record and in two windows of it, with the "
    "simulated outputs of the models that offline least squares gives.",
    "fig7": f"{_TRANSIENTS} Gradient and IntegralCost with the article's filters.",
    "fig7-exact": f"{_TRANSIENTS} Gradient and IntegralCost with exact filters.",
    "fig8": f"{_TRANSIENTS} AMSGrad and Adam with the article's filters.",
    "fig8-exact": f"{_TRANSIENTS} AMSGrad and Adam with exact filters.",
}

_PRINTED = (
    (r"(?<=\d)e-(\d+)", r"×10<sup>−\1</sup>"),
    (r"(?<=\d)e(\d+)", r"×10<sup>\1</sup>"),
    (r"\^(\d)", r"<sup>\1</sup>"),
    (r"\b([Jg])_(sum|n)\b", r"\1<sub>\2</sub>"),
    (r"\b([ab])(\d)\b", r"\1<sub>\2</sub>"),
    (r"(<sub>\d</sub>) (?=\d)", "\\1\u00a0"),
    (r"(?<![\w.])-(?=\d)", "−"),
    (r"\bLambda\b", "Λ"),
    (r" um\b", "\u00a0µm"),
    (r" %", "\u00a0%"),
)


def as_element(canvas: Any, name: str) -> str:
    """Return a matplotlib figure as an ``svg`` element with selectable text, in the colours that it was drawn in."""
    import matplotlib as mpl

    with mpl.rc_context({"svg.fonttype": "none"}):
        return svg(canvas, name, themed=False)


def write_report(path: Path, outcome: Outcome, pictures: Mapping[str, str], command: str = "") -> Path:
    """Write tables and figures into one self-contained HTML file, and return its path."""
    parts = {f"table{name[3:]}": _pair(f"table{name[3:]}", outcome, pictures) for name in FIGURES}
    parts["actuator"] = _actuator(outcome.actuator, pictures)
    shown = {name: (title, body) for name, (title, body) in parts.items() if body}
    links = "".join(f'<li><a href="#{name}">{html.escape(title)}</a></li>' for name, (title, _) in shown.items())
    results = list(outcome.tables.values())
    claims = "".join(f'<p class="claim">{html.escape(line)}</p>' for line in summary(results))
    source = f'<p class="note">{html.escape(SOURCE)}</p>' if results else ""
    body = [
        section("", claims + source, f'<nav aria-label="Contents"><ul>{links}</ul></nav>'),
        *(section(title, part, anchor=name) for name, (title, part) in shown.items()),
        section("How to reproduce this", code("shell", command)) if command else "",
        section("Article and versions", facts([("article", LEDE), ("versions", versions())])),
    ]
    return write_page(path, title=TITLE, eyebrow="The article compared with replant", lede=LEDE, body="".join(body))


def _pair(name: str, outcome: Outcome, pictures: Mapping[str, str]) -> tuple[str, str]:
    """Return title and body of a table and of the figure that shows its runs."""
    result = outcome.tables.get(name)
    figure = f"fig{name[5:]}"
    title = result.table.title if result else FIGURES[figure].title.replace("$", "").replace("_", "")
    return title, (_table(result) if result else "") + _sheet(figure, pictures)


def _table(result: TableResult) -> str:
    headings = (result.table.heading, *(_index(index) for index in result.table.indices))
    rows = [[row.row.label, *map(_cell, row.cells)] for row in result.rows]
    return table(headings, rows, result.table.title, "table wide") + _notes(notes(result))


def _cell(cell: Cell) -> Html:
    """Return our figure, and below it the published one with the result of the comparison."""
    sign = icon("good" if cell.agrees else "warn")
    ours = number(cell.ours, 3) if cell.std is None else uncertain(cell.ours, cell.std)
    printed = f"published {number(cell.published, 3)}, {cell.verdict}"
    return Html(f'<span class="status">{sign}{ours}</span><small>{html.escape(printed)}</small>')


def _index(index: str) -> Html:
    """Return the name of an index with its subscript."""
    return Html(f"J<sub>{html.escape(index.removeprefix('J_'))}</sub>")


def _actuator(actuator: Actuator | None, pictures: Mapping[str, str]) -> tuple[str, str]:
    figures = {name: _sheet(name, pictures) for name in CAPTIONS if name.partition("-")[0] in ACTUATOR_FIGURES}
    title = "The actuator"
    if actuator is None:
        return title, "".join(figures.values())
    headings, rows = summary_table(actuator)
    names = [_index(name) if name.startswith("J_") else Html(typeset(name)) for name in headings]
    first = table(names, map(_emphasised, rows), ACTUATOR_TITLE, "table wide")
    claims = "".join(f"<p>{typeset(line)}</p>" for line in actuator_summary(actuator))
    more = "".join(
        f"<details><summary>{html.escape(name)}</summary>{table(heads, map(_cells, lines), name, 'table wide')}"
        "</details>"
        for name, heads, lines in measure_tables(actuator)
    )
    body = [figures.pop("fig6"), f"<h3>{html.escape(ACTUATOR_TITLE)}</h3>",
            f'<div class="said">{claims}</div>', first,
            _notes([*LEGEND, *NOTES]), more]  # fmt: skip
    return title, "".join([*body, *figures.values()])


def _cells(row: Sequence[str]) -> list[str]:
    """Return a row with its figures typeset."""
    return [row[0], *(Html(typeset(cell)) for cell in row[1:])]


def _emphasised(row: Sequence[str]) -> list[str]:
    """Return a row, in bold if it is that of replant's default."""
    if not row[0].startswith(DEFAULT):
        return _cells(row)
    return [Html(f"<b>{typeset(cell)}</b>") for cell in row]


def typeset(text: str) -> str:
    r"""Return plain text of the terminal as HTML with typeset symbols, exponents, signs and units."""
    text = html.escape(text)
    for pattern, printed in _PRINTED:
        text = re.sub(pattern, printed, text)
    return text


def _sheet(name: str, pictures: Mapping[str, str]) -> str:
    """Return a figure on a white background; nothing if it was not drawn."""
    if name not in pictures:
        return ""
    said = html.escape(CAPTIONS[name])
    drawn = pictures[name].replace("<svg", f'<svg role="img" aria-label="{said}"', 1)
    return (
        f'<figure class="sheet"><div class="paper" tabindex="0">{drawn}</div><figcaption>{said}</figcaption></figure>'
    )


def _notes(lines: Iterable[str]) -> str:
    items = "".join(f"<li>{typeset(line)}</li>" for line in lines)
    return f'<ul class="note">{items}</ul>' if items else ""
