"""Solving again: the record so far, or the samples since a change, solved as a whole from the samples kept."""

from __future__ import annotations

import math

import numpy as np

from replant.arguments import FloatArray
from replant.engine.dimensions import RECENT
from replant.engine.recent_samples import RecentSamples
from replant.engine.record import Record
from replant.engine.state import State
from replant.kernels.schema import Alarm, Doubt
from replant.model.structure import Structure
from replant.offline.map_srivc import revise
from replant.offline.refined import Refined
from replant.offline.srivc import refine
from replant.online.initialization import initialize
from replant.online.startup import carry_over, warm_up, without_spikes
from replant.settings import Settings
from replant.simulation.auxiliary_model import SLOWEST
from replant.simulation.model_run import run_model
from replant.simulation.prediction import prediction_error
from replant.statistics.autoregression import Autoregression
from replant.statistics.linear_algebra import quiet, roots

REGULAR = np.zeros(0)  # the time stamps of a regular clock

MOST_DOUBTED = 0.05
"""Share of bridged samples up to which a record is one that can be solved [share of samples].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

NEARER = 0.5
"""Typical error of a model, beside another's, below which the other is the one that is wrong [ratio of medians].
Derivation: outliers in up to a twentieth of the samples move a median by a tenth; a model that takes right outputs for
outliers is off by several standard deviations.
Sensitivity: not measured.
"""

EXPLAINED = 0.3
"""Part of the output's power that the input must explain, where a model is to replace another one after a change [part
of the output's power].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

SURE = 15.0
"""Gain in the logarithm of the likelihood below which a change may be chance [nats].
Derivation: more than as many coefficients as a usual model has would gain by chance.
Sensitivity: not measured.
"""

MATURE = 8
"""Length of the record before which its estimate may itself have gone astray, and goes on to be solved again
[start-ups].
Origin: three doublings of the start-up, after each of which the record is solved again.
Sensitivity: not measured.
"""


def next_solution(state: State, settings: Settings) -> int:
    """Return the number of accepted samples at which the record is solved again, twice as long as now; 0: never."""
    revised = state.was_revised
    origin, samples = state.revised_from if revised else state.record_began, state.samples
    remembers_all = settings.optimizer.keeps_colour and state.settings[0] == 1.0
    due = 2 * (samples - origin)
    if revised and samples - origin < RECENT:  # the last solution uses all samples kept, as a slow mode needs them
        due = min(due, RECENT)
    return origin + due if remembers_all and settings.filter.follows_estimate and due <= RECENT else 0


@quiet
def solve_again(old: State, settings: Settings) -> State | None:
    """Return the state that begins at a solution of the whole record, found from the present estimate.

    None where no usable model is found, or where the record has a gap or too many bridged outputs.  As long as the
    record is so short that its estimate may be the one that is wrong, the outputs as they were measured are solved too.
    """
    if old.was_revised:
        return _revised_again(old, settings) if old.adapt else None
    origin = old.record_began
    kept = RecentSamples.since(old, origin)
    if old.gap_at > origin or not old.adapt or old.samples - origin > len(kept):
        return None
    mature = is_mature(old, settings)
    if old.alarm and mature:
        return None
    bridged = kept.with_output(kept.bridged)
    found = _solution(old, settings, bridged) if kept.doubted <= MOST_DOUBTED else None
    if not mature and kept.is_bridged.any() and kept.stuck <= MOST_DOUBTED:
        measured = RecentSamples.of(old)[-len(kept) :]
        plain = measured.with_output(without_spikes(measured.output))
        other, present = _solution(old, settings, plain), old.physical if found is None else found.theta
        if other is not None and _is_nearer(settings, measured, other.theta, present):
            new = restart(old, settings, other, _record(settings, plain), origin)
            clear_doubt(new, plain)
            return new
    return None if found is None else restart(old, settings, found, _record(settings, bridged), origin)


def _record(settings: Settings, kept: RecentSamples) -> Record:
    return kept.record(settings.dt, settings.filter.input_hold)


def _solution(old: State, settings: Settings, kept: RecentSamples) -> Refined | None:
    """Return the estimate of samples; None where it is not acceptable."""
    refined = refine(settings.structure, _record(settings, kept), [old.physical], afresh=True)
    return refined if refined is not None and refined.acceptable else None


def _is_nearer(settings: Settings, measured: RecentSamples, model: FloatArray, other: FloatArray) -> bool:
    """Return whether a model is so much nearer to the measured outputs that another has bridged right ones.

    The median of the magnitudes of its error, which outliers hardly move, is then less than `NEARER` of the other's.
    """
    size, record = settings.structure.size, _record(settings, measured)
    typical = []
    for each in (model, other):
        error = prediction_error(settings.structure, each[:size], record, settings.dt)
        typical.append(math.inf if error is None else float(np.median(np.abs(error))))
    return typical[0] < NEARER * typical[1]


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


def restart_from_prior(old: State, settings: Settings, kept: RecentSamples, stayed: float = 1.0) -> State | None:
    """Return the state that begins at the estimate before a change (`State.prior`), revised by the samples after it.

    None where the revised model's residual is larger than usual, or where the probability that no coefficient has moved
    exceeds ``stayed``.  Later solutions use the same prior.

    Parameters
    ----------
    old : State
    settings : Settings
    kept : RecentSamples
        The samples after the change.
    stayed : float
        Largest probability that no coefficient has moved.
    """
    from replant.kernels.monitoring import outliers

    record = kept.record(settings.dt, settings.filter.input_hold)
    usual = max(old.usual_variance, outliers.LEAST * old.largest_output) * settings.scaling.output**2
    before, std = old.prior
    found = revise(settings.structure, record, before, std, usual, old.stability_margin)
    if found is None or found[0].variance > outliers.GROWN * usual or found[1] > stayed:
        return None
    if not is_driven(settings, found[0], record):
        return None
    new = restart(old, settings, found[0], record, old.record_began)
    new.noise.filters = old.noise.filters
    new.gap_at = new.revised_from = old.samples - len(kept)
    # the record is short, and its length no bound for a time constant: the plant may be as slow as before
    new.stability_margin = min(new.stability_margin, old.stability_margin)
    new.forget_input = min(new.forget_input, old.forget_input)
    clear_doubt(new, kept)
    return new


def left_by_input(
    structure: Structure, parameters: FloatArray, record: Record, dt: float, seen: int = 0, *, certain: bool = True
) -> tuple[float, bool]:
    """Return the variance of a model's residual, and whether the input explains a part of the output.

    What counts is what the model's numerator adds, to the residual and to the residual whitened: of an output that
    wanders an integrated input explains much by chance, and nothing once both are whitened.  The variance is infinite
    where a signal leaves float64.

    Parameters
    ----------
    structure : Structure
    parameters : (P,) array or longer
    record : Record
    dt : float
        Sampling time in s.
    seen : int
        Samples at the beginning that do not count.
    certain : bool
        False for a model that was known before: then the part alone counts, not whether it may be chance.
    """
    still = parameters[: structure.size].copy()
    still[structure.numerator] = 0.0
    run, alone = (run_model(structure, each, record, dt) for each in (parameters[: structure.size], still))
    if run is None or alone is None:
        return math.inf, False
    errors = [each.error[seen:] - each.error[seen:].mean() for each in (run, alone)]
    left, power = (float(np.mean(error**2)) for error in errors)
    if not left < (1.0 - EXPLAINED) * power:
        return left, False
    if not certain:
        return left, True
    white = [Autoregression.of(error) for error in errors]
    least = np.finfo(float).tiny
    gain = math.log(max(white[1].power, least) / max(white[0].power, least))
    return left, errors[0].size * gain > SURE


def is_driven(settings: Settings, refined: Refined, record: Record) -> bool:
    """Return whether a model is stable, or the input explains what it would not predict without it."""
    structure = settings.structure
    poles = roots(np.concatenate([[1.0], refined.theta[structure.denominator]]))
    if poles.real.max() < -SLOWEST / record.span:
        return True
    return left_by_input(structure, refined.theta, record, settings.dt)[1]


def clear_doubt(state: State, kept: RecentSamples) -> None:
    """Bridge the newest samples by the outputs that the model was solved with; no doubt is left of a measured one."""
    doubted = np.flatnonzero(kept.is_bridged & (kept.output != kept.bridged))
    rows, recent = (state.samples - len(kept) + doubted) % len(state.recent), RecentSamples(state.recent)
    recent.bridged[rows] = kept.output[doubted]
    recent.doubt[rows[recent.output[rows] == recent.bridged[rows]]] = Doubt.NONE


def is_mature(state: State, settings: Settings) -> bool:
    """Return whether the record is so long that a larger residual means a changed plant, not a wrong estimate.

    True as well where the record is not solved again as it grows, as with a forgetting factor.
    """
    length = state.samples - state.record_began
    return length >= MATURE * settings.startup or not next_solution(state, settings)


def restart(old: State, settings: Settings, refined: Refined, record: Record, origin: int) -> State:
    """Return a state that begins at a refined estimate and goes on at the newest sample of ``old``.

    Parameters
    ----------
    old : State
    settings : Settings
    refined : Refined
        The estimate of ``record``.
    record : Record
        The newest samples; the filters are run over it.
    origin : int
        Accepted samples before the record that the estimate is made from.
    """
    new = State.of_settings(settings, RECENT)
    initialize(new, settings, refined, record)
    stamps = REGULAR
    if record.intervals.size > 1:
        stamps = old.last_time - (record.intervals.sum() - np.cumsum(record.intervals))
    with new.without_preprocessing():
        warm_up(new, record.u, record.y, stamps, record.r, learn=False)
    new.ready_at = new.elapsed
    carry_over(old, new)
    new.record_began = origin
    return new
