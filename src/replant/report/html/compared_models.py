"""The page of a comparison of models: a table, then outputs, responses and poles in common axes."""

from __future__ import annotations

import html
from pathlib import Path

from replant.plotting.diagrams import blank_figure
from replant.report.figures import style
from replant.report.figures.models import draw_poles_of, draw_steps
from replant.report.html import tables
from replant.report.html.comparison_figures import outputs, responses, swatches_of
from replant.report.html.model_comparison import HEADINGS, ModelComparison
from replant.report.html.page import Html, code, facts, section, write_page
from replant.report.html.svg import HALF, described, look, svg
from replant.report.number_format import percent


def write_models(path: Path, comparison: ModelComparison, command: str = "") -> Path:
    """Write a comparison of models into one self-contained HTML file, and return its path."""
    log, contenders = comparison.log, comparison.contenders
    body = [
        section("", f'<p class="claim">{html.escape(claim(comparison))}</p>', _table(comparison), _reasons(comparison)),
        section("Outputs", outputs(contenders, log)),
        section("Step responses and poles", _steps_and_poles(comparison)),
        section("Frequency responses", responses(contenders, log, style.mapped_label(log.input_name, "identity"))),
        section("How to reproduce this", code("shell", command) if command else "", facts(tables.of_record(log))),
    ]
    lede = f"{log.input_name} → {log.output_name}, {len(comparison.models)} models over {len(log):,} samples"
    title = log.path.name or "Models compared"
    return write_page(path, title=title, eyebrow="Models compared", lede=lede, body="".join(body))


def claim(comparison: ModelComparison) -> str:
    """Return which model follows the record best, and whether it is trusted, as a sentence."""
    name = comparison.best
    found = comparison.validations[name]
    return f"{name} follows the record best: {percent(found.fit)}, {found.verdict.status}."


def _table(comparison: ModelComparison) -> str:
    swatches = swatches_of(comparison.contenders)
    rows = [[Html(swatches[name] + html.escape(name)), *rest] for name, *rest in comparison.rows]
    return tables.table(HEADINGS, rows, "Models compared", "table wide methods")


def _reasons(comparison: ModelComparison) -> str:
    """Return the first reason of each verdict."""
    said = [
        f"<li><div><b>{html.escape(name)}:</b> {html.escape(found.verdict.reasons[0])}</div></li>"
        for name, found in comparison.validations.items()
        if found.verdict.status != "trusted" and found.verdict.reasons
    ]
    return f'<ul class="remarks">{"".join(said)}</ul>' if said else ""


def _steps_and_poles(comparison: ModelComparison) -> str:
    words = "Response to a unit step of each model", "Poles of each model in the complex plane"
    with look():
        axes = [blank_figure(HALF, 3.2).subplots() for _ in words]
        draw_steps(comparison.models, axes[0])
        draw_poles_of(comparison.models, axes[1])
        pictures = [svg(axis.figure, f"models{i}") for i, axis in enumerate(axes)]
    drawn = "".join(described(picture, said) for picture, said in zip(pictures, words, strict=True))
    legend = "".join(f"<li>{mark}{html.escape(name)}</li>" for name, mark in swatches_of(comparison.contenders).items())
    caption = "Bands are two standard deviations wide to either side; regions of poles hold 95 %."
    panels = f'<ul class="lines">{legend}</ul><div class="panels">{drawn}</div>'
    return f"<figure>{panels}<figcaption>{caption}</figcaption></figure>"
