"""Material: a result with its record, and the signals and figures of the report, each computed once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

from replant.arguments import FloatArray
from replant.data.logs import Log
from replant.errors import ReplantError
from replant.model.uncertainty import Uncertainty
from replant.regressor.filters import StateVariableFilter
from replant.regressor.preprocess import Preprocess
from replant.report.diagnostics import Excitation, excitation, regressors_of
from replant.report.figures import style
from replant.report.figures.poles import usable_uncertainty
from replant.runs.result import Result
from replant.statistics.correlations import Correlations, correlation_lags, correlations


class OverTime(NamedTuple):
    """Signals for drawing, (V,) each, from ``start`` s on and ``step`` s apart: the record or its overview."""

    input: FloatArray
    output: FloatArray
    model: FloatArray
    residual: FloatArray
    start: float
    step: float


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
            return OverTime(self.u, self.y, self.result.simulation.output, self.residual, 0.0, self.dt)
        u, y, model, residual = (each.values for each in (shown.input, shown.output, shown.model, shown.residual))
        return OverTime(u, y, model, residual, self.dt * shown.output.first, self.dt * shown.output.step)

    @cached_property
    def residual(self) -> FloatArray:
        """Measured minus simulated output, (K,); NaN for samples that are left out."""
        return self.result.residual(self.y)

    @cached_property
    def correlations(self) -> Correlations | None:
        """Correlations of the residual with itself and with the mapped input."""
        modes = self.result.transfer_function.modes
        lags = correlation_lags([mode.time_constant for mode in modes], self.y.size, self.dt)
        return correlations(self.residual, self.preprocess.map_input(self.u), lags)

    @cached_property
    def excitation(self) -> Excitation | None:
        """Excitation by the regressors along the record."""
        if self.filter is None or not self.y.size:
            return None
        try:
            found = excitation(regressors_of(self.result, self.filter, self.preprocess, self.u, self.y, self.dt))
            return found and replace(found, samples=found.samples + self.log.earlier)
        except ReplantError:  # without a usable sample there is no working point
            return None
