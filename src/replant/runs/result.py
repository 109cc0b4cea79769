"""The result of a run or of a fit: the model, its fits, its verdict, and the history of the estimate."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass, field

import numpy as np

from replant.arguments import FloatArray, IntArray
from replant.assessment import Assessment, Simulation, assess_record
from replant.engine.record import ready_record
from replant.model.noise import NoiseModel
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.offline.fit import FitResult
from replant.regressor.filters import StateVariableFilter
from replant.regressor.preprocess import screen
from replant.runs.overview import Overview
from replant.settings import Settings
from replant.simulation.stretches import (
    NONE,
    flags_of,
    joined,
    stretches_of,
)
from replant.statistics.linear_algebra import quiet

MOST_SHADES = 1000
"""Stretches left out that a plot tells apart [count]."""


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


@dataclass(frozen=True, eq=False)
class Result:
    """An identified model with the figures that its quality is judged by.

    Attributes
    ----------
    structure : Structure
    parameters : (P,) array
    transfer_function : TransferFunction
    one_step, simulated : float
        Fit in percent: one step ahead, and from the input alone.
    simulation : Simulation
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
    covariance : (P, P) array or None
        Of the parameters, in their units squared, if the estimator gives it.
    overview : Overview or None
        Of a record that is too long for memory; the simulation then holds only its newest samples.
    noise : NoiseModel or None
        Of the residual, where the method has one.
    left_out : (R, 2) array of int
        Samples that the fits leave out, as rows [begin, end) of the record: bridged, rejected, or without an output.
    finished : bool
        Whether an online run ended with `Identifier.finish`.
    """

    structure: Structure
    parameters: FloatArray
    transfer_function: TransferFunction
    one_step: float
    simulation: Simulation
    samples: int
    rejected: dict[str, int]
    verdict: Assessment
    elapsed: float
    settings: Settings | None = None
    history: History | None = None
    covariance: FloatArray | None = None
    overview: Overview | None = None
    noise: NoiseModel | None = None
    left_out: IntArray = field(default_factory=NONE.copy)
    finished: bool = False

    def left_out_over_time(self, dt: float) -> FloatArray:
        """Return begin and end of the stretches left out, (L, 2) in s; those too close for a plot are joined."""
        samples = self.overview.samples if self.overview else self.simulation.output.size
        rows = joined(self.left_out, max(1, samples // MOST_SHADES)) - np.array([1.0, 0.0])
        return np.asarray(dt * np.maximum(rows, 0.0))

    def residual(self, y: FloatArray) -> FloatArray:
        """Return the newest measured outputs (K,) minus the simulated ones; NaN for samples that are left out."""
        first = (self.overview.samples if self.overview else y.size) - y.size
        with np.errstate(over="ignore", invalid="ignore"):
            return np.where(flags_of(self.left_out, first, y.size), np.nan, y - self.simulation.output)

    @property
    def uncertainty(self) -> Uncertainty | None:
        """Standard deviations of parameters, poles, gain and response, if the estimator gives them."""
        return None if self.covariance is None else Uncertainty(self.structure, self.parameters, self.covariance)

    @property
    def fixed_filter(self) -> StateVariableFilter | None:
        """The filter of an online run; 1/A of the result if it was the refined filter."""
        if self.settings is None:
            return None
        return self.settings.filter.fixed_at(self.transfer_function.den, self.settings.dt)


@quiet
def result_of_fit(fitted: FitResult, u: FloatArray, y: FloatArray, begun: float) -> Result:
    """Return the result of an offline fit.

    Parameters
    ----------
    fitted : FitResult
    u, y : (K,) arrays
        Raw input and output that were fitted.
    begun : float
        Value of `time.perf_counter` at the start, in s.
    """
    hold = fitted.filter.input_hold
    r = fitted.reference.signal if fitted.reference else None
    if r is not None:
        y = np.where(np.isfinite(r), y, np.nan)
    used = screen(fitted.preprocess.map_input(u), y)[0]
    used[fitted.outliers] = False
    y = fitted.bridged(y)
    record = ready_record(fitted.structure, fitted.dt, fitted.preprocess, u, y, input_hold=hold, r=r)
    return Result(
        fitted.structure,
        fitted.parameters,
        fitted.transfer_function,
        fitted.one_step,
        fitted.simulation,
        fitted.samples,
        fitted.rejected,
        _with_finding(
            assess_record(
                fitted.structure,
                fitted.parameters,
                record,
                fitted.dt,
                fitted.covariance,
                instruments=fitted.method != "least_squares",
            ),
            fitted.reference.finding if fitted.reference else "",
        ),
        time.perf_counter() - begun,
        covariance=fitted.covariance,
        noise=fitted.noise,
        left_out=stretches_of(~used),
    )


def _with_finding(verdict: Assessment, finding: str) -> Assessment:
    """Return the verdict with what a fit has found wrong with its reference, where no reason of it says so."""
    if not finding or any(finding.partition(":")[0] in reason for reason in verdict.reasons):
        return verdict
    return dataclasses.replace(verdict, reasons=(*verdict.reasons, finding))
