"""The whole record: at its end the estimate is solved for with every sample, as `fit` does, unless it changed."""

from __future__ import annotations

import math

import numpy as np

from replant.arguments import FloatArray
from replant.engine.dimensions import STORED
from replant.engine.recent_samples import RecentSamples
from replant.engine.state import GAP, State
from replant.kernels.schema import Alarm, Doubt
from replant.offline.refined import Refined
from replant.offline.srivc import refine
from replant.online.restart import SURE, clear_doubt, restart
from replant.online.solve_again import remembers_all
from replant.settings import Settings
from replant.simulation.prediction import prediction_error, runs_away
from replant.statistics.autoregression import likelihood_ratio
from replant.statistics.linear_algebra import quiet
from replant.statistics.robust import without_spikes


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
    is_whole = old.finished_at < old.samples == len(kept) and bool((kept.interval[1:] <= GAP * settings.dt).all())
    if not (old.adapt and remembers_all(old, settings) and is_whole):
        return None
    found = _solution(old, settings, kept)
    if found is None:
        return None
    refined, used = found
    since = max(old.record_began, old.revised_from, old.change_began if old.alarm else 0)
    if since and _has_changed(settings, refined.theta, old.physical, kept[since:]):
        return None
    away, left = _rank(settings, refined.theta, kept)
    present = _rank(settings, old.physical, kept)
    if away > present[0] or not (refined.acceptable or (away, left) < present):
        return None
    new = restart(old, settings, refined, used.record(settings.dt, settings.filter.input_hold), 0)
    clear_doubt(new, used)
    new.alarm, new.change_began, new.finished_at = Alarm.NONE, new.samples, new.samples
    new.gap_at = 0  # it was where an alarm ended: the record has no gap
    return new


def _has_changed(settings: Settings, whole: FloatArray, present: FloatArray, newest: RecentSamples) -> bool:
    """Return whether the samples since an alarm are those of another plant than the whole record's model.

    It leaves more than `outliers.GROWN` times the power that the present model does, as it makes an alarm, and that is
    no chance: a residual that drifts differs as much from one stretch to another.
    """
    from replant.kernels.monitoring import outliers

    if _left(settings, whole, newest) < outliers.GROWN * _left(settings, present, newest):
        return False
    record = newest.with_output(without_spikes(newest.output)).record(settings.dt, settings.filter.input_hold)
    size = settings.structure.size
    errors = [prediction_error(settings.structure, each[:size], record, settings.dt) for each in (present, whole)]
    if errors[0] is None or errors[1] is None:
        return errors[0] is not None
    return likelihood_ratio(errors[0], errors[1]) > SURE


def _solution(old: State, settings: Settings, kept: RecentSamples) -> tuple[Refined, RecentSamples] | None:
    """Return the estimate of the whole record, and the samples that it used; None where there is none.

    The outputs are those measured, or where the filters bridged some perhaps those that they saw; the estimate is what
    `fit` finds, or what the steps from the present one come to: what leaves least.  Without a reference a model that
    runs away comes last.
    """
    outputs = [without_spikes(kept.output)]
    if kept.is_bridged.any():
        outputs.append(kept.bridged)
    found = []
    for output in outputs:
        used = kept.with_output(output)
        record = used.record(settings.dt, settings.filter.input_hold)
        for refined in (refine(settings.structure, record), refine(settings.structure, record, [old.physical])):
            if refined is not None:
                found.append((_rank(settings, refined.theta, kept), refined, used))
    return min(found, key=lambda each: each[0])[1:] if found else None


def _rank(settings: Settings, model: FloatArray, kept: RecentSamples) -> tuple[bool, float]:
    """Return whether a model runs away, without a reference, and what it leaves of the output: less is better."""
    denominator = np.concatenate([[1.0], model[settings.structure.denominator]])
    away = not settings.reference and runs_away(denominator, float(kept.interval[1:].sum()))
    return away, _left(settings, model, kept)


def _left(settings: Settings, model: FloatArray, kept: RecentSamples) -> float:
    """Return the mean square of what a model leaves of the output, where the sensor gave one, without spikes."""
    record = kept.with_output(without_spikes(kept.output)).record(settings.dt, settings.filter.input_hold)
    error = prediction_error(settings.structure, model[: settings.structure.size], record, settings.dt)
    given = ~np.isin(kept.doubt, (Doubt.STUCK, Doubt.MISSING))
    return math.inf if error is None or not given.any() else float(np.mean(error[given] ** 2))
