"""The report of `replant reproduce`: the article's tables and figures compared with ours, on one page."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from replant.paper.actuator import rendering
from replant.paper.actuator.experiment import DEFAULT, NOTES, Actuator
from replant.paper.catalogue import ACTUATOR_FIGURES, Outcome
from replant.paper.tables.figures import FIGURES
from replant.paper.tables.rendering import SOURCE, notes, summary
from replant.paper.tables.reproduction import Cell, TableResult
from replant.report.html.page import (
    Html,
    code,
    facts,
    icon,
    section,
    write_page,
)
from replant.report.html.svg import svg
from replant.report.html.tables import table, versions
from replant.report.number_format import number, uncertain

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
    body = [
        section("", _outcome(outcome), f'<nav aria-label="Contents"><ul>{links}</ul></nav>'),
        *(section(title, part, anchor=name) for name, (title, part) in shown.items()),
        section("How to reproduce this", code("shell", command)) if command else "",
        section("Article and versions", facts([("article", LEDE), ("versions", versions())])),
    ]
    return write_page(path, title=TITLE, eyebrow="The article compared with replant", lede=LEDE, body="".join(body))


def _outcome(outcome: Outcome) -> str:
    """Return the summary of the tables."""
    results = list(outcome.tables.values())
    claims = "".join(f'<p class="claim">{html.escape(line)}</p>' for line in summary(results))
    return claims + (f'<p class="note">{html.escape(SOURCE)}</p>' if results else "")


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
    return Html(
        f'<span class="status">{sign}{ours}</span><small>{html.escape(printed)}</small>'
    )  # fmt: skip


def _index(index: str) -> Html:
    """Return the name of an index with its subscript."""
    return Html(f"J<sub>{html.escape(index.removeprefix('J_'))}</sub>")


def _actuator(actuator: Actuator | None, pictures: Mapping[str, str]) -> tuple[str, str]:
    figures = {name: _sheet(name, pictures) for name in CAPTIONS if name.partition("-")[0] in ACTUATOR_FIGURES}
    title = "The actuator"
    if actuator is None:
        return title, "".join(figures.values())
    headings, rows = rendering.summary_table(actuator)
    names = [_index(name) if name.startswith("J_") else Html(typeset(name)) for name in headings]
    first = table(names, map(_emphasised, rows), rendering.TITLE, "table wide")
    claims = "".join(f"<p>{typeset(line)}</p>" for line in rendering.summary(actuator))
    more = "".join(
        f"<details><summary>{html.escape(name)}</summary>{table(heads, map(_figures, lines), name, 'table wide')}"
        "</details>"
        for name, heads, lines in rendering.measure_tables(actuator)
    )
    body = [figures.pop("fig6"), f"<h3>{html.escape(rendering.TITLE)}</h3>",
            f'<div class="said">{claims}</div>', first,
            _notes([*rendering.LEGEND, *NOTES]), more]  # fmt: skip
    return title, "".join([*body, *figures.values()])


def _figures(row: Sequence[str]) -> list[str]:
    """Return a row with its figures typeset."""
    return [row[0], *(Html(typeset(cell)) for cell in row[1:])]


def _emphasised(row: Sequence[str]) -> list[str]:
    """Return a row, in bold if it is that of replant's default."""
    if not row[0].startswith(DEFAULT):
        return _figures(row)
    return [Html(f"<b>{typeset(cell)}</b>") for cell in row]


def typeset(text: str) -> str:
    r"""Return plain text of the terminal as HTML with typeset symbols, exponents, signs and units.

    Examples
    --------
    >>> typeset("J_sum 2.79e12, a0 -5 %, g_n 5e-5 (1/s^2)")
    'J<sub>sum</sub> 2.79×10<sup>12</sup>, a<sub>0</sub> −5\xa0%, g<sub>n</sub> 5×10<sup>−5</sup> (1/s<sup>2</sup>)'
    """
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
