"""The verdict on an identifier, from what it keeps: the newest raw samples, and its estimate as it was before them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from replant.assessment import sensor
from replant.assessment.evidence import Evidence
from replant.assessment.judge import RESTING, judge
from replant.assessment.verdict import Assessment, Finding, conclude
from replant.covariance import covariance
from replant.kernels import layout as at
from replant.refined import Record
from replant.settings import Request, Settings
from replant.state import GAP, SHORTEST_STEP, State
from replant.validation import FloatArray

MOST_IRREGULAR = 5000  # samples looked at where each interval costs a discretisation of its own


def assess_running(state: State, settings: Settings) -> Assessment:
    """Return the verdict on an estimate in use."""
    return judge(evidence_of(state, settings))


def assess_starting(request: Request, held: Sequence[tuple[float, float, float]], wanted: int) -> Assessment:
    """Return the verdict during start-up.

    Parameters
    ----------
    request : Request
    held : sequence of (u, y, t)
        Raw samples held so far; t is NaN for a regular clock.
    wanted : int
        How many there are to be by now.
    """
    if not held:
        return Assessment("converging", ("no sample yet",))
    u, y, t = np.array(held).T
    u = request.preprocess.map_input(u)
    reason = f"starting: {u.size} samples held of {wanted} that the first model is made from"
    if wanted > request.startup:
        reason += f" ({request.startup} were asked for, and not enough for one that can be used)"
    findings = [Finding("converging", reason)]
    if np.ptp(u) <= RESTING * np.abs(u).max():
        findings.append(Finding("not excited", "the input stands still: move it"))
    if u.size > 1 and not np.isnan(t).any():
        findings += sensor.clock_finding(float(np.median(np.diff(t))), request.dt)
    findings += sensor.level_finding(u, y)
    return Assessment(*conclude(findings, ""), samples=u.size)


def evidence_of(state: State, settings: Settings) -> Evidence:
    """Return the evidence that a state holds."""
    ints, dt, size = state.ints, settings.dt, settings.structure.size
    recent = unrolled(state)
    usual_interval = float(np.median(recent[1:, 2])) if len(recent) > 1 else 0.0
    recent = since_last_gap(recent, dt)
    regular = bool((recent[1:, 2] == dt).all())
    if not regular:
        recent = recent[-MOST_IRREGULAR:]
    samples = int(ints[at.SAMPLES])
    unit = state.unit[:size]
    record = Record(
        recent[:, 0].copy(),
        recent[:, 1].copy(),
        np.array([dt]) if regular else recent[:, 2].copy(),
        settings.filter.input_hold,
    )
    estimate = state.theta[:size] * unit
    learned, earlier = int(ints[at.LEARNED]), estimate
    kept = state.past[: min(int(ints[at.PAST_KEPT]), at.PAST)]
    if len(kept):
        oldest = kept[np.argmin(kept[:, 0])]
        if oldest[0] < learned:
            learned, earlier = int(oldest[0]), oldest[1 : 1 + size] * unit
    unseen = min(samples - learned, len(recent) // 2)
    known = covariance(state, settings)
    return Evidence(
        settings.structure,
        dt,
        record,
        estimate,
        known if np.isfinite(known).all() else None,
        earlier,
        unseen,
        learned,
        refused=bool(ints[at.REFUSED]),
        adapts=bool(ints[at.ADAPT]),
        instruments=settings.instruments,
        follows=bool(ints[at.PAST_STEP] == SHORTEST_STEP),
        largest_power=float(state.reals[at.LARGEST_POWER]),
        usual_interval=usual_interval,
    )


def unrolled(state: State) -> FloatArray:
    """Return the raw samples kept (K, 3), in their order."""
    samples, head = int(state.ints[at.SAMPLES]), int(state.ints[at.RECENT_HEAD])
    if samples < len(state.recent):
        return state.recent[:samples]
    return np.roll(state.recent, -head, axis=0)


def since_last_gap(recent: FloatArray, dt: float) -> FloatArray:
    """Return the samples since the last interruption."""
    gaps = np.flatnonzero(recent[1:, 2] > GAP * dt)
    return recent[gaps[-1] + 1 :] if gaps.size else recent
