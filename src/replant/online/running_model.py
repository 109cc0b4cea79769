"""Running model: the `Model` of a running identification, and its newest samples for fits and views."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.estimation.simulation.fitted_run import Simulation, fit_percent
from replant.estimation.simulation.model_run import model_output
from replant.fitting.miso_fit import RowFit
from replant.fitting.model import Model
from replant.fitting.model_fields import Provenance, has_rest
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.autoregression import one_step
from replant.numerics.linear_algebra import quiet
from replant.online.estimate import Estimate
from replant.online.miso_identifier import RowIdentifier
from replant.verdict.verdict import Assessment, Verdict

# stamps of some 1e9 s have a resolution of 1e-7 s
IRREGULAR = 1e-6  # deviation of an interval up to which it is rounding [part of the sampling time]
LONGEST_IRREGULAR = 3000  # newest samples simulated if each interval needs a matrix exponential [samples]


def model_of(
    estimate: Estimate,
    simulation: Simulation | None = None,
    one_step_fit: float = np.nan,
    verdict: Verdict | None = None,
) -> Model:
    """Return the model of a running identification."""
    if simulation is None:
        simulation, one_step_fit = newest_run(estimate, newest_samples(estimate))
    settings, verdict = estimate.settings, estimate.assess() if verdict is None else verdict
    preprocess = (settings or estimate.request).preprocess
    entered, given = _number(preprocess.input_offset), simulation.offset  # not known yet during start-up: 0
    u, y, intervals = estimate.recent.T
    fit = simulation.fit
    if settings is not None and isinstance(verdict, Assessment) and not y.size:  # no raw samples are kept
        given, fit = _number(preprocess.output_offset), verdict.fit
    if y.size and (simulation.is_prediction or not has_rest(estimate.transfer_function, float(intervals.sum()))):
        entered, given = float(u.mean()), float(y.mean())
    return Model(
        estimate.structure,
        estimate.parameters,
        estimate.dt,
        covariance=estimate.covariance,
        noise=estimate.noise,
        input_hold=estimate.input_hold,
        input_map=preprocess.input_map,
        input_level=entered,
        output_level=given,
        simulated_fit=fit,
        one_step_fit=one_step_fit,
        rejected=tuple(estimate.rejected.items()),
        verdict=Verdict(verdict.status, verdict.reasons, verdict.excited),
        provenance=Provenance(_method(estimate), samples=estimate.samples),
    )


def _number(level: float | str) -> float:
    return 0.0 if isinstance(level, str) else float(level)


@quiet
def newest_run(estimate: Estimate, newest: NewestSamples) -> tuple[Simulation, float]:
    """Return the run of the model over the newest samples, and its fit one step ahead."""
    u, y = newest.input, newest.known_output
    if u.size == 0:
        return Simulation(u, 0.0, np.nan), np.nan
    preprocess = (estimate.settings or estimate.request).preprocess
    u, model = u - _number(preprocess.input_offset), estimate.transfer_function
    t = None if newest.regular else np.cumsum(newest.intervals)
    first = estimate.samples - u.size
    begins = [load - first for load in estimate.loads if load > first]
    found = model_output(model, u, y, estimate.dt, input_hold=estimate.input_hold, t=t, begins=begins)
    return found, found.fit if found.is_prediction else fit_percent(y, y - one_step(y - found.output))


def _method(estimate: Estimate) -> str:
    settings = estimate.settings
    if settings is None:
        return "srivc"  # the provisional model of the samples collected
    name = type(settings.optimizer).__name__
    if settings.instruments:
        return "recursive srivc" if settings.filter.follows_estimate else f"{name} with instruments"
    return name


@dataclass(frozen=True)
class NewestSamples:
    """Signals of the newest samples, (K,), in the units of the log; the input is mapped."""

    input: FloatArray  # (K, q) for several inputs
    output: FloatArray
    intervals: FloatArray  # seconds since the sample before
    reference: FloatArray  # empty without one
    judged: BoolArray  # which samples the verdict uses
    regular: bool  # whether all of them are one sampling time apart

    @property
    def known_output(self) -> FloatArray:
        """The output (K,), with NaN at samples that the verdict does not use."""
        return np.where(self.judged, self.output, np.nan)


def newest_samples(estimate: Estimate) -> NewestSamples:
    """Return the newest samples: all of `recent`, or the last 3,000 if the clock is irregular."""
    u, y, intervals = estimate.recent.T
    kept = estimate.recent_reference
    r, judged = np.zeros(0) if kept is None else kept, estimate.judged
    regular = bool((np.abs(intervals[1:] - estimate.dt) <= IRREGULAR * estimate.dt).all())
    last = slice(None) if regular else slice(-LONGEST_IRREGULAR, None)
    return NewestSamples(u[last], y[last], intervals[last], r[last], judged[last], regular)


def newest_of_row(identifier: RowIdentifier, found: RowFit | None) -> NewestSamples:
    """Return the newest samples of several inputs, with the first reference; ``found``: their fit, or None."""
    (u, y), intervals, references = identifier.recent, identifier.recent_intervals, identifier.recent_reference
    judged = np.isfinite(y)
    if found is not None:
        judged[np.concatenate([found.outliers, found.stuck])] = False
    regular = bool((np.abs(intervals[1:] - identifier.dt) <= IRREGULAR * identifier.dt).all())
    return NewestSamples(u, y, intervals, references[:, :1].ravel(), judged, regular)
