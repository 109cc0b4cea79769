"""Outlier, stuck-sensor and change detection: which outputs are implausible, and whether the plant has changed.

An outlier must not reach the filters.  There it would stay for as long as the plant's own memory, and meanwhile the
step theta += P zeta e / alpha does not contract: with the instruments free of the outlier and the regressor full of
it, 1 - zeta' P phi / alpha leaves [-1, 1].  So an output that cannot be is bridged by the auxiliary model's, as if the
sample were missing, and nothing is learned from it.

* An outlier: its a-priori error exceeds eight standard deviations, with the parameters' own uncertainty counted, and
  the largest that the modelled output lately was, or what would move that by a fiftieth.  Errors below that, however
  sure, do no harm, and a model that is a little wrong must learn from them.  The variance grows by each outlier, so
  that what stays is soon believed.
* A stuck sensor: the same number to the bit so often that it is no chance, while the model says that the output moved,
  and by more than three steps of the sensor's scale.  A number that was rounded comes twice now and then, and an output
  that has settled between two steps stands still to the bit by right.

Whether the plant has changed is told from the residual's power by a cumulative sum (Page, 1954): of what it exceeds
GROWN times its usual value; that it is back as it was, by the same sum the other way.  Source: Basseville and
Nikiforov, "Detection of Abrupt Changes", 1993, chapter 2.
"""

import math

from replant.kernels.filters import bank as bk
from replant.kernels.filters import chain, whitening
from replant.kernels.native import inlined
from replant.kernels.optimizers import covariance as second
from replant.kernels.schema import Alarm, Doubt

GATE = 64.0
"""A-priori error beyond which an output may be an outlier, the parameters' own uncertainty counted: eight standard
deviations [variances of the residual].
Level: eight standard deviations: one in 64 of any noise at the most (Chebyshev), of normal noise none.
Sensitivity: halved, 66 samples held against 'load step' instead of 49; doubled, 26 samples held against 'load step'
instead of 49; error of 'load step' times 0.48.
"""

# a hundred times as far out as the modelled output reaches: no initial state does that
UNSETTLED = 1e4  # the same while the filters' initial state is unknown [largest squares of the modelled output]
# 100 residuals know a standard deviation to 7 %
ENOUGH = 100.0  # residuals that give a variance to judge by [samples]
# its window of (2 - a) / a = 399 samples knows a variance to 7 %
SHORT = 1.0 / 200.0  # share of the newest residual in its variance lately [share]
# the usual variance follows a growth that goes on: with this share a power from 2.26 times the usual one on reaches
# LIMIT before, with twice it from 2.39 on, with half of it from 2.18 on; GROWN is where none does
LONG = 1.0 / 4000.0  # share of the newest residual in its usual variance [share]
# three standard deviations: 0.3 % of normal noise is beyond
MOST = 9.0  # power that one residual counts as at the most [variances]
# two standard deviations: 5 % of normal noise is beyond
UNKNOWN = 4.0  # variance of an error that is of an initial state not yet known, no residual [variances of the residual]

HARM = 4e-4
"""Square by which one sample may move the modelled output: a fiftieth of its size [part of its largest square].
Origin: tests/online/test_quantised_sensor.py: where crests are cut the first few samples are off by little beside the
output.
Sensitivity: halved or doubled, nothing changes on these records.
"""

# at the most a hundredth of the samples is then not learned: standard deviations grow by half a percent
RESOLVED = 0.01  # share of ties, samples equal to a new one before, below which the scale is fine, none learned [share]
# of white normal noise that is rounded to its standard deviation 27 % are ties: the scale is as coarse as the noise
COARSE = 0.3  # share of ties from which on the scale is coarse [share]
# 1.5e-8, one run in 66 million samples
CHANCE = -18.0  # logarithm of the chance of a run of ties below which it is none [logarithm]
# at the share COARSE such a run has the chance 7e-5
MANY = 8  # ties in a row on a coarse scale that are looked at [samples]
# as GATE; on a fine scale, where ties are no chance, one is enough
MOVED = 64.0  # square by which the model must have moved meanwhile on a coarse scale [variances of the residual]

STEPS = 3.0
"""Steps of the sensor's scale by which the modelled output must have moved meanwhile: an output that settles stands
still between two of them [steps of the scale].
Origin: tests/online/test_quantised_sensor.py.
Sensitivity: halved, no verdict changes, and no error by a quarter; doubled, error of 'stuck, coarse scale' times 2.8.
"""

# the memory of the residual's variance lately, 1 / SHORT: a sensor that saturates does so again soon
CALM = 200  # samples after a stuck one until learning goes on [samples]
# half of the newest samples that are kept
FORGOTTEN = 5000  # samples after a stuck one until its output is forgotten [samples]
# its window of 999 samples has ten ties at the share RESOLVED: it is known to a third
TIE_SHARE = 1.0 / 500.0  # share of the newest sample in the share of ties [share]
# half of what TIE_SHARE adds with one tie: fewer were not seen
LEAST_TIE_SHARE = 1e-3  # share of ties that a scale counts as having at the least [share]
# the reference value r ln r / (r - 1) of Page's test for a power that grows r = 5 times
GROWN = 2.0  # power of the residual that is no growth yet [usual power]
# with GROWN it is 20 nats, at least 5e8 samples between two false alarms of normal noise (Wald)
LIMIT = 50.0  # sum over GROWN that raises the alarm, and below it that ends it [usual power, summed]
# three doublings of LIMIT
LARGEST_LIMIT = 400.0  # largest sum that raises the alarm: each false one doubles it [usual power, summed]
# a thousandth of the output
LEAST = 1e-6  # residual below which there is as good as none [part of the modelled output's largest square]


def model_output(s):
    """Return the auxiliary model's output at the newest sample, 0 without one."""
    return s.banks[s.serving_bank, bk.MODEL_OUTPUT] if s.instruments else 0.0


def equation_error(s, target):
    """Return the a-priori error y - theta' phi, epsilon of (12)."""
    error = target
    for i in range(s.entries):
        error -= s.theta[i] * s.phi[i]
    return error


def own_noise(s):
    """Return what the residual's variance is in the unit of the optimizer's covariance."""
    return second.own_noise(s.algorithm, s.entries, s.memory, s.settings)


def variance_ratio(s):
    """Return the variance of the newest a-priori error over the residual's: more while parameters are uncertain."""
    U, D = second.factors_of(s)
    along = second.variance_along(U, D, s.zeta if s.instruments else s.phi)
    return 1.0 + whitening.gain(s) * along / own_noise(s)


def is_harmful(s, square):
    """Return whether an a-priori error is no chance, the parameters' uncertainty counted, and would do harm."""
    ratio = variance_ratio(s)
    s.variance_ratio = ratio
    leverage = 1.0 - 1.0 / ratio  # part of the error by which learning it would move the modelled output
    usual = max(s.late_variance, s.usual_variance)
    harm = square > s.largest_output or leverage * leverage * square > HARM * s.largest_output
    return harm and square > GATE * usual * ratio


def is_outlier(s, error, settled):
    """Return whether an a-priori error is too large to be, or is none."""
    square = error * error
    if square <= GATE * max(s.late_variance, s.usual_variance):
        return False
    if math.isnan(square):  # of an output that is missing
        return True
    if s.residuals_seen < ENOUGH or not s.largest_output > 0.0:
        return False
    if not settled and not square > UNSETTLED * s.largest_output:
        return False
    return is_harmful(s, square)


def reason_of(s, y, doubt):
    """Return the doubt in an output whose error is too large to be, ``doubt`` where there was one before; count it."""
    if math.isnan(y):
        s.no_output += 1
        return Doubt.MISSING
    if doubt != Doubt.NONE:
        return doubt
    s.outliers += 1
    return Doubt.OUTLIER


def is_stuck(s, y, modelled):
    """Return whether a run of ties is no chance; if so, remember the output."""
    share = max(s.tie_share, LEAST_TIE_SHARE)
    fine = share < COARSE
    if s.ties < MANY if not fine else s.ties * math.log(share) > CHANCE:
        return False
    moved = modelled - s.tie_model
    if abs(moved) < STEPS * s.sensor_step:
        return False
    away = moved / s.output_scale
    usual = max(s.usual_variance, LEAST * s.largest_output)  # lately it is that of a stuck sensor
    if not away * away > (1.0 if fine else MOVED) * usual:
        return False
    s.stuck_outputs += 1
    s.stuck_last = s.samples
    s.stuck_also = s.stuck_at
    s.stuck_at = y
    return True


def stands(s, y, modelled):
    """Follow how long the output has stood still; return whether the sensor is stuck."""
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
    """Take ``y`` for the newest output: undo what the filters made of the measured one."""
    n, T, last, kept = s.order, s.entries, s.used_output, s.backup
    refined = s.refined
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
    return chain.fill_regressor(s, s.banks[s.serving_bank if refined else 0], y, not refined)


def keep_outputs(s):
    """Keep the states of the output's filters as they were before the newest sample."""
    n, room = s.order, s.backup
    states = bk.at_states(n, s.entries) + bk.OUTPUT * n
    for b in range(3):
        old = s.banks[b, states : states + n]
        for i in range(old.size):
            room[b * n + i] = old[i]


def observe(s, u, y, interval):
    """Take a sample through the chain as `chain.observe` does; bridge its output where that cannot be.

    Leaves the error as measured in ERROR, the output that the filters saw in USED, and the reason in DOUBT.
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
    """Return whether the newest error was that of an initial state not yet known after a gap, and no residual."""
    alpha = second.alpha_of(s)
    return s.gap_at > 0 and alpha > UNKNOWN * own_noise(s)


def is_calm(s):
    """Return whether no sensor was stuck just now, for one that saturates does so again soon, nor seems to be."""
    # the first of many, perhaps, and so seldom a chance that nothing is lost by not learning it
    if s.ties > 0 and s.tie_share < RESOLVED:
        return False
    return s.stuck_outputs == 0 or s.samples - s.stuck_last >= CALM


def test_power(s, power):
    """Raise the alarm, or end it, by the sum of the residual's ``power`` over the usual one."""
    if s.alarm != Alarm.NONE:
        back = max(s.cusum + GROWN - power, 0.0)
        s.cusum = back
        if back > LIMIT:
            if s.alarm == Alarm.FLOATS:  # what came meanwhile is no part of the record
                s.gap_at = s.samples
            else:
                s.cusum_limit = min(2.0 * s.cusum_limit, LARGEST_LIMIT)
            if s.alarm == Alarm.LOOKED_INTO:  # and no other plant was found: such residuals are usual
                s.usual_variance = max(s.usual_variance, s.late_variance)
                s.usual_innovation = max(s.usual_innovation, s.late_innovation)
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
    """Take the newest ``square`` into a variance lately; return that, the square as far as it counts, the usual one.

    The numbers may be vectors.
    """
    usual = max(usual, least)
    return late + SHORT * (min(square, MOST * max(late, least)) - late), min(square, MOST * usual), usual


def watch(s, learned, white):
    """Follow the residual's variance, and its growth where the plant can be judged by it; ``white``: it is filtered."""
    if s.doubt >= Doubt.STUCK:
        return
    if learned and s.doubt == Doubt.NONE and s.learned == s.samples:
        alpha = second.alpha_of(s)
        s.variance_ratio = max(alpha / own_noise(s), 1.0)
    square = s.error * s.error / s.variance_ratio
    s.residuals_seen += 1.0
    if s.residuals_seen > ENOUGH:
        least = LEAST * s.largest_output
        s.late_variance, square, usual = follow(s.late_variance, s.usual_variance, square, least)
        power = square / usual if usual > 0.0 else 0.0
        # of the residual itself, which varies slowly where it is coloured, a long swing would pass for a change
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
