"""Revision: at growing counts, at an alarm and at the end, the model of all samples so far is determined again.

The record is solved again, and hypotheses on changes of the plant compete.  An estimate that forgets nothing follows a
change more slowly in a longer record.  The CUSUM test finds a change that makes the residual grow
(`online.change_response`).  A change of the gain by a tenth, or by a quarter with strong noise, hardly does; the score
shows it (`estimation.solver.change_search`).  No decision is final.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np

from replant.estimation.engine.dimensions import RECENT
from replant.estimation.engine.recent_samples import RecentSamples
from replant.estimation.engine.state import State
from replant.estimation.settings import STORED, Settings
from replant.estimation.simulation.model_run import prediction_error, runs_away
from replant.estimation.solver.change_contest import Claim, decided, is_sure
from replant.estimation.solver.change_search import begin_of_change, change_at, change_within
from replant.estimation.solver.record_changes import Parted
from replant.estimation.solver.solve import Solution, solve
from replant.fitting.parted_record import rival_of, solve_parted
from replant.kernels.schema import Alarm, Doubt, Supposition
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import likelihood_ratio
from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import quiet
from replant.online.begin_recursion import note_loads, restart_at
from replant.online.change_response import (
    AGAIN,
    behind_loads,
    believed,
    gap_before,
    information_of,
    is_at_rest,
    look,
    looked_at,
    note_alarm,
    of_whole,
    remembers_all,
    remembers_since_change,
    since_change,
    tells_of_changes,
)
from replant.verdict import assess_running

SURELY = -math.log(ALPHA)  # significant log-likelihood ratio of two models [nats]
# half of the newest samples, so that the input still moves in the other half after it has come to rest
EVERY = RECENT // 2  # samples between two reviews of a long record, which note the verdict [samples]

GROWTH = 1.25
"""Growth of the record after which it is tested whether one model holds for it [ratio of lengths].
Origin: three tests between two solutions; on a chirp of 3,799 samples the last solution was at 2,000, and gave another
plant.
Sensitivity: halved, 48 samples held against 'load step' instead of 49; error of 'stuck, coarse scale' times 2.4;
doubled, no verdict changes, and no error by a quarter.
"""


def revise(state: State, settings: Settings, due: int, most: int) -> tuple[State, int]:
    """Return the next state, and the accepted samples at which the record is next examined."""
    samples = state.samples
    state.attention_at, state.attention = 0, False  # samples that are learned again must not stop for attention
    note_alarm(state, settings)
    if samples == due:
        state = (reconsider(state, settings) if state.changed_at else None) or renew(state, settings) or state
        due = next_revision(state, settings, most)
        # a trusted model at rest is noted before the samples that support the verdict are gone
        trusted = is_at_rest(state) and assess_running(state, settings, most).status == "trusted"
        state.trusted_at = state.samples if trusted else 0
    if samples == state.look_at:
        found, look_at = look(state, settings)
        if found is not state:
            state, due = found, next_revision(found, settings, most)
        state.look_at = look_at
    return state, due


def next_revision(state: State, settings: Settings, most: int) -> int:
    """Return the accepted samples at which the estimate is next examined; 0: never; ``most``: raw samples kept."""
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
def reconsider(old: State, settings: Settings) -> State | None:
    """Return the state after the last change is decided on again; None if nothing new is decided."""
    if old.alarm or not old.adapt or is_at_rest(old):
        return None
    claims = _claims_again(old, settings)
    found = decided(claims)
    if found is None:
        return None
    undecided = not is_sure(claims, found)
    if undecided and found.supposition is old.change is Supposition.LOAD:  # the same decision, still uncertain
        old.undecided = True
        return None
    return believed(old, settings, found, undecided=undecided)


def _claims_again(old: State, settings: Settings) -> list[Claim]:
    """Return the claims on the last change over all samples since; none if these are not all known."""
    if old.gap_at > old.changed_at or not remembers_since_change(old, settings):
        return []
    contest = since_change(old, settings)
    claims = [] if contest is None else contest.claims(again=True)
    return [*claims, *of_whole(old, settings, contest, gap_before(old), claims)] if contest and claims else []


@quiet
def renew(old: State, settings: Settings) -> State | None:
    """Return the state at a new solution of the record, or after a change found in it; None to keep the present one."""
    if old.alarm or not (old.adapt and remembers_all(old, settings)):
        return None
    began = max(old.record_began, old.gap_at)
    rows = min(old.samples - began or 1, STORED, len(old.recent))
    knows_more = rows < old.samples - old.record_began  # than these samples say
    # later the present estimate contains more information than the samples kept
    is_short = not knows_more and rows <= RECENT
    has_grown = is_short and old.samples - began >= AGAIN * (old.solved_at - began)
    # search for a change: always while the record is short, then whenever half of the samples kept are new; not at
    # rest, when new samples could not test another model
    count, half = old.samples - (old.changed_at or old.record_began), min(STORED, len(old.recent)) // 2
    is_due = count <= RECENT or half <= EVERY or count // half > (count - EVERY) // half
    is_searched = is_due and not is_at_rest(old)
    if not (is_searched or has_grown):
        return None
    structure = settings.structure
    record = RecentSamples.record_of(old, rows, settings.dt, settings.filter.input_hold)
    known = information_of(old, settings) if knows_more else None
    begin = begin_of_change(structure, record, old.physical, known) if is_searched else 0
    if begin and knows_more:
        return looked_at(old, settings, old.samples - rows + begin)
    if not (begin or has_grown):
        return None
    solution = solve(structure, record, [old.physical], afresh=is_short)
    if solution is None:
        return None
    found = change_at(structure, solution.record, solution.found.theta, begin) if begin else None
    if found is not None and not found.goes_on:
        return believed(old, settings, found.claim, undecided=not is_sure(found.claims, found.claim))
    if not (is_short and _advantage(solution, settings, old.physical) > SURELY):
        return None
    new = restart_at(old, settings, solution, began)
    new.undecided = False  # the record has grown by half, and one model still explains it
    return new


def _advantage(solution: Solution, settings: Settings, present: FloatArray) -> float:
    """Return the log-likelihood ratio of a solution to the present estimate [nats]; infinite if one is excluded."""
    structure, found, record = settings.structure, solution.found, solution.record
    # without a reference a model that does not diverge is preferred to one that does, unless the latter is acceptable
    # and more likely, as for an integrator
    models = found.theta, present
    away = [
        not settings.reference and runs_away(np.append(1.0, each[structure.denominator]), record.span)
        for each in models
    ]
    if away[0] < away[1] or (found.acceptable and away[0] == away[1]):
        return math.inf
    if not found.settled or (away[0] > away[1] and not found.acceptable):
        return -math.inf
    errors = [prediction_error(structure, each[: structure.size], record, settings.dt) for each in models]
    new, old = (np.array([math.inf]) if each is None else each for each in errors)
    return likelihood_ratio(new, old)


@quiet
def solve_whole(old: State, settings: Settings) -> State | None:
    """Return the state at a solution of every sample so far; None to keep the present estimate."""
    kept = RecentSamples.of(old, STORED)
    if not (old.adapt and remembers_all(old, settings) and old.finished_at < old.samples == len(kept)):
        return None
    record = kept.record(settings.dt, settings.filter.input_hold, parted=True)
    solution = solve(settings.structure, record, nested=True)
    if solution is None:
        return None
    structure = settings.structure

    @cache
    def with_loads(loads: tuple[int, ...]) -> Solution | None:
        return solve(structure, replace(record, begins=loads))

    # the search for loads has no use of a reference
    found = None if record.r is not None else solve_parted(structure, solution, with_loads, [old.physical])
    new = None if found is None else _behind(old, settings, found)
    if new is None:
        if old.change.is_of_plant and _has_changed(old, settings, solution):
            return None
        if _advantage(solution, settings, old.physical) < -SURELY:
            return None
        new = restart_at(old, settings, solution, 0)
        new.gap_at = 0  # it was set where an alarm ended: the record has no gap
        new.change, new.changed_at = Supposition.NOTHING, 0
        new.undecided = False
        _note_end(new, solution)
        # if a division may be right, and speaks against the model of all samples, that must not be trusted
        rival = None if found is None else rival_of(structure, solution, found, with_loads)
        if rival is not None:
            new.undecided = True
            note_loads(new, rival.loads, len(kept))
    return new


def _has_changed(old: State, settings: Settings, solution: Solution) -> bool:
    """Return whether the last change of the plant stands, or shows in a solution of the whole record."""
    claims = [] if old.alarm else _claims_again(old, settings)
    again = decided(claims)
    if again is not None and again.supposition.is_of_plant and is_sure(claims, again):
        return True
    structure = settings.structure
    return change_within(structure, solution.record, solution.found.theta[: structure.size]) is not None


def _behind(old: State, settings: Settings, parted: Parted[Solution | None]) -> State | None:
    """Return the state after the last load of a divided record; None unless that is sure and its model trusted."""
    if parted.solution is None or not (parted.loads and parted.is_sure):
        return None
    new = behind_loads(old, settings, parted.solution)
    if new is None:
        return None
    _note_end(new, parted.solution)
    note_loads(new, parted.loads, parted.solution.doubt.size)
    return new if assess_running(new, settings, len(new.recent)).status == "trusted" else None


def _note_end(state: State, solution: Solution) -> None:
    """Mark in the state that the record has ended and was solved as a whole, with the counts of its bad outputs."""
    state.alarm, state.change_began, state.finished_at = Alarm.NONE, state.samples, state.samples
    state.outliers, state.stuck = (int((solution.doubt == each).sum()) for each in (Doubt.OUTLIER, Doubt.STUCK))
