"""Review: whether the plant has changed within the record, and a new beginning where it has.

An estimate that forgets nothing follows a change the more slowly, the longer the record is.  A change that makes the
residual grow is noticed by its CUSUM test (`online.change_response`).  A gain that is off by a tenth, or by a quarter
where the noise is strong, makes it grow little: that shows in the score of the samples since (`offline.change_search`).
"""

from __future__ import annotations

import numpy as np

from replant.assessment.evidence import LEAST_POWER, RESTED
from replant.engine.dimensions import RECENT
from replant.engine.recent_samples import RecentSamples
from replant.engine.state import State
from replant.kernels.schema import Alarm
from replant.offline.change_search import find_change
from replant.online.restart import clear_doubt, restart
from replant.online.solve_again import MOST_DOUBTED, next_solution, remembers_all
from replant.settings import Settings
from replant.statistics.linear_algebra import quiet

EVERY = RECENT // 2
"""Samples between two reviews, and the fewest that one uses [samples].
Derivation: half of the newest samples: as far back as the past estimates reach.
"""


def next_renewal(state: State, settings: Settings) -> int:
    """Return the number of accepted samples at which the record is solved again, or later reviewed; 0: never."""
    return next_solution(state, settings) or (state.samples + EVERY if settings.optimizer.keeps_covariance else 0)


def is_at_rest(state: State) -> bool:
    """Return whether the input has rested since half of the time between two reviews."""
    newest = RecentSamples.of(state, RESTED).input
    return len(newest) == RESTED and float(np.var(newest)) < LEAST_POWER * state.largest_power


@quiet
def review(old: State, settings: Settings) -> State | None:
    """Return the state that begins at the plant since it is found to have changed; None where it has not."""
    began = max(old.record_began, old.gap_at)
    if old.alarm or not (old.adapt and remembers_all(old, settings)):
        return None
    kept = RecentSamples.since(old, began)
    # at rest nothing that comes now could test another model
    if is_at_rest(old) or kept.doubted > MOST_DOUBTED:
        return None
    found = find_change(settings.structure, kept.record(settings.dt, settings.filter.input_hold), old.physical)
    refined = None if found is None else found.contest.estimate(found)
    if found is None or refined is None:
        return None
    new = restart(old, settings, refined, found.contest.since, old.samples - found.contest.since.u.size)
    clear_doubt(new, kept)
    new.past_kept, new.past_due = 0, new.samples
    new.alarm, new.change_began = Alarm.NONE, new.samples
    return new
