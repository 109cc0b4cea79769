"""Solving again: the record so far, or the samples since a change, solved as a whole from the samples kept."""

from __future__ import annotations

import math

from replant.arguments import FloatArray
from replant.engine.dimensions import RECENT
from replant.engine.recent_samples import RecentSamples
from replant.engine.state import State
from replant.kernels.schema import Alarm
from replant.offline.solve import Solution, solve
from replant.online.estimate_movement import asked_for
from replant.online.restart import SURE, restart_at, restart_from_prior
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

MATURE = 8
"""Length of the record before which its estimate may itself have gone astray, and goes on to be solved again
[start-ups].
Origin: three doublings of the start-up, after each of which the record is solved again.
Sensitivity: halved, 52 samples held against 'load step' instead of 49; error of 'load step' times 0.54; doubled,
nothing changes on these records.
"""


def next_solution(state: State, settings: Settings) -> int:
    """Return the number of accepted samples at which it is next seen to whether the record is solved; 0: never.

    The record is solved again when it is twice as long as at the last solution, and before where the estimate moves.
    """
    origin, samples = _origin(state), state.samples
    twice = origin + 2 * (state.solved_at - origin)
    due = origin + math.ceil(GROWTH * (samples - origin))
    due = min(due, twice) if twice > samples else due
    if state.was_revised and samples - origin < RECENT:  # the last one uses all samples kept, as a slow mode needs them
        due = min(due, origin + RECENT)
    return due if remembers_all(state, settings) and due - origin <= RECENT else 0


def _origin(state: State) -> int:
    """Return the accepted samples before those that a solution uses."""
    return state.revised_from if state.was_revised else state.record_began


def _is_due(state: State, settings: Settings) -> bool:
    """Return whether the record has doubled since the last solution, or the estimate moves beyond chance."""
    origin, samples = _origin(state), state.samples
    is_last = state.was_revised and samples - origin == RECENT
    return is_last or samples - origin >= 2 * (state.solved_at - origin) or asked_for(state, settings) is not None


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
    if old.was_revised:
        return _revised_again(old, settings)
    origin = old.record_began
    kept = RecentSamples.of(old)
    if old.gap_at > origin or old.samples - origin > len(kept) or (old.alarm and is_mature(old, settings)):
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


def _revised_again(old: State, settings: Settings) -> State | None:
    """Return the state revised anew from the estimate before a change, by all samples since; None where that fails."""
    begin = old.revised_from
    kept = RecentSamples.since(old, begin)
    if old.samples - begin > len(kept) or kept.doubted > MOST_DOUBTED:
        return None
    kept.output[:] = kept.bridged
    new = restart_from_prior(old, settings, kept)
    if new is not None:
        new.alarm, new.change_began = Alarm.NONE, new.samples
    return new


def is_mature(state: State, settings: Settings) -> bool:
    """Return whether the record is so long that a larger residual means a changed plant, not a wrong estimate.

    True as well where the record is not solved again as it grows, as with a forgetting factor.
    """
    length = state.samples - state.record_began
    return length >= MATURE * settings.startup or not next_solution(state, settings)
