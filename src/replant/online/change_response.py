"""Change response: what is done about an alarm of the residual's CUSUM test.

The samples since the alarm began are looked into at growing intervals.  A look has one of four results:

1. the residual is explained by another constant or initial state: only these are learned anew;
2. the samples since the alarm, with the estimate before it as a prior, give a model: the estimate is revised;
3. these samples alone, or the whole record, give a model that predicts much better: the record begins anew there;
4. none of these: another look follows, until the larger residual is taken for the usual one.
"""

from __future__ import annotations

import math

import numpy as np

from replant.engine.covariance import covariance
from replant.engine.dimensions import RECENT
from replant.engine.recent_samples import RecentSamples
from replant.engine.record import Record
from replant.engine.state import State
from replant.kernels.schema import Alarm, Doubt
from replant.offline.srivc import refine
from replant.offline.srivc_steps import SOONEST
from replant.online.restart import (
    EXPLAINED,
    SURE,
    clear_doubt,
    is_driven,
    left_by_input,
    restart,
    restart_from_prior,
)
from replant.online.solve_again import MATURE, MOST_DOUBTED, is_mature
from replant.online.step_disturbance import only_constant_moved, with_new_constant
from replant.settings import Settings
from replant.statistics.linear_algebra import quiet, roots

BETTER = 0.5
"""Power left of the last third of what came since by a model of the first two, over what the present one leaves, up to
which a change is believed [ratio of powers].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved, right estimates no longer trusted: 'gain 20 % up'; error of 'gain 20 % up' times 4.8; doubled, 48
samples held against 'load step' instead of 49.
"""

LIKELY = 0.8
"""Probability that no coefficient has moved beyond which only the constant is learned anew [probability].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

BRIEF = 0.25
"""Length of a record below which it cannot tell the slowest mode [slowest time constants].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

BEGINNINGS = 0.125, 0.25
"""Parts of what came since an alarm, after which whatever has moved is held to have moved [part of the record since].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

EARLIEST = 0.25
"""Length of what came since after which it is looked into first [start-ups].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, 48 samples held against 'load step' instead of 49.
"""

LATEST = 2.0
"""Length after which a change is no longer believed [start-ups].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

WORSE = 0.8
"""Ratio of powers as of BETTER from which on a model of what came since is hardly better [ratio of powers].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved, nothing changes on these records; doubled, right estimates no longer trusted: 'load step'; 48
samples held against 'load step' instead of 49; error of 'load step' times 1.5e+02.
"""

EARLIER = 0.5
"""Length after which a change is then no longer believed [start-ups].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

SETTLED = 10.0
"""Time in which an input that moves seldom must have moved, before a change is no longer believed [slowest time
constants].
Origin: as WARM_TIME_CONSTANTS: the plant shows what it has become.
Sensitivity: halved or doubled, nothing changes on these records.
"""

PATIENCE = 1.5
"""Growth of what came since until the next look [ratio of lengths].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, 48 samples held against 'load step' instead of 49.
"""


@quiet
def first_look(state: State, settings: Settings) -> int:
    """Return the number of accepted samples at which an alarm is first looked into.

    Until then a mature estimate (`resolving.is_mature`) does not learn: the samples may be of a failed sensor.
    """
    _note_estimate(state, settings)
    state.alarm = Alarm.RESTS if is_mature(state, settings) else Alarm.LOOKED_INTO
    return max(_began(state) + _least(settings), state.samples + 1)


def _note_estimate(state: State, settings: Settings) -> None:
    """Store the estimate before a change and its standard deviations: the prior of a revision.

    It is stored at once, before the estimate learns from samples of the changed plant.  Where the estimate was itself
    revised a short while ago, the older prior stays: it is known better than the revised estimate.
    """
    samples = state.samples
    if state.was_revised and _is_brief(state, settings, samples - state.revised_from):
        return
    state.prior[:] = state.physical, np.zeros(state.entries)
    state.prior[1, : settings.structure.size] = np.sqrt(np.maximum(np.diag(covariance(state, settings)), 0.0))
    state.revised_from = 0


@quiet
def look(old: State, settings: Settings) -> tuple[State, int]:
    """Look for a model of the samples since the alarm began.

    Returns the state to go on with, and the number of accepted samples at which to look again; 0: no further look.
    """
    from replant.kernels.monitoring import outliers

    if old.alarm == Alarm.NONE:  # the residual is as usual again
        return old, 0
    samples = old.samples
    kept = RecentSamples.since(old, _began(old)).after_stuck()
    length = len(kept)
    later = samples + max(int((PATIENCE - 1.0) * length), SOONEST)
    if length < _least(settings) or kept.stuck > MOST_DOUBTED:
        return old, later
    # a constant output: a gain of zero would explain it, but it is a failed sensor
    if float(np.ptp(kept.output[-_least(settings) :])) == 0.0:
        return old, later
    mature = is_mature(old, settings)
    share, explained = _share_left(old, settings, kept.record(settings.dt, settings.filter.input_hold))
    if mature:
        renewed = _hardly_changed(old, settings, kept, explained and share >= BETTER)
        if renewed is not None:
            return renewed, 0
    if share < BETTER:
        # where the samples since the alarm give no model, the whole record may: then not the plant has changed but the
        # estimate was wrong, and the residual of a model of the whole record is no larger than usual
        usual = outliers.GROWN * max(old.usual_variance, outliers.LEAST * old.largest_output)
        whole = max(old.record_began, old.gap_at)
        for begin, most in ((samples - length, math.inf), (whole, usual * settings.scaling.output**2)):
            new = _revised_since(old, settings, begin) if begin > whole else None
            new = new or _solved_since(old, settings, begin, most)
            if new is not None:
                return _on_its_own(new), 0
    rests = mature and not explained and _explained_before(old)
    rests = rests and length < min(_began(old) - old.record_began, RECENT // 2)
    old.alarm = Alarm.FLOATS if rests else Alarm.LOOKED_INTO
    if rests:
        return old, later
    settled = min(_settling(old, settings), RECENT / 2)
    enough = max((LATEST if share < WORSE else EARLIER) * settings.startup, settled)
    if share >= BETTER and length >= enough:
        _believe_residual(old)
        return old, 0
    if length > RECENT // 2:  # the plant may have changed a second time: only the newer half counts
        old.change_began = samples - RECENT // 4
        return old, samples + RECENT // 4
    return old, later


def _hardly_changed(old: State, settings: Settings, kept: RecentSamples, explained: bool) -> State | None:
    """Return the state after learning the samples since the alarm, where another constant explains them; else None.

    An initial state that differs is treated like a constant.  In a record that is brief beside the slowest time
    constant, a slow mode that has changed looks the same; the coefficients are then revised with a prior, unless they
    have probably not moved.  A longer record tells the two apart, and there a slow disturbance is no change of G(s).

    Parameters
    ----------
    old : State
    settings : Settings
    kept : RecentSamples
        Since the alarm began.
    explained : bool
        Whether the present model explains these samples, and no new model predicts them much better.
    """
    brief = _is_brief(old, settings, len(kept))
    rests = [kept[int(beginning * len(kept)) :] for beginning in BEGINNINGS]
    for rest in rests:
        if only_constant_moved(old, settings, rest.record(settings.dt, settings.filter.input_hold)):
            revised = _revised(old, settings, rest, LIKELY) if brief else None
            return revised or with_new_constant(old, rest.record(settings.dt, settings.filter.input_hold))
    tried = (_revised(old, settings, rest, LIKELY) for rest in rests if explained and brief)
    return next((state for state in tried if state is not None), None)


def _revised_since(old: State, settings: Settings, begin: int) -> State | None:
    """Return the state revised by the samples since ``begin``; None where they are not brief, or give no model.

    Parameters
    ----------
    old : State
    settings : Settings
    begin : int
        Accepted samples before the first one used.
    """
    kept = RecentSamples.since(old, begin)
    if _is_guesswork(kept) or not (is_mature(old, settings) and _is_brief(old, settings, len(kept))):
        return None
    tried = (_revised(old, settings, kept[int(beginning * len(kept)) :]) for beginning in (0.0, *BEGINNINGS))
    return next((state for state in tried if state is not None), None)


def _is_guesswork(kept: RecentSamples) -> bool:
    """Return whether too many outputs of a record were bridged rather than measured."""
    bridged = (kept.doubt > 0) & (kept.output == kept.bridged)
    return float((bridged | (kept.doubt == Doubt.STUCK)).mean()) > MOST_DOUBTED


def _solved_since(old: State, settings: Settings, begin: int, most: float) -> State | None:
    """Return the state that begins at a model of the samples since ``begin`` alone.

    None where they give no usable model, or where its residual's variance exceeds ``most``.

    Parameters
    ----------
    old : State
    settings : Settings
    begin : int
        Accepted samples before the first one used.
    most : float
        In the output's unit squared.
    """
    kept = RecentSamples.since(old, begin)
    if _is_guesswork(kept):
        return None
    record = kept.record(settings.dt, settings.filter.input_hold)
    refined = refine(settings.structure, record, filtered=old.noise.filters > 0.0)
    if refined is None or refined.variance > most:
        return None
    if not (refined.acceptable or (refined.settled and record.u.size >= MATURE * settings.startup)):
        return None
    if not is_driven(settings, refined, record):
        return None
    new = restart(old, settings, refined, record, old.samples - len(kept))
    clear_doubt(new, kept)
    return new


def _revised(old: State, settings: Settings, kept: RecentSamples, stayed: float = 1.0) -> State | None:
    """Return the state revised by samples after a change, its alarm ended.

    None where the revised model's residual is larger than usual, or where the probability that no coefficient has moved
    exceeds ``stayed``.

    Parameters
    ----------
    old : State
    settings : Settings
    kept : RecentSamples
        The samples after the change.
    stayed : float
        Largest probability that no coefficient has moved.
    """
    new = restart_from_prior(old, settings, kept, stayed)
    return None if new is None else _on_its_own(new)


def _on_its_own(new: State) -> State:
    """End the alarm of a state that has just begun anew, and forget its past estimates."""
    samples = new.samples
    new.past_kept, new.past_due = 0, samples
    new.alarm, new.change_began = Alarm.NONE, samples
    return new


def _least(settings: Settings) -> int:
    """Return the fewest samples since an alarm that are looked into."""
    structure = settings.structure
    return max(4 * (2 * structure.poles + structure.zeros + 2), int(EARLIEST * settings.startup))


def _began(state: State) -> int:
    """Return the accepted samples before those since the alarm, in one piece."""
    return max(state.change_began, state.gap_at, state.record_began)


def _settling(state: State, settings: Settings) -> float:
    """Return in how many samples the slowest mode has settled; infinite for a model that is not stable."""
    denominator = np.concatenate([[1.0], state.physical[: settings.structure.poles]])
    slowest = -float(roots(denominator).real.max())
    return SETTLED / (slowest * settings.dt) if slowest > 0.0 else math.inf


def _is_brief(state: State, settings: Settings, length: int) -> bool:
    """Return whether so many samples are too few to identify the slowest mode without a prior."""
    return length < BRIEF / SETTLED * _settling(state, settings)


def _explained_before(state: State) -> bool:
    """Return whether the model usually explains a part of the output's power, at least `EXPLAINED`."""
    return bool(state.usual_variance < (1.0 - EXPLAINED) * state.largest_output)


def _share_left(state: State, settings: Settings, record: Record) -> tuple[float, bool]:
    """Return the ratio of two residual variances, and whether the present model explains the output by the input.

    The ratio compares, over the last third of a record, a model identified from the first two thirds with the present
    one.  It is at least `BETTER` where the difference may be chance, and 1 where no new model explains the output.
    A model fitted to a few samples always fits these better; only samples that it has not seen tell a change.

    Parameters
    ----------
    state : State
        Of the present model.
    settings : Settings
    record : Record
        The samples since the alarm.
    """
    structure, seen = settings.structure, 2 * record.u.size // 3
    refined = (
        refine(structure, record.first(seen), filtered=state.noise.filters > 0.0)
        if float(np.ptp(record.u[:seen])) > 0.0
        else None
    )
    left, explains, power = [math.inf, math.inf], [False, False], float(np.var(record.y[seen:]))
    for which, parameters in enumerate((refined.theta if refined else None, state.physical)):
        if parameters is None:
            continue
        is_new = which == 0
        left[which], explains[which] = left_by_input(structure, parameters, record, settings.dt, seen, certain=is_new)
    if not explains[0]:
        return 1.0, explains[1]
    least = np.finfo(float).eps * power  # rounding errors do not count
    share = (left[0] + least) / (left[1] + least)
    sure = -(record.u.size - seen) * math.log(max(share, 1e-300)) > SURE
    return share if sure else max(share, BETTER), explains[1]


def _believe_residual(state: State) -> None:
    """Take the residual's present variance for the usual one, as no model explains it, and double the CUSUM limit."""
    from replant.kernels.monitoring import outliers

    state.alarm = Alarm.NONE
    state.usual_variance = max(state.usual_variance, state.late_variance)
    state.usual_innovation = max(state.usual_innovation, state.late_innovation)
    state.cusum = 0.0
    state.cusum_limit = min(2.0 * state.cusum_limit, outliers.LARGEST_LIMIT)
