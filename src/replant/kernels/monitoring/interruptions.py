"""What interrupts learning: an input that rests, a gap in the record, a clock that was set."""

import math

import numpy as np

from replant.kernels import schema as at
from replant.kernels.filters import bank as bk
from replant.kernels.filters import whitening
from replant.kernels.filters.routh import slowest_decay
from replant.kernels.monitoring import residual_colour
from replant.kernels.native import LAID_OUT, Ints, Matrix, Reals, kernel
from replant.kernels.optimizers import covariance as second
from replant.kernels.optimizers.covariance import RECURSIVE_LEAST_SQUARES
from replant.kernels.optimizers.memory import place

INPUT_LEAP = 1e3
"""Distance beyond which an input leaps [largest moving standard deviations that it so far had].
Derivation: at ten times as many one such sample would pass for the largest input ever, beside which all later ones
rest; at a tenth a single pulse may be one.
Sensitivity: halved or doubled, nothing changes on these records.
"""

AT_REST = 1e-6
"""Moving variance of the input below which it rests [part of the largest that it has been].
Derivation: a thousandth of the amplitude.
Sensitivity: halved or doubled, nothing changes on these records.
"""

LONGEST = 1e9
"""Longest time that a gap counts as [sampling times]."""

UNKNOWN = 100.0
"""Variance of an initial state of which nothing is known [largest square of the modelled output lately].
Derivation: ten times the largest that the output was.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

LEAST_NOISE = 1e-12
"""Least variance of the residual that such a variance is compared with [part of that square].
Derivation: where there is no noise at all.
Sensitivity: halved or doubled, nothing changes on these records.
"""

SETTLE = 5.0
"""Time to wait after a gap where the initial state is not estimated [slowest time constants].
Derivation: what is left of it is then exp(-5), 0.7 %.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""


def input_rests(ints, reals, u):
    """Return whether the input has come to rest: its moving variance says so, or it has not moved for a memory.

    An optimizer that forgets must not wait for the variance: it would have forgotten all by then.
    """
    if ints[at.SAMPLES] == 0:
        reals[at.INPUT_MEAN] = reals[at.INPUT_ANCHOR] = u
    share = reals[at.FORGET_INPUT]
    away = u - reals[at.INPUT_MEAN]
    reals[at.INPUT_MEAN] += share * away
    reals[at.INPUT_POWER] += share * (away * away - reals[at.INPUT_POWER])
    reals[at.LARGEST_POWER] = max(reals[at.LARGEST_POWER], reals[at.INPUT_POWER])
    least = AT_REST * reals[at.LARGEST_POWER]
    if ints[at.REST_AFTER] > 0:
        step = u - reals[at.INPUT_ANCHOR]
        ints[at.INPUT_STILL] += 1
        if step * step > least:
            reals[at.INPUT_ANCHOR] = u
            ints[at.INPUT_STILL] = 0
        elif ints[at.INPUT_STILL] > ints[at.REST_AFTER]:
            return True
    return reals[at.INPUT_POWER] < least


def unit_of_covariance(ints, reals):
    """Return the variance that the covariance of recursive least squares is a multiple of: that of what it learns."""
    usual = max(reals[at.USUAL_VARIANCE], LEAST_NOISE * reals[at.LARGEST_OUTPUT], np.finfo(np.float64).tiny)
    return whitening.gain(ints, reals) * usual


def begin_initial_state(ints, reals, banks, y):
    """Take the initial state for that of an output that stood at ``y``, and for unknown: learning goes on.

    The refined filter estimates it beside the parameters.  Ten times the largest that the modelled output lately was
    is what it may be.  The auxiliary model begins there, too: instruments far from the regressor would do harm.
    """
    n, T = ints[at.ORDER], ints[at.ENTRIES]
    first, memory = T - n, ints[at.AT_MEMORY]
    theta = reals[ints[at.AT_THETA] : ints[at.AT_THETA] + T]
    U, D = reals[memory : memory + T * T], reals[memory + T * T : memory + T * T + T]
    variances, bank = reals[ints[at.AT_WORK] : ints[at.AT_WORK] + n], banks[ints[at.SERVING_BANK]]
    size = (
        UNKNOWN
        * max(reals[at.LARGEST_OUTPUT], np.finfo(np.float64).tiny)
        * (reals[at.OUTPUT_SCALE] * reals[at.OUTPUT_SCALE])
    )
    if not y * y < size:
        y = 0.0
    for i in range(n):  # (s^(n-1) + a_(n-1) s^(n-2) + ..)/A of an impulse is one at first, and flat
        unit = reals[ints[at.AT_UNIT] + first + i]
        mean = y if i == 0 else y * bank[bk.DENOMINATOR + i - 1]
        theta[first + i] = mean / unit
        variances[i] = size / (unit * unit)
        size *= bank[bk.SCALE] * bank[bk.SCALE]
        for b in range(1, 3):
            banks[b, bk.at_weights(n, T) + first + i] = theta[first + i] * reals[at.OUTPUT_SCALE]
        if ints[at.ALGORITHM] == RECURSIVE_LEAST_SQUARES:
            variances[i] /= unit_of_covariance(ints, reals)
            cap = memory + place(second.AT_CAPS, T) + first + i
            reals[cap] = max(reals[cap], variances[i])
    second.begin_last(U, D, first, variances, reals[ints[at.AT_BACKUP] : ints[at.AT_BACKUP] + T])
    if ints[at.COLOURED] == 1:
        residual_colour.begin_last(reals[ints[at.AT_COLOUR] :], first, T)


@kernel(LAID_OUT, "ints[at.REFINED] == 1 and ints[at.COLOURED] == 1")
def forget_constant(ints: Ints, reals: Reals, banks: Matrix):
    """Take the constant beside G(s) for unknown: as large as would make the output ten times what it lately was.

    The initial state, the entries behind it, is begun anew by the next sample.
    """
    n, T = ints[at.ORDER], ints[at.ENTRIES]
    which, memory, work = T - n - 1, ints[at.AT_MEMORY], ints[at.AT_WORK]
    U, D = reals[memory : memory + T * T], reals[memory + T * T : memory + T * T + T]
    variances = reals[work : work + n + 1]
    size = (
        UNKNOWN
        * max(reals[at.LARGEST_OUTPUT], np.finfo(np.float64).tiny)
        * (reals[at.OUTPUT_SCALE] * reals[at.OUTPUT_SCALE])
    )
    unit = reals[ints[at.AT_UNIT] + which]
    size *= bk.whole_power(banks[ints[at.SERVING_BANK], bk.SCALE], 2 * n) / (unit * unit)
    size /= unit_of_covariance(ints, reals)
    for i in range(n + 1):
        variances[i] = size
    cap = memory + place(second.AT_CAPS, T) + which
    reals[cap] = max(reals[cap], size)
    second.begin_last(U, D, which, variances, reals[ints[at.AT_BACKUP] : ints[at.AT_BACKUP] + T])
    residual_colour.begin_last(reals[ints[at.AT_COLOUR] :], which, T)


@kernel(LAID_OUT)
def interrupt(ints: Ints, reals: Reals, banks: Matrix, interval: float):
    """Begin the filters anew after a gap: parameters stay, learning waits until what is unknown has died out."""
    n = ints[at.ORDER]
    ints[at.GAPS] += 1
    ints[at.GAP_AT] = ints[at.SAMPLES]
    ints[at.STARTED] = 0
    ints[at.WARMING] = 0
    reals[at.CUSUM] = 0.0
    bank = banks[ints[at.SERVING_BANK]] if ints[at.INSTRUMENTS] == 1 else banks[0]
    work = reals[ints[at.AT_WORK] :]
    decay = slowest_decay(bank[bk.DENOMINATOR : bk.DENOMINATOR + n], work)
    wait = SETTLE / decay if decay > 0.0 else 0.0
    if ints[at.INSTRUMENTS] == 1:  # a model that hardly forgets is not waited for longer than it has been known
        wait = min(wait, reals[at.ELAPSED])
    now = reals[at.ELAPSED] + interval
    reals[at.LEARN_FROM] = reals[at.READY_AT] = now + wait
    # the refined filter estimates the initial state; not where the parameters may have walked meanwhile, as far as they
    # may then go with instruments that are not yet like the regressor
    if ints[at.REFINED] == 1 and ints[at.ALGORITHM] == RECURSIVE_LEAST_SQUARES:
        reals[at.LEARN_FROM] = now


def clock_was_set(ints, reals, t):
    """Count a stamp that does not advance; return whether so many in a row advance that it is the clock's new time."""
    ints[at.EARLIER_STAMPS] = (
        ints[at.EARLIER_STAMPS] + 1 if ints[at.EARLIER_STAMPS] > 0 and t > reals[at.EARLIER_TIME] else 1
    )
    reals[at.EARLIER_TIME] = t
    if ints[at.EARLIER_STAMPS] <= at.MOST_EARLIER:
        ints[at.NOT_LATER] += 1
        return False
    return True


def hold(ints, reals, u, y, t, r, reason):
    """Hold a sample back until the next one tells whether it was misread; it counts as rejected so long."""
    ints[at.HELD_AT] = ints[at.SAMPLES] + 1
    reals[at.HELD_INPUT], reals[at.HELD_OUTPUT], reals[at.HELD_TIME] = u, y, t
    if ints[at.HAS_REFERENCE] == 1:
        reals[at.HELD_REFERENCE] = r
    ints[reason] += 1


def believe(ints, reason):
    """Tell the identifier to take the sample that is held back, and the present one once more."""
    ints[reason] -= 1
    ints[at.HELD_AT] = at.BELIEVED
    ints[at.ATTENTION] = 1


def is_far(reals, u):
    """Return whether an input is far beyond all before, where these are known."""
    away = u - reals[at.INPUT_MEAN]
    return away * away > INPUT_LEAP * INPUT_LEAP * reals[at.LARGEST_POWER] > 0.0


def input_leaps(ints, reals, u, y, t, r):
    """Return whether a sample whose input is far away is to be left: alone it was misread, two in a row are a move."""
    if ints[at.HELD_AT] == at.BELIEVED:
        return False
    if math.isinf(t):
        ints[at.NOT_FINITE] += 1
    elif ints[at.HELD_AT] == ints[at.SAMPLES] + 1 and is_far(reals, reals[at.HELD_INPUT]):
        believe(ints, at.INPUT_LEAPS)
    else:
        hold(ints, reals, u, y, t, r, at.INPUT_LEAPS)
    return True


def time_leaps(ints, reals, u, y, t, r):
    """Return whether a sample whose stamp leaps ahead is to be left: the next one shows whether it was misread.

    It was not where that comes soon after it, or hardly further ahead than it had leapt: there are slow rigs.
    """
    leap, held = at.LEAP * reals[at.INTERVAL], reals[at.HELD_TIME]
    if ints[at.HELD_AT] == at.BELIEVED:
        return False
    ahead = held - reals[at.LAST_TIME]
    if ints[at.HELD_AT] == ints[at.SAMPLES] + 1 and ahead > leap and 0.0 < t - held <= max(leap, 2.0 * ahead):
        believe(ints, at.TIME_LEAPS)
    else:
        hold(ints, reals, u, y, t, r, at.TIME_LEAPS)
    return True


def is_too_coarse(ints, reals, t):
    """Return whether stamps as far from zero cannot tell sampling times apart; count it."""
    if abs(t) <= at.FARTHEST * reals[at.INTERVAL]:
        return False
    ints[at.TOO_COARSE] += 1
    return True


def interval_of(ints, reals, banks, u, y, t, r):
    """Return the time since the sample before; NaN, and count it, where a time stamp cannot be used, or not yet."""
    if math.isnan(t):
        return reals[at.INTERVAL]
    if math.isinf(t):
        ints[at.NOT_FINITE] += 1
        return np.nan
    interval = reals[at.INTERVAL]
    if ints[at.SAMPLES] > 0:
        interval = t - reals[at.LAST_TIME]
        if not interval > 0.0:
            if is_too_coarse(ints, reals, t) or not clock_was_set(ints, reals, t):
                return np.nan
            interval = 2.0 * reals[at.LONGEST_GAP]  # how long it was nobody knows
        if reals[at.DELAY] > 0.0 and interval * (ints[at.RING_SIZE] - 2) < reals[at.DELAY]:
            ints[at.TOO_DENSE] += 1
            return np.nan
        if interval > reals[at.LONGEST_GAP]:
            if interval > at.LEAP * reals[at.INTERVAL] and (
                is_too_coarse(ints, reals, t) or time_leaps(ints, reals, u, y, t, r)
            ):
                return np.nan
            interval = min(interval, LONGEST * reals[at.INTERVAL])
            interrupt(ints, reals, banks, interval)
    elif is_too_coarse(ints, reals, t):
        return np.nan
    ints[at.EARLIER_STAMPS] = 0
    reals[at.LAST_TIME] = t
    return interval
