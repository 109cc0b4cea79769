"""The verdict on an identifier, from the newest raw samples that it keeps and its estimate from before them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from replant.arguments import BoolArray, FloatArray
from replant.assessment import sensor_faults
from replant.assessment.assess_sums import assess_sums
from replant.assessment.evidence import Evidence
from replant.assessment.judge import RESTING, judge
from replant.assessment.verdict import Assessment, Finding, conclude
from replant.engine.covariance import covariance, slowness
from replant.engine.dimensions import FEWEST_JUDGED, RECENT
from replant.engine.recent_samples import RecentSamples
from replant.engine.state import GAP, SHORTEST_STEP, State
from replant.kernels.schema import PAST, Doubt
from replant.settings import STORED, Request, Settings
from replant.statistics.linear_algebra import quiet

MOST_IRREGULAR = 5000
"""Samples that the verdict looks at where each interval costs a discretisation of its own [samples]."""
NO_SAMPLE = Assessment("converging", ("no sample yet",))


def assess_running(state: State, settings: Settings, history: int) -> Assessment:
    """Return the verdict on an estimate in use that keeps at most so many raw samples."""
    if state.samples == 0:
        return NO_SAMPLE
    if history < FEWEST_JUDGED:
        return assess_sums(state, settings, history)
    return judge(evidence_of(state, settings))


def assess_starting(
    request: Request,
    kept: RecentSamples,
    wanted: int,
    solved: int = 0,
    uncertainty: float = math.nan,
) -> Assessment:
    """Return the verdict during start-up."""
    if not len(kept):
        return NO_SAMPLE
    u, there = kept.input, kept.is_measured
    reason = f"starting: {int(there.sum())} of the {wanted} samples for the first model"
    if wanted > request.startup:
        reason += f"; startup={request.startup} samples gave no usable model"
    findings = [Finding("converging", reason)]
    if solved:
        reason = f"the present model is provisional: it is made from {solved} samples and tested on none"
        findings.append(Finding("converging", reason))
    if np.ptp(u) <= RESTING * np.abs(u).max():
        findings.append(Finding("not excited", "the input is constant: move it"))
    if u.size > 1:
        findings += sensor_faults.clock_finding(float(np.median(kept.interval[1:])), request.dt)
    findings += sensor_faults.level_finding(u[there], kept.output[there])
    excited = all(finding.status != "not excited" for finding in findings)
    return Assessment(*conclude(findings, ""), excited=excited, samples=u.size, uncertainty=uncertainty)


@quiet
def evidence_of(state: State, settings: Settings) -> Evidence:
    """Return the evidence for a verdict that a state holds."""
    from replant.kernels.monitoring import outliers

    dt, size, origin, samples = settings.dt, settings.structure.size, state.record_began, state.samples
    finished = state.finished_at == samples
    in_use = _in_use(RecentSamples.of(state, STORED if finished else RECENT).cleaned(), state)
    kept = in_use if finished else in_use.since_last_gap(dt)
    record = kept.without_stuck().record(dt, settings.filter.input_hold, parted=True)
    is_well = finished or _is_well(kept)  # what is over is left out, and said
    if is_well and kept.is_stuck.any():
        record = replace(record, measured=record.is_measured & ~kept.is_stuck)
    record = record if record.intervals.size == 1 else record.last(MOST_IRREGULAR)
    record = record.answering(settings.structure.delay)
    newest = kept[len(kept) - record.u.size :]
    learned, earlier = earlier_estimate(state, size)
    known = covariance(state, settings)
    return Evidence(
        settings.structure,
        dt,
        record,
        estimate=state.physical[:size],
        covariance=known if np.isfinite(known).all() else None,
        slowness=slowness(state, settings),
        earlier=earlier,
        unseen=min(samples - learned, record.u.size // 2),
        learned=learned - origin,
        refused=state.refused > 0,
        adapts=state.adapt,
        instruments=settings.instruments,
        follows=state.past_step == SHORTEST_STEP,
        largest_power=state.largest_power,
        grown=samples - state.change_began if state.alarm else 0,
        after_change=_is_after_change(state),
        undecided=state.undecided > 0,
        after_alarm=not finished and _is_after_alarm(state, in_use, kept, dt),
        trusted_before=state.trusted_at > 0,
        since_trusted=samples - state.trusted_at,
        finished=finished,
        disagreement=state.disagreement if finished else 0.0,
        input_zero=-state.input_offset,
        missing=_missing(in_use),
        stuck=not finished and bool(kept.is_stuck[-outliers.CALM :].any()),
        left_out=state.stuck if finished else int(kept.is_stuck.sum()) if is_well else 0,
        usual_interval=float(np.median(in_use.interval[1:])) if len(in_use) > 1 else 0.0,
        # a solution of the whole record has left out what the sensor did not measure
        measured=None if finished else newest.output.copy(),
        bridged=newest.is_bridged if finished else newest.is_replaced,
    )


def judged(state: State, dt: float) -> BoolArray:
    """Return which of the raw samples kept (K,) the verdict uses: those since the last interruption, not bridged."""
    kept = RecentSamples.of(state)
    used = _in_use(kept, state).since_last_gap(dt)
    return np.asarray((np.arange(len(kept)) >= len(kept) - len(used)) & ~(kept.is_bridged | kept.is_stuck))


def _in_use(kept: RecentSamples, state: State) -> RecentSamples:
    """Return the raw samples since the record began anew, at least the newest one."""
    return kept[-max(state.samples - max(state.record_began, state.gap_at), 1) :]


def _is_after_alarm(state: State, in_use: RecentSamples, kept: RecentSamples, dt: float) -> bool:
    """Return whether the samples of the verdict begin where an alarm ended, without a change or a gap in time."""
    began = len(kept) == len(in_use) == state.samples - state.gap_at
    began = began and state.gap_at > max(state.record_began, state.changed_at)
    return began and bool(in_use.interval[0] <= GAP * dt)


def _is_well(kept: RecentSamples) -> bool:
    """Return whether a sensor that was stuck has shown since that it is well.

    It has given other outputs for as long, and before or since some on both sides of those at which it was stuck:
    else an end of its scale may be there, where it is stuck again as soon as the output comes near.
    """
    from replant.kernels.monitoring import outliers

    stuck = np.flatnonzero(kept.is_stuck)
    if not stuck.size:
        return True
    held, given = kept.output[stuck], kept.output[~kept.is_stuck]
    has_lasted = len(kept) - 1 - stuck[-1] >= max(outliers.CALM, stuck[-1] - stuck[0])
    return bool(has_lasted and (given < held.min()).any() and (given > held.max()).any())


def _missing(kept: RecentSamples) -> int:
    """Return how many of the newest raw samples in a row came without an output."""
    if not kept.are_examined:
        return 0
    there = np.flatnonzero(kept.doubt != Doubt.MISSING)
    return len(kept) - 1 - int(there[-1]) if there.size else len(kept)


def _is_after_change(state: State) -> bool:
    """Return whether the estimate was begun anew, or revised, after a change of the plant.

    An estimate that forgets does not become better known for ever: once the change is older than the newest samples,
    its uncertainty is that of its memory.
    """
    changed = max(state.revised_from, state.record_began)
    forgotten = state.past_step == SHORTEST_STEP and state.samples - changed > RECENT
    return changed > 0 and not forgotten


def earlier_estimate(state: State, size: int) -> tuple[int, FloatArray]:
    """Return the oldest past estimate (P,) and how many samples it has learned; the present one if it is no older."""
    learned, estimate = state.learned, state.theta
    kept = state.past[: min(state.past_kept, PAST)]
    oldest = kept[np.argmin(kept[:, 0])] if len(kept) else np.array([np.inf])
    if oldest[0] < learned:
        learned, estimate = int(oldest[0]), oldest[1:]
    return learned, estimate[:size] * state.unit[:size]
