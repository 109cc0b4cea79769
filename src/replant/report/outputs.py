"""An output of a report: what was identified of it, from one input or several, and its record."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import ReplantError
from replant.estimation.filters import StateVariableFilter
from replant.estimation.solver.least_squares import regressors
from replant.fitting.miso_fit import RowFit
from replant.fitting.model import Model
from replant.logs.log import Log
from replant.model.preprocess import Preprocess, screen
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import places_on_grid
from replant.numerics.residuals import Correlations, correlation_lags, correlations
from replant.numerics.robust import stretches_of
from replant.online.runs.result import Clock, Result
from replant.plotting import style
from replant.plotting.numbers import mapped_label
from replant.plotting.over_time import POINTS, Panel, draw_panels, thin
from replant.report.findings import Excitation, excitation
from replant.report.panels import estimate_panels, excitation_panels, fit_panels, part_panel
from replant.verdict import Simulation

PLAIN = Preprocess()
SAME = 1e-9  # part of a dead time that is a rounding error [part]


@dataclass(frozen=True, eq=False)
class Output:
    """What was identified of an output, a model from one input or a row of models, and its record."""

    fitted: RowFit | Result
    log: Log
    filter: StateVariableFilter | None = None  # the filter of the regressors; None: the excitation is unknown
    preprocess: Preprocess = PLAIN
    truth: Sequence[float] | None = None  # (P,): true parameters, of a simulated plant

    @property
    def name(self) -> str:
        """The name of the output."""
        return self.log.output_name

    @cached_property
    def models(self) -> list[Model]:
        """The model from each input; a map of the input is a part of its name."""
        if isinstance(self.fitted, Result):
            label = mapped_label(self.log.input_name, self.preprocess.input_map)
            return [replace(self.fitted.model, input_name=label, output_name=self.name)]
        return [self.fitted.model.of_input(i) for i in range(len(self.fitted.model.structures))]

    @cached_property
    def result(self) -> Result:
        """The result; that of a row has the model of all inputs.

        Left out are its doubtful samples, and those that depend on inputs before the record.
        """
        if isinstance(self.fitted, Result):
            return self.fitted
        row, log, clock = self.fitted, self.log, Clock.of(self.log.dt, self.log.stamps)
        left_out = ~np.isfinite(log.output - row.output)
        left_out[np.concatenate([row.outliers, row.stuck])] = True
        longest = max(each.delay for each in row.model.structures)
        left_out[clock.at(np.arange(left_out.size)) < longest * (1.0 - SAME)] = True
        model: Any = row.model
        return Result(
            model, model.one_step_fit, Simulation(row.output, 0.0, row.fit), row.samples, row.rejected, model.verdict,
            math.nan, left_out=stretches_of(left_out), clock=clock,
        )  # fmt: skip

    @property
    def how(self) -> str:
        """How the model's output was made, in words."""
        how = self.result.simulation.how
        return how if len(self.models) == 1 else how.replace("the input", "the inputs")

    @cached_property
    def residual(self) -> FloatArray:
        """Measured minus simulated output, (K,); NaN for samples that are left out."""
        return self.result.residual(self.log.output)

    @property
    def clock(self) -> Clock:
        """The times of the samples."""
        return self.result.clock_of(self.log.dt)

    @cached_property
    def parts(self) -> FloatArray:
        """The contribution of each input of a row to the output (K, q)."""
        assert isinstance(self.fitted, RowFit)
        return self.fitted.model.contributions(self.log.inputs, self.log.stamps)

    def over_time(self, number: str = "") -> tuple[list[Panel], list[Panel]]:
        """Return the inputs, and the output above the residual; ``number`` distinguishes the outputs of a page."""
        log = self.log
        given = dict(zip(log.input_names, log.inputs.T, strict=True))
        inputs, outputs = fit_panels(self.result, given, log.output, log.dt, self.name, number)
        if isinstance(self.fitted, RowFit):
            parts = (thin(part, POINTS).values for part in self.parts.T)
            outputs.insert(1, part_panel(outputs[0], dict(zip(given, parts, strict=True)), number))
            # the inputs serve every output of a page, and each leaves out its own samples
            nothing = np.zeros((0, 2))
            inputs = [replace(each, name=f"input{i}", left_out=nothing) for i, each in enumerate(inputs, 1)]
        return inputs, outputs

    @cached_property
    def correlations(self) -> dict[str, Correlations | None]:
        """Correlations of the residual with itself and each mapped input, by how the input is called."""
        log, names = self.log, [model.input_name for model in self.models]
        times = [mode.time_constant for model in self.models for mode in model.transfer_function.modes]
        lags = correlation_lags(times, self.residual.size, log.dt)
        residual = on_grid(self.residual, log)
        inputs = (on_grid(self.preprocess.map_input(u), log) for u in log.inputs.T)
        found = (correlations(residual, u, lags) for u in inputs)
        return dict(zip(["input"] if isinstance(self.fitted, Result) else names, found, strict=True))

    @cached_property
    def excitation(self) -> Excitation | None:
        """Excitation by the regressors along the record."""
        log, preprocess = self.log, self.preprocess
        if self.filter is None or not log.output.size:
            return None
        try:
            accepted, _ = screen(preprocess.map_input(log.input), log.output)
            y = np.where(accepted, log.output, np.nan)
            phi = regressors(self.result.structure, log.dt, self.filter, preprocess, log.input, y, log.stamps)[0]
        except ReplantError:  # no usable sample, and thus no working point
            return None
        found = excitation(phi)
        return found and replace(found, samples=found.samples + log.earlier)


def panels_of(outputs: Sequence[Output]) -> dict[str, list[Panel]]:
    """Return the panels over time, by section; only a result of one input has a history and an excitation."""
    first, drawn = outputs[0], [each.over_time(str(k) if k > 1 else "") for k, each in enumerate(outputs, 1)]
    inputs, of_outputs = drawn[0][0], [panel for _, panels in drawn for panel in panels]
    if isinstance(first.fitted, RowFit):
        return {"fit": of_outputs + inputs, "parameters": [], "excitation": []}
    result, log, model = first.fitted, first.log, first.models[0]
    known = result.history is not None and result.history.samples.size
    return {
        "fit": inputs + of_outputs,
        "parameters": estimate_panels(result, log.dt, first.truth, model.input_name, model.output_name)
        if known
        else [],
        "excitation": excitation_panels(first.excitation, first.clock),
    }


def on_grid(signal: FloatArray, log: Log) -> FloatArray:
    """Return a signal (K,) on a regular clock: NaN for each lost sample, for at most a few in a gap."""
    stamps, dt = log.stamps, log.dt
    if stamps is None or not signal.size:
        return signal
    places = places_on_grid(np.diff(stamps, prepend=stamps[0] - dt), dt)
    spread = np.full(places[-1] + 1, np.nan)
    spread[places] = signal
    return spread


def save_figures(folder: Path, outputs: Sequence[Output]) -> list[Path]:
    """Draw each output over time, and the responses from each input, as PNG files; return their paths."""
    found: dict[str, Any] = {}
    for i, each in enumerate(outputs, 1):
        assert isinstance(each.fitted, RowFit)
        number_of = f"-{i}" if len(outputs) > 1 else ""
        inputs, of_output = each.over_time()
        panels = of_output + inputs
        axes = style.blank_figure(9.0, 1.0 + 1.8 * len(panels)).subplots(len(panels), 1, sharex=True)
        draw_panels(axes, panels)
        for axis in axes[:2]:
            style.legend(axis)
        style.title(axes[0], f"simulated fit {each.fitted.fit:.1f} %")
        found |= {f"fit{number_of}": axes[0], f"responses{number_of}": each.fitted.model.plot()[0, 0]}
    return style.saved(folder, found)
