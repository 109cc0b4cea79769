"""Resolving: the record so far, or what came since a change, solved as a whole from what the state keeps."""

from __future__ import annotations

import numpy as np

from replant.engine.dimensions import RECENT
from replant.engine.recent_samples import RecentSamples
from replant.engine.record import Record
from replant.engine.state import State
from replant.kernels.schema import Alarm, Doubt
from replant.offline.map_srivc import revise
from replant.offline.srivc import Refined, refine
from replant.online.initialization import initialize
from replant.online.startup import carry_over, warm_up
from replant.settings import Settings
from replant.statistics.linear_algebra import quiet

REGULAR = np.zeros(0)  # the time stamps of a regular clock

MOST_DOUBTED = 0.05
"""Share of bridged samples up to which a record is one that can be solved [share of samples].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

MATURE = 8
"""Length of the record before which its estimate may itself have gone astray, and goes on to be solved again
[start-ups].
Origin: three doublings of the start-up, after each of which the record is solved again.
Sensitivity: not measured.
"""


def next_solution(state: State, settings: Settings) -> int:
    """Return at how many accepted samples the record as a whole is solved again, twice of what it is; 0: never."""
    revised = state.was_revised
    origin, samples = state.revised_from if revised else state.record_began, state.samples
    remembers_all = settings.optimizer.keeps_colour and state.settings[0] == 1.0
    due = 2 * (samples - origin)
    if revised and samples - origin < RECENT:  # of a slow mode each sample tells
        due = min(due, RECENT)
    return origin + due if remembers_all and settings.filter.follows_estimate and due <= RECENT else 0


@quiet
def solve_again(old: State, settings: Settings) -> State | None:
    """Return the state after solving the record so far as a whole, from the present estimate.

    None where that leads to no model that could be used, or where the record is not in one piece.
    """
    if old.was_revised:
        return _revised_again(old, settings) if old.adapt else None
    origin = old.record_began
    kept = RecentSamples.since(old, origin)
    if old.gap_at > origin or not old.adapt or old.samples - origin > len(kept):
        return None
    if (old.alarm and is_mature(old, settings)) or kept.doubted > MOST_DOUBTED:
        return None
    kept.output[:] = kept.bridged
    record = kept.record(settings.dt, settings.filter.input_hold)
    refined = refine(settings.structure, record, [old.physical])
    if refined is None or not refined.acceptable:
        return None
    return restart(old, settings, refined, record, origin)


def _revised_again(old: State, settings: Settings) -> State | None:
    """Return the state after revising the estimate before a change once more, by all that came since."""
    begin = old.revised_from
    kept = RecentSamples.since(old, begin)
    if old.samples - begin > len(kept) or kept.doubted > MOST_DOUBTED:
        return None
    kept.output[:] = kept.bridged
    new = restart_from_prior(old, settings, kept)
    if new is not None:
        new.alarm, new.change_began = Alarm.NONE, new.samples
    return new


def restart_from_prior(old: State, settings: Settings, kept: RecentSamples, stayed: float = 1.0) -> State | None:
    """Return the state that begins at the estimate noted before a change, revised by a record.

    The record that the estimate is made from goes on: it is not solved again without what was known before.
    """
    from replant.kernels.monitoring import outliers

    record = kept.record(settings.dt, settings.filter.input_hold)
    usual = max(old.usual_variance, outliers.LEAST * old.largest_output) * settings.scaling.output**2
    before, std = old.prior
    found = revise(settings.structure, record, before, std, usual, old.stability_margin)
    if found is None or found[0].variance > outliers.GROWN * usual or found[1] > stayed:
        return None
    new = restart(old, settings, found[0], record, old.record_began)
    new.gap_at = new.revised_from = old.samples - len(kept)
    # as slow as the plant was it may still be
    new.stability_margin = min(new.stability_margin, old.stability_margin)
    new.forget_input = min(new.forget_input, old.forget_input)
    clear_doubt(new, kept)
    return new


def clear_doubt(state: State, kept: RecentSamples) -> None:
    """Take doubt off the newest raw samples where the model was solved for with the output as it was measured."""
    doubted = np.flatnonzero((kept.doubt > 0) & (kept.output != kept.bridged))
    rows, recent = (state.samples - len(kept) + doubted) % len(state.recent), RecentSamples(state.recent)
    recent.bridged[rows] = recent.output[rows]
    recent.doubt[rows] = Doubt.NONE


def is_mature(state: State, settings: Settings) -> bool:
    """Return whether the record is so long that a larger residual says more of the plant than of the estimate.

    What forgets is never solved again as it grows, and has nothing to wait for.
    """
    length = state.samples - state.record_began
    return length >= MATURE * settings.startup or not next_solution(state, settings)


def restart(old: State, settings: Settings, refined: Refined, record: Record, origin: int) -> State:
    """Return a state that begins at a refined estimate of the record since ``origin``, and goes on where ``old`` is."""
    new = State.of_settings(settings, RECENT)
    initialize(new, settings, refined, record)
    stamps = REGULAR
    if record.intervals.size > 1:
        stamps = old.last_time - (record.intervals.sum() - np.cumsum(record.intervals))
    with new.without_preprocessing():
        warm_up(new, record.u, record.y, stamps, learn=False)
    new.ready_at = new.elapsed
    carry_over(old, new)
    new.record_began = origin
    return new
