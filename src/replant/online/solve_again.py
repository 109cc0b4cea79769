"""Solving again: the record so far, or the samples since a change, solved as a whole from the samples kept."""

from __future__ import annotations

import math

from replant.arguments import FloatArray
from replant.engine.dimensions import RECENT
from replant.engine.recent_samples import RecentSamples
from replant.engine.state import State
from replant.offline.solve import Solution, solve
from replant.online.estimate_movement import asked_for
from replant.online.restart import SURE, restart_at
from replant.settings import Settings
from replant.simulation.prediction import prediction_error
from replant.statistics.autoregression import likelihood_ratio
from replant.statistics.linear_algebra import quiet

MOST_DOUBTED = 0.05
"""Share of bridged samples up to which a record is one that can be solved [share of samples].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved, nothing changes on these records; doubled, no verdict changes, and no error by a quarter.
"""

GROWTH = 1.25
"""Growth of the record after which it is seen to whether the estimate moves [ratio of lengths].
Origin: three looks between two solutions; on a chirp the last solution of 3,799 samples was at 2,000, and of another
plant.
Sensitivity: halved, 48 samples held against 'load step' instead of 49; error of 'stuck, coarse scale' times 2.4;
doubled, no verdict changes, and no error by a quarter.
"""

AFTER_CHANGE = 1.5
"""The same of the record since a change that is believed, after which it is asked again what has changed [ratio of
lengths].
Derivation: all contests together cost three times the last one.
Sensitivity: not measured.
"""


def next_solution(state: State, settings: Settings) -> int:
    """Return the number of accepted samples at which it is next seen to whether the record is solved; 0: never.

    The record is solved again when it is twice as long as at the last solution, and before where the estimate moves.
    """
    origin, samples = state.changed_at or state.record_began, state.samples
    twice = origin + 2 * (state.solved_at - origin)
    due = origin + math.ceil((AFTER_CHANGE if state.changed_at else GROWTH) * (samples - origin))
    due = min(due, twice) if twice > samples else due
    return due if remembers_all(state, settings) and due - origin <= RECENT else 0


def _is_due(state: State, settings: Settings) -> bool:
    """Return whether the record has doubled since the last solution, or the estimate moves beyond chance."""
    origin = state.record_began
    return state.samples - origin >= 2 * (state.solved_at - origin) or asked_for(state, settings) is not None


def remembers_all(state: State, settings: Settings) -> bool:
    """Return whether the estimate is made from every sample of its record, none forgotten, and solved again."""
    keeps = settings.optimizer.keeps_colour and float(state.settings[0]) == 1.0
    return bool(keeps and settings.filter.follows_estimate)


@quiet
def solve_again(old: State, settings: Settings) -> State | None:
    """Return the state that begins at a solution of the whole record as it was measured.

    None where no usable model is found, where older samples are forgotten, or where the record has a gap.
    """
    if not (old.adapt and remembers_all(old, settings) and _is_due(old, settings)):
        return None
    origin = old.record_began
    kept = RecentSamples.of(old)
    if old.gap_at > origin or old.samples - origin > len(kept) or old.alarm:
        return None
    record = kept[len(kept) - (old.samples - origin) :].record(settings.dt, settings.filter.input_hold, parted=True)
    solution = solve(settings.structure, record, [old.physical], afresh=True)
    if solution is None or not _is_usable(solution, settings, old.physical):
        return None
    return restart_at(old, settings, solution, origin)


def _is_usable(solution: Solution, settings: Settings, present: FloatArray) -> bool:
    """Return whether an estimate is certain, or explains its record better than the present one, beyond chance."""
    found = solution.found
    if found.acceptable or not found.settled:
        return found.acceptable
    size, record = settings.structure.size, solution.record
    errors = [prediction_error(settings.structure, each[:size], record, settings.dt) for each in (found.theta, present)]
    if errors[0] is None or errors[1] is None:
        return errors[0] is not None
    return likelihood_ratio(errors[0], errors[1]) > SURE
