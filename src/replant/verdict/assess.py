"""The verdicts on a record, on an identifier that keeps raw samples, and on one that keeps running sums alone.

| question, of an identifier that keeps too few samples to test its estimate | answered by |
|---|---|
| does the input move | its moving variance, relative to the largest so far |
| does it excite every coefficient | the information matrix of the recursion, nuisances eliminated |
| does the model follow the output | the moving mean square of the a-priori error, beside the variance of the output |
| is the estimate certain | its covariance, by power and colour of the residual |
| has it converged | the past estimates that are kept |
| is the structure right | the verdict on the start-up, made while its samples were kept |
| have residual or sensor changed | the CUSUM test, ties, missing outputs |

What needs samples is not checked, and the verdict says so.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from replant.estimation.engine.dimensions import FEWEST_JUDGED, RECENT
from replant.estimation.engine.estimate_covariance import covariance, slowness
from replant.estimation.engine.recent_samples import RecentSamples
from replant.estimation.engine.record import Record
from replant.estimation.engine.state import GAP, SHORTEST_STEP, State
from replant.estimation.settings import STORED, Request, Settings
from replant.estimation.simulation.model_run import PER_COEFFICIENT
from replant.estimation.solver.record_changes import plant_changed
from replant.kernels.monitoring.outliers import CALM
from replant.kernels.schema import PAST, Doubt
from replant.model.structure import Structure
from replant.model.uncertainty import cancelled_pole
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.linear_algebra import compose, eigenvalues, inverse_of, quiet, real_coefficients
from replant.verdict.estimate_tests import (
    MOST_UNCERTAIN,
    MOST_UNCERTAIN_IN_LOOP,
    movement_findings,
    uncertainty_findings,
)
from replant.verdict.evidence import (
    CONSTANT,
    COPY,
    FEWEST,
    LEAST_POWER,
    STANDS_STILL,
    Evidence,
    is_constant,
    is_copy,
    moving,
)
from replant.verdict.reasons import POOREST_FIT, judge
from replant.verdict.sensor_and_excitation import (
    REFUSED,
    RESTED,
    Excitation,
    clock_finding,
    guard_findings,
    level_finding,
)
from replant.verdict.verdict import Assessment, Finding, conclude, duration, percent

MOST_SAMPLES = 50_000  # newest samples of a record that the verdict uses [samples]
MOST_IRREGULAR = 5000  # the same if each interval needs its own discretisation [samples]
NO_SAMPLE = Assessment("converging", ("no sample yet",))
NOT_CHECKED = (
    "history={}: too few raw samples are kept to solve the record again, and to check what else the input explains, "
    "feedback, the dead time, actuator, sensor and slow noise"
)
NO_SUMS = (
    "history={}: too few raw samples are kept for a verdict, and this optimizer follows no sums: give history=1000"
)


def assess_record(
    structure: Structure,
    parameters: FloatArray,
    record: Record,
    dt: float,
    covariance: FloatArray | None = None,
    *,
    unseen: bool = False,
    usual_interval: float | None = None,
    **noticed: Any,  # fields of `Evidence`
) -> Assessment:
    """Return the verdict on a model by a record; in sample, unless the record is ``unseen`` by the model."""
    irregular = record.intervals.size > 1
    rest = 0 if record.u.size <= MOST_SAMPLES else record.u.size - moving(record.u)
    rest = rest if rest > MOST_SAMPLES // 2 else 0  # a long rest may take half of the samples used, no more
    end = min(record.u.size - rest + MOST_SAMPLES // 2, record.u.size)
    looked_at = record.first(end).last(MOST_SAMPLES).answering(structure.delay)
    evidence = Evidence(
        structure,
        dt,
        looked_at,
        estimate=parameters,
        covariance=None if covariance is None or not np.isfinite(covariance).all() else covariance,
        earlier=parameters,
        unseen=looked_at.u.size if unseen else 0,
        learned=record.u.size,
        in_sample=not unseen,
        adapts=not unseen,
        finished=not unseen,
        usual_interval=usual_interval or (float(np.median(record.intervals[1:])) if irregular else 0.0),
        **noticed,
    )
    verdict = judge(evidence)
    if not rest:
        return verdict
    return replace(verdict, excited=False, reasons=(*verdict.reasons, RESTED.format(duration(record.last(rest).span))))


def assess_running(state: State, settings: Settings, history: int) -> Assessment:
    """Return the verdict on a running estimate; ``history``: the most raw samples that are kept."""
    if state.samples == 0:
        return NO_SAMPLE
    if history < FEWEST_JUDGED:
        return assess_sums(state, settings, history)
    return judge(evidence_of(state, settings))


def assess_starting(
    request: Request, kept: RecentSamples, wanted: int, solved: int, uncertainty: float, *, finished: bool
) -> Assessment:
    """Return the verdict during start-up; ``solved``: samples of the provisional model, or 0; ``finished``: at its end.

    ``wanted``: outputs for the next attempt at a model, twice those of an attempt that failed.
    """
    if not len(kept):
        return NO_SAMPLE
    u, there = kept.input, kept.is_measured
    count, failed = int(there.sum()), wanted > request.first_hold
    reason = f"starting: {count} of the {wanted} samples for the first model"
    if finished:
        few = f"; one takes {request.least_startup} at least" if count < request.least_startup else ""
        reason = f"the record of {count} samples gives no usable model{few}"
    elif failed:
        reason += "; the attempts before gave no usable model"
    findings = [Finding("converging", reason)]
    if solved:
        reason = f"the present model is provisional: it is made from {solved} samples and tested on none"
        findings.append(Finding("converging", reason))
    excited = not is_constant(u)
    if not excited:
        findings.append(Finding("not excited", CONSTANT))
    elif (finished or failed) and is_constant(kept.output[there]):
        findings.append(Finding("inconsistent", STANDS_STILL.format(f"the last {duration(kept.interval[1:].sum())}")))
    elif is_copy(u[there], kept.output[there]):
        findings.append(Finding("inconsistent", COPY))
    if u.size > 1:
        findings += clock_finding(float(np.median(kept.interval[1:])), request.dt)
    findings += level_finding(u[there], kept.output[there])
    return Assessment(*conclude(findings, ""), excited=excited, samples=u.size, uncertainty=uncertainty)


@quiet
def evidence_of(state: State, settings: Settings) -> Evidence:
    """Return the evidence for a verdict from a state."""
    dt, origin, samples = settings.dt, state.record_began, state.samples
    if state.finished_at == samples:
        return _of_solution(state, settings)
    raw = RecentSamples.of(state).cleaned()
    in_use, intervals = _in_use(raw, state), raw.interval[-max(samples - origin, 1) :][1:]
    kept = in_use.since_last_gap(dt)
    seen = kept.changed(output=np.where(kept.is_stuck, kept.bridged, kept.output))
    record, is_well = seen.record(dt, settings.filter.input_hold, parted=True), _is_well(kept)
    if is_well and kept.is_stuck.any():  # outputs of a past fault are left out, and the verdict says so
        record = replace(record, measured=record.is_measured & ~kept.is_stuck)
    record = record if record.intervals.size == 1 else record.last(MOST_IRREGULAR)
    record = record.answering(settings.structure.delay)
    newest = kept[len(kept) - record.u.size :]
    # the record begins where an alarm ended, without a change or a gap in time
    began = len(kept) == len(in_use) == samples - state.gap_at and state.gap_at > max(origin, state.changed_at)
    # an estimate that forgets has the uncertainty of its memory once a change is older than the newest samples
    follows, changed = state.past_step == SHORTEST_STEP, max(state.revised_from, origin)
    return replace(
        _of_state(state, settings, record),
        follows=follows,
        usual_power=state.usual_variance * settings.scaling.output**2 if state.noise_has_grown else 0.0,
        grown=samples - state.change_began if state.alarm else 0,
        after_change=changed > 0 and not (follows and samples - changed > RECENT),
        undecided=state.undecided > 0,
        begun_anew=samples - state.changed_at if state.change.is_of_plant and not state.undecided else 0,
        after_alarm=began and bool(in_use.interval[0] <= GAP * dt),
        missing=_missing(in_use),
        stuck=bool(kept.is_stuck[-CALM:].any()),
        left_out=int(kept.is_stuck.sum()) if is_well else 0,
        usual_interval=float(np.median(intervals)) if intervals.size else 0.0,
        measured=newest.output.copy(),
        bridged=newest.is_replaced,
    )


def _of_solution(state: State, settings: Settings) -> Evidence:
    """Return the evidence of a record that has ended and was solved as a whole, as by `fit`."""
    structure, kept = settings.structure, RecentSamples.of(state, STORED)
    solved = kept.changed(output=np.where(kept.is_bridged, kept.bridged, kept.output))
    record = solved.record(settings.dt, settings.filter.input_hold, parted=True)
    begins, intervals = kept.loads, record.intervals
    if kept.is_bridged.any():
        record = replace(record, measured=~kept.is_bridged)
    divided = replace(record, begins=begins).levelled if begins else record
    change = plant_changed(
        structure, divided, state.physical[: structure.size], loads=bool(divided.begins), most=MOST_SAMPLES
    )
    record = record if state.undecided else divided
    evidence = _of_state(state, settings, record.answering(structure.delay))
    return replace(
        evidence,
        finished=True,
        plant_change=change,
        loads=tuple(record.since_first(begin) for begin in begins),
        undecided=state.undecided > 0,
        disagreement=state.disagreement,
        left_out=state.stuck,
        missing=_missing(kept),
        usual_interval=float(np.median(intervals[1:])) if intervals.size > 1 else 0.0,
    )


def _of_state(state: State, settings: Settings, record: Record) -> Evidence:
    """Return the evidence of a running estimate and a record, without the findings of the monitoring."""
    size, known = settings.structure.size, covariance(state, settings)
    learned, earlier = earlier_estimate(state, size)
    return Evidence(
        settings.structure,
        settings.dt,
        record,
        estimate=state.physical[:size],
        covariance=known if np.isfinite(known).all() else None,
        slowness=slowness(state, settings),
        earlier=earlier,
        unseen=min(state.samples - learned, record.u.size // 2),
        learned=learned - state.record_began,
        refused=state.refused > 0,
        adapts=state.adapt,
        instruments=settings.instruments,
        largest_power=state.largest_power,
        trusted_before=state.trusted_at > 0,
        since_trusted=state.samples - state.trusted_at,
        filtered=state.noise.filters > 0.0,
        input_zero=-state.input_offset,
    )


def judged(state: State, dt: float) -> BoolArray:
    """Return which raw samples kept (K,) the verdict uses: since the last interruption, neither bridged nor stuck."""
    kept = RecentSamples.of(state)
    used = kept if state.finished_at == state.samples else _in_use(kept, state).since_last_gap(dt)
    return np.asarray((np.arange(len(kept)) >= len(kept) - len(used)) & ~(kept.is_bridged | kept.is_stuck))


def _in_use(kept: RecentSamples, state: State) -> RecentSamples:
    """Return the raw samples since the record began or was interrupted, at least the newest one."""
    return kept[-max(state.samples - max(state.record_began, state.gap_at), 1) :]


def _is_well(kept: RecentSamples) -> bool:
    """Return whether a sensor that was stuck has since worked for as long, with outputs on both sides of the fault."""
    stuck = np.flatnonzero(kept.is_stuck)
    if not stuck.size:
        return True
    held, given = kept.output[stuck], kept.output[~kept.is_stuck]
    # without outputs beyond, the value may be an end of the scale, and the sensor sticks again when the output is near
    has_lasted = len(kept) - 1 - stuck[-1] >= max(CALM, stuck[-1] - stuck[0])
    return bool(has_lasted and (given < held.min()).any() and (given > held.max()).any())


def _missing(kept: RecentSamples) -> int:
    """Return the number of newest raw samples in a row without an output."""
    if not kept.are_examined:
        return 0
    there = np.flatnonzero(kept.doubt != Doubt.MISSING)
    return len(kept) - 1 - int(there[-1]) if there.size else len(kept)


def earlier_estimate(state: State, size: int) -> tuple[int, FloatArray]:
    """Return the oldest past estimate (P,) and the samples it has learned; the present one if none is older."""
    learned, estimate, kept = state.learned, state.theta, state.past[: min(state.past_kept, PAST)]
    oldest = kept[np.argmin(kept[:, 0])] if len(kept) else np.array([np.inf])
    if oldest[0] < learned:
        learned, estimate = int(oldest[0]), oldest[1:]
    return learned, estimate[:size] * state.unit[:size]


@quiet
def assess_sums(state: State, settings: Settings, history: int) -> Assessment:
    """Return the verdict by running sums, for an identifier that keeps too few raw samples."""
    if not (state.examines_output and settings.instruments):
        return Assessment("converging", (NO_SUMS.format(history),), samples=0)
    sums, size, poles = state.sums, settings.structure.coefficients, settings.structure.poles
    fit = math.nan
    if sums.output_power > 0.0:  # with the refined filter the error is that of a simulation
        fit = 100.0 * (1.0 - math.sqrt(sums.error_power / sums.output_power))
    known, estimate = covariance(state, settings)[:size, :size], state.physical[:size]
    sizes = real_coefficients(estimate[:poles], 1.0 / max(state.elapsed, settings.dt))
    std = np.sqrt(np.maximum(np.diag(known), 0.0))
    uncertainty = float((std[:poles] / sizes).max())
    learned, earlier = earlier_estimate(state, size)
    step = np.abs(earlier - estimate)
    sigmas = float((step / np.maximum(std, np.finfo(float).tiny)).max())
    found = Excitation(_condition(state, size), 1.0)
    findings, enough = _of_monitoring(state, settings), max(FEWEST, PER_COEFFICIENT * size)
    rests = _of_input(state)
    if sums.count < enough:
        seen = state.samples - state.record_began
        findings.append(Finding("converging", f"{seen} samples are too few for a verdict: it takes {enough}"))
    elif state.largest_power > 0.0:
        findings += found.findings
        if not fit >= POOREST_FIT:
            reason = f"run beside the plant, the model explains almost nothing of the output (fit {fit:.0f} %)"
            reason += ": if a controller moves the input, give its reference"
            findings.append(Finding("inconsistent", reason))
        most = MOST_UNCERTAIN_IN_LOOP if settings.reference else MOST_UNCERTAIN
        cancelled = cancelled_pole(settings.structure, state.physical, known)
        findings += uncertainty_findings(uncertainty, most, math.inf, cancelled, "", "take more samples")
        span = f"the last {duration((state.samples - learned) * settings.dt)}"
        findings += movement_findings(float((step[:poles] / sizes).max()), sigmas, span)
    findings += [*rests, Finding("trusted", NOT_CHECKED.format(history))]
    favour = f"run beside the plant, the model fits the output to {fit:.1f} %; its denominator's coefficients have"
    told = conclude(findings, f"{favour} standard deviations up to {percent(uncertainty)}")
    return Assessment(
        *told, not rests and not found.findings, int(sums.count),
        fit=fit, condition=found.condition, movement=sigmas, uncertainty=uncertainty,
    )  # fmt: skip


def _condition(state: State, size: int) -> float:
    """Return the condition number of the scaled instruments, as in `excitation`, from their information matrix."""
    information = inverse_of(compose(*state.factors)[:size, :size])
    scale = np.sqrt(np.diag(information))
    values = eigenvalues(information / np.outer(scale, scale))
    return math.sqrt(values[-1] / values[0]) if np.isfinite(values).all() and values[0] > 0.0 else math.inf


def _of_input(state: State) -> list[Finding]:
    if not state.largest_power > 0.0:
        return [Finding("not excited", CONSTANT)]
    if state.input_power < LEAST_POWER * state.largest_power:
        part = percent(state.input_power / state.largest_power)
        reason = f"the input hardly moves any more: its variance is {part} of its largest so far"
        return [Finding("trusted", reason)]  # the sums are from the time when it moved
    return []


def _of_monitoring(state: State, settings: Settings) -> list[Finding]:
    findings = [Finding("diverged", REFUSED)] if state.refused else []
    if state.sums.refuted:
        reason = "the samples of the start-up spoke against the model that they gave: a plant of more poles, or not"
        findings.append(Finding("inconsistent", f"{reason} linear; fit says more of them"))
    return findings + guard_findings(
        state.sums.missing * settings.dt if state.sums.missing > GAP else 0.0,
        bool(state.stuck_outputs) and state.samples - state.stuck_last < CALM,
        (state.samples - state.change_began) * settings.dt if state.alarm else 0.0,
        bool(state.undecided),
        "" if state.look_at else "; nothing is learned until it is as before: reset begins anew",
    )
