"""The section of a report on other logs: the model's validation on each, beside the log that it was made from."""

from __future__ import annotations

import html
from collections.abc import Sequence

from replant.assessment.verdict import percent as share
from replant.identified.validation import Validation
from replant.plotting.diagrams import blank_figure, draw_validation
from replant.report.figures import style
from replant.report.html import svg, tables
from replant.report.number_format import number, percent

HEADINGS = ("log", "simulated", "one step", "offset", "residual beyond its limit", "error by frequency", "verdict")


def section(validations: Sequence[tuple[str, Validation]]) -> str:
    """Return the section; empty without another log."""
    if not validations:
        return ""
    found = tables.table(HEADINGS, [_row(*each) for each in validations], "Validation on other logs", "table wide")
    figures = "".join(_figure(f"other{number}", *each) for number, each in enumerate(validations))
    return f"<section><h2>On other logs</h2>{found}{figures}</section>"


def _row(name: str, found: Validation) -> tuple[str, ...]:
    auto, cross = found.outside
    worst = None if found.by_frequency is None else found.by_frequency.worst
    return (
        name,
        percent(found.fit),
        percent(found.one_step),
        number(found.offset, 4),
        f"{100 * auto:.0f} % with itself, {100 * cross:.0f} % with the input",
        "–" if worst is None else f"up to {share(worst)}" if worst else "none beyond chance",
        found.verdict.status,
    )


def _figure(element: str, name: str, found: Validation) -> str:
    figure = blank_figure(svg.WHOLE, 4.6)
    grid = figure.add_gridspec(2, 3)
    axes = [figure.add_subplot(grid[0, :]), *(figure.add_subplot(grid[1, column]) for column in range(3))]
    for axis in draw_validation(found, axes):
        style.tidy(axis)  # with the colours of the page
        axis.title.set_color(style.INK)
        for text in axis.get_legend().get_texts() if axis.get_legend() else ():
            text.set_color(style.INK)
    said = (
        f"{name}: measured output and the model's, {found.how}, with offset and initial state estimated. "
        + " ".join(f"{reason[0].upper()}{reason[1:]}." for reason in found.verdict.reasons)
    )
    picture = svg.described(svg.svg(figure, element), said)
    return f'<figure><div class="still">{picture}</div><figcaption>{html.escape(said)}</figcaption></figure>'
