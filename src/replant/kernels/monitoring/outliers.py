"""Outlier, stuck-sensor and change detection: which outputs are implausible, and whether the plant has changed.

An outlier must not reach the filters.  It would stay there for as long as the plant's own memory, and meanwhile the
step theta += P zeta e / alpha does not contract: with the outlier in the regressor but not in the instruments,
1 - zeta' P phi / alpha leaves [-1, 1].  So the auxiliary model's output replaces (bridges) an implausible output, as if
the sample were missing, and nothing is learned from it.

* An outlier has an a-priori error above eight standard deviations, including the uncertainty of the parameters.  The
  error must also be harmful: larger than the recent modelled output, or large enough to move that by a fiftieth.
  Smaller errors do no harm, and a slightly wrong model must learn from them.  Each outlier increases the variance, so
  that a lasting shift is soon accepted.
* A stuck sensor repeats the same number to the bit, more often than chance allows, while the model's output moves by
  more than three steps of the sensor's scale.  Rounded numbers repeat now and then, and an output that has settled
  between two steps is rightly constant.

A cumulative sum (Page, 1954) of the residual's power above GROWN times its usual value detects a change of the plant.
The reversed sum detects the return to the usual power.  Source: Basseville and Nikiforov, "Detection of Abrupt
Changes", 1993, chapter 2.
"""

import math

from replant.kernels.filters import autoregressions, chain
from replant.kernels.filters import bank as bk
from replant.kernels.native import inlined
from replant.kernels.optimizers import covariance as second
from replant.kernels.schema import Alarm, Doubt

GATE = 64.0
"""Squared a-priori error beyond which an output may be an outlier: eight standard deviations, including the uncertainty
of the parameters [variances of the residual].
Level: eight standard deviations: at most one sample in 64 of any noise (Chebyshev), none of normal noise.
Sensitivity: halved, 66 samples held against 'load step' instead of 49; doubled, 26 samples held against 'load step'
instead of 49; error of 'load step' times 0.48.
"""

# a hundred times the modelled output: no initial state explains that
UNSETTLED = 1e4  # the same limit while the filters' initial state is unknown [largest squares of the modelled output]
# 100 residuals estimate a standard deviation to 7 %
ENOUGH = 100.0  # residuals needed before their variance is used [samples]
# its window of (2 - a) / a = 399 samples estimates a variance to 7 %
SHORT = 1.0 / 200.0  # share of the newest residual in the recent variance [share]
# the usual variance follows a lasting growth: with this share LIMIT is reached first from 2.26 times the usual power
# on, with twice the share from 2.39, with half of it from 2.18; GROWN is the bound for a share of zero
LONG = 1.0 / 4000.0  # share of the newest residual in the usual variance [share]
# three standard deviations: exceeded by 0.3 % of normal noise
MOST = 9.0  # largest power that one residual counts as [variances]
# two standard deviations: exceeded by 5 % of normal noise
UNKNOWN = 4.0  # variance beyond which an error is due to an unknown initial state [variances of the residual]

HARM = 4e-4
"""Largest squared shift of the modelled output by one sample that does no harm: a fiftieth of its size [part of its
largest square].
Origin: tests/online/test_quantised_sensor.py: if crests are cut off, the first few samples deviate little.
Sensitivity: halved or doubled, nothing changes on these records.
"""

# then at most a hundredth of the samples is not learned: standard deviations grow by half a percent
RESOLVED = 0.01  # share of ties (repeated outputs) below which the scale is fine: ties are not learned [share]
# white normal noise rounded to its standard deviation has 27 % ties: the scale is as coarse as the noise
COARSE = 0.3  # share of ties above which the scale is coarse [share]
# 1.5e-8, one run in 66 million samples
CHANCE = -18.0  # logarithm of the probability of a run of ties below which it is not chance [logarithm]
# with the share COARSE the probability of such a run is 7e-5
MANY = 8  # ties in a row that are tested on a coarse scale [samples]
# as GATE; on a fine scale one variance is enough, as ties are not chance
MOVED = 64.0  # squared move of the model during the ties that is required on a coarse scale [variances of the residual]

STEPS = 3.0
"""Move of the modelled output during the ties that is required: an output that settles between two steps of the scale
is constant [steps of the scale].
Origin: tests/online/test_quantised_sensor.py.
Sensitivity: halved, no verdict changes, and no error by a quarter; doubled, error of 'stuck, coarse scale' times 2.8.
"""

# the memory of the recent variance, 1 / SHORT: a saturated sensor soon saturates again
CALM = 200  # samples after a stuck one until learning goes on [samples]
# half of the newest samples that are kept
FORGOTTEN = 5000  # samples after a stuck one until its output is forgotten [samples]
# its window of 999 samples has ten ties at the share RESOLVED, which estimate it to a third
TIE_SHARE = 1.0 / 500.0  # share of the newest sample in the share of ties [share]
# half of what one tie adds by TIE_SHARE: a smaller share cannot be observed
LEAST_TIE_SHARE = 1e-3  # least share of ties that a scale is assumed to have [share]
# the reference value r ln r / (r - 1) of Page's test for a power that grows r = 5 times
GROWN = 2.0  # largest power of the residual that does not count as growth [usual power]
# with GROWN it is 20 nats: at least 5e8 samples between two false alarms in normal noise (Wald)
LIMIT = 50.0  # sum above GROWN that raises the alarm, and sum below it that ends the alarm [usual power, summed]
# three doublings of LIMIT
LARGEST_LIMIT = 400.0  # largest limit of the sum: each false alarm doubles the limit [usual power, summed]
# a thousandth of the output
LEAST = 1e-6  # least variance that the residual is assumed to have [part of the modelled output's largest square]


def model_output(s):
    """Return the auxiliary model's output at the newest sample, 0 without one."""
    return s.banks[s.serving_bank, bk.MODEL_OUTPUT] if s.instruments else 0.0


def equation_error(s, target):
    """Return the a-priori error y - theta' phi, epsilon of (12)."""
    error = target
    for i in range(s.entries):
        error -= s.theta[i] * s.phi[i]
    return error


def variance_ratio(s):
    """Return the variance of the newest a-priori error over the residual's: above 1 if parameters are uncertain."""
    U, D = second.factors_of(s)
    along = second.variance_along(U, D, s.zeta if s.instruments else s.phi)
    return 1.0 + autoregressions.gain(s) * along / second.own_noise(s)


def is_harmful(s, square):
    """Return whether a squared a-priori error is significant, given the parameters' uncertainty, and harmful."""
    ratio = variance_ratio(s)
    s.variance_ratio = ratio
    leverage = 1.0 - 1.0 / ratio  # shift of the modelled output if it is learned, as a part of the error
    usual = max(s.late_variance, s.usual_variance)
    harm = square > s.largest_output or leverage * leverage * square > HARM * s.largest_output
    return harm and square > GATE * usual * ratio


def is_outlier(s, error, settled):
    """Return whether an a-priori error is implausibly large, or NaN as the output is missing."""
    square = error * error
    if square <= GATE * max(s.late_variance, s.usual_variance):
        return False
    if math.isnan(square):  # the output is missing
        return True
    if s.residuals_seen < ENOUGH or not s.largest_output > 0.0:
        return False
    if not settled and not square > UNSETTLED * s.largest_output:
        return False
    return is_harmful(s, square)


def reason_of(s, y, doubt):
    """Return the reason to doubt an output with an implausible error; keep an earlier ``doubt``; count a new one."""
    if math.isnan(y):
        s.no_output += 1
        return Doubt.MISSING
    if doubt != Doubt.NONE:
        return doubt
    s.outliers += 1
    return Doubt.OUTLIER


def is_stuck(s, y, modelled):
    """Return whether a run of ties is not chance, so the sensor is stuck; if so, remember the output."""
    share = max(s.tie_share, LEAST_TIE_SHARE)
    fine = share < COARSE
    if s.ties < MANY if not fine else s.ties * math.log(share) > CHANCE:
        return False
    moved = modelled - s.tie_model
    if abs(moved) < STEPS * s.sensor_step:
        return False
    away = moved / s.output_scale
    usual = max(s.usual_variance, LEAST * s.largest_output)  # the recent variance is that of the stuck sensor
    if not away * away > (1.0 if fine else MOVED) * usual:
        return False
    s.stuck_outputs += 1
    s.stuck_last = s.samples
    s.stuck_also = s.stuck_at
    s.stuck_at = y
    return True


def stands(s, y, modelled):
    """Count how long the output has been constant; return whether the sensor is stuck."""
    step = abs(y - s.last_raw)
    equal = step == 0.0
    s.last_raw = y
    known = False
    if s.stuck_outputs > 0:
        known = y == s.stuck_at or (s.stuck_outputs > 1 and y == s.stuck_also)
        if s.samples - s.stuck_last > FORGOTTEN:
            s.stuck_outputs = 0
    if s.ties == 0 and not known:
        s.tie_share += TIE_SHARE * ((1.0 if equal else 0.0) - s.tie_share)
    if not equal:
        s.ties = 0
        s.tie_model = modelled
        if step < s.sensor_step or not s.sensor_step > 0.0:
            s.sensor_step = step
        return known and s.tie_share < COARSE
    s.ties += 1
    if known:
        s.stuck_last = s.samples
    return known or is_stuck(s, y, modelled)


def advance_outputs(s, y, interval, first):
    """Replace the newest output by ``y``: reset the output's filters and advance them again; return the target."""
    n, T, last, kept, refined = s.order, s.entries, s.used_output, s.backup, s.refined
    for b in range(3):
        bank = s.banks[b]
        states = bk.at_states(n, T) + bk.OUTPUT * n
        for i in range(n):
            bank[states + i] = 0.0 if first else kept[b * n + i]
        idle = b == 3 - s.serving_bank and not s.warming
        if first or idle or (b == 0 and refined) or (b > 0 and not s.instruments):
            continue
        slot = bk.discretization(bank, n, T, interval, s.work)
        bk.advance_channel(bank, n, T, bk.OUTPUT, slot, last, y, s.work)
    s.last_output = y
    return chain.fill_regressor(s, s.banks[s.serving_bank if refined else 0], y)


def keep_outputs(s):
    """Keep the states of the output's filters as they were before the newest sample."""
    n, room = s.order, s.backup
    states = bk.at_states(n, s.entries) + bk.OUTPUT * n
    for b in range(3):
        old = s.banks[b, states : states + n]
        for i in range(old.size):
            room[b * n + i] = old[i]


def observe(s, u, y, interval):
    """Pass a sample through the chain as `chain.observe` does; bridge an implausible output; return the target.

    Sets `error` as measured, `used_output` as the filters saw it, and the reason, `doubt`.
    """
    first = not s.started or s.unknown_input > 0.0
    settled = not first and s.elapsed >= s.learn_from
    keep_outputs(s)
    s.used_output = s.last_output
    target = chain.observe(s, u, y, interval)
    error = equation_error(s, target)
    modelled = model_output(s)
    doubt = Doubt.NONE
    s.variance_ratio = 1.0
    if stands(s, y, modelled):
        doubt = Doubt.STUCK
        s.stuck += 1
    if is_outlier(s, error, settled) or math.isnan(y):
        doubt = reason_of(s, y, doubt)
    if doubt != Doubt.NONE:
        bridged = modelled if s.instruments else s.used_output
        target = advance_outputs(s, bridged, interval, first)
        y = bridged
    s.doubt = doubt
    s.error = error
    s.used_output = y
    size = (modelled if s.instruments else y) / s.output_scale
    s.largest_output = max(size * size, s.largest_output - s.forget_input * s.largest_output)
    return target


def begins_anew(s):
    """Return whether the newest error is due to an initial state still unknown after a gap, so is not a residual."""
    alpha = second.alpha_of(s)
    return s.gap_at > 0 and alpha > UNKNOWN * second.own_noise(s)


def is_calm(s):
    """Return whether the sensor was not stuck recently, as a saturated one soon saturates again, and may not be now."""
    # a tie on a fine scale may be the first of a stuck sensor; chance ties are so rare that not learning them costs
    # nothing
    if s.ties > 0 and s.tie_share < RESOLVED:
        return False
    return s.stuck_outputs == 0 or s.samples - s.stuck_last >= CALM


def test_power(s, power):
    """Raise or end the alarm by the cumulative sum of the residual's ``power``, relative to the usual one."""
    if s.alarm != Alarm.NONE:
        back = max(s.cusum + GROWN - power, 0.0)
        s.cusum = back
        if back > LIMIT:
            if s.alarm == Alarm.FLOATS:  # the samples during the alarm are not part of the record
                s.gap_at = s.samples
            else:
                s.cusum_limit = min(2.0 * s.cusum_limit, LARGEST_LIMIT)
            s.alarm = Alarm.NONE
            s.cusum = 0.0
            s.change_began = s.samples
        return
    grown = s.cusum + power - GROWN
    s.cusum = max(grown, 0.0)
    if not grown > 0.0:
        s.change_began = s.samples
    elif grown > s.cusum_limit:
        s.alarm = Alarm.RAISED
        s.cusum = 0.0


@inlined
def follow(late, usual, square, least):
    """Return the recent variance updated by ``square``, the square clipped, and the usual variance.

    The numbers may be vectors.
    """
    usual = max(usual, least)
    return late + SHORT * (min(square, MOST * max(late, least)) - late), min(square, MOST * usual), usual


def watch(s, learned, white):
    """Update the residual's variances, and test for growth if learning is on; ``white`` is the innovation."""
    if s.doubt >= Doubt.STUCK:
        return
    if learned and s.doubt == Doubt.NONE and s.learned == s.samples:
        alpha = second.alpha_of(s)
        s.variance_ratio = max(alpha / second.own_noise(s), 1.0)
    square = s.error * s.error / s.variance_ratio
    s.residuals_seen += 1.0
    if s.residuals_seen > ENOUGH:
        least = LEAST * s.largest_output
        s.late_variance, square, usual = follow(s.late_variance, s.usual_variance, square, least)
        power = square / usual if usual > 0.0 else 0.0
        # the power of a coloured residual varies slowly, which would pass for a change: the innovation is tested
        if s.has_noise_model and s.doubt == Doubt.NONE:
            newest = white * white / s.variance_ratio
            s.late_innovation, newest, usual = follow(s.late_innovation, s.usual_innovation, newest, least)
            power = newest / usual if usual > 0.0 else 0.0
        if learned and s.cusum_limit > 0.0:
            test_power(s, power)
        if s.alarm == Alarm.NONE:
            share = max(1.0 / s.residuals_seen, LONG)
            s.usual_variance += share * (square - s.usual_variance)
            if s.has_noise_model and s.doubt == Doubt.NONE:
                s.usual_innovation += share * (power - 1.0) * max(s.usual_innovation, least)
    else:
        s.usual_variance += (square - s.usual_variance) / s.residuals_seen
        s.late_variance = s.usual_variance
