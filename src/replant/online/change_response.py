"""Change response: the reaction to an alarm of the residual's CUSUM test.

The samples since the alarm began are examined at growing intervals: hypotheses of what has changed compete
(`estimation.solver.change_contest`).  Nothing is learned until one of them is decided on.  The reaction depends on it:

    the noise              its present variance becomes the usual one
    a load, a part         the estimate before the change is revised by the samples since
    the plant              the record begins anew with these
    a cable that floats    nothing is learned until the residual is as usual again, or another one is decided on

No decision is final: see `replant.online.revision`.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from replant.estimation.engine.estimate_covariance import covariance, covariance_by_colour
from replant.estimation.engine.recent_samples import RecentSamples, variance_of_input
from replant.estimation.engine.record import Record
from replant.estimation.engine.state import State
from replant.estimation.settings import STORED, Settings
from replant.estimation.solver.bad_samples import suspicious
from replant.estimation.solver.change_contest import Claim, Contest, decided, is_sure, odds_of, would_change
from replant.estimation.solver.change_evidence import Known
from replant.estimation.solver.solve import Solution, solve
from replant.estimation.solver.srivc_steps import SOONEST, least_since
from replant.kernels.schema import Alarm, Doubt, Supposition
from replant.numerics.arguments import FloatArray
from replant.numerics.linear_algebra import inverse_of, quiet
from replant.online.begin_recursion import clear_doubt, note_doubts, restart, restart_at
from replant.verdict.evidence import LEAST_POWER, RESTED

# the sum of the power beyond twice the usual begins late if a change shows slowly, and early by chance; the onset is
# searched from the first of these on, and the others are tried
BEGINS = -0.25, 0.0, 0.25  # begin of the change relative to that of the alarm [part of the samples since]
# the last solution then has two thirds of the samples, and all solutions together cost three times the last one
AGAIN = 1.5  # growth of a record, or of the part since an alarm or change, after which it is solved again [ratio]


def note_alarm(state: State, settings: Settings) -> None:
    """Plan the first look into an alarm that was raised; ``look_at`` 0: never, as too few samples are kept."""
    if state.alarm != Alarm.RAISED:
        return
    first = max(_began(state) + least_since(settings.structure), state.samples + 1)
    state.look_at, state.trusted_at = first if tells_of_changes(state, settings) else 0, 0
    # nothing is learned until the look, or without one until the residual is as usual again
    state.alarm = Alarm.RESTS  # last, so that an interrupted call is repeated


@quiet
def look(old: State, settings: Settings) -> tuple[State, int]:
    """Examine what has changed since the alarm; return the next state, and the samples of the next look; 0: never."""
    from replant.kernels.monitoring import outliers

    if old.alarm == Alarm.NONE or not tells_of_changes(old, settings):  # the residual is as usual again
        return old, _after_noise(old)
    length = old.samples - _began(old)
    later = old.samples + max(math.ceil((AGAIN - 1.0) * length), SOONEST)
    kept, first = kept_since(old, max(old.gap_at, old.record_began, old.changed_at))
    begin = max(_began(old) - first, 0)
    since, fewest = kept[begin:], least_since(settings.structure)
    # a sensor that was stuck, or at an end of its scale, must work for as long as it failed, or for a start-up
    raw, odd = RecentSamples.of(old, len(since)), suspicious(since.input, since.output)
    failed = raw.is_stuck | (odd == Doubt.STUCK)
    lasted = int(np.flatnonzero(failed)[-1]) + 1 if failed.any() else 0
    enough = len(since) - lasted >= max(fewest, min(lasted, settings.startup))
    if len(since) < fewest or not enough or not np.ptp(since.output[-SOONEST:]) > 0.0:
        return old, later
    # an alarm may begin early by chance: these samples, which the model explains, look like outliers beside those since
    begin += int(np.logical_and.accumulate((odd == Doubt.OUTLIER) & ~raw.is_bridged).sum())
    earliest, *begins = (max(begin + int(part * len(since)), 1) for part in BEGINS)
    record = kept.record(settings.dt, settings.filter.input_hold)
    information = _information(settings, covariance(old, settings), old.entries)
    present = _known(old, settings, record, earliest, old.physical, information)
    if present is None:  # the model cannot be run, as after a start-up that identified the controller
        new = _anew(old, settings, first)
        return (old, later) if new is None else (new, 0)
    if old.alarm == Alarm.FLOATS:
        claims, found = _afloat(settings, record, begin, present)
    else:
        begins = sorted({min(present.onset(record, earliest), begins[-1]), *begins})
        contests = {at: Contest(settings.structure, record, at, present) for at in begins}
        claims = [claim for contest in contests.values() for claim in contest.claims()]
        if claims and remembers_since_change(old, settings):
            claims += _one_model(old, settings, contests[max(begin, 1)], claims)
        found = decided(claims)
    if found is None:
        return old, later
    if found.supposition in (Supposition.NOTHING, Supposition.NOISE):
        _end(old)
        if found.supposition is Supposition.NOISE:
            # the late variance lags behind the variance since the change
            power = found.contest.power / settings.scaling.output**2
            lag = max(power / max(old.late_variance, np.finfo(float).tiny), 1.0)
            old.usual_variance = max(old.usual_variance, lag * old.late_variance)
            old.usual_innovation = max(old.usual_innovation, lag * old.late_innovation)
            old.cusum_limit = min(2.0 * old.cusum_limit, outliers.LARGEST_LIMIT)
            # noise that does not last as long again is not the usual one; then the recent variance has followed it
            return old, old.samples + max(length, round(1.0 / outliers.SHORT))
        return old, 0
    if found.supposition is Supposition.CUT:
        old.alarm = Alarm.FLOATS
        return old, later
    new = believed(old, settings, found, undecided=not is_sure(claims, found))
    return (old, later) if new is None else (new, 0)


def _anew(old: State, settings: Settings, first: int) -> State | None:
    """Return the state at a solution of the samples after the first accepted ones; None if there is no solution."""
    kept = RecentSamples.of(old, STORED)[first - old.samples :]
    solution = solve(settings.structure, kept.record(settings.dt, settings.filter.input_hold, parted=True))
    if solution is None or not solution.found.settled:
        return None
    return _of_one_model(old, settings, solution, first, undecided=False)


def _of_one_model(old: State, settings: Settings, solution: Solution, begin: int, *, undecided: bool) -> State:
    """Return the state at a solution of all samples after the first ``begin`` accepted ones, without a change."""
    new = restart_at(old, settings, solution, begin)
    new.change, new.changed_at, new.before_began, new.revised_from = Supposition.NOTHING, 0, 0, 0
    new.undecided, new.gap_at = undecided, min(old.gap_at, begin)
    new.past_kept, new.past_due = 0, new.samples
    _end(new)
    return new


def _afloat(settings: Settings, record: Record, begin: int, present: Known) -> tuple[list[Claim], Claim | None]:
    """Return the claims on the newest samples after a floating cable, and the one decided on, if any."""
    since = record.u.size - begin
    most = int(math.log2(max(since / least_since(settings.structure), 1.0)))
    for halvings in range(most, -1, -1):  # fewest samples first, as they are all from after the fault
        claims = Contest(settings.structure, record, record.u.size - (since >> halvings), present).claims()
        found = decided(claims)
        if found is not None and found.supposition is not Supposition.CUT:
            return claims, found
    return [], None


def since_change(old: State, settings: Settings, parted: int = 0) -> Contest | None:
    """Return the contest over all samples since the last change; ``parted``: samples before the variance changed."""
    kept, first = kept_since(old, gap_before(old))
    begin = old.changed_at - first
    if begin <= 0:
        return None
    record = kept.record(settings.dt, settings.filter.input_hold)
    known = _known(old, settings, record, begin, old.prior[0].copy(), old.prior[1:].copy())
    if known is None:
        return None
    return Contest(settings.structure, record, begin, known, parted - first if parted else None)


def _one_model(old: State, settings: Settings, since_alarm: Contest, rivals: list[Claim]) -> list[Claim]:
    """Return claims on an alarm that involve older samples: the last change was another one, or the model was wrong."""
    if old.gap_at > max(old.record_began, old.changed_at):
        return []
    if not old.changed_at:
        return of_whole(old, settings, since_alarm, old.record_began, rivals)
    present = since_alarm.known
    contest = since_change(old, settings, old.samples - since_alarm.since.u.size)
    if contest is None:
        return []
    # these claims are relative to NOTHING since the change; the others to the present model, with its penalty
    goes_on = contest.stretch.of_usual(present.error[-contest.rows :], present.noise, present.variance, last=True)
    base, odds = goes_on - contest.usual - old.change_price, odds_of(old.change)
    claims = contest.claims(again=True)
    others = [replace(claim, likelihood=claim.likelihood + base, odds=claim.odds + odds) for claim in rivals]
    claims += of_whole(old, settings, contest, gap_before(old), [*others, *claims])
    return [replace(claim, likelihood=claim.likelihood - base, odds=claim.odds - odds) for claim in claims]


def of_whole(old: State, settings: Settings, contest: Contest, began: int, rivals: list[Claim]) -> list[Claim]:
    """Return the claim that one model holds for all samples after ``began``, if that may change what is decided on.

    There is no claim if not all of the samples are kept.
    """
    if old.samples - contest.record.u.size > began:
        return []
    models = [old.physical, *(claim.theta for claim in rivals if claim.supposition is not Supposition.CUT)]
    if not would_change(rivals, contest.hopeful(models)):
        return []
    solution = solve(settings.structure, contest.record, [old.physical, contest.known.mean])
    if solution is None or not solution.found.settled:
        return []
    return [contest.whole(solution.found.theta, solution)]


def kept_since(state: State, first: int) -> tuple[RecentSamples, int]:
    """Return a copy of the kept samples after the first accepted ones, and the number of samples before them."""
    raw = RecentSamples.of(state, STORED)
    kept = raw.cleaned()
    kept = kept.changed(doubt=np.where(kept.is_stuck, Doubt.MISSING, kept.doubt))
    if state.alarm:  # outputs since are restored: they were outliers of a model that may no longer hold
        since = slice(max(len(kept) - (state.samples - _began(state)), 0), None)
        kept.output[since] = raw.output[since]
        gross = suspicious(raw.input[since], raw.output[since]) == Doubt.OUTLIER
        kept.doubt[since][gross] = Doubt.MISSING
    kept = kept[max(len(kept) - (state.samples - first), 0) :]
    return kept, state.samples - len(kept)


def _known(
    state: State, settings: Settings, record: Record, begin: int, mean: FloatArray, information: FloatArray
) -> Known | None:
    """Return the knowledge before a sample of a record, from a model (T,) and the information (T, T) on it."""
    from replant.kernels.monitoring import outliers

    usual = float(max(state.usual_variance, outliers.LEAST * state.largest_output)) * settings.scaling.output**2
    filters = state.noise.filters > 0.0
    return Known.before(settings.structure, record, begin, mean, information, usual, filters=filters)


def information_of(state: State, settings: Settings) -> FloatArray:
    """Return the information (T, T) on the coefficients if one model holds, whose estimate scatters by the colour."""
    return _information(settings, covariance_by_colour(state) * np.outer(state.unit, state.unit), state.entries)


def looked_at(old: State, settings: Settings, began: int) -> State | None:
    """Return the state after a change of the plant that raised no alarm, since an accepted sample; None without one."""
    tried = old.copy()
    tried.alarm, tried.change_began = Alarm.RESTS, began
    new, _ = look(tried, settings)
    # a drift of the output, which raises no alarm either, is no load
    return new if new is not tried and new.change.is_of_plant else None


def _information(settings: Settings, covariance: FloatArray, entries: int) -> FloatArray:
    """Return the information (T, T) on the coefficients, the inverse of their covariance; zero if it is not finite."""
    size, information = settings.structure.coefficients, np.zeros((entries, entries))
    known = inverse_of(covariance[:size, :size])
    if np.isfinite(known).all():  # else nothing is known: beyond the range of float64
        information[:size, :size] = known
    return information


def believed(old: State, settings: Settings, found: Claim, *, undecided: bool) -> State | None:
    """Return the state after a claim is accepted; None if the claim gives no estimate."""
    contest = found.contest
    if found.solution is not None:
        begin = old.samples - contest.record.u.size
        return _of_one_model(old, settings, found.solution, begin, undecided=undecided)
    refined, begin = contest.estimate(found), old.samples - contest.since.u.size
    if refined is None:
        return None
    of_plant, again = found.supposition is Supposition.PLANT, begin <= old.changed_at
    # the samples before those that one G(s) is assumed to explain
    before = old.changed_at if old.change.is_of_plant else old.record_began
    gap = old.gap_at
    if again:  # the last change is replaced: what held before it
        before = old.before_began if old.change is Supposition.PLANT else old.record_began
        gap = gap_before(old)
    new = restart(old, settings, refined, contest.since, begin if of_plant else before)
    new.change, new.changed_at = found.supposition, begin
    # no one model explains the samples on both sides of a load
    new.before_began = before if of_plant else max(before, gap)
    new.change_price, new.undecided = found.price, undecided
    new.prior[0], new.prior[1:] = contest.known.mean, contest.known.information
    new.gap_at = min(gap, begin) if of_plant else begin
    new.revised_from = 0 if of_plant else begin
    if not of_plant:
        # the record is short, and its length does not bound time constants: the plant may be as slow as before
        new.stability_margin = min(new.stability_margin, old.stability_margin)
        new.forget_input = min(new.forget_input, old.forget_input)
    clear_doubt(new, RecentSamples.since(old, begin))
    # residual power above the usual must raise another alarm
    new.usual_variance = min(new.usual_variance, old.usual_variance)
    new.usual_innovation = min(new.usual_innovation, old.usual_innovation)
    if found.supposition is not Supposition.LOAD or not remembers_all(old, settings):  # G(s) may have moved
        new.past_kept, new.past_due = 0, new.samples
    _end(new)
    return new


def behind_loads(old: State, settings: Settings, parted: Solution) -> State | None:
    """Return the state after the last load of a record that was solved divided at its loads; None if it fails."""
    *earlier, load = parted.record.begins
    first = earlier[-1] if earlier else 0
    before = solve(settings.structure, parted.record.first(load), [parted.found.theta])
    if before is None:
        return None
    record = replace(parted.record.last(parted.record.u.size - first), begins=())
    # the information on G(s) from the samples before is prior knowledge, as for a load that is found online
    mean, information = before.found.theta, _information(settings, before.found.covariance, old.entries)
    known = _known(old, settings, record, load - first, mean, information)
    if known is None:
        return None
    claims = Contest(settings.structure, record, load - first, known).claims(again=True)
    found = next((claim for claim in claims if claim.supposition is Supposition.LOAD), None)
    if found is None:
        return None
    whole = old.copy()
    whole.change, whole.gap_at = Supposition.NOTHING, first
    whole.changed_at = whole.before_began = whole.record_began = 0
    new = believed(whole, settings, found, undecided=False)
    if new is not None:
        note_doubts(new, parted)
    return new


def gap_before(state: State) -> int:
    """Return the accepted samples before those until the last change that one model with one offset explains."""
    return max(state.before_began, state.gap_at) if state.change is Supposition.PLANT else state.before_began


def _end(state: State) -> None:
    """End an alarm."""
    state.alarm, state.change_began, state.cusum = Alarm.NONE, state.samples, 0.0


def _after_noise(state: State) -> int:
    """Take the recent variance as the usual one if noise is over; return the samples at which to look again, or 0."""
    from replant.kernels.monitoring import outliers

    is_over = outliers.GROWN * state.late_variance < state.usual_variance
    if is_over:  # the recent variance is still falling
        state.usual_variance = state.late_variance
        state.usual_innovation = min(state.usual_innovation, state.late_innovation)
    return state.samples + round(1.0 / outliers.SHORT) if is_over else 0


def _began(state: State) -> int:
    """Return the accepted samples before the alarm, or before a later interruption, record or change."""
    return max(state.change_began, state.gap_at, state.record_began, state.changed_at)


def remembers_all(state: State, settings: Settings) -> bool:
    """Return whether the estimate forgets no sample of its record, and can be solved again."""
    return float(state.settings[0]) == 1.0 and is_solved_again(settings)


def is_solved_again(settings: Settings) -> bool:
    """Return whether a solution of the raw samples can replace the estimate."""
    return bool(settings.optimizer.keeps_colour and settings.filter.follows_estimate)


def remembers_since_change(state: State, settings: Settings) -> bool:
    """Return whether all samples since the last change, or of the record, weigh at least 1/e of the newest one."""
    since = state.samples - (state.changed_at or state.record_began)
    return is_solved_again(settings) and (1.0 - float(state.settings[0])) * since <= 1.0


def tells_of_changes(state: State, settings: Settings) -> bool:
    """Return whether enough raw samples are kept for a model of the samples since a change."""
    return len(state.recent) >= least_since(settings.structure)


def is_at_rest(state: State) -> bool:
    """Return whether the input has rested for `RESTED` samples, or if not all are kept, a quarter of those if fewer."""
    rested = min(RESTED, len(state.recent) // 4) if state.samples > len(state.recent) else RESTED
    return 0 < rested <= state.samples and variance_of_input(state, rested) < LEAST_POWER * state.largest_power
