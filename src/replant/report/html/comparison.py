"""The report of a comparison: a table of the methods, and their estimates over time in common axes."""

from __future__ import annotations

import html
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from replant.data.logs import Log
from replant.plotting.palette import blank_figure
from replant.regressor.preprocess import Preprocess
from replant.report.figures import draw_overlay, style
from replant.report.figures.overlay import legend_columns
from replant.report.findings import (
    BAD,
    GOOD,
    Finding,
    findings,
)
from replant.report.html import python_program, tables
from replant.report.html.page import (
    NO_BREAK,
    Html,
    code,
    facts,
    icon,
    section,
    write_page,
)
from replant.report.html.svg import (
    HALF,
    look,
    svg,
    variable,
)
from replant.report.number_format import number, percent
from replant.report.terminal.comparison import OUTCOME, cells_of, gravity_of
from replant.runs.comparison import Contender, best
from replant.runs.result import Result


def write_comparison(
    path: Path, contenders: Sequence[Contender], log: Log, preprocess: Preprocess, command: str = ""
) -> Path:
    """Write the comparison into one self-contained HTML file, and return its path.

    Parameters
    ----------
    path : Path
        The file to write; its folder is created if missing.
    contenders : sequence of Contender
        At least one with a result.
    log : Log
    preprocess : Preprocess
        Its input map determines the units.
    command : str
        The command line that reproduces the comparison.

    Raises
    ------
    MissingDependencyError
        If matplotlib is not installed.
    """
    plant_label = style.mapped_label(log.input_name, preprocess.input_map)
    structure = next(entry.result.structure for entry in contenders if entry.result is not None)
    labels = style.symbols(structure, plant_label, log.output_name)
    body = [
        section("", f'<p class="claim">{html.escape(claim(contenders))}</p>',
                _html_table(contenders, labels, len(log)), _remarks(contenders, len(log))),
        section("Estimates over time", _figures(contenders, log, plant_label)),
        section("How to reproduce this", code("shell", command) if command else "", _programs(contenders, log)),
        section("Record and versions", facts([*tables.of_record(log), ("versions", tables.versions())])),
    ]  # fmt: skip
    lede = (
        f"{log.input_name} → {log.output_name}, {len(contenders)} methods on the same {len(log):,} samples, "
        f"{tables.lasts(log)}"
    )
    title = log.path.name or "Simulated record"
    return write_page(path, title=title, eyebrow="Methods compared", lede=lede, body="".join(body))


def claim(contenders: Sequence[Contender]) -> str:
    """Return which method has the best simulated fit, as a sentence."""
    first = best(contenders)
    if first is None or first.result is None:
        return "No method found a model that can be simulated."
    top = first.result.simulation.fit
    said = f"Simulated from the input alone, the model of {first.name} has the best fit: {percent(top)}.".replace(
        " %", "\u00a0%"
    )
    level = [entry.name for entry in contenders if entry is not first and _within(entry, top)]
    return said + (f" Within half a percentage point: {', '.join(level)}." if level else "")


def _within(entry: Contender, top: float, points: float = 0.5) -> bool:
    return entry.result is not None and entry.result.simulation.fit > top - points


def _html_table(contenders: Sequence[Contender], labels: Sequence[str], samples: int) -> str:
    swatches = _swatches(contenders)
    rows = []
    for entry in contenders:
        status, *cells = cells_of(entry, len(labels))
        name = Html(swatches.get(entry.name, '<svg class="swatch" aria-hidden="true"></svg>') + html.escape(entry.name))
        sign = icon(gravity_of(entry, samples))
        verdict = Html(f'<span class="status">{sign}{html.escape(status)}</span>')
        outcome = [cell.replace(" ", NO_BREAK) for cell in cells[: len(OUTCOME) - 1]]
        rows.append([name, verdict, *outcome, *map(_two_lines, cells[len(outcome) :])])
    headings = ("method", "verdict", "simulated fit", "one-step fit", "time", *labels)
    return (
        tables.table(headings, rows, "Methods compared", "table wide methods")
        + '<p class="note">Estimate ± standard deviation, if the method gives one.</p>'
    )


def _two_lines(text: str) -> Html:
    """Return a number with its standard deviation below."""
    value, sign, std = html.escape(text).partition(" ± ")
    return Html(f"{value}<small>± {std}</small>" if sign and not value.startswith(("(", "−(")) else html.escape(text))


def _remarks(contenders: Sequence[Contender], samples: int) -> str:
    """Return the findings against each model, the gravest first."""
    remarks = []
    for entry in contenders:
        found = [Finding(BAD, "No model", f"{entry.problem[:1].upper()}{entry.problem[1:]}.")]
        if entry.result is not None:
            found = [each for each in findings(entry.result, samples) if each.gravity != GOOD]
        remarks += [(each.gravity != BAD, entry.name, each) for each in found]
    items = "".join(
        f"<li>{icon(each.gravity)}<div><b>{html.escape(name)}: {html.escape(each.headline.lower())}.</b> "
        f"{_shortened(each.text)}</div></li>"
        for _, name, each in sorted(remarks, key=lambda entry: entry[0])
    )
    return f'<ul class="remarks">{items}</ul>' if items else ""


def _shortened(text: str) -> str:
    """Return the first two sentences, and the others folded away.

    Examples
    --------
    >>> _shortened("It fails. It does. Why? See.")
    'It fails. It does. <details><summary>More</summary>Why? See.</details>'
    """
    sentences = re.split(r"(?<=[.?!]) (?=[A-Z0-9])", html.escape(text.replace(" %", NO_BREAK + "%")))
    first, rest = " ".join(sentences[:2]), " ".join(sentences[2:])
    return f"{first} <details><summary>More</summary>{rest}</details>" if rest else first


def _results(contenders: Sequence[Contender]) -> dict[str, Result]:
    return {entry.name: entry.result for entry in contenders if entry.result is not None}


def _swatches(contenders: Sequence[Contender]) -> dict[str, str]:
    """Return, by method, a sample of its line in the figures."""
    swatches = {}
    for name, (colour, dashes) in zip(_results(contenders), style.LINES, strict=False):
        pattern = "" if dashes == "solid" else f' stroke-dasharray="{" ".join(f"{1.4 * x:g}" for x in dashes[1])}"'
        swatches[name] = (
            f'<svg class="swatch" viewBox="0 0 42 8" aria-hidden="true"><path d="M0 4h42" fill="none" '
            f'stroke="var(--{variable(colour)})" stroke-width="2.4"{pattern}/></svg>'
        )
    return swatches


def _figures(contenders: Sequence[Contender], log: Log, plant_label: str) -> str:
    """Return the estimates over time, a picture for each coefficient, below one legend."""
    results, first = _results(contenders), best(contenders)
    reference = first.name if first else next(iter(results))
    structure = results[reference].structure
    with look():
        axes = [blank_figure(HALF, 2.5).subplots() for _ in structure.names]
        labels = {"input_label": plant_label, "output_label": log.output_name}
        draw_overlay(results, log.dt, reference=reference, axes=axes, **labels)
        drawn = [
            svg(axis.figure, name).replace("<svg", f'<svg role="img" aria-label="{_ends(results, i)}"', 1)
            for i, (name, axis) in enumerate(zip(structure.names, axes, strict=True))
        ]
    legend = "".join(f"<li>{mark}{html.escape(name)}</li>" for name, mark in _swatches(contenders).items())
    return (
        f'<figure><ul class="lines">{legend}</ul><div class="panels">{"".join(drawn)}</div>'
        f"<figcaption>{html.escape(_caption(contenders))}</figcaption></figure>"
    )


def _ends(results: Mapping[str, Result], i: int) -> str:
    """Return the text alternative of a panel."""
    name = next(iter(results.values())).structure.names[i]
    ends = ", ".join(f"{method} {number(float(result.parameters[i]))}" for method, result in results.items())
    return html.escape(f"{name} over time by method; at the end: {ends}")


def save_overlay(path: Path, contenders: Sequence[Contender], log: Log, preprocess: Preprocess) -> Path:
    """Draw the estimates of all methods over time into a PNG file, and return its path.

    Parameters
    ----------
    path : Path
        The file to write; its folder is created if missing.
    contenders : sequence of Contender
        At least one with a result.
    log : Log
    preprocess : Preprocess
        Its input map determines the units.

    Raises
    ------
    MissingDependencyError
        If matplotlib is not installed.
    """
    results, first = _results(contenders), best(contenders)
    plant_label = style.mapped_label(log.input_name, preprocess.input_map)
    labels = {"input_label": plant_label, "output_label": log.output_name}
    axes = draw_overlay(results, log.dt, reference=first.name if first else None, **labels)
    canvas, columns = axes[0].figure, legend_columns(len(results), 5)
    canvas.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=columns, frameon=False,
        labelcolor=style.INK, handlelength=3.4,
    )  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    canvas.savefig(path, dpi=130)
    return path


def _caption(contenders: Sequence[Contender]) -> str:
    whole = [entry.name for entry in contenders if entry.result is not None and entry.result.history is None]
    said = "Each coefficient's estimate over time, by method"
    if whole:
        said += f"; a horizontal line: {' and '.join(whole)}, fitted to the whole record at once"
    late = [name for name, result in _results(contenders).items() if _is_late(result)]
    if late:
        said += f"; a dot: {' and '.join(late)}, with an estimate only at the end"
    return f"{said}. Bands are two standard deviations wide to either side; curves far from the best model are cut off."


def _is_late(result: Result) -> bool:
    """Return whether an online run had its first estimate at the end of the record."""
    return result.history is not None and not result.history.parameters.any()


def _programs(contenders: Sequence[Contender], log: Log) -> str:
    """Return the Python programs that reproduce each method's result."""
    parts = []
    for entry in contenders:
        if entry.result is None:
            continue
        if entry.fitted is not None:
            program = python_program.fit_as_python(entry.fitted, log)
        elif entry.result.settings is not None:
            program = python_program.run_as_python(entry.result, log)
        else:
            continue
        summary = f"<summary>{html.escape(entry.name)} alone, in Python</summary>"
        parts.append(f"<details>{summary}{code('python', program)}</details>")
    return "".join(parts)
