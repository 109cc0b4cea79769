"""The page of a comparison of methods over one log, with its figures."""

from __future__ import annotations

import html
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from replant.logs.log import Log
from replant.model.preprocess import Preprocess
from replant.online.runs.result import Result
from replant.online.runs.run_log import Contender, best
from replant.plotting import style
from replant.plotting.numbers import mapped_label, number, percent, symbols
from replant.plotting.style import blank_figure
from replant.report import material as tables
from replant.report import programs
from replant.report.figures import draw_outputs, draw_overlay, draw_responses
from replant.report.findings import BAD, GOOD, Finding, findings
from replant.report.page import NO_BREAK, Html, code, facts, icon, section, table, write_page
from replant.report.page_figures import HALF, look, svg, variable
from replant.report.terminal_tables import OUTCOME, cells_of, gravity_of


def results_of(contenders: Sequence[Contender]) -> dict[str, Result]:
    """Return the results of the methods that found a model, by their names."""
    return {entry.name: entry.result for entry in contenders if entry.result is not None}


def swatches_of(contenders: Sequence[Contender]) -> dict[str, str]:
    """Return, by method, a sample of its line in the figures."""
    return {name: _swatch(*line) for name, line in zip(results_of(contenders), style.LINES, strict=False)}


def _swatch(colour: str, dashes: Any, width: float = 2.4) -> str:
    pattern = "" if dashes == "solid" else f' stroke-dasharray="{" ".join(f"{1.4 * x:g}" for x in dashes[1])}"'
    return (
        f'<svg class="swatch" viewBox="0 0 42 8" aria-hidden="true"><path d="M0 4h42" fill="none" '
        f'stroke="var(--{variable(colour)})" stroke-width="{width:g}"{pattern}/></svg>'
    )


def estimates(contenders: Sequence[Contender], log: Log, plant_label: str) -> str:
    """Return the estimates over time, a picture for each coefficient, below one legend."""
    results, first = results_of(contenders), best(contenders)
    reference = first.name if first else next(iter(results))
    names = results[reference].structure.names
    with look():
        axes = [blank_figure(HALF, 2.5).subplots() for _ in names]
        labels = {"input_label": plant_label, "output_label": log.output_name}
        draw_overlay(results, log.dt, reference=reference, axes=axes, **labels)
        drawn = _panels(axes, names, [_ends(results, i) for i in range(len(names))])
    return figure(contenders, drawn, _caption(contenders))


def outputs(contenders: Sequence[Contender], log: Log) -> str:
    """Return the simulated outputs of all methods over the measured one."""
    results = results_of(contenders)
    said = "Measured output, and that of each model, simulated from the input alone"
    with look():
        axes = [blank_figure(HALF, 2.9).subplots() for _ in range(2)]
        draw_outputs(results, log.output, log.dt, axes=axes, output_label=log.output_name)
        fits = ", ".join(f"{name} {percent(result.simulation.fit)}" for name, result in results.items())
        words = f"{said}; fit: {fits}", "The same over the last tenth of the record"
        drawn = _panels(axes, ("outputs0", "outputs1"), words)
    caption = (
        f"{said}; on the right or below, over the last tenth of the record. Outputs that leave the range of the "
        "measured one by more than its size are cut off."
    )
    return figure(contenders, drawn, caption, f"<li>{_swatch(style.MEASURED, 'solid', 3.6)}measured</li>")


def responses(contenders: Sequence[Contender], log: Log, plant_label: str) -> str:
    """Return the Bode diagrams of all methods in common axes."""
    results, first = results_of(contenders), best(contenders)
    said = "Bode diagram of each model"
    with look():
        axes = [blank_figure(HALF, 2.9).subplots() for _ in range(2)]
        labels = {"input_label": plant_label, "output_label": log.output_name}
        draw_responses(results, log.dt, reference=first.name if first else None, axes=axes, **labels)
        words = f"{said}: magnitude in dB", f"{said}: phase in degrees"
        drawn = _panels(axes, ("responses0", "responses1"), words)
    return figure(
        contenders, drawn, f"{said}. Bands are two standard deviations wide to either side, where they are known."
    )


def _panels(axes: Sequence[Any], names: Sequence[str], words: Sequence[str]) -> str:
    """Return pictures that stand side by side, on a narrow page below each other."""
    return "".join(svg(axis.figure, name, said) for axis, name, said in zip(axes, names, words, strict=True))


def figure(contenders: Sequence[Contender], drawn: str, caption: str, first: str = "") -> str:
    """Return pictures with a legend of the methods above and a caption below them."""
    entries = "".join(f"<li>{mark}{html.escape(name)}</li>" for name, mark in swatches_of(contenders).items())
    return (
        f'<figure><ul class="lines">{first}{entries}</ul><div class="panels">{drawn}</div>'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )


def _ends(results: Mapping[str, Result], i: int) -> str:
    """Return the text alternative of a panel."""
    name = next(iter(results.values())).structure.names[i]
    ends = ", ".join(f"{method} {number(float(result.parameters[i]))}" for method, result in results.items())
    return f"{name} over time by method; at the end: {ends}"


def save_figures(folder: Path, contenders: Sequence[Contender], log: Log, preprocess: Preprocess) -> list[Path]:
    """Draw outputs, Bode diagrams and estimates over time of all methods into PNG files, and return their paths."""
    results, first = results_of(contenders), best(contenders)
    plant_label = mapped_label(log.input_name, preprocess.input_map)
    labels = {"input_label": plant_label, "output_label": log.output_name}
    chosen = first.name if first else None
    drawn = {
        "outputs": draw_outputs(results, log.output, log.dt, output_label=log.output_name)[0],
        "bode": draw_responses(results, log.dt, reference=chosen, **labels)[0],
        "parameters": draw_overlay(results, log.dt, reference=chosen, **labels)[0],
    }
    folder.mkdir(parents=True, exist_ok=True)
    return [_saved(folder / f"{name}.png", axis) for name, axis in drawn.items()]


def _saved(path: Path, axis: Any) -> Path:
    """Write the figure of an axis with a legend of its curves, if there are any, above it."""
    handles, names = axis.get_legend_handles_labels()
    if names:
        axis.figure.legend(
            handles, names, loc="outside upper left", ncols=-(-len(names) // -(-len(names) // 6)), frameon=False,
            labelcolor=style.INK, handlelength=3.4,
        )  # fmt: skip
    axis.figure.savefig(path, dpi=130)
    return path


def _caption(contenders: Sequence[Contender]) -> str:
    whole = [entry.name for entry in contenders if entry.result is not None and entry.result.history is None]
    said = "Each coefficient's estimate over time, by method"
    if whole:
        said += f"; a horizontal line: {' and '.join(whole)}, fitted to the whole record at once"
    late = [name for name, result in results_of(contenders).items() if _is_late(result)]
    if late:
        said += f"; a dot: {' and '.join(late)}, with an estimate only at the end"
    return f"{said}. Bands are two standard deviations wide to either side; curves far from the best model are cut off."


def _is_late(result: Result) -> bool:
    """Return whether an online run had its first estimate at the end of the record."""
    return result.history is not None and not result.history.parameters.any()


def write_comparison(
    path: Path, contenders: Sequence[Contender], log: Log, preprocess: Preprocess, command: str = ""
) -> Path:
    """Write the comparison into one self-contained HTML file, and return its path."""
    plant_label = mapped_label(log.input_name, preprocess.input_map)
    structure = next(entry.result.structure for entry in contenders if entry.result is not None)
    labels = symbols(structure, plant_label, log.output_name)
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
        table(headings, rows, "Methods compared", "table wide methods")
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
    """Return the first two sentences, and the others folded away."""
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
            program = programs.fit_as_python(entry.fitted, [log])
        elif entry.result.settings is not None:
            program = programs.run_as_python(entry.result, log)
        else:
            continue
        summary = f"<summary>{html.escape(entry.name)} alone, in Python</summary>"
        parts.append(f"<details>{summary}{code('python', program)}</details>")
    return "".join(parts)
