"""The result of a run or of a fit: the model, its fits, its verdict, and the history of the estimate."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np

from replant.arguments import FloatArray, IntArray
from replant.assessment import Assessment, Simulation
from replant.identified import notation
from replant.identified.model import Model
from replant.model.noise import NoiseModel
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.offline.fit_result import FitResult
from replant.regressor.filters import StateVariableFilter
from replant.regressor.preprocess import screen
from replant.runs.overview import Overview
from replant.runs.record_clock import Clock
from replant.settings import Settings
from replant.simulation.stretches import (
    NONE,
    flags_of,
    joined,
    stretches_of,
)

MOST_SHADES = 1000  # stretches left out that a plot tells apart [count]


@dataclass(frozen=True, eq=False)
class History:
    """The estimate over time, thinned.

    Attributes
    ----------
    samples : (H,) array of int
        After how many samples each row was taken.
    parameters : (H, P) array
    std : (H, P) array or None
        Standard deviation of each estimate, if the estimator gives it.
    """

    samples: np.ndarray[tuple[int], np.dtype[np.int64]]
    parameters: FloatArray
    std: FloatArray | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """An identified model with the record of its identification.

    Attributes
    ----------
    model : Model
        What is worth keeping: G(s), its uncertainty, its noise.
    one_step : float
        Fit in percent, one step ahead.
    simulation : Simulation
        The model's output beside the record, with its fit in percent.
    samples : int
        Accepted samples.
    rejected : dict
        Number of rejected samples, by reason.
    verdict : Assessment
    elapsed : float
        Duration of the computation in s.
    settings : Settings or None
        Of an online run.
    history : History or None
        Of an online run.
    overview : Overview or None
        Of a record that is too long for memory; the simulation then holds only its newest samples.
    left_out : (R, 2) array of int
        Samples that the fits leave out, as rows [begin, end) of the record: bridged, rejected, or without an output.
    finished : bool
        Whether an online run ended with `Identifier.finish`.
    clock : Clock or None
        When the samples were taken; None for a regular clock.
    """

    model: Model
    one_step: float
    simulation: Simulation
    samples: int
    rejected: dict[str, int]
    verdict: Assessment
    elapsed: float
    settings: Settings | None = None
    history: History | None = None
    overview: Overview | None = None
    left_out: IntArray = field(default_factory=NONE.copy)
    finished: bool = False
    clock: Clock | None = None

    def clock_of(self, dt: float) -> Clock:
        """Return the clock of the record, whose sampling time is ``dt`` s."""
        return self.clock if self.clock is not None and self.clock.irregular else Clock(dt)

    def __repr__(self) -> str:
        return notation.in_lines("Result", self.model, self.samples, self.verdict.reasons)

    def _repr_html_(self) -> str:
        return notation.with_picture(self.model)

    @property
    def structure(self) -> Structure:
        """The structure of the model."""
        return self.model.structure

    @property
    def parameters(self) -> FloatArray:
        """The parameters (P,)."""
        return self.model.parameters

    @property
    def transfer_function(self) -> TransferFunction:
        """The model as G(s)."""
        return self.model.transfer_function

    @property
    def covariance(self) -> FloatArray | None:
        """Of the parameters (P, P), in their units squared, if the estimator gives it."""
        return self.model.covariance

    @property
    def noise(self) -> NoiseModel | None:
        """The model of the residual, where the method has one."""
        return self.model.noise

    def left_out_over_time(self, dt: float) -> FloatArray:
        """Return begin and end of stretches left out, and of gaps, (L, 2) in s; those close together are joined."""
        samples = self.overview.samples if self.overview else self.simulation.output.size
        rows = joined(self.left_out, max(1, samples // MOST_SHADES)) - np.array([1.0, 0.0])
        clock = self.clock_of(dt)
        found = clock.at(np.maximum(rows, 0.0))
        return np.concatenate([found, clock.gaps]) if clock.irregular else found

    def residual(self, y: FloatArray) -> FloatArray:
        """Return the newest measured outputs (K,) minus the simulated ones; NaN for samples that are left out."""
        first = (self.overview.samples if self.overview else y.size) - y.size
        with np.errstate(over="ignore", invalid="ignore"):
            return np.where(flags_of(self.left_out, first, y.size), np.nan, y - self.simulation.output)

    @property
    def uncertainty(self) -> Uncertainty | None:
        """Standard deviations of parameters, poles, gain and response, if the estimator gives them."""
        return self.model.uncertainty

    @property
    def fixed_filter(self) -> StateVariableFilter | None:
        """The filter of an online run; 1/A of the result if it was the refined filter."""
        if self.settings is None:
            return None
        return self.settings.filter.fixed_at(self.transfer_function.den, self.settings.dt)


def result_of_fit(fitted: FitResult, u: FloatArray, y: FloatArray, begun: float, t: FloatArray | None = None) -> Result:
    """Return the result of an offline fit."""
    if fitted.reference:
        y = np.where(np.isfinite(fitted.reference.signal), y, np.nan)
    used = screen(fitted.preprocess.map_input(u), y)[0]
    used[fitted.outliers] = used[fitted.stuck] = False
    return Result(
        fitted.model,
        fitted.one_step,
        fitted.simulation,
        fitted.samples,
        fitted.rejected,
        fitted.verdict,
        time.perf_counter() - begun,
        left_out=stretches_of(~used),
        clock=Clock.of(fitted.dt, t),
    )
