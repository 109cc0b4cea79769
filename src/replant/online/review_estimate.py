"""Review: whether the plant has changed without that the residual has shown it.

An estimate that forgets nothing follows a change the more slowly, the longer the record is.  A change that makes the
residual grow is noticed by its CUSUM test (`online.change_response`).  A gain that is off by a tenth, or by a quarter
where the noise is strong, makes it grow little: it shows in the score (`offline.change_search`).
"""

from __future__ import annotations

import numpy as np

from replant.assessment.evidence import LEAST_POWER, RESTED
from replant.engine.dimensions import RECENT
from replant.engine.recent_samples import RecentSamples
from replant.engine.state import State
from replant.offline.change_search import begin_of_change, find_change
from replant.offline.contest import is_sure
from replant.offline.solve import solve
from replant.online.change_response import believed, kept_since
from replant.online.solve_again import next_solution, remembers_all
from replant.settings import Settings
from replant.statistics.linear_algebra import quiet

EVERY = RECENT // 2
"""Samples between two reviews of a long record [samples].
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
    """Return the state that goes on where the plant is found to have changed since the record began; else None."""
    began = max(old.record_began, old.gap_at)
    if old.alarm or not (old.adapt and remembers_all(old, settings)):
        return None
    record = kept_since(old, began)[0].record(settings.dt, settings.filter.input_hold)
    begin = begin_of_change(settings.structure, record, old.physical)
    solution = solve(settings.structure, record, [old.physical]) if begin else None
    found = None if solution is None else find_change(settings.structure, solution, begin)
    return None if found is None else believed(old, settings, found[0], undecided=not is_sure(found[1], found[0]))
