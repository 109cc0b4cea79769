"""Comparison of several methods, or of saved models, on one log: numbers, figures and pages."""

from __future__ import annotations

import html
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError
from replant.fitting.model import Model
from replant.fitting.validation import Validation
from replant.logs.log import Log
from replant.model.preprocess import Preprocess
from replant.numerics.arguments import instance
from replant.numerics.robust import stretches_of
from replant.online.runs.result import Clock, Result
from replant.online.runs.run_log import Contender, best
from replant.plotting import diagrams, style
from replant.plotting.numbers import mapped_label, number, percent, symbols, uncertain
from replant.plotting.over_time import SHOWN_SMALL, draw_panels
from replant.plotting.style import Shown, axes_for, blank_figure
from replant.report import contents as tables
from replant.report import page_frame as page
from replant.report import python_programs
from replant.report.figures import draw_outputs, draw_overlay, draw_responses, responses_of
from replant.report.findings import BAD, GOOD, Finding, findings
from replant.report.panels import draw_poles_of, draw_step_of, output_panels
from replant.report.results_as_text import OUTCOME, cells_of, gain_and_times, gravity_of
from replant.verdict import Assessment, Simulation

BANDS = "Bands are two standard deviations wide to either side"


def results_of(contenders: Sequence[Contender]) -> dict[str, Result]:
    """Return the results of the methods that found a model, by their names."""
    return {entry.name: entry.result for entry in contenders if entry.result is not None}


def reference_of(contenders: Sequence[Contender]) -> str:
    """Return the method that sets the limits of the figures: the best, else the first one with a model."""
    first = best(contenders)
    return first.name if first else next(iter(results_of(contenders)))


def swatches_of(names: Iterable[str]) -> dict[str, str]:
    """Return each method's name as HTML behind a sample of its line in the figures."""
    return {name: _swatch(*line) + html.escape(name) for name, line in zip(names, style.LINES, strict=False)}


def _swatch(colour: str, dashes: Any, width: float = 2.4) -> str:
    pattern = "" if dashes == "solid" else f' stroke-dasharray="{" ".join(f"{1.4 * x:g}" for x in dashes[1])}"'
    return (
        f'<svg class="swatch" viewBox="0 0 42 8" aria-hidden="true"><path d="M0 4h42" fill="none" '
        f'stroke="var(--{page.VARIABLES[colour]})" stroke-width="{width:g}"{pattern}/></svg>'
    )


def pictures(
    names: Iterable[str],
    words: Mapping[str, str],
    height: float,
    draw: Callable[[list[Any]], object],
    caption: str,
    first: str = "",
) -> str:
    """Return pictures side by side under one legend of ``names``; ``words`` has each picture's name and alternative."""
    with page.look():
        axes = [blank_figure(page.HALF, height).subplots() for _ in words]
        draw(axes)
        drawn = "".join(page.svg(axis.figure, *each) for axis, each in zip(axes, words.items(), strict=True))
    entries = "".join(f"<li>{name}</li>" for name in swatches_of(names).values())
    return (
        f'<figure><ul class="lines">{first}{entries}</ul><div class="panels">{drawn}</div>'
        f"<figcaption>{html.escape(caption)}</figcaption></figure>"
    )


def estimates(results: Mapping[str, Result], reference: str, dt: float, labels: dict[str, str]) -> str:
    """Return the estimates over time, a picture for each coefficient."""
    said = {}
    for i, name in enumerate(results[reference].structure.names):
        ends = ", ".join(f"{method} {number(float(each.parameters[i]))}" for method, each in results.items())
        said[name] = f"{name} over time by method; at the end: {ends}"
    whole = [name for name, each in results.items() if each.history is None]
    late = [name for name, each in results.items() if each.history is not None and not each.history.parameters.any()]
    caption = "Each coefficient's estimate over time, by method"
    caption += f"; a horizontal line: {' and '.join(whole)}, fitted to the whole record at once" if whole else ""
    caption += f"; a dot: {' and '.join(late)}, with an estimate only at the end" if late else ""
    return pictures(
        results, said, 2.5, lambda axes: draw_overlay(results, dt, reference=reference, axes=axes, **labels),
        f"{caption}. {BANDS}; curves far from the best model are cut off.",
    )  # fmt: skip


def outputs(results: Mapping[str, Result], log: Log) -> str:
    """Return the simulated outputs of all methods over the measured one."""
    said = "Measured output, and that of each model, simulated from the input alone"
    fits = ", ".join(f"{name} {percent(result.simulation.fit)}" for name, result in results.items())
    return pictures(
        results,
        {"outputs0": f"{said}; fit: {fits}", "outputs1": "The same over the last tenth of the record"},
        2.9,
        lambda axes: draw_outputs(results, log.output, log.dt, axes=axes, output_label=log.output_name),
        f"{said}; on the right or below, over the last tenth of the record. Outputs are cut off where they leave the "
        "range of the measured output by more than its width.",
        f"<li>{_swatch(style.MEASURED, 'solid', 3.6)}measured</li>",
    )


def responses(results: Mapping[str, Result], reference: str, dt: float, labels: dict[str, str]) -> str:
    """Return the Bode diagrams of all methods in common axes."""
    said = "Bode diagram of each model"
    return pictures(
        results, {"responses0": f"{said}: magnitude in dB", "responses1": f"{said}: phase in degrees"}, 2.9,
        lambda axes: draw_responses(results, dt, reference=reference, axes=axes, **labels),
        f"{said}. {BANDS}, where they are known. Curves are cut off far beyond the range of {reference}.",
    )  # fmt: skip


def _labels(log: Log, input_map: Any) -> dict[str, str]:
    return {"input_label": mapped_label(log.input_name, input_map), "output_label": log.output_name}


def save_figures(folder: Path, contenders: Sequence[Contender], log: Log, preprocess: Preprocess) -> list[Path]:
    """Draw outputs, Bode diagrams and estimates over time of all methods into PNG files, and return their paths."""
    results = results_of(contenders)
    more: Any = {"reference": reference_of(contenders), **_labels(log, preprocess.input_map)}
    drawn = {
        "outputs": draw_outputs(results, log.output, log.dt, output_label=log.output_name)[0],
        "bode": draw_responses(results, log.dt, **more)[0],
        "parameters": draw_overlay(results, log.dt, **more)[0],
    }
    for axis in drawn.values():
        handles, names = axis.get_legend_handles_labels()
        if names:
            axis.figure.legend(
                handles, names, loc="outside upper left", ncols=-(-len(names) // -(-len(names) // 6)), frameon=False,
                labelcolor=style.INK, handlelength=3.4,
            )  # fmt: skip
    return style.saved(folder, drawn)


def write_comparison(
    path: Path, contenders: Sequence[Contender], log: Log, preprocess: Preprocess, command: str = "", opened: str = ""
) -> Path:
    """Write a comparison of methods into one self-contained HTML file, and return its path.

    ``opened``: begin of the programs, see `python_programs.opening`.
    """
    labels, results, reference = _labels(log, preprocess.input_map), results_of(contenders), reference_of(contenders)
    listed = _html_table(contenders, symbols(results[reference].structure, *labels.values()), len(log))
    sections = {
        "": _claimed(claim(contenders)) + listed + _remarks(contenders, len(log)),
        "Outputs": outputs(results, log),
        "Frequency responses": responses(results, reference, log.dt, labels),
        "Estimates over time": estimates(results, reference, log.dt, labels),
        "How to reproduce this": (page.code("shell", command) if command else "") + _programs(contenders, log, opened),
        "Record and versions": page.facts([*tables.of_record(log), ("versions", tables.versions())]),
    }
    lede = (
        f"{log.input_name} → {log.output_name}, {len(contenders)} methods on the same {len(log):,} samples, "
        f"{tables.lasts(log)}"
    )
    return _write(path, log.path.name or "Simulated record", "Methods compared", lede, sections)


def _claimed(text: str) -> str:
    return f'<p class="claim">{html.escape(text)}</p>'


def _write(path: Path, title: str, eyebrow: str, lede: str, sections: Mapping[str, str]) -> Path:
    body = "".join(page.section(name, content) for name, content in sections.items())
    return page.write_page(path, title=title, eyebrow=eyebrow, lede=lede, body=body)


def claim(contenders: Sequence[Contender]) -> str:
    """Return a text on the method with the best simulated fit and, if it is not trusted, on the best trusted one."""
    first, results = best(contenders), results_of(contenders)
    if first is None:
        return "No method found a model that can be simulated."
    fits = {name: result.simulation.fit for name, result in results.items()}
    top = fits[first.name]
    said = f"Simulated from the input alone, the model of {first.name} has the best fit: {percent(top)}."
    level = [name for name, fit in fits.items() if name != first.name and fit > top - 0.5]
    said += f" Within half a percentage point: {', '.join(level)}." if level else ""
    trusted = {name: fits[name] for name, result in results.items() if result.verdict.status == "trusted"}
    if not trusted:
        said += " No model is trusted."
    elif first.name not in trusted:
        name = max(trusted, key=lambda each: trusted[each])
        said += f" It is not trusted; the best trusted model is that of {name}: {percent(trusted[name])}."
    return said.replace(" %", page.NO_BREAK + "%")


def _html_table(contenders: Sequence[Contender], labels: Sequence[str], samples: int) -> str:
    swatches, none = swatches_of(results_of(contenders)), '<svg class="swatch" aria-hidden="true"></svg>'
    rows = []
    for entry in contenders:
        status, *cells = cells_of(entry, len(labels))
        name = page.Html(swatches.get(entry.name, none + html.escape(entry.name)))
        verdict = page.Html(f'<span class="status">{page.icon(gravity_of(entry, samples))}{html.escape(status)}</span>')
        outcome = [cell.replace(" ", page.NO_BREAK) for cell in cells[: len(OUTCOME) - 1]]
        rows.append([name, verdict, *outcome, *(page.Html(page.in_small(cell)) for cell in cells[len(outcome) :])])
    headings = ("method", "verdict", "simulated fit", "one-step fit", "time", *labels)
    listed = page.table(headings, rows, "Methods compared", "table wide methods")
    return listed + page.note("Estimate ± standard deviation, if the method gives one.")


def _remarks(contenders: Sequence[Contender], samples: int) -> str:
    """Return the adverse findings on each model, the gravest first."""
    remarks = []
    for entry in contenders:
        found = [Finding(BAD, "No model", f"{entry.problem[:1].upper()}{entry.problem[1:]}.")]
        if entry.result is not None:
            found = [each for each in findings(entry.result, samples) if each.gravity != GOOD]
        remarks += [(each.gravity != BAD, entry.name, each) for each in found]
    items = "".join(
        f"<li>{page.icon(each.gravity)}<div><b>{html.escape(name)}: {html.escape(each.headline.lower())}.</b> "
        f"{shortened(' '.join((each.text, *each.more)))}</div></li>"
        for _, name, each in sorted(remarks, key=lambda entry: entry[0])
    )
    return f'<ul class="remarks">{items}</ul>' if items else ""


def shortened(text: str) -> str:
    """Return the first two sentences, and the others folded."""
    sentences = re.split(r"(?<=[.?!]) (?=[A-Z0-9])", page.words(text))
    first, rest = " ".join(sentences[:2]), " ".join(sentences[2:])
    return f"{first} <details><summary>More</summary>{rest}</details>" if rest else first


def _programs(contenders: Sequence[Contender], log: Log, opened: str) -> str:
    """Return the Python programs that reproduce each method's result."""
    parts = []
    for entry in contenders:
        if entry.fitted is not None and entry.result is not None:
            program = python_programs.fit_as_python(entry.fitted, [log], opened)
        elif entry.result is not None and entry.result.settings is not None:
            program = python_programs.run_as_python(entry.result, log, opened)
        else:
            continue
        summary = f"<summary>{html.escape(entry.name)} alone, in Python</summary>"
        parts.append(f"<details>{summary}{page.code('python', program)}</details>")
    return "".join(parts)


# --- saved models

HEADINGS = ("model", "verdict", "simulated", "one step", "poles", "zeros", "dead time", "DC gain", "time constants [s]")


@dataclass(frozen=True, eq=False, repr=False)
class ModelComparison(Shown):
    """Several models beside one record.

    Attributes
    ----------
    models : dict of Model
        By name.
    validations : dict of Validation
        Validation of each model on the record, by the same names.
    log : Log
        The record.
    """

    models: Mapping[str, Model]
    validations: Mapping[str, Validation]
    log: Log

    @property
    def best(self) -> str:
        """Name of the model whose simulated output fits the record best."""
        return reference_of(self.contenders)

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The table: a row of texts for each model, see `HEADINGS`."""
        rows: list[tuple[str, ...]] = []
        for name, model in self.models.items():
            found, structure = self.validations[name], model.structure
            gain, times = gain_and_times(model, uncertain)
            size = (str(structure.poles), str(structure.zeros), f"{structure.delay:.4g} s")
            fits = percent(found.fit), percent(found.one_step)
            rows.append((name, found.verdict.status, *fits, *size, gain, "; ".join(times)))
        return rows

    @property
    def contenders(self) -> list[Contender]:
        """The models with their outputs as results, for the figures."""
        found = []
        for name, model in self.models.items():
            each = self.validations[name]
            simulation = Simulation(each.output, each.offset, each.fit, is_prediction=each.is_prediction)
            verdict = Assessment(each.verdict.status, each.verdict.reasons, each.verdict.excited, each.samples)
            result = Result(
                model, each.one_step, simulation, each.samples, {}, verdict, 0.0,
                left_out=stretches_of(~np.isfinite(each.residual)), clock=Clock.of(self.log.dt, self.log.stamps),
            )  # fmt: skip
            found.append(Contender(name, result))
        return found

    def plot(self, axes: Any = None) -> Any:
        """Draw outputs, step responses, magnitudes and poles of all models; return four axes of matplotlib.

        Parameters
        ----------
        axes : four matplotlib axes, optional
            Drawn into; without them a figure is made.
        """
        output, step, magnitude, poles = axes_for("axes", axes, 4, (11.0, 7.0), nrows=2, ncols=2)
        results, log = results_of(self.contenders), self.log
        draw_panels([output], output_panels(results, log.output, log.dt, log.output_name)[:1], SHOWN_SMALL)
        draw_step_of(self.models, step)
        diagrams.draw_magnitude(magnitude, responses_of(results, log.dt, self.best), reference=self.best)
        draw_poles_of(self.models, poles)
        style.legend(output)
        return np.array([output, step, magnitude, poles], dtype=object)

    def __repr__(self) -> str:
        rows = [f"{name}: {self.models[name].transfer_function}, {self.validations[name]!r}" for name in self.models]
        more = [f"... {len(rows) - 10} more"] if len(rows) > 10 else []
        return "\n  ".join([f"<ModelComparison over {self.log!r}", *rows[:10], *more]) + ">"


def compare(models: Mapping[str, Model] | Sequence[Model], log: Log) -> ModelComparison:
    """Compare several models on one record; only the offset and the initial state of each are estimated.

    Parameters
    ----------
    models : dict or sequence of Model
        By name; those of a sequence are called "model 1" and so on.
    log : Log
        Preferably a record that the models were not fitted to.

    Returns
    -------
    ModelComparison
        With a table, the validation of each model, and a plot of all.

    Raises
    ------
    ArgumentTypeError
        If an entry is not a Model, or ``log`` is not a Log.
    InvalidArgumentError
        If there is no model.

    Examples
    --------
    >>> import replant as rp
    >>> log = rp.examples.motor()
    >>> found = compare({"one pole": rp.fit(log, poles=1, delay=0.01).model, "two": rp.fit(log, poles=2).model}, log)
    >>> found.best, len(found.rows)
    ('one pole', 2)
    """
    if not isinstance(models, Mapping | Sequence):
        raise ArgumentTypeError("models must be several: compare([model, other], log); model.validate(log) takes one")
    named = dict(models) if isinstance(models, Mapping) else {f"model {k + 1}": each for k, each in enumerate(models)}
    if not named:
        raise InvalidArgumentError("there is no model to compare")
    named = {name: instance(f"models, {name},", model, Model) for name, model in named.items()}
    log = instance("log", log, Log)
    return ModelComparison(named, {name: model.validate(log) for name, model in named.items()}, log)


def write_models(path: Path, comparison: ModelComparison, command: str = "") -> Path:
    """Write a comparison of models into one self-contained HTML file, and return its path."""
    log, results, best_of = comparison.log, results_of(comparison.contenders), comparison.best
    found, swatches = comparison.validations[best_of], swatches_of(results)
    said = f"{best_of} follows the record best: {percent(found.fit)}, {found.verdict.status}."
    rows = [[page.Html(swatches[name]), *rest] for name, *rest in comparison.rows]
    listed = page.table(HEADINGS, rows, "Models compared", "table wide methods")
    reasons = "".join(
        f"<li><div><b>{html.escape(name)}:</b> {html.escape(each.verdict.reasons[0])}</div></li>"
        for name, each in comparison.validations.items()
        if each.verdict.status != "trusted" and each.verdict.reasons
    )

    def draw(axes: list[Any]) -> None:
        draw_step_of(comparison.models, axes[0])
        draw_poles_of(comparison.models, axes[1])

    drawn = {"models0": "Response to a unit step of each model", "models1": "Poles of each model in the complex plane"}
    sections = {
        "": _claimed(said) + listed + (f'<ul class="remarks">{reasons}</ul>' if reasons else ""),
        "Outputs": outputs(results, log),
        "Step responses and poles": pictures(results, drawn, 3.2, draw, f"{BANDS}; regions of poles hold 95 %."),
        "Frequency responses": responses(results, best_of, log.dt, _labels(log, "identity")),
        "How to reproduce this": (page.code("shell", command) if command else "") + page.facts(tables.of_record(log)),
    }
    lede = f"{log.input_name} → {log.output_name}, {len(comparison.models)} models over {len(log):,} samples"
    return _write(path, log.path.name or "Models compared", "Models compared", lede, sections)
