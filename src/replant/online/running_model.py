"""Running model: the model and the verdict of a running identification over its newest samples, for fits and views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from replant.estimation.engine.dimensions import RECENT
from replant.estimation.simulation.fitted_run import Simulation, fit_percent
from replant.estimation.simulation.miso import Point, Row, RowRecord, evaluate
from replant.estimation.simulation.model_run import model_output
from replant.estimation.solver.solve import leaving_out
from replant.fitting.miso_solve import RowEstimate, RowSolution, doubts_of, with_outside
from replant.fitting.model import Model
from replant.fitting.model_fields import Provenance, has_rest
from replant.kernels.schema import Doubt
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.autoregression import one_step
from replant.numerics.linear_algebra import quiet
from replant.online.estimate import Estimate
from replant.online.miso_recursion import RowRecursion
from replant.online.miso_state import RowState
from replant.verdict.miso_inputs import controlled, timing
from replant.verdict.miso_tests import judged, left_out
from replant.verdict.sensor_and_excitation import FOLLOWED, guard_findings, left_out_finding
from replant.verdict.verdict import Assessment, Finding, Verdict, duration

NO_COLUMNS: Mapping[str, FloatArray] = {}

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


def is_regular(intervals: FloatArray, dt: float) -> bool:
    """Return whether samples are one sampling time apart, except for rounding."""
    return bool((np.abs(intervals[1:] - dt) <= IRREGULAR * dt).all())


def newest_samples(estimate: Estimate) -> NewestSamples:
    """Return the newest samples: all of `recent`, or the last 3,000 if the clock is irregular."""
    u, y, intervals = estimate.recent.T
    kept = estimate.recent_reference
    r, judged = np.zeros(0) if kept is None else kept, estimate.judged
    regular = is_regular(intervals, estimate.dt)
    last = slice(None) if regular else slice(-LONGEST_IRREGULAR, None)
    return NewestSamples(u[last], y[last], intervals[last], r[last], judged[last], regular)


@quiet
def newest_of(
    state: RowState, others: Mapping[str, FloatArray] = NO_COLUMNS
) -> tuple[RowRecord, RowSolution, Verdict] | None:
    """Return the newest samples, the estimate over them and the verdict; None if they are too few."""
    known = state.recursion
    if known is None:
        return None
    if np.isfinite(state.newest_rows[:, -2]).sum() <= known.delta.size:
        return None
    ready, row, references = state.record(RECENT)
    if row.count <= row.nuisances:
        return None
    is_moved = np.zeros(len(row.structures), bool) if known.instruments is None else known.instruments.is_moved
    ready, _ = with_outside(ready, references, row.names, is_moved)
    doubt = doubts_of(row, ready, _over(row, known), known.noise)
    row = Row(row.structures, leaving_out(ready.record, doubt), ready.inputs, row.names, ready.outside)
    if row.count <= row.nuisances:
        return None
    point = _over(row, known)
    # findings of the last solution take precedence: without a noise model inputs seem to answer a coloured error
    of_model = state.findings or (*controlled(row, point, known.noise),) or (*timing(row, point),)
    findings: list[Finding] = []
    if not row.is_stable(point.theta):
        findings.append(Finding("diverged", "an update has made a pole unstable: solve again, with finish, or reset"))
    if known.surprising:
        findings += guard_findings(0.0, False, known.surprising * state.settings.dt, False)
    if known.counts[2]:
        findings.append(Finding("diverged", "an update would have left float64: begin again, with reset"))
    rest = {name: signal[ready.used] for name, signal in others.items()}
    findings += [*state.of_references, *left_out(row, point, known.noise, rest)]  # the column that explains most
    findings += left_out_finding(int((doubt == Doubt.STUCK).sum()))
    if state.record_began:
        findings.append(Finding("trusted", FOLLOWED.format(duration(state.length * state.settings.dt))))
    found = RowEstimate(point, known.noise, known.covariance, (*of_model, *findings))
    verdict = judged(row, point, known.noise, known.covariance, of_model, findings, is_of_record=False)
    return ready, RowSolution(row, found, doubt), verdict


def _over(row: Row, known: RowRecursion) -> Point:
    """Return the estimate evaluated over a row."""
    theta = known.parameters_in(row)
    point = evaluate(row, theta, known.noise)
    return evaluate(row, theta, known.noise, point)  # with the initial states of the first
