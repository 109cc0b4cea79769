"""Interruptions of learning: an input at rest, a gap in the record, a clock that was reset."""

import math

import numpy as np

from replant.kernels import schema as at
from replant.kernels.filters import autoregressions
from replant.kernels.filters import bank as bk
from replant.kernels.filters.polynomials import slowest_decay
from replant.kernels.monitoring import scatter
from replant.kernels.native import LAID_OUT, kernel
from replant.kernels.optimizers import covariance as second
from replant.kernels.optimizers.covariance import RECURSIVE_LEAST_SQUARES
from replant.kernels.optimizers.memory import block
from replant.kernels.schema import StateSlots

# at ten times this a misread input would be accepted, and all later inputs would seem at rest beside it; at a tenth a
# single pulse may be a leap
INPUT_LEAP = 1e3  # distance from the mean beyond which an input leaps [largest moving standard deviation so far]
# a thousandth of the amplitude
AT_REST = 1e-6  # moving variance of the input below which it is at rest [part of the largest so far]
LONGEST = 1e9  # longest interval that a gap counts as [sampling times]
# ten times the largest recent output
UNKNOWN = 100.0  # variance of an unknown initial state [recent largest square of the modelled output]
# for records without noise
LEAST_NOISE = 1e-12  # least variance of the residual, as the unit of that variance [part of that square]
# exp(-5), 0.7 %, of the initial state then remains
SETTLE = 5.0  # time to wait after a gap if the initial state is not estimated [slowest time constants]


def input_rests(s, u):
    """Return whether the input is at rest: its moving variance is small, or it is constant for too long."""
    if s.samples == 0:
        s.input_mean = s.input_anchor = u
    share = s.forget_input
    away = u - s.input_mean
    s.input_mean += share * away
    s.input_power += share * (away * away - s.input_power)
    s.largest_power = max(s.largest_power, s.input_power)
    least = AT_REST * s.largest_power
    # an optimizer that forgets cannot wait for the variance: by then it would have forgotten everything
    if s.rest_after > 0:
        step = u - s.input_anchor
        s.input_still += 1
        if step * step > least:
            s.input_anchor = u
            s.input_still = 0
        elif s.input_still > s.rest_after:
            return True
    return s.input_power < least


def begin_initial_state(s, y):
    """Set the initial state to that of a constant output ``y``, with a large covariance, so that learning goes on."""
    n, T = s.order, s.entries
    first, theta, (U, D) = T - n, s.theta, second.factors_of(s)
    variances, bank = s.work[:n], s.banks[s.serving_bank]
    # the refined filter estimates the state with the parameters; the auxiliary model starts from the same state, as
    # instruments far from the regressor would harm the estimate
    size = UNKNOWN * max(s.largest_output, np.finfo(np.float64).tiny) * (s.output_scale * s.output_scale)
    if not y * y < size:
        y = 0.0
    for i in range(n):  # the response (s^(n-1) + a_(n-1) s^(n-2) + ..)/A to an impulse starts at one, with slope zero
        unit = s.unit[first + i]
        mean = y if i == 0 else y * bank[bk.DENOMINATOR + i - 1]
        theta[first + i] = mean / unit
        variances[i] = size / (unit * unit)
        size *= bank[bk.SCALE] * bank[bk.SCALE]
        for b in range(1, 3):
            s.banks[b, bk.at_weights(n, T) + first + i] = theta[first + i] * s.output_scale
        if s.algorithm == RECURSIVE_LEAST_SQUARES:  # in the unit of its covariance: the variance of what it learns
            usual = max(s.usual_variance, LEAST_NOISE * s.largest_output, np.finfo(np.float64).tiny)
            variances[i] /= autoregressions.gain(s) * usual
            caps = block(s.memory, second.AT_CAPS, T)
            caps[first + i] = max(caps[first + i], variances[i])
    second.begin_last(U, D, first, variances, s.backup[:T])
    if s.coloured:
        scatter.begin_last(s.colour, first, T)


@kernel(LAID_OUT)
def interrupt(s: StateSlots, interval: float):
    """Restart the filters after a gap: parameters stay, learning waits until the unknown initial state has decayed."""
    n = s.order
    s.gaps += 1
    s.gap_at = s.samples
    s.started = False
    s.warming = False
    s.cusum = 0.0
    bank = s.banks[s.serving_bank] if s.instruments else s.banks[0]
    decay = slowest_decay(bank[bk.DENOMINATOR : bk.DENOMINATOR + n], s.work)
    wait = SETTLE / decay if decay > 0.0 else 0.0
    if s.instruments:  # a slow model must not delay learning longer than the record lasted so far
        wait = min(wait, s.elapsed)
    now = s.elapsed + interval
    s.learn_from = s.ready_at = now + wait
    # the refined filter estimates the initial state, so learning need not wait; a random walk of the parameters must
    # wait: its covariance grows meanwhile, and instruments still differ from the regressor
    if s.refined and s.algorithm == RECURSIVE_LEAST_SQUARES:
        s.learn_from = now


def clock_was_set(s, t):
    """Count an earlier stamp; return whether enough of them advance in a row to show that the clock was reset."""
    s.earlier_stamps = s.earlier_stamps + 1 if s.earlier_stamps > 0 and t > s.earlier_time else 1
    s.earlier_time = t
    if s.earlier_stamps <= at.MOST_EARLIER:
        s.not_later += 1
        return False
    return True


def leave(s, u, y, t, r, confirms):
    """Hold back a sample that leaps; return the change of the number of rejected samples.

    If it ``confirms`` the sample held back, the identifier takes that one, and then this one again.  Otherwise it is
    held back itself, until the next one shows whether it was misread.
    """
    if confirms:
        s.held_at = at.BELIEVED
        s.attention = True
        return -1
    s.held_at = s.samples + 1
    s.held_input, s.held_output, s.held_time = u, y, t
    if s.has_reference:
        s.held_reference = r
    return 1


def pass_time(s, t, samples):
    """Let rejected ``samples`` lengthen the next interval, if there are no stamps and outputs are examined."""
    if math.isnan(t) and s.examines_output and s.samples > 0:
        s.earlier_stamps += samples


def is_far(s, u):
    """Return whether an input is far beyond all earlier ones; never before the first."""
    away = u - s.input_mean
    return away * away > INPUT_LEAP * INPUT_LEAP * s.largest_power > 0.0


def input_leaps(s, u, y, t, r):
    """Return whether to leave out a sample with a far input: one alone was misread, two in a row are a real move."""
    if s.held_at == at.BELIEVED:
        return False
    if math.isinf(t):
        s.not_finite += 1
        return True
    more = leave(s, u, y, t, r, s.held_at == s.samples + 1 and is_far(s, s.held_input))
    s.input_leaps += more
    pass_time(s, t, more)
    return True


def time_leaps(s, u, y, t, r):
    """Return whether to leave out a sample whose stamp leaps ahead: the next one shows whether it was misread."""
    leap, held = at.LEAP * s.interval, s.held_time
    if s.held_at == at.BELIEVED:
        return False
    ahead = held - s.last_time
    # the held stamp is confirmed by one up to LEAP after it, or, for slow rigs, up to twice its own leap after it
    soon = ahead > leap and 0.0 < t - held <= max(leap, 2.0 * ahead)
    s.time_leaps += leave(s, u, y, t, r, s.held_at == s.samples + 1 and soon)
    return True


def is_too_coarse(s, t):
    """Return whether a stamp is so far from zero that float64 cannot resolve a sampling time; count it if so."""
    if abs(t) <= at.FARTHEST * s.interval:
        return False
    s.too_coarse += 1
    return True


def interval_of(s, u, y, t, r):
    """Return the time since the previous sample; NaN if the stamp cannot be used, or not yet, which is counted."""
    if math.isnan(t):
        interval = s.interval * (1.0 + s.earlier_stamps)
        s.earlier_stamps = 0
        if interval > s.longest_gap:
            interrupt(s, interval)
        return interval
    if math.isinf(t):
        s.not_finite += 1
        return np.nan
    interval = s.interval
    if s.samples > 0:
        interval = t - s.last_time
        if not interval > 0.0:
            if is_too_coarse(s, t) or not clock_was_set(s, t):
                return np.nan
            interval = 2.0 * s.longest_gap  # the true interval is unknown
        if s.delay > 0.0 and interval * (s.ring_size - 2) < s.delay:
            s.too_dense += 1
            return np.nan
        if interval > s.longest_gap:
            if interval > at.LEAP * s.interval and (is_too_coarse(s, t) or time_leaps(s, u, y, t, r)):
                return np.nan
            interval = min(interval, LONGEST * s.interval)
            interrupt(s, interval)
    elif is_too_coarse(s, t):
        return np.nan
    s.earlier_stamps = 0
    s.last_time = t
    return interval
