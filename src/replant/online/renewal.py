"""Renewal: at growing counts the record is solved again, and asked whether the plant has changed within it.

An estimate that forgets nothing follows a change the more slowly, the longer the record is.  A change that makes the
residual grow is noticed by its CUSUM test (`online.change_response`).  A gain that is off by a tenth, or by a quarter
where the noise is strong, makes it grow little: it shows in the score (`offline.change_search`).
"""

from __future__ import annotations

import math

from replant.arguments import FloatArray
from replant.assessment.verdict import ALPHA
from replant.engine.dimensions import RECENT
from replant.engine.recent_samples import RecentSamples
from replant.engine.state import State
from replant.offline.change_search import begin_of_change, change_at
from replant.offline.contest import is_sure
from replant.offline.solve import Solution, solve
from replant.online.change_response import believed
from replant.online.restart import (
    AGAIN,
    is_at_rest,
    remembers_all,
    remembers_since_change,
    restart_at,
    tells_of_changes,
)
from replant.settings import STORED, Settings
from replant.simulation.model_run import prediction_error
from replant.statistics.autoregression import likelihood_ratio
from replant.statistics.linear_algebra import quiet

EVERY = RECENT // 2
"""Samples between two verdicts that are noted of a long record [samples].
Derivation: half of the newest samples, so that an input that has come to rest still moves in the other half.
"""

REVIEWED = STORED // 2
"""Samples between two searches of a long record for a change [samples].
Derivation: half of the samples kept are then new, as where a growing record is solved again; a search takes as long as
to learn them.
"""

GROWTH = 1.25
"""Growth of the record after which it is asked whether one model holds for it [ratio of lengths].
Origin: three looks between two solutions; on a chirp the last solution of 3,799 samples was at 2,000, and of another
plant.
Sensitivity: halved, 48 samples held against 'load step' instead of 49; error of 'stuck, coarse scale' times 2.4;
doubled, no verdict changes, and no error by a quarter.
"""


def next_renewal(state: State, settings: Settings, most: int) -> int:
    """Return the number of accepted samples at which the estimate is next looked into, of ``most`` kept; 0: never.

    The record is solved again at growing lengths (`AGAIN`), and before where the plant has changed.
    """
    if not tells_of_changes(state, settings):
        return 0
    origin, samples = state.changed_at or state.record_began, state.samples
    known = min(RECENT, most)
    due = origin + math.ceil((AGAIN if state.changed_at else GROWTH) * (samples - origin))
    if remembers_since_change(state, settings) and due - origin <= known:
        return due
    every = min(EVERY, max(known // 2, settings.startup))
    return samples + every if settings.optimizer.keeps_covariance else 0


@quiet
def renew(old: State, settings: Settings) -> State | None:
    """Return the state that goes on at a solution of the record as it was measured, or where the plant has changed.

    None where the record has not grown by `AGAIN` and one plant explains it, where no usable model is found, or where
    older samples are forgotten.
    """
    if old.alarm or not (old.adapt and remembers_all(old, settings)):
        return None
    began = max(old.record_began, old.gap_at)
    kept = RecentSamples.of(old, STORED)[-max(old.samples - began, 1) :]
    # short: the present estimate then knows more than the samples kept
    is_whole = old.gap_at <= old.record_began and RECENT >= len(kept) == old.samples - began
    has_grown = is_whole and old.samples - began >= AGAIN * (old.solved_at - began)
    is_searched = _is_searched(old) and not is_at_rest(old)  # at rest nothing that comes now could test another model
    if not (is_searched or has_grown):
        return None
    structure, record = settings.structure, kept.record(settings.dt, settings.filter.input_hold, parted=True)
    begin = begin_of_change(structure, record, old.physical) if is_searched else 0
    if not (begin or has_grown):
        return None
    solution = solve(structure, record, [old.physical], afresh=is_whole)
    if solution is None:
        return None
    found = change_at(structure, solution.record, solution.found.theta, begin) if begin else None
    if found is not None:
        return believed(old, settings, found[0], undecided=not is_sure(found[1], found[0]))
    usable = is_whole and _is_usable(solution, settings, old.physical)
    if not usable:
        return None
    new = restart_at(old, settings, solution, began)
    new.undecided = False  # the record has grown by half, and one model explains it still
    return new


def _is_searched(state: State) -> bool:
    """Return whether to search for a change: always while the record is short, then once in REVIEWED samples."""
    count = state.samples - (state.changed_at or state.record_began)
    return count <= RECENT or count // REVIEWED > (count - EVERY) // REVIEWED


def _is_usable(solution: Solution, settings: Settings, present: FloatArray) -> bool:
    """Return whether an estimate is certain, or explains its record better than the present one, beyond chance."""
    found = solution.found
    if found.acceptable or not found.settled:
        return found.acceptable
    size, record = settings.structure.size, solution.record
    errors = [prediction_error(settings.structure, each[:size], record, settings.dt) for each in (found.theta, present)]
    if errors[0] is None or errors[1] is None:
        return errors[0] is not None
    return likelihood_ratio(errors[0], errors[1]) > -math.log(ALPHA)
