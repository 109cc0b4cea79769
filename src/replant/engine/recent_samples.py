"""Recent samples: the newest raw samples that a state keeps, in order, outliers bridged."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.engine.state import GAP, State
from replant.kernels import schema as at

STANDS = 2  # the doubt of a stuck sensor, as `replant.kernels.monitoring.outliers` numbers it
LONELY = 5  # outliers in a row that are no more than that; what lasts longer may be the plant


def unrolled(state: State) -> FloatArray:
    """Return the raw samples kept (K, 3), in their order."""
    samples, head = int(state.ints[at.SAMPLES]), int(state.ints[at.RECENT_HEAD])
    if samples < len(state.recent):
        return state.recent[:samples]
    return np.roll(state.recent, -head, axis=0)


def cleaned(kept: FloatArray) -> FloatArray:
    """Return a copy of raw samples (K, 3 or 5) with lonely outliers bridged, as the filters saw them."""
    kept = kept.copy()
    if kept.shape[1] <= at.DOUBTED:
        return kept
    rows = np.flatnonzero(kept[:, at.DOUBTED] == 1.0)
    for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
        if run.size <= LONELY:
            kept[run, at.OUTPUT] = kept[run, at.BRIDGED]
    return kept


def since_last_gap(recent: FloatArray, dt: float) -> FloatArray:
    """Return the samples since the last interruption."""
    gaps = np.flatnonzero(recent[1:, 2] > GAP * dt)
    return recent[gaps[-1] + 1 :] if gaps.size else recent


STUCK_RUN = 4  # ties in a row of a sensor that was stuck: what lies before is not looked at


def since(state: State, sample: int) -> FloatArray:
    """Return the raw samples kept since then, lonely outliers bridged."""
    kept = cleaned(unrolled(state))
    return kept[max(len(kept) - (int(state.ints[at.SAMPLES]) - sample), 0) :]


def after_stuck(kept: FloatArray) -> FloatArray:
    """Return the raw samples that came after a sensor was last stuck for a while."""
    stuck = np.convolve(kept[:, at.DOUBTED] == STANDS, np.ones(STUCK_RUN), "valid") == STUCK_RUN
    return kept[int(np.flatnonzero(stuck)[-1]) + STUCK_RUN :] if stuck.any() else kept


def record_of(kept: FloatArray, dt: float, input_hold: str) -> Record:
    """Return raw samples (K, 3 or more), input, output and interval, as a record."""
    u, y, intervals = kept[:, :3].T.copy()
    regular = bool((intervals[1:] == dt).all())
    return Record(u, y, np.array([dt]) if regular else intervals, input_hold)
