"""The report of a comparison: a table of the methods; their outputs, responses and estimates in common axes."""

from __future__ import annotations

import html
import re
from collections.abc import Sequence
from pathlib import Path

from replant.data.logs import Log
from replant.regressor.preprocess import Preprocess
from replant.report.figures import style
from replant.report.findings import (
    BAD,
    GOOD,
    Finding,
    findings,
)
from replant.report.html import python_program, tables
from replant.report.html.comparison_figures import estimates, outputs, responses, swatches_of
from replant.report.html.page import (
    NO_BREAK,
    Html,
    code,
    facts,
    icon,
    section,
    write_page,
)
from replant.report.number_format import percent
from replant.report.terminal.comparison import OUTCOME, cells_of, gravity_of
from replant.runs.run_log import Contender, best


def write_comparison(
    path: Path, contenders: Sequence[Contender], log: Log, preprocess: Preprocess, command: str = ""
) -> Path:
    """Write the comparison into one self-contained HTML file, and return its path."""
    plant_label = style.mapped_label(log.input_name, preprocess.input_map)
    structure = next(entry.result.structure for entry in contenders if entry.result is not None)
    labels = style.symbols(structure, plant_label, log.output_name)
    body = [
        section("", f'<p class="claim">{html.escape(claim(contenders))}</p>',
                _html_table(contenders, labels, len(log)), _remarks(contenders, len(log))),
        section("Outputs", outputs(contenders, log)),
        section("Frequency responses", responses(contenders, log, plant_label)),
        section("Estimates over time", estimates(contenders, log, plant_label)),
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
    said += f" Within half a percentage point: {', '.join(level)}." if level else ""
    return said + _of_trust(contenders, first)


def _of_trust(contenders: Sequence[Contender], first: Contender) -> str:
    """Return what the verdicts add where the best fit is not that of a trusted model."""
    trusted = [entry for entry in contenders if entry.result is not None and entry.result.verdict.status == "trusted"]
    if first in trusted:
        return ""
    if not trusted:
        return " No model is trusted."
    fits = {entry.name: entry.result.simulation.fit for entry in trusted if entry.result is not None}
    name = max(fits, key=lambda each: fits[each])
    return f" It is not trusted; of the models that are, that of {name} is best: {percent(fits[name])}.".replace(
        " %", NO_BREAK + "%"
    )


def _within(entry: Contender, top: float, points: float = 0.5) -> bool:
    return entry.result is not None and entry.result.simulation.fit > top - points


def _html_table(contenders: Sequence[Contender], labels: Sequence[str], samples: int) -> str:
    swatches = swatches_of(contenders)
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
        f"{_shortened(' '.join((each.text, *each.more)))}</div></li>"
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


def _programs(contenders: Sequence[Contender], log: Log) -> str:
    """Return the Python programs that reproduce each method's result."""
    parts = []
    for entry in contenders:
        if entry.result is None:
            continue
        if entry.fitted is not None:
            program = python_program.fit_as_python(entry.fitted, [log])
        elif entry.result.settings is not None:
            program = python_program.run_as_python(entry.result, log)
        else:
            continue
        summary = f"<summary>{html.escape(entry.name)} alone, in Python</summary>"
        parts.append(f"<details>{summary}{code('python', program)}</details>")
    return "".join(parts)
