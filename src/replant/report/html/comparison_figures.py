"""The figures of a comparison: outputs, Bode diagrams and estimates over time of all methods, in common axes."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from replant.data.logs import Log
from replant.plotting.diagrams import blank_figure
from replant.regressor.preprocess import Preprocess
from replant.report.figures import draw_outputs, draw_overlay, draw_responses, style
from replant.report.figures.overlay import legend_columns
from replant.report.html.svg import HALF, described, look, svg, variable
from replant.report.number_format import number, percent
from replant.runs.result import Result
from replant.runs.run_log import Contender, best


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
    structure = results[reference].structure
    with look():
        axes = [blank_figure(HALF, 2.5).subplots() for _ in structure.names]
        labels = {"input_label": plant_label, "output_label": log.output_name}
        draw_overlay(results, log.dt, reference=reference, axes=axes, **labels)
        drawn = [
            svg(axis.figure, name).replace("<svg", f'<svg role="img" aria-label="{_ends(results, i)}"', 1)
            for i, (name, axis) in enumerate(zip(structure.names, axes, strict=True))
        ]
    return _figure(_legend(contenders), f'<div class="panels">{"".join(drawn)}</div>', _caption(contenders))


def outputs(contenders: Sequence[Contender], log: Log) -> str:
    """Return the simulated outputs of all methods over the measured one."""
    results = results_of(contenders)
    said = "Measured output, and that of each model, simulated from the input alone"
    with look():
        axes = _panels()
        draw_outputs(results, log.output, log.dt, axes=axes, output_label=log.output_name)
        fits = ", ".join(f"{name} {percent(result.simulation.fit)}" for name, result in results.items())
        drawn = _drawn(axes, "outputs", f"{said}; fit: {fits}", "The same over the last tenth of the record")
    caption = (
        f"{said}; on the right or below, over the last tenth of the record. Outputs that leave the range of the "
        "measured one by more than its size are cut off."
    )
    measured = _swatch(style.MEASURED, "solid", 3.6)
    return _figure(f"<li>{measured}measured</li>{_legend(contenders)}", drawn, caption)


def responses(contenders: Sequence[Contender], log: Log, plant_label: str) -> str:
    """Return the Bode diagrams of all methods in common axes."""
    results, first = results_of(contenders), best(contenders)
    said = "Bode diagram of each model"
    with look():
        axes = _panels()
        labels = {"input_label": plant_label, "output_label": log.output_name}
        draw_responses(results, log.dt, reference=first.name if first else None, axes=axes, **labels)
        drawn = _drawn(axes, "responses", f"{said}: magnitude in dB", f"{said}: phase in degrees")
    caption = f"{said}. Bands are two standard deviations wide to either side, where they are known."
    return _figure(_legend(contenders), drawn, caption)


def _panels() -> list[Any]:
    """Return the axes of two pictures that stand side by side, on a narrow page below each other."""
    return [blank_figure(HALF, 2.9).subplots() for _ in range(2)]


def _drawn(axes: Sequence[Any], name: str, *words: str) -> str:
    pictures = (
        described(svg(axis.figure, f"{name}{i}"), said) for i, (axis, said) in enumerate(zip(axes, words, strict=True))
    )
    return f'<div class="panels">{"".join(pictures)}</div>'


def _figure(legend: str, drawn: str, caption: str) -> str:
    return f'<figure><ul class="lines">{legend}</ul>{drawn}<figcaption>{html.escape(caption)}</figcaption></figure>'


def _legend(contenders: Sequence[Contender]) -> str:
    return "".join(f"<li>{mark}{html.escape(name)}</li>" for name, mark in swatches_of(contenders).items())


def _ends(results: Mapping[str, Result], i: int) -> str:
    """Return the text alternative of a panel."""
    name = next(iter(results.values())).structure.names[i]
    ends = ", ".join(f"{method} {number(float(result.parameters[i]))}" for method, result in results.items())
    return html.escape(f"{name} over time by method; at the end: {ends}")


def save_figures(folder: Path, contenders: Sequence[Contender], log: Log, preprocess: Preprocess) -> list[Path]:
    """Draw outputs, Bode diagrams and estimates over time of all methods into PNG files, and return their paths."""
    results, first = results_of(contenders), best(contenders)
    plant_label = style.mapped_label(log.input_name, preprocess.input_map)
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
            handles, names, loc="outside upper left", ncols=legend_columns(len(names), 6), frameon=False,
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
