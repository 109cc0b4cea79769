"""Saved models compared over one log: their numbers, and their page."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError
from replant.estimation.simulation.stretches import stretches_of
from replant.fitting.model import Model
from replant.fitting.validation import Validation
from replant.logs.log import Log
from replant.numerics.arguments import instance
from replant.online.runs.result import Clock, Result
from replant.online.runs.run_log import Contender, best
from replant.plotting import diagrams, style
from replant.plotting.numbers import percent, uncertain
from replant.plotting.over_time import SHOWN_SMALL, Curve, Panel, draw_panel, draw_panels
from replant.plotting.style import Shown, axes_for, blank_figure
from replant.report import material as tables
from replant.report.figures import responses_of
from replant.report.methods_page import figure, outputs, responses, swatches_of
from replant.report.page import Html, code, facts, section, table, write_page
from replant.report.page_figures import HALF, look, svg
from replant.report.panels import output_panels
from replant.verdict import Assessment, Simulation

HEADINGS = ("model", "verdict", "simulated", "one step", "poles", "zeros", "dead time", "DC gain", "time constants [s]")


@dataclass(frozen=True, eq=False, repr=False)
class ModelComparison(Shown):
    """Several models beside one record.

    Attributes
    ----------
    models : dict of Model
        By name.
    validations : dict of Validation
        Of each model by the record, by the same names.
    log : Log
        The record.
    """

    models: Mapping[str, Model]
    validations: Mapping[str, Validation]
    log: Log

    @property
    def best(self) -> str:
        """Name of the model whose simulated output fits the record best."""
        found = best(self.contenders)
        return next(iter(self.models)) if found is None else found.name

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The table: a row of words for each model, see `HEADINGS`."""
        return [self._row(name) for name in self.models]

    @property
    def contenders(self) -> list[Contender]:
        """The models with their outputs as results, for the figures."""
        return [Contender(name, self._result(name)) for name in self.models]

    def plot(self, axes: Any = None) -> Any:
        """Draw outputs, step responses, magnitudes and poles of all models; return four axes of matplotlib.

        Parameters
        ----------
        axes : four matplotlib axes, optional
            Drawn into; without them a figure is made.
        """
        results = {each.name: each.result for each in self.contenders if each.result is not None}
        return draw_models(self.models, results, self.log, self.best, axes)

    def __repr__(self) -> str:
        rows = [f"{name}: {self.models[name].transfer_function}, {self.validations[name]!r}" for name in self.models]
        more = [f"... {len(rows) - 10} more"] if len(rows) > 10 else []
        return "\n  ".join([f"<ModelComparison over {self.log!r}", *rows[:10], *more]) + ">"

    def _row(self, name: str) -> tuple[str, ...]:
        model, found = self.models[name], self.validations[name]
        structure, known = model.structure, model.uncertainty
        gain = uncertain(float(model.transfer_function.dc_gain), math.nan if known is None else known.dc_gain_std)
        modes = [
            uncertain(mode.time_constant, None if known is None else known.modes[i].time_constant_std)
            for i, mode in enumerate(model.transfer_function.modes)
        ]
        size = (str(structure.poles), str(structure.zeros), f"{structure.delay:.4g} s")
        return name, found.verdict.status, percent(found.fit), percent(found.one_step), *size, gain, "; ".join(modes)

    def _result(self, name: str) -> Result:
        found = self.validations[name]
        simulation = Simulation(found.output, found.offset, found.fit, is_prediction=found.is_prediction)
        verdict = Assessment(found.verdict.status, found.verdict.reasons, found.verdict.excited, found.samples)
        return Result(
            self.models[name], found.one_step, simulation, found.samples, {}, verdict, 0.0,
            left_out=stretches_of(~np.isfinite(found.residual)), clock=Clock.of(self.log.dt, self.log.stamps),
        )  # fmt: skip


def compare(models: Mapping[str, Model] | Sequence[Model], log: Log) -> ModelComparison:
    """Compare several models over one record; of each, offset and initial state are estimated and nothing else.

    Parameters
    ----------
    models : dict or sequence of Model
        By name; of a sequence the names are "model 1" and so on.
    log : Log
        A record that they were not made from tells most.

    Returns
    -------
    ModelComparison
        With a table, the validation of each model, and a plot of all.

    Raises
    ------
    ArgumentTypeError
        If one is no model, or the log no log.
    InvalidArgumentError
        If there is no model.

    Examples
    --------
    >>> import replant as rp
    >>> log = rp.examples.motor()
    >>> found = compare({"one pole": rp.fit(log, poles=1, delay=0.01).model, "two": rp.fit(log, poles=2).model}, log)
    >>> found.best, len(found.rows)
    ('two', 2)
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
    log, contenders = comparison.log, comparison.contenders
    body = [
        section("", f'<p class="claim">{html.escape(claim(comparison))}</p>', _table(comparison), _reasons(comparison)),
        section("Outputs", outputs(contenders, log)),
        section("Step responses and poles", _steps_and_poles(comparison)),
        section("Frequency responses", responses(contenders, log, log.input_name)),
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
    return table(HEADINGS, rows, "Models compared", "table wide methods")


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
        drawn = "".join(svg(axis.figure, f"models{i}", words[i]) for i, axis in enumerate(axes))
    caption = "Bands are two standard deviations wide to either side; regions of poles hold 95 %."
    return figure(comparison.contenders, drawn, caption)


def draw_models(
    models: Mapping[str, Model], results: Mapping[str, Result], log: Log, best: str, axes: Any = None
) -> Any:
    """Draw outputs, step responses, magnitudes and poles of all models; return four axes."""
    output, step, magnitude, poles = axes_for("axes", axes, 4, (11.0, 7.0), nrows=2, ncols=2)
    draw_panels([output], output_panels(results, log.output, log.dt, log.output_name)[:1], SHOWN_SMALL)
    draw_steps(models, step)
    diagrams.draw_magnitude(magnitude, responses_of(results, log.dt, best), reference=best)
    draw_poles_of(models, poles)
    style.legend(output)
    return np.array([output, step, magnitude, poles], dtype=object)


def draw_steps(models: Mapping[str, Model], axis: Any) -> None:
    """Draw the step response of each model with its band of two standard deviations."""
    longest = max(float(model.step().time[-1]) for model in models.values())
    curves = []
    for (name, model), (colour, dashes) in zip(models.items(), style.LINES, strict=False):
        step = model.step(longest)
        std = None if step.std is None else np.minimum(step.std, 0.5 * (np.ptp(step.output) or 1.0))
        curves.append(Curve(step.time, step.output, name, colour, std, dashes=dashes))
    draw_panel(axis, Panel("", curves, (0.0, longest)))
    axis.set(xlabel="time [s]", ylabel="step response")


def draw_poles_of(models: Mapping[str, Model], axis: Any) -> None:
    """Draw the poles and zeros of each model with their 95 % regions."""
    found = {name: model.poles() for name, model in models.items()}
    regions = {name: [(mode.mode.pole, mode.covariance) for mode in each.uncertain] for name, each in found.items()}
    drawn = {n: (each.values, each.zeros, diagrams.with_conjugates(regions[n])) for n, each in found.items()}
    diagrams.draw_poles(drawn, axis)
