"""The whole record: at its end the estimate is solved for with every sample, as `fit` does, unless it changed."""

from __future__ import annotations

import math

import numpy as np

from replant.arguments import FloatArray
from replant.engine.recent_samples import RecentSamples
from replant.engine.record import Record
from replant.engine.state import State
from replant.kernels.schema import Alarm, Doubt, Supposition
from replant.offline.contest import weighed
from replant.offline.solve import Solution, solve
from replant.online.change_response import one_plant_before, since_change
from replant.online.restart import remembers_all, restart_at
from replant.settings import STORED, Settings
from replant.simulation.model_run import prediction_error, runs_away
from replant.statistics.linear_algebra import quiet


@quiet
def solve_whole(old: State, settings: Settings) -> State | None:
    """Return the state that begins at a solution of every sample so far; None where the present estimate stays.

    It stays where older samples are forgotten or no longer kept, and where the plant has changed, see `_has_changed`.
    """
    kept = RecentSamples.of(old, STORED)
    if not (old.adapt and remembers_all(old, settings) and old.finished_at < old.samples == len(kept)):
        return None
    solution = solve(settings.structure, kept.record(settings.dt, settings.filter.input_hold, parted=True))
    if solution is None:
        return None
    found = solution.found
    if old.change.is_of_plant and _lasts(old, settings) and _has_changed(old, settings, solution):
        return None
    away, left = _rank(settings, found.theta, solution.record)
    present = _rank(settings, old.physical, solution.record)
    if away > present[0] or not (found.acceptable or (away, left) < present):
        return None
    new = restart_at(old, settings, solution, 0)
    new.alarm, new.change_began, new.finished_at = Alarm.NONE, new.samples, new.samples
    new.gap_at = 0  # it was where an alarm ended: the record has no gap
    new.change, new.changed_at, new.undecided = Supposition.NOTHING, 0, False
    new.outliers, new.stuck = (int((solution.doubt == each).sum()) for each in (Doubt.OUTLIER, Doubt.STUCK))
    return new


def _lasts(state: State, settings: Settings) -> bool:
    """Return whether there was one change, and the records before and since are no shorter than a start-up.

    What changes more often, or sooner than it can be identified, is no linear plant: its model is that of all samples.
    """
    shortest = min(state.changed_at, state.samples - state.changed_at)
    return one_plant_before(state) == 0 and shortest >= settings.startup


def _has_changed(state: State, settings: Settings, whole: Solution) -> bool:
    """Return whether another plant since the last change explains the record better than one model of all samples."""
    contest = since_change(state, settings)
    if contest is None:
        return True
    claims = [*contest.claims(again=True), contest.whole(whole.found.theta)]
    return max(weighed(claims), key=lambda claim: claim.evidence).supposition.is_of_plant


def _rank(settings: Settings, model: FloatArray, record: Record) -> tuple[bool, float]:
    """Return whether a model runs away, without a reference, and what it leaves of the output: less is better."""
    denominator = np.append(1.0, model[settings.structure.denominator])
    return not settings.reference and runs_away(denominator, record.span), _left(settings, model, record)


def _left(settings: Settings, model: FloatArray, record: Record) -> float:
    """Return the mean square of what a model leaves of the measured output."""
    error = prediction_error(settings.structure, model[: settings.structure.size], record, settings.dt)
    return math.inf if error is None else float(error @ error) / max(record.count, 1)
