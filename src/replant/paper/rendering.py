"""The output of `replant reproduce`: tables as JSON, Markdown and text, and the report."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from replant.fitting.model_json import finite
from replant.paper.actuator import DEFAULT, LEGEND, NORMALISED, NOTES, OFFLINE, Actuator, Row
from replant.paper.figures import ACTUATOR, ACTUATOR_FIGURES, FIGURES, Outcome
from replant.paper.tables import LIMIT, Cell, RowResult, TableResult, three_digits
from replant.plotting.numbers import number, uncertain
from replant.report.contents import versions
from replant.report.page_frame import Html, code, facts, icon, section, svg, table, write_page

if TYPE_CHECKING:
    from rich.table import Table as RichTable


SOURCE = (
    "Bernat and Kolota (2023), doi 10.24425/acs.2023.146960: the performance index J of each parameter, "
    "the sum over all samples of its squared error, (21)."
)
Texts = tuple[str, ...]
ACTUATOR_TITLE = "The actuator: twelve online runs, least squares, and replant's default"


def as_json(outcome: Outcome) -> dict[str, dict[str, dict[str, dict[str, Any]]]]:
    """Return {table: {row: {index: {ours, published, agrees}}}}; with a buffer ours is a mean, with std and seeds.

    For the actuator, whose table the article does not have, ``published`` is None.  Its indices: J_* (21), error_* [%],
    settled_* [s], roughness_* [%] by coefficient, J_sum, settled, roughness, and free_run [%].
    """
    tables: dict[str, Any] = {
        name: {row.row.label: {cell.index: _cell_as_json(cell, row.seeds) for cell in row.cells} for row in result.rows}
        for name, result in outcome.tables.items()
    }
    if outcome.actuator is not None:
        tables[ACTUATOR] = {
            row.label: {
                name: {"ours": None if value is None else finite(value), "published": None}
                for name, value in _figures(row).items()
            }
            for row in outcome.actuator.rows
        }
    return tables


def as_markdown(outcome: Outcome) -> str:
    """Return the tables as a Markdown page: the article's with a summary, then the actuator's with every measure."""
    parts, results = [], list(outcome.tables.values())
    if results:
        parts += ["# The article's tables, reproduced", SOURCE]
    for result in results:
        headings, rows = _as_text(result)
        lines = [(row.row.label, *line) for row, cells in rows for line in cells]
        parts += [f"## {result.table.title}", markdown_table(headings, lines, left=("index", "match"))]
        parts.append(_bullets(notes(result)))
    if results:
        parts += ["## Summary", _bullets(summary(results))]
    if (actuator := outcome.actuator) is not None:
        parts += [f"## {ACTUATOR_TITLE}", markdown_table(*summary_table(actuator))]
        parts.append(_bullets([*LEGEND, *NOTES, *actuator_summary(actuator)]))
        for title, names, shown in measure_tables(actuator):
            parts += [f"### {title}", markdown_table(names, shown)]
    return "\n\n".join(parts) + "\n"


def _bullets(lines: Iterable[str]) -> str:
    return "\n".join(f"* {line}" for line in lines)


def _as_text(result: TableResult) -> tuple[Texts, list[tuple[RowResult, list[Texts]]]]:
    """Return the headings of a table, and for each row its lines, one for each figure, without the row's label."""
    buffered = any(row.batch is not None for row in result.rows)

    def line(cell: Cell) -> Texts:
        std = () if not buffered else ("",) if cell.std is None else (f"{cell.std:.1e}",)
        return (cell.index, three_digits(cell.ours), *std, three_digits(cell.published), cell.verdict)

    headings = (result.table.heading, "index", "ours", *(("std",) if buffered else ()), "published", "match")
    return headings, [(row, [line(cell) for cell in row.cells]) for row in result.rows]


def for_terminal(outcome: Outcome) -> Iterator[tuple[str, RichTable, Sequence[str], Sequence[str]]]:
    """Yield title, table, notes and conclusions of each table; the last of the article has its conclusions."""
    results = list(outcome.tables.values())
    for result in results:
        yield result.table.title, _rich(result), notes(result), summary(results) if result is results[-1] else ()
    if outcome.actuator is not None:
        told = actuator_summary(outcome.actuator)
        yield ACTUATOR_TITLE, _rich_of_actuator(outcome.actuator), (*LEGEND, *NOTES), told


def _rich(result: TableResult) -> RichTable:
    """Return a table with a section for each row; each figure is a line in it."""
    from rich.text import Text

    headings, texts = _as_text(result)
    rows = []
    for row, lines in texts:
        *figures, _ = ("\n".join(column) for column in zip(*lines, strict=True))
        match = Text("\n").join(Text(cell.verdict, "green" if cell.agrees else "yellow") for cell in row.cells)
        rows.append((row.row.label, *figures, match))
    return _sections(headings, rows, left=("index", "match"), wrap=result.table.heading)


def _rich_of_actuator(actuator: Actuator) -> RichTable:
    """Return a table, 80 columns wide, with a section for each run; each kind of filter is a line in it."""
    from rich.text import Text

    rows = []
    for (method, variant), group in groupby(actuator.rows, lambda row: (row.method, row.variant)):
        columns = zip(*((row.filters, *_fields(row)) for row in group), strict=True)
        style = "bold" if method == DEFAULT else ""
        name = f"{method}\n{variant}" if variant else method
        rows.append((Text(name, style), *(Text("\n".join(column), style) for column in columns)))
    return _sections(("method", "filter", *_headings(actuator)), rows, left=("method", "filter"), padding=0)


def _sections(
    headings: Sequence[str], rows: Iterable[Sequence[Any]], *, left: Collection[str], wrap: str = "", padding: int = 1
) -> RichTable:
    """Return a table with a line between rows; the column ``wrap`` may be broken on a narrow terminal."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, show_lines=True, pad_edge=False, padding=(0, padding))
    for heading in headings:
        is_left = heading in left or heading == wrap
        table.add_column(heading, justify="left" if is_left else "right", no_wrap=heading != wrap)
    for row in rows:
        table.add_row(*row)
    return table


def summary_table(actuator: Actuator) -> tuple[Texts, list[Texts]]:
    """Return headings and rows of the table, as text."""
    return ("method", *_headings(actuator)), [(row.label, *_fields(row)) for row in actuator.rows]


def measure_tables(actuator: Actuator) -> Iterator[tuple[str, Texts, list[Texts]]]:
    """Return title, headings and rows of a table for each measure, by coefficient."""
    names = tuple(actuator.record.true)
    online = [row for row in actuator.rows if row.totals]
    for title, name, write in (
        ("Index J of each coefficient", "J", _scientific),
        ("Time [s] from which on it stays within 10 %", "settled", _short),
        ("Roughness [%] of each coefficient", "roughness", _short),
    ):
        rows: list[Texts] = [(row.label, *map(write, row.measures[name].values())) for row in online]
        yield title, ("method", *names), rows


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
    totals, errors = row.totals, map(_short, row.errors.values())
    if not totals:
        return ("", *errors, "", "", _short(row.free_run))
    told = _short(totals["settled"]), _short(totals["roughness"])
    return (_scientific(totals["J_sum"]), *errors, *told, _short(row.free_run))


def _figures(row: Row) -> dict[str, float | None]:
    figures = {f"{name}_{of}": value for name, each in row.measures.items() for of, value in each.items()}
    return figures | row.totals | {"free_run": row.free_run}


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


def markdown_table(headings: Sequence[str], rows: Iterable[Iterable[str]], left: Collection[str] = ()) -> str:
    """Return a table in Markdown with right-aligned columns, except the first one and those in ``left``."""
    below = ["---" if heading in left else "--:" for heading in headings[1:]]
    return "\n".join("| " + " | ".join(row) + " |" for row in (headings, ["---", *below], *rows))


def notes(result: TableResult) -> list[str]:
    """Return the notes to a table."""
    lines = list(result.table.notes)
    seeds = max(row.seeds for row in result.rows)
    if seeds > 1:
        lines.append(f"With buffer: mean and standard deviation (std) over {seeds} seeds; the article prints one run.")
    if result.improvement is not None and result.table.improvement is not None:
        printed, ours = result.improvement
        lines.append(
            f"The article's text gives the improvement of J_sum as {result.table.improvement.published} %. "
            f"By its own table the improvement is {printed:.1f} %, by ours {ours:.1f} %."
        )
    return lines


def summary(results: Sequence[TableResult]) -> list[str]:
    """Return the numbers of figures that agree, for rows without buffer, then for rows with buffer by batch size."""
    rows = [row for result in results for row in result.rows]
    lines = []
    for batch in sorted({row.batch for row in rows}, key=lambda batch: batch or 0):
        chosen = [row for row in rows if row.batch == batch]
        if batch is None:
            lines.append(f"Without buffer: {_count(chosen)} equal in all printed digits.")
        else:
            said = " as the article prints it" if any("as printed" in row.row.label for row in chosen) else ""
            lines.append(f"With buffer, batch {batch}{said}: {_count(chosen)} within {LIMIT:g} standard deviations.")
    return lines


def _count(rows: Sequence[RowResult]) -> str:
    parameters = [cell.agrees for row in rows for cell in row.cells if cell.index != "J_sum"]
    sums = [row["J_sum"].agrees for row in rows]
    return f"{sum(parameters)} of {len(parameters)} figures and {sum(sums)} of {len(sums)} sums"


def _cell_as_json(cell: Cell, seeds: int) -> dict[str, Any]:
    chance = {} if cell.std is None else {"std": cell.std, "seeds": seeds}
    return {"ours": cell.ours, **chance, "published": cell.published, "agrees": cell.agrees}


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
    """Return a matplotlib figure as an ``svg`` element with selectable text, in its original colours."""
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
    shown = (_cells(row, bold=row[0].startswith(DEFAULT)) for row in rows)
    first = table(names, shown, ACTUATOR_TITLE, "table wide")
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


def _cells(row: Sequence[str], *, bold: bool = False) -> list[str]:
    """Return a row with its figures typeset."""
    return [Html(f"<b>{typeset(cell)}</b>" if bold else typeset(cell)) for cell in row]


def typeset(text: str) -> str:
    r"""Return plain text as HTML with typeset symbols, exponents, signs and units."""
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
