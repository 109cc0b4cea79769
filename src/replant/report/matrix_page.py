"""The report of several inputs and outputs: the matrix of transfer functions as one self-contained page."""

from __future__ import annotations

import html
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from replant.fitting.miso_fit import RowFit
from replant.fitting.model import Model
from replant.fitting.validation import Validation
from replant.logs.log import Log
from replant.model.preprocess import rejected_in_words
from replant.numerics.arguments import FloatArray
from replant.numerics.residuals import Correlations
from replant.numerics.robust import joined, stretches_of
from replant.online.runs.result import MOST_SHADES, Clock
from replant.plotting import diagrams, style
from replant.plotting.numbers import gain_unit, mathml, percent, uncertain, with_unit
from replant.plotting.over_time import POINTS, Panel, draw_panels, thin
from replant.plotting.style import blank_figure
from replant.report import contents as tables
from replant.report import page_frame as page
from replant.report.findings import findings
from replant.report.panels import draw_poles_of, input_panel, model_panels, part_panel, whole_record
from replant.report.result_page import drawn, reproduction, section, verdict_of, with_plots
from replant.report.results_as_text import gain_and_times

SAME = 1e-9  # part of a dead time that is a rounding error [part]
SMALLEST = 2.6  # least width of a picture of the matrix [inches]


@dataclass(frozen=True, eq=False)
class Output:
    """One output: the fit of its row, and its record."""

    fitted: RowFit
    log: Log

    @property
    def name(self) -> str:
        """The name of the output."""
        return self.fitted.model.output_name

    @cached_property
    def pairs(self) -> dict[str, Model]:
        """The model from each input, by its name."""
        model = self.fitted.model
        return {name: model.of_input(i) for i, name in enumerate(model.input_names)}

    @cached_property
    def residual(self) -> FloatArray:
        """Measured minus simulated output (K,); NaN if left out, or if the sample depends on inputs before the log."""
        left, fitted = self.log.output - self.fitted.output, self.fitted
        left[np.concatenate([fitted.outliers, fitted.stuck])] = np.nan
        longest = max(each.delay for each in fitted.model.structures)
        left[self.clock.at(np.arange(left.size)) < longest * (1.0 - SAME)] = np.nan
        return left

    @cached_property
    def clock(self) -> Clock:
        """The times of the samples."""
        return Clock.of(self.log.dt, self.log.stamps)

    @property
    def left_out(self) -> FloatArray:
        """Begin and end of stretches left out, (L, 2) in s."""
        rows = joined(stretches_of(~np.isfinite(self.residual)), max(1, self.residual.size // MOST_SHADES))
        return self.clock.at(np.maximum(rows - np.array([1.0, 0.0]), 0.0))

    def panels(self, which: str) -> list[Panel]:
        """Return output, parts and residual over time; ``which`` distinguishes the outputs of a page."""
        whole = whole_record(self.clock, len(self.log), self.left_out)
        signals = [thin(each, POINTS) for each in (self.log.output, self.fitted.output, self.residual)]
        outputs, residual = model_panels(self.name, self.clock, signals, which, whole)
        parts = {name: thin(part, POINTS).values for name, part in zip(self.pairs, self.parts.T, strict=True)}
        t = self.clock.at(signals[0].places)
        return [outputs, part_panel(self.name, t, parts, which, whole), residual]

    @cached_property
    def parts(self) -> FloatArray:
        """The contribution of each input to the output (K, q)."""
        return self.fitted.model.contributions(self.log.inputs, self.log.stamps)

    @property
    def inputs(self) -> list[Panel]:
        """The inputs over time."""
        whole, found = whole_record(self.clock, len(self.log), np.zeros((0, 2))), []
        for i, (name, u) in enumerate(zip(self.log.input_names, self.log.inputs.T, strict=True), 1):
            hold = self.fitted.model.input_hold
            found.append(input_panel(name, self.clock, thin(u, POINTS), hold, f"input{i}", whole))
        return found

    @cached_property
    def correlations(self) -> list[Correlations | None]:
        """Correlations of the residual with itself and with each input."""
        return tables.correlated(self.residual, self.log.inputs.T, self.log, self.fitted.transfer_functions)


def write_rows(
    path: Path,
    outputs: Sequence[Output],
    *,
    title: str = "",
    command: str = "",
    python: str = "",
    validations: Sequence[tuple[str, Validation]] = (),
    candidates: str = "",
) -> Path:
    """Write the report of the rows of a model into one self-contained HTML file, and return its path."""
    several = len(outputs) > 1
    numbers = [str(i) if i > 1 else "" for i in range(1, len(outputs) + 1)]
    of_outputs = [panel for each, which in zip(outputs, numbers, strict=True) for panel in each.panels(which)]
    panels, said = {"fit": [*of_outputs, *outputs[0].inputs]}, _of_fit(outputs)
    models = [model for each in outputs for model in each.pairs.values()]
    parts = [(f"{_said(model)}: ", model, model.input_name, model.output_name) for model in models]
    with page.look(), np.errstate(all="ignore"):
        plots = page.charts_of(panels)
        fields = {
            "verdicts": "".join(
                verdict_of(findings(each.fitted, len(each.log)), None, each.name if several else "") for each in outputs
            ),
            "models": _matrix(outputs, map(_formula, models)),
            "figures": "".join(_figures(each, several=several) for each in outputs),
            "zoom": page.asset("zoom.html"),
            "fit": drawn(said, page.time_picture("fit", panels["fit"], said), plots["fit"]),
            "left": "".join(_left(each, i, several=several) for i, each in enumerate(outputs)),
            "gains": _gains(models),
            "steps": _pictures(outputs, "step", "Response of {y} to a unit step of {u}", _draw_step, 2.6)
            + page.note("Bands are two standard deviations wide to either side."),
            "bode": _pictures(outputs, "bode", "Bode diagram from {u} to {y}", _draw_bode, 4.0, 2),
            "poles": _pictures(outputs, "poles", "Poles and zeros from {u} to {y}", _draw_poles, 3.0)
            + page.note("Coloured: 95 % confidence regions. Grey: unstable poles."),
            "other_logs": section(validations),
            "candidates": candidates,
            "coefficients": page.folded("Coefficients", tables.coefficients(parts)),
            "reproduce": page.folded("How to reproduce this", reproduction(command, python)),
            "origin": page.folded("Record and versions", _origin(outputs)),
        }
    log, names = outputs[0].log, ", ".join(each.name for each in outputs)
    lede = f"{', '.join(log.input_names)} → {names}; {len(log):,} samples, {tables.lasts(log)}"
    return with_plots(path, "rows.html", fields, plots, title=title or log.path.name or "Record", lede=lede)


def save_figures(folder: Path, outputs: Sequence[Output]) -> list[Path]:
    """Draw each output over time, and the responses from each input, as PNG files; return their paths."""
    found: dict[str, Any] = {}
    for i, each in enumerate(outputs, 1):
        number_of = f"-{i}" if len(outputs) > 1 else ""
        panels = [*each.panels(""), *each.inputs]
        axes = blank_figure(9.0, 1.0 + 1.8 * len(panels)).subplots(len(panels), 1, sharex=True)
        draw_panels(axes, panels)
        for axis in axes[:2]:
            style.legend(axis)
        style.title(axes[0], f"simulated fit {each.fitted.fit:.1f} %")
        found |= {f"fit{number_of}": axes[0], f"responses{number_of}": each.fitted.model.plot()[0, 0]}
    return style.saved(folder, found)


def _matrix(outputs: Sequence[Output], cells: Iterable[str]) -> str:
    """Return a matrix of cells: one row for each output, one column for each input."""
    return f'<div class="panels" style="--columns:{len(outputs[0].pairs)}">{"".join(cells)}</div>'


def _said(model: Model) -> str:
    return f"{model.input_name} → {model.output_name}"


def _formula(model: Model) -> str:
    said, formula = _said(model), mathml(model.transfer_function)
    region = f'<div class="math" tabindex="0" role="region" aria-label="G(s), {html.escape(said)}">{formula}</div>'
    return f"<div>{page.note(said)}{region}</div>"


def _pictures(
    outputs: Sequence[Output], kind: str, words: str, draw: Callable[[Any, Model], None], height: float, rows: int = 1
) -> str:
    """Return a picture for each pair of input and output, drawn into axes below each other."""
    cells, size = [], (max(SMALLEST, 2.0 * page.HALF / max(len(outputs[0].pairs), 2)), height)
    for i, output in enumerate(outputs):
        for j, model in enumerate(output.pairs.values()):
            axes = blank_figure(*size).subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
            draw(axes, model)
            style.title(axes[0], _said(model), diagrams.ABOVE_LEGEND)
            said = words.format(u=model.input_name, y=model.output_name)
            cells.append(page.svg(axes[0].figure, f"{kind}{i}-{j}", said))
    return _matrix(outputs, cells)


def _unit(model: Model) -> str:
    return gain_unit(model.input_name, model.output_name)


def _draw_step(axes: Any, model: Model) -> None:
    model.step().plot(axes[0]).set_ylabel(with_unit("step response", _unit(model)))


def _draw_bode(axes: Any, model: Model) -> None:
    diagrams.draw_bode({"model": model.bode()}, axes, unit=_unit(model))


def _draw_poles(axes: Any, model: Model) -> None:
    draw_poles_of({model.input_name: model}, axes[0])


def _of_fit(outputs: Sequence[Output]) -> str:
    fits = ", ".join(f"{each.name} {percent(each.fitted.fit)}" for each in outputs)
    return (
        "Measured output and the model's, simulated from the inputs alone with offset and initial states estimated; "
        f"fit: {fits}. Below it the contribution of each input, from rest at its first value, as a deviation from the "
        "working point."
    )


def _figures(output: Output, *, several: bool) -> str:
    of = f"{output.name}: " if several else ""
    entries = [
        (percent(output.fitted.fit), f"{of}fit, simulated from the inputs alone"),
        (percent(output.fitted.model.one_step_fit), f"{of}fit, one step ahead"),
        (f"{output.fitted.samples:,}", f"{of}samples used"),
    ]
    return page.key_figures(entries) + ("<div></div>" if several else "")


def _left(output: Output, place: int, *, several: bool) -> str:
    """Return the residual's correlation with itself and with each input."""
    found, dt, parts = output.correlations, output.log.dt, []
    heading = f"<h3>{html.escape(output.name)}</h3>" if several else ""
    for i, name in enumerate(["", *output.pairs]):
        said = tables.correlation_in_words(each := found[max(i - 1, 0)], name)
        draw = partial(diagrams.draw_correlation, each, dt, name=name)
        parts.append(drawn(said, page.picture(f"left{place}-{i}", said, (page.HALF, 2.3), draw)))
    return heading + "".join(parts)


def _gains(models: Sequence[Model]) -> str:
    rows = []
    for model in models:
        gain, times = gain_and_times(model, uncertain)
        gain = f"{gain} {_unit(model)}".strip()
        rows.append((_said(model), gain, f"{model.transfer_function.delay:.4g}", "; ".join(times)))
    return page.table(("from, to", "DC gain", "dead time [s]", "time constants [s]"), rows, "Gains")


def _origin(outputs: Sequence[Output]) -> str:
    logs = [each.log for each in outputs]
    said = [*tables.of_record(logs[0], *logs[1:])]
    for each in outputs:
        rejected = rejected_in_words(each.fitted.rejected) or "none"
        said.append((f"{each.name}, used", f"{each.fitted.samples:,} samples; rejected: {rejected}"))
    return page.facts([*said, ("versions", tables.versions())])
