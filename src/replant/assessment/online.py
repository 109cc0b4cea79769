"""The verdict on an identifier, from what it keeps: the newest raw samples, and its estimate as it was before them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from replant.arguments import FloatArray
from replant.assessment import sensor
from replant.assessment.estimate import MOST_UNCERTAIN
from replant.assessment.evidence import Evidence
from replant.assessment.judge import RESTING, judge
from replant.assessment.verdict import Assessment, Finding, conclude
from replant.engine.covariance import covariance, slowness
from replant.engine.recent_samples import cleaned, record_of, since_last_gap, unrolled
from replant.engine.state import SHORTEST_STEP, State
from replant.kernels import schema as at
from replant.settings import Request, Settings

STUCK_LATELY = 200  # samples since the sensor was stuck, within which it is not relied on
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
    reason = f"starting: {u.size} of the {wanted} samples that the first model is made from"
    if wanted > request.startup:
        reason += f"; startup={request.startup} is too few for one that can be used"
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
    origin, samples = int(ints[at.ORIGIN]), int(ints[at.SAMPLES])
    kept = cleaned(unrolled(state))
    # the newest one at the least, where the record begins anew just now
    kept = kept[-max(samples - max(origin, int(ints[at.GAP_AT])), 1) :]
    record = record_of(since_last_gap(kept, dt), dt, settings.filter.input_hold)
    record = record if record.intervals.size == 1 else record.last(MOST_IRREGULAR)
    learned, earlier = earlier_estimate(state, size)
    known = covariance(state, settings)
    return Evidence(
        settings.structure,
        dt,
        record,
        estimate=state.theta[:size] * state.unit[:size],
        covariance=known if np.isfinite(known).all() else None,
        slowness=slowness(state, settings),
        earlier=earlier,
        unseen=min(samples - learned, record.u.size // 2),
        learned=learned - origin,
        refused=bool(ints[at.REFUSED]),
        adapts=bool(ints[at.ADAPT]),
        instruments=settings.instruments,
        follows=bool(ints[at.PAST_STEP] == SHORTEST_STEP),
        largest_power=float(state.reals[at.LARGEST_POWER]),
        grown=samples - int(ints[at.CHANGE_BEGAN]) if ints[at.ALARM] else 0,
        unsettled=_unsettled(state, settings, known),
        stuck=bool(ints[at.IS_STUCK]) and samples - int(ints[at.STUCK_LAST]) < STUCK_LATELY,
        usual_interval=float(np.median(kept[1:, 2])) if len(kept) > 1 else 0.0,
    )


def _unsettled(state: State, settings: Settings, known: FloatArray) -> float:
    """Return how uncertain a revised estimate is in what was known before the change, as a part of itself."""
    ints = state.ints
    forgotten = ints[at.PAST_STEP] == SHORTEST_STEP and ints[at.SAMPLES] - ints[at.REVISED] > ints[at.RECENT]
    if not state.was_revised or forgotten:  # what forgets is at length as uncertain by right
        return 0.0
    size = settings.structure.poles + settings.structure.zeros + 1
    before, std = np.abs(state.prior[:, :size])
    now = np.maximum(np.abs(state.theta * state.unit)[:size], before)
    share = np.sqrt(np.maximum(np.diag(known)[:size], 0.0)) / np.maximum(now, np.finfo(float).tiny)
    return float(share[std < MOST_UNCERTAIN * before].max(initial=0.0))


def earlier_estimate(state: State, size: int) -> tuple[int, FloatArray]:
    """Return the oldest past estimate (P,), or the present one if nothing was learned since, and its samples."""
    learned, estimate = int(state.ints[at.LEARNED]), state.theta
    kept = state.past[: min(int(state.ints[at.PAST_KEPT]), at.PAST)]
    oldest = kept[np.argmin(kept[:, 0])] if len(kept) else np.array([np.inf])
    if oldest[0] < learned:
        learned, estimate = int(oldest[0]), oldest[1:]
    return learned, estimate[:size] * state.unit[:size]
