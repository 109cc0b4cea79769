"""What interrupts learning: an input that rests, a gap in the record, a clock that was set."""

import math

import numpy as np

from replant.kernels import schema as at
from replant.kernels.filters import bank as bk
from replant.kernels.filters import whitening
from replant.kernels.filters.polynomials import slowest_decay
from replant.kernels.monitoring import scatter
from replant.kernels.native import LAID_OUT, kernel
from replant.kernels.optimizers import covariance as second
from replant.kernels.optimizers.covariance import RECURSIVE_LEAST_SQUARES
from replant.kernels.optimizers.memory import block
from replant.kernels.schema import StateArrays

# at ten times as many one such sample would pass for the largest input ever, beside which all later ones rest; at a
# tenth a single pulse may be one
INPUT_LEAP = 1e3  # distance beyond which an input leaps [largest moving standard deviations that it so far had]
# a thousandth of the amplitude
AT_REST = 1e-6  # moving variance of the input below which it rests [part of the largest that it has been]
LONGEST = 1e9  # longest time that a gap counts as [sampling times]
# ten times the largest that the output was
UNKNOWN = 100.0  # variance of an initial state that is not known [largest square of the modelled output lately]
# where there is no noise at all
LEAST_NOISE = 1e-12  # least variance of the residual that such a variance is compared with [part of that square]
# what is left of it is then exp(-5), 0.7 %
SETTLE = 5.0  # time to wait after a gap where the initial state is not estimated [slowest time constants]


def input_rests(s, u):
    """Return whether the input has come to rest: its moving variance says so, or it has not moved for a memory."""
    if s.samples == 0:
        s.input_mean = s.input_anchor = u
    share = s.forget_input
    away = u - s.input_mean
    s.input_mean += share * away
    s.input_power += share * (away * away - s.input_power)
    s.largest_power = max(s.largest_power, s.input_power)
    least = AT_REST * s.largest_power
    # an optimizer that forgets must not wait for the variance: it would have forgotten all by then
    if s.rest_after > 0:
        step = u - s.input_anchor
        s.input_still += 1
        if step * step > least:
            s.input_anchor = u
            s.input_still = 0
        elif s.input_still > s.rest_after:
            return True
    return s.input_power < least


def unit_of_covariance(s):
    """Return the variance that the covariance of recursive least squares is a multiple of: that of what it learns."""
    usual = max(s.usual_variance, LEAST_NOISE * s.largest_output, np.finfo(np.float64).tiny)
    return whitening.gain(s) * usual


def begin_initial_state(s, y):
    """Take the initial state for that of an output that stood at ``y``, and for unknown: learning goes on."""
    n, T = s.order, s.entries
    first, theta, (U, D) = T - n, s.theta, second.factors_of(s)
    variances, bank = s.work[:n], s.banks[s.serving_bank]
    # the refined filter estimates the state beside the parameters; the auxiliary model begins there, too, as
    # instruments far from the regressor would do harm
    size = UNKNOWN * max(s.largest_output, np.finfo(np.float64).tiny) * (s.output_scale * s.output_scale)
    if not y * y < size:
        y = 0.0
    for i in range(n):  # (s^(n-1) + a_(n-1) s^(n-2) + ..)/A of an impulse is one at first, and flat
        unit = s.unit[first + i]
        mean = y if i == 0 else y * bank[bk.DENOMINATOR + i - 1]
        theta[first + i] = mean / unit
        variances[i] = size / (unit * unit)
        size *= bank[bk.SCALE] * bank[bk.SCALE]
        for b in range(1, 3):
            s.banks[b, bk.at_weights(n, T) + first + i] = theta[first + i] * s.output_scale
        if s.algorithm == RECURSIVE_LEAST_SQUARES:
            variances[i] /= unit_of_covariance(s)
            caps = block(s.memory, second.AT_CAPS, T)
            caps[first + i] = max(caps[first + i], variances[i])
    second.begin_last(U, D, first, variances, s.backup[:T])
    if s.coloured:
        scatter.begin_last(s.colour, first, T)


@kernel(LAID_OUT)
def interrupt(s: StateArrays, interval: float):
    """Begin the filters anew after a gap: parameters stay, learning waits until what is unknown has died out."""
    n = s.order
    s.gaps += 1
    s.gap_at = s.samples
    s.started = False
    s.warming = False
    s.cusum = 0.0
    bank = s.banks[s.serving_bank] if s.instruments else s.banks[0]
    decay = slowest_decay(bank[bk.DENOMINATOR : bk.DENOMINATOR + n], s.work)
    wait = SETTLE / decay if decay > 0.0 else 0.0
    if s.instruments:  # a model that hardly forgets is not waited for longer than it has been known
        wait = min(wait, s.elapsed)
    now = s.elapsed + interval
    s.learn_from = s.ready_at = now + wait
    # the refined filter estimates the initial state; not where the parameters may have walked meanwhile, as far as they
    # may then go with instruments that are not yet like the regressor
    if s.refined and s.algorithm == RECURSIVE_LEAST_SQUARES:
        s.learn_from = now


def clock_was_set(s, t):
    """Count a stamp that does not advance; return whether so many in a row advance that it is the clock's new time."""
    s.earlier_stamps = s.earlier_stamps + 1 if s.earlier_stamps > 0 and t > s.earlier_time else 1
    s.earlier_time = t
    if s.earlier_stamps <= at.MOST_EARLIER:
        s.not_later += 1
        return False
    return True


def leave(s, u, y, t, r, confirms):
    """Leave a sample that leaps; return by how much more are rejected.

    Where it ``confirms`` the one that is held back, the identifier takes that, and this one once more.  Else it is held
    back itself, until the next one tells whether it was misread.
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


def is_far(s, u):
    """Return whether an input is far beyond all before, where these are known."""
    away = u - s.input_mean
    return away * away > INPUT_LEAP * INPUT_LEAP * s.largest_power > 0.0


def input_leaps(s, u, y, t, r):
    """Return whether a sample whose input is far away is to be left: alone it was misread, two in a row are a move."""
    if s.held_at == at.BELIEVED:
        return False
    if math.isinf(t):
        s.not_finite += 1
    else:
        s.input_leaps += leave(s, u, y, t, r, s.held_at == s.samples + 1 and is_far(s, s.held_input))
    return True


def time_leaps(s, u, y, t, r):
    """Return whether a sample whose stamp leaps ahead is to be left: the next one shows whether it was misread."""
    leap, held = at.LEAP * s.interval, s.held_time
    if s.held_at == at.BELIEVED:
        return False
    ahead = held - s.last_time
    # it was not where that comes soon after it, or hardly further ahead than it had leapt: there are slow rigs
    soon = ahead > leap and 0.0 < t - held <= max(leap, 2.0 * ahead)
    s.time_leaps += leave(s, u, y, t, r, s.held_at == s.samples + 1 and soon)
    return True


def is_too_coarse(s, t):
    """Return whether stamps as far from zero cannot tell sampling times apart; count it."""
    if abs(t) <= at.FARTHEST * s.interval:
        return False
    s.too_coarse += 1
    return True


def interval_of(s, u, y, t, r):
    """Return the time since the sample before; NaN, and count it, where a time stamp cannot be used, or not yet."""
    if math.isnan(t):
        return s.interval
    if math.isinf(t):
        s.not_finite += 1
        return np.nan
    interval = s.interval
    if s.samples > 0:
        interval = t - s.last_time
        if not interval > 0.0:
            if is_too_coarse(s, t) or not clock_was_set(s, t):
                return np.nan
            interval = 2.0 * s.longest_gap  # how long it was nobody knows
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
