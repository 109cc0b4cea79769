"""Report data: a result with its record, and the signals and figures of the report, each computed once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from replant.arguments import FloatArray
from replant.data.logs import Log
from replant.errors import ReplantError
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.regressor.filters import StateVariableFilter
from replant.regressor.preprocess import Preprocess
from replant.report.diagnostics import Excitation, excitation, regressors_of
from replant.report.figures import style
from replant.report.figures.poles import usable_uncertainty
from replant.runs.result import Clock, Result
from replant.statistics.autoregression import places_on_grid
from replant.statistics.residuals import Correlations, correlation_lags, correlations


class OverTime(NamedTuple):
    """Signals for drawing, (V,) each, the record or its overview.

    Of a regular clock from ``start`` s on and ``step`` s apart; of an irregular one at ``times`` (V,) in s.
    """

    input: FloatArray
    output: FloatArray
    model: FloatArray
    residual: FloatArray
    start: float
    step: float
    times: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Material:
    """A result and its record, which a report is made from.

    Attributes
    ----------
    result : Result
    log : Log
    filter : StateVariableFilter or None
        The filter of the regressors; without it the excitation is not known.
    preprocess : Preprocess
    truth : (P,) sequence or None
        True parameters, of a simulated plant.
    """

    result: Result
    log: Log
    filter: StateVariableFilter | None
    preprocess: Preprocess
    truth: Sequence[float] | None = None

    @property
    def true_plant(self) -> TransferFunction | None:
        """The true plant, of a simulated record."""
        return None if self.truth is None else self.result.structure.transfer_function(np.array(self.truth))

    @property
    def u(self) -> FloatArray:
        """Raw input (K,)."""
        return self.log.input

    @property
    def y(self) -> FloatArray:
        """Raw output (K,)."""
        return self.log.output

    @property
    def dt(self) -> float:
        """Sampling time in s."""
        return self.log.dt

    @property
    def clock(self) -> Clock:
        """When the samples were taken."""
        return self.result.clock_of(self.dt)

    @property
    def input_label(self) -> str:
        """The input's name."""
        return self.log.input_name

    @property
    def output_label(self) -> str:
        """The output's name."""
        return self.log.output_name

    @property
    def plant_label(self) -> str:
        """The name of the mapped input."""
        return style.mapped_label(self.log.input_name, self.preprocess.input_map)

    @property
    def figure_label(self) -> str:
        """The name of the input for the figures, which apply the input map of an online run's settings themselves."""
        return self.input_label if self.result.settings is not None else self.plant_label

    @cached_property
    def uncertainty(self) -> Uncertainty | None:
        """Uncertainty of the result; None without a usable covariance."""
        return usable_uncertainty(self.result)

    @cached_property
    def over_time(self) -> OverTime:
        """The signals that are drawn over time."""
        shown = self.result.overview
        if shown is None:
            times = self.clock.at(np.arange(self.y.size)) if self.clock.irregular else None
            return OverTime(self.u, self.y, self.result.simulation.output, self.residual, 0.0, self.dt, times)
        u, y, model, residual = (each.values for each in (shown.input, shown.output, shown.model, shown.residual))
        times = self.clock.at(shown.output.places) if self.clock.irregular else None
        return OverTime(u, y, model, residual, self.dt * shown.output.first, self.dt * shown.output.step, times)

    @cached_property
    def residual(self) -> FloatArray:
        """Measured minus simulated output, (K,); NaN for samples that are left out."""
        return self.result.residual(self.y)

    @cached_property
    def correlations(self) -> Correlations | None:
        """Correlations of the residual with itself and with the mapped input."""
        times = [mode.time_constant for mode in self.result.transfer_function.modes]
        lags = correlation_lags(times, self.y.size, self.dt)
        return correlations(self.on_grid(self.residual), self.on_grid(self.preprocess.map_input(self.u)), lags)

    def on_grid(self, signal: FloatArray) -> FloatArray:
        """Return a signal (K,) as one of a regular clock: NaN stands for each sample that was lost, for up to a few."""
        if self.log.stamps is None or not signal.size:
            return signal
        places = places_on_grid(np.diff(self.log.stamps, prepend=self.log.stamps[0] - self.dt), self.dt)
        spread = np.full(places[-1] + 1, np.nan)
        spread[places] = signal
        return spread

    @cached_property
    def excitation(self) -> Excitation | None:
        """Excitation by the regressors along the record."""
        if self.filter is None or not self.y.size:
            return None
        try:
            t = self.log.stamps
            found = excitation(regressors_of(self.result, self.filter, self.preprocess, self.u, self.y, self.dt, t))
            return found and replace(found, samples=found.samples + self.log.earlier)
        except ReplantError:  # without a usable sample there is no working point
            return None
