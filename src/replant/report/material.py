"""What a report is made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from replant.arguments import FloatArray
from replant.errors import ReplantError
from replant.log import Log
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.plotting.numbers import mapped_label
from replant.plotting.over_time import Panel
from replant.regressor.filters import StateVariableFilter
from replant.regressor.preprocess import Preprocess
from replant.report.figures import usable_uncertainty
from replant.report.findings import Excitation, excitation, regressors_of
from replant.report.panels import estimate_panels, excitation_panels, fit_panels
from replant.runs.result import Clock, Result
from replant.statistics.autoregression import places_on_grid
from replant.statistics.residuals import Correlations, correlation_lags, correlations


@dataclass(frozen=True, eq=False)
class Material:
    """A result and its record, which a report is made from."""

    result: Result
    log: Log
    filter: StateVariableFilter | None  # the filter of the regressors; without it the excitation is not known
    preprocess: Preprocess
    truth: Sequence[float] | None = None  # (P,): true parameters, of a simulated plant

    @property
    def true_plant(self) -> TransferFunction | None:
        """The true plant, of a simulated record."""
        return None if self.truth is None else self.result.structure.transfer_function(np.array(self.truth))

    @property
    def clock(self) -> Clock:
        """When the samples were taken."""
        return self.result.clock_of(self.log.dt)

    @property
    def plant_label(self) -> str:
        """The name of the mapped input."""
        return mapped_label(self.log.input_name, self.preprocess.input_map)

    @property
    def labels(self) -> dict[str, str]:
        """The names for the figures, which apply the input map of an online run's settings themselves."""
        of_input = self.plant_label if self.result.settings is None else self.log.input_name
        return {"input_label": of_input, "output_label": self.log.output_name}

    @cached_property
    def uncertainty(self) -> Uncertainty | None:
        """Uncertainty of the result; None without a usable covariance."""
        return usable_uncertainty(self.result)

    @cached_property
    def panels(self) -> dict[str, list[Panel]]:
        """What is drawn over time, by section."""
        result, log = self.result, self.log
        known = result.history is not None and result.history.samples.size
        return {
            "fit": fit_panels(result, log.input, log.output, log.dt, log.input_name, log.output_name),
            "parameters": estimate_panels(result, log.dt, self.truth, **self.labels) if known else [],
            "excitation": excitation_panels(self.excitation, self.clock),
        }

    @cached_property
    def residual(self) -> FloatArray:
        """Measured minus simulated output, (K,); NaN for samples that are left out."""
        return self.result.residual(self.log.output)

    @cached_property
    def correlations(self) -> Correlations | None:
        """Correlations of the residual with itself and with the mapped input."""
        times = [mode.time_constant for mode in self.result.transfer_function.modes]
        lags = correlation_lags(times, self.log.output.size, self.log.dt)
        return correlations(self.on_grid(self.residual), self.on_grid(self.preprocess.map_input(self.log.input)), lags)

    def on_grid(self, signal: FloatArray) -> FloatArray:
        """Return a signal (K,) as one of a regular clock: NaN stands for each sample that was lost, for up to a few."""
        stamps, dt = self.log.stamps, self.log.dt
        if stamps is None or not signal.size:
            return signal
        places = places_on_grid(np.diff(stamps, prepend=stamps[0] - dt), dt)
        spread = np.full(places[-1] + 1, np.nan)
        spread[places] = signal
        return spread

    @cached_property
    def excitation(self) -> Excitation | None:
        """Excitation by the regressors along the record."""
        log = self.log
        if self.filter is None or not log.output.size:
            return None
        try:
            phi = regressors_of(self.result, self.filter, self.preprocess, log.input, log.output, log.dt, log.stamps)
        except ReplantError:  # without a usable sample there is no working point
            return None
        found = excitation(phi)
        return found and replace(found, samples=found.samples + log.earlier)
