"""Restart: a state that begins at an estimate of the samples kept, and goes on at the newest of them."""

from __future__ import annotations

import numpy as np

from replant.assessment.evidence import LEAST_POWER, RESTED
from replant.engine.recent_samples import RecentSamples
from replant.engine.record import Record
from replant.engine.state import REGULAR, State
from replant.kernels.schema import Doubt
from replant.offline.refined import Refined
from replant.offline.solve import Solution
from replant.offline.srivc_steps import least_since
from replant.online.begin_recursion import initialize
from replant.online.startup import carry_over, note_doubts, warm_up
from replant.settings import Settings

AGAIN = 1.5
"""Growth of a record after which it is solved again: of all samples, of those since an alarm, and of those since a
change that is believed [ratio of lengths].
Derivation: the last solution has then two thirds of the samples, and all solutions together cost three times the last.
"""


def remembers_all(state: State, settings: Settings) -> bool:
    """Return whether the estimate is made from every sample of its record, none forgotten, and solved again."""
    return float(state.settings[0]) == 1.0 and is_solved_again(settings)


def is_solved_again(settings: Settings) -> bool:
    """Return whether the estimate is one that a solution of the raw samples can stand in for."""
    return bool(settings.optimizer.keeps_colour and settings.filter.follows_estimate)


def remembers_since_change(state: State, settings: Settings) -> bool:
    """Return whether no sample since the last change, or of the record, weighs less than 1/e of the newest one."""
    since = state.samples - (state.changed_at or state.record_began)
    return is_solved_again(settings) and (1.0 - float(state.settings[0])) * since <= 1.0


def tells_of_changes(state: State, settings: Settings) -> bool:
    """Return whether as many raw samples are kept as a model of what came since a change takes."""
    return len(state.recent) >= least_since(settings.structure)


def is_at_rest(state: State) -> bool:
    """Return whether the input has rested since half of the time between two reviews, or in a quarter of those kept."""
    rested = min(RESTED, len(state.recent) // 4) if state.samples > len(state.recent) else RESTED
    newest = RecentSamples.of(state, rested).input
    return 0 < len(newest) == rested and float(np.var(newest)) < LEAST_POWER * state.largest_power


def restart(old: State, settings: Settings, refined: Refined, record: Record, origin: int) -> State:
    """Return a state that begins at a refined estimate and goes on at the newest sample of ``old``."""
    new = State.of_settings(settings, len(old.recent))
    initialize(new, settings, refined, record)
    stamps = REGULAR
    if record.intervals.size > 1:
        stamps = old.last_time - (record.intervals.sum() - np.cumsum(record.intervals))
    with new.without_preprocessing():
        warm_up(new, record.u, record.y, stamps, record.r, learn=False)
    new.ready_at = new.elapsed
    carry_over(old, new)
    new.record_began, new.solved_at = origin, old.samples
    return new


def restart_at(old: State, settings: Settings, solution: Solution, origin: int) -> State:
    """Return `restart` at the solution of a record as it was measured; what it left out is in doubt from now on."""
    new = restart(old, settings, solution.found, solution.record, origin)
    note_doubts(new, solution)
    return new


def clear_doubt(state: State, kept: RecentSamples) -> None:
    """Bridge the newest samples by the outputs that the model was solved with; no doubt is left of a measured one."""
    doubted = np.flatnonzero(kept.is_bridged & (kept.output != kept.bridged))
    rows, recent = (state.samples - len(kept) + doubted) % len(state.recent), RecentSamples(state.recent)
    recent.bridged[rows] = kept.output[doubted]
    recent.doubt[rows[recent.output[rows] == recent.bridged[rows]]] = Doubt.NONE
