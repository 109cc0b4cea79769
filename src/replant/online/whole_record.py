"""The whole record: at its end the estimate is solved for with every sample, as `fit` does, unless it changed."""

from __future__ import annotations

import math

import numpy as np

from replant.arguments import FloatArray
from replant.engine.dimensions import STORED
from replant.engine.recent_samples import RecentSamples
from replant.engine.record import Record
from replant.engine.state import State
from replant.kernels.schema import Alarm, Doubt
from replant.offline.solve import solve
from replant.online.restart import SURE, restart_at
from replant.online.solve_again import remembers_all
from replant.settings import Settings
from replant.simulation.prediction import prediction_error, runs_away
from replant.statistics.autoregression import likelihood_ratio
from replant.statistics.linear_algebra import quiet


@quiet
def solve_whole(old: State, settings: Settings) -> State | None:
    """Return the state that begins at a solution of every sample so far; None where the present estimate stays.

    It stays where older samples are forgotten or no longer kept, and where the plant has changed, see `_has_changed`.

    Parameters
    ----------
    old : State
    settings : Settings
    """
    kept = RecentSamples.of(old, STORED)
    if not (old.adapt and remembers_all(old, settings) and old.finished_at < old.samples == len(kept)):
        return None
    solution = solve(settings.structure, kept.record(settings.dt, settings.filter.input_hold, parted=True))
    if solution is None:
        return None
    found = solution.found
    since = max(old.record_began, old.revised_from, old.change_began if old.alarm else 0)
    newest = solution.record.last(old.samples - since)
    if since and _lasts(old, settings) and _has_changed(settings, found.theta, old.physical, newest):
        return None
    away, left = _rank(settings, found.theta, solution.record)
    present = _rank(settings, old.physical, solution.record)
    if away > present[0] or not (found.acceptable or (away, left) < present):
        return None
    new = restart_at(old, settings, solution, 0)
    new.alarm, new.change_began, new.finished_at = Alarm.NONE, new.samples, new.samples
    new.gap_at = 0  # it was where an alarm ended: the record has no gap
    new.outliers, new.stuck = (int((solution.doubt == each).sum()) for each in (Doubt.OUTLIER, Doubt.STUCK))
    return new


def _lasts(state: State, settings: Settings) -> bool:
    """Return whether the records before and since the last change are no shorter than a start-up.

    What changes sooner than it can be identified is no linear plant: its model is that of all samples.
    """
    shortest = min(state.changed_at - state.before_began, state.samples - state.changed_at)
    return state.alarm != Alarm.NONE or not state.changed_at or shortest >= settings.startup


def _has_changed(settings: Settings, whole: FloatArray, present: FloatArray, newest: Record) -> bool:
    """Return whether the samples since an alarm are those of another plant than the whole record's model.

    It leaves more than `outliers.GROWN` times the power that the present model does, as it makes an alarm, and that is
    no chance: a residual that drifts differs as much from one stretch to another.
    """
    from replant.kernels.monitoring import outliers

    if _left(settings, whole, newest) < outliers.GROWN * _left(settings, present, newest):
        return False
    size = settings.structure.size
    errors = [prediction_error(settings.structure, each[:size], newest, settings.dt) for each in (present, whole)]
    if errors[0] is None or errors[1] is None:
        return errors[0] is not None
    return likelihood_ratio(errors[0], errors[1]) > SURE


def _rank(settings: Settings, model: FloatArray, record: Record) -> tuple[bool, float]:
    """Return whether a model runs away, without a reference, and what it leaves of the output: less is better."""
    denominator = np.append(1.0, model[settings.structure.denominator])
    return not settings.reference and runs_away(denominator, record.span), _left(settings, model, record)


def _left(settings: Settings, model: FloatArray, record: Record) -> float:
    """Return the mean square of what a model leaves of the measured output."""
    error = prediction_error(settings.structure, model[: settings.structure.size], record, settings.dt)
    return math.inf if error is None else float(error @ error) / max(record.count, 1)
