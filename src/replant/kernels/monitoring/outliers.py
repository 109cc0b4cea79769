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

from replant.kernels import schema as at
from replant.kernels.filters import bank as bk
from replant.kernels.filters import chain, whitening
from replant.kernels.optimizers import covariance as second
from replant.kernels.schema import Alarm, Doubt

GATE = 64.0
"""A-priori error beyond which an output may be an outlier, the parameters' own uncertainty counted: eight standard
deviations [variances of the residual].
Level: eight standard deviations: one in 64 of any noise at the most (Chebyshev), of normal noise none.
Sensitivity: halved, 66 samples held against 'load step' instead of 49; doubled, 26 samples held against 'load step'
instead of 49; error of 'load step' times 0.48.
"""

UNSETTLED = 1e4
"""The same while the filters' initial state is unknown, on its own [largest squares of the modelled output].
Derivation: a hundred times as far out as the modelled output reaches: no initial state does that.
Sensitivity: halved or doubled, nothing changes on these records.
"""

ENOUGH = 100.0
"""Residuals that give a variance to judge by [samples].
Derivation: 100 residuals know a standard deviation to 7 %.
Sensitivity: halved or doubled, nothing changes on these records.
"""

SHORT = 1.0 / 200.0
"""Share of the newest residual in its variance lately [share].
Derivation: its window of (2 - a) / a = 399 samples knows a variance to 7 %.
Sensitivity: halved, 114 samples held against 'load step' instead of 49; error of 'load step' times 2.3; doubled, 9
samples held against 'load step' instead of 49.
"""

LONG = 1.0 / 4000.0
"""Share of the newest residual in its usual variance [share].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved, nothing changes on these records; doubled, no verdict changes, and no error by a quarter.
"""

MOST = 9.0
"""Power that one residual counts as at the most: three standard deviations [variances].
Level: three standard deviations: 0.3 % of normal noise is beyond.
Sensitivity: halved, 136 samples held against 'load step' instead of 49; error of 'load step' times 0.38; doubled, 7
samples held against 'load step' instead of 49.
"""

UNKNOWN = 4.0
"""Variance of an a-priori error beyond which it is that of an initial state not yet known, and no residual [variances
of the residual].
Level: two standard deviations: 5 % of normal noise is beyond.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

FADE = 0.9
"""What is left, after a sample, of a bridged output's distance from the model's [ratio].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved, 46 samples held against 'load step' instead of 49; error of 'stuck, coarse scale' times 0.78;
doubled, 46 samples held against 'load step' instead of 49; error of 'load step' times 1.4.
"""

HARM = 4e-4
"""Square by which one sample may move the modelled output: a fiftieth of its size [part of its largest square].
Origin: tests/online/test_quantised_sensor.py: where crests are cut the first few samples are off by little beside the
output.
Sensitivity: halved or doubled, nothing changes on these records.
"""

RESOLVED = 0.01
"""Share of ties (a sample equal to a new one before it) below which the scale is fine, and a tie is not learned
[share].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

COARSE = 0.3
"""Share of ties from which on the scale is coarse [share].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

CHANCE = -18.0
"""Logarithm of the chance of a run of ties below which it is none [logarithm].
Derivation: 1.5e-8, one run in 66 million samples.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

MANY = 8
"""Ties in a row on a coarse scale that are looked at [samples].
Derivation: at the share COARSE such a run has the chance 7e-5.
Sensitivity: halved or doubled, nothing changes on these records.
"""

MOVED_RESOLVED = 0.0625
"""Square by which the modelled output must have moved meanwhile, on a fine scale [variances of the residual].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

MOVED = 64.0
"""The same on a coarse scale: eight standard deviations [variances of the residual].
Derivation: as GATE.
Sensitivity: halved, nothing changes on these records; doubled, error of 'stuck, coarse scale' times 2.1.
"""

PART_RESOLVED = 1e-8
"""The same on a fine scale, where there is hardly any noise [part of the modelled output's largest square].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

PART = 1e-3
"""The same on a coarse scale [part of the modelled output's largest square].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

STEPS = 3.0
"""Steps of the sensor's scale by which the modelled output must have moved meanwhile: an output that settles stands
still between two of them [steps of the scale].
Origin: tests/online/test_quantised_sensor.py.
Sensitivity: halved, no verdict changes, and no error by a quarter; doubled, error of 'stuck, coarse scale' times 2.8.
"""

COARSER = 1.01
"""Growth of the least step seen, with each one that is larger: a scale may change [ratio a step].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

CALM = 200
"""Samples after a stuck one until learning goes on: a sensor that saturates does so again soon [samples].
Derivation: the memory of the residual's variance lately, 1 / SHORT.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

FORGOTTEN = 5000
"""Samples after a stuck one until its output is forgotten [samples].
Derivation: half of the newest samples that are kept.
Sensitivity: halved or doubled, nothing changes on these records.
"""

TIE_SHARE = 1.0 / 500.0
"""Share of the newest sample in the share of ties [share].
Derivation: its window of 999 samples has ten ties at the share RESOLVED: it is known to a third.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

LEAST_TIE_SHARE = 1e-3
"""Share of ties that a scale counts as having at the least [share].
Derivation: half of what TIE_SHARE adds with one tie: fewer were not seen.
Sensitivity: halved or doubled, nothing changes on these records.
"""

GROWN = 2.0
"""Power of the residual that is no growth yet [usual power].
Derivation: the reference value r ln r / (r - 1) of Page's test for a power that grows r = 5 times.
Sensitivity: halved, right estimates no longer trusted: 'gain doubled', 'gain 20 % up'; wrong ones trusted no longer:
'input rests'; 'input rests' noticed after 50 samples instead of never; 1 samples held against 'slow noise' instead of
0; 1 samples held against 'gaps' instead of 0; error of 'saturated' times 0.27; error of 'gain doubled' times 6.3; error
of 'gain 20 % up' times 4.8; doubled, right estimates no longer trusted: 'gain 20 % up'; error of 'gain 20 % up' times
4.8.
"""

LIMIT = 50.0
"""Sum by which the residual must have exceeded GROWN that raises the alarm, and must have stayed below that
ends it [usual power, summed].
Level: with GROWN it is 20 nats, at least 5e8 samples between two false alarms of normal noise (Wald).
Sensitivity: halved or doubled, nothing changes on these records.
"""

LARGEST_LIMIT = 400.0
"""Largest sum that raises the alarm: each false one doubles it [usual power, summed].
Derivation: three doublings of LIMIT.
Sensitivity: halved or doubled, nothing changes on these records.
"""

LEAST = 1e-6
"""Residual below which there is as good as none [part of the modelled output's largest square].
Derivation: a thousandth of the output.
Sensitivity: halved or doubled, nothing changes on these records.
"""


def model_output(ints, banks):
    """Return the auxiliary model's output at the newest sample, 0 without one."""
    return banks[ints[at.SERVING_BANK], bk.MODEL_OUTPUT] if ints[at.INSTRUMENTS] == 1 else 0.0


def equation_error(ints, reals, target):
    """Return target - theta' phi, scaled."""
    theta = reals[ints[at.AT_THETA] : ints[at.AT_THETA] + ints[at.ENTRIES]]
    phi = reals[ints[at.AT_PHI] : ints[at.AT_PHI] + ints[at.ENTRIES]]
    error = target
    for i in range(theta.size):
        error -= theta[i] * phi[i]
    return error


def own_noise(ints, reals):
    """Return what the residual's variance is in the unit of the optimizer's covariance."""
    memory, settings = reals[ints[at.AT_MEMORY] :], reals[ints[at.AT_SETTINGS] :]
    return second.own_noise(ints[at.ALGORITHM], ints[at.ENTRIES], memory, settings)


def variance_ratio(ints, reals):
    """Return the variance of the newest a-priori error over the residual's: more while parameters are uncertain."""
    T = ints[at.ENTRIES]
    memory = ints[at.AT_MEMORY]
    U, D = reals[memory : memory + T * T], reals[memory + T * T : memory + T * T + T]
    direction = ints[at.AT_ZETA] if ints[at.INSTRUMENTS] == 1 else ints[at.AT_PHI]
    along = second.variance_along(U, D, reals[direction : direction + T])
    return 1.0 + whitening.gain(ints, reals) * along / own_noise(ints, reals)


def is_harmful(ints, reals, square):
    """Return whether an a-priori error is no chance, the parameters' uncertainty counted, and would do harm."""
    ratio = variance_ratio(ints, reals)
    reals[at.VARIANCE_RATIO] = ratio
    leverage = 1.0 - 1.0 / ratio  # part of the error by which learning it would move the modelled output
    usual = max(reals[at.LATE_VARIANCE], reals[at.USUAL_VARIANCE])
    harm = square > reals[at.LARGEST_OUTPUT] or leverage * leverage * square > HARM * reals[at.LARGEST_OUTPUT]
    return harm and square > GATE * usual * ratio


def is_outlier(ints, reals, error, settled):
    """Return whether an a-priori error is too large to be, or is none."""
    square = error * error
    if square <= GATE * max(reals[at.LATE_VARIANCE], reals[at.USUAL_VARIANCE]):
        return False
    if math.isnan(square):  # of an output that is missing
        return True
    if reals[at.RESIDUALS_SEEN] < ENOUGH or not reals[at.LARGEST_OUTPUT] > 0.0:
        return False
    if not settled and not square > UNSETTLED * reals[at.LARGEST_OUTPUT]:
        return False
    return is_harmful(ints, reals, square)


def reason_of(ints, y, doubt):
    """Return the doubt in an output whose error is too large to be, ``doubt`` where there was one before; count it."""
    if math.isnan(y):
        ints[at.NO_OUTPUT] += 1
        return Doubt.MISSING
    if doubt != Doubt.NONE:
        return doubt
    ints[at.OUTLIERS] += 1
    return Doubt.OUTLIER


def is_stuck(ints, reals, y, modelled):
    """Return whether a run of ties is no chance; if so, remember the output."""
    share = max(reals[at.TIE_SHARE], LEAST_TIE_SHARE)
    fine = share < COARSE
    if ints[at.TIES] < MANY if not fine else ints[at.TIES] * math.log(share) > CHANCE:
        return False
    moved = modelled - reals[at.TIE_MODEL]
    if abs(moved) < STEPS * reals[at.SENSOR_STEP]:
        return False
    away = moved / reals[at.OUTPUT_SCALE]
    noise = (MOVED_RESOLVED if fine else MOVED) * reals[at.USUAL_VARIANCE]  # lately it is that of a stuck sensor
    if not away * away > max(noise, (PART_RESOLVED if fine else PART) * reals[at.LARGEST_OUTPUT]):
        return False
    ints[at.STUCK_OUTPUTS] += 1
    ints[at.STUCK_LAST] = ints[at.SAMPLES]
    reals[at.STUCK_ALSO] = reals[at.STUCK_AT]
    reals[at.STUCK_AT] = y
    return True


def stands(ints, reals, y, modelled):
    """Follow how long the output has stood still; return whether the sensor is stuck."""
    step = abs(y - reals[at.LAST_RAW])
    equal = step == 0.0
    reals[at.LAST_RAW] = y
    known = False
    if ints[at.STUCK_OUTPUTS] > 0:
        known = y == reals[at.STUCK_AT] or (ints[at.STUCK_OUTPUTS] > 1 and y == reals[at.STUCK_ALSO])
        if ints[at.SAMPLES] - ints[at.STUCK_LAST] > FORGOTTEN:
            ints[at.STUCK_OUTPUTS] = 0
    if ints[at.TIES] == 0 and not known:
        reals[at.TIE_SHARE] += TIE_SHARE * ((1.0 if equal else 0.0) - reals[at.TIE_SHARE])
    if not equal:
        ints[at.TIES] = 0
        reals[at.TIE_MODEL] = modelled
        least = COARSER * reals[at.SENSOR_STEP]
        reals[at.SENSOR_STEP] = step if step < least or not least > 0.0 else least
        return known and reals[at.TIE_SHARE] < COARSE
    ints[at.TIES] += 1
    if known:
        ints[at.STUCK_LAST] = ints[at.SAMPLES]
    return known or is_stuck(ints, reals, y, modelled)


def advance_outputs(ints, reals, banks, y, interval, first):
    """Take ``y`` for the newest output: undo what the filters made of the measured one."""
    n, T, last, kept = ints[at.ORDER], ints[at.ENTRIES], reals[at.USED_OUTPUT], ints[at.AT_BACKUP]
    work = reals[ints[at.AT_WORK] :]
    refined = ints[at.REFINED] == 1
    for b in range(3):
        bank = banks[b]
        states = bk.at_states(n, T) + bk.OUTPUT * n
        for i in range(n):
            bank[states + i] = 0.0 if first else reals[kept + b * n + i]
        idle = b == 3 - ints[at.SERVING_BANK] and ints[at.WARMING] == 0
        if first or idle or (b == 0 and refined) or (b > 0 and ints[at.INSTRUMENTS] == 0):
            continue
        slot = bk.discretization(bank, n, T, interval, work)
        bk.advance_channel(bank, n, T, bk.OUTPUT, slot, last, y, work)
    reals[at.LAST_OUTPUT] = y
    return chain.fill_regressor(ints, reals, banks[ints[at.SERVING_BANK] if refined else 0], y, not refined)


def keep_outputs(ints, reals, banks):
    """Keep the states of the output's filters as they were before the newest sample."""
    n, kept = ints[at.ORDER], ints[at.AT_BACKUP]
    states = bk.at_states(n, ints[at.ENTRIES]) + bk.OUTPUT * n
    room = reals[kept : kept + 3 * n]
    for b in range(3):
        old = banks[b, states : states + n]
        for i in range(old.size):
            room[b * n + i] = old[i]


def observe(ints, reals, banks, u, y, interval):
    """Take a sample through the chain as `chain.observe` does; bridge its output where that cannot be.

    Leaves the error as measured in ERROR, the output that the filters saw in USED, and the reason in DOUBT.
    """
    first = ints[at.STARTED] == 0 or reals[at.UNKNOWN_INPUT] > 0.0
    settled = not first and reals[at.ELAPSED] >= reals[at.LEARN_FROM]
    away = reals[at.LAST_OUTPUT] - model_output(ints, banks)
    keep_outputs(ints, reals, banks)
    reals[at.USED_OUTPUT] = reals[at.LAST_OUTPUT]
    target = chain.observe(ints, reals, banks, u, y, interval)
    error = equation_error(ints, reals, target)
    modelled = model_output(ints, banks)
    doubt = Doubt.NONE
    reals[at.VARIANCE_RATIO] = 1.0
    if stands(ints, reals, y, modelled):
        doubt = Doubt.STUCK
        ints[at.STUCK] += 1
    if is_outlier(ints, reals, error, settled) or math.isnan(y):
        doubt = reason_of(ints, y, doubt)
    if doubt != Doubt.NONE:
        bridged = reals[at.USED_OUTPUT]
        if ints[at.INSTRUMENTS] == 1:
            bridged = modelled + (0.0 if first else FADE * away)
        target = advance_outputs(ints, reals, banks, bridged, interval, first)
        y = bridged
    ints[at.DOUBT] = doubt
    reals[at.ERROR] = error
    reals[at.USED_OUTPUT] = y
    size = (modelled if ints[at.INSTRUMENTS] == 1 else y) / reals[at.OUTPUT_SCALE]
    reals[at.LARGEST_OUTPUT] = max(
        size * size, reals[at.LARGEST_OUTPUT] - reals[at.FORGET_INPUT] * reals[at.LARGEST_OUTPUT]
    )
    return target


def begins_anew(ints, reals):
    """Return whether the newest error was that of an initial state not yet known after a gap, and no residual."""
    alpha = reals[ints[at.AT_MEMORY] + ints[at.MEMORY_SIZE] - 1]
    return ints[at.GAP_AT] > 0 and alpha > UNKNOWN * own_noise(ints, reals)


def is_calm(ints, reals):
    """Return whether no sensor was stuck just now, for one that saturates does so again soon, nor seems to be.

    On a fine scale a tie may be the first of many, and is so seldom a chance that nothing is lost by not learning it.
    """
    if ints[at.TIES] > 0 and reals[at.TIE_SHARE] < RESOLVED:
        return False
    return ints[at.STUCK_OUTPUTS] == 0 or ints[at.SAMPLES] - ints[at.STUCK_LAST] >= CALM


def test_power(ints, reals, power):
    """Raise the alarm, or end it, by the sum of the residual's ``power`` over the usual one."""
    if ints[at.ALARM] != Alarm.NONE:
        back = max(reals[at.CUSUM] + GROWN - power, 0.0)
        reals[at.CUSUM] = back
        if back > LIMIT:
            if ints[at.ALARM] == Alarm.FLOATS:  # what came meanwhile is no part of the record
                ints[at.GAP_AT] = ints[at.SAMPLES]
            else:
                reals[at.CUSUM_LIMIT] = min(2.0 * reals[at.CUSUM_LIMIT], LARGEST_LIMIT)
            if ints[at.ALARM] == Alarm.LOOKED_INTO:  # and no other plant was found: such residuals are usual
                reals[at.USUAL_VARIANCE] = max(reals[at.USUAL_VARIANCE], reals[at.LATE_VARIANCE])
                reals[at.USUAL_INNOVATION] = max(reals[at.USUAL_INNOVATION], reals[at.LATE_INNOVATION])
            ints[at.ALARM] = Alarm.NONE
            reals[at.CUSUM] = 0.0
            ints[at.CHANGE_BEGAN] = ints[at.SAMPLES]
        return
    grown = reals[at.CUSUM] + power - GROWN
    reals[at.CUSUM] = max(grown, 0.0)
    if not grown > 0.0:
        ints[at.CHANGE_BEGAN] = ints[at.SAMPLES]
    elif grown > reals[at.CUSUM_LIMIT]:
        ints[at.ALARM] = Alarm.RAISED
        reals[at.CUSUM] = 0.0


def innovation_power(reals, square):
    """Follow the variance of the filtered residual; return its newest ``square`` over the usual one.

    The residual itself varies slowly where it is coloured: a long swing of it would pass for a change.
    """
    least = LEAST * reals[at.LARGEST_OUTPUT]
    late, usual = max(reals[at.LATE_INNOVATION], least), max(reals[at.USUAL_INNOVATION], least)
    reals[at.LATE_INNOVATION] += SHORT * (min(square, MOST * late) - reals[at.LATE_INNOVATION])
    square = min(square, MOST * usual)
    return square / usual if usual > 0.0 else 0.0


def watch(ints, reals, learned, white):
    """Follow the residual's variance, and whether it has grown.

    ``learned``: whether the plant can be judged by it; ``white``: the residual filtered by the noise model.
    """
    if ints[at.DOUBT] >= Doubt.STUCK:
        return
    if learned and ints[at.DOUBT] == Doubt.NONE and ints[at.LEARNED] == ints[at.SAMPLES]:
        alpha = reals[ints[at.AT_MEMORY] + ints[at.MEMORY_SIZE] - 1]
        reals[at.VARIANCE_RATIO] = max(alpha / own_noise(ints, reals), 1.0)
    square = reals[at.ERROR] * reals[at.ERROR] / reals[at.VARIANCE_RATIO]
    reals[at.RESIDUALS_SEEN] += 1.0
    if reals[at.RESIDUALS_SEEN] > ENOUGH:
        least = LEAST * reals[at.LARGEST_OUTPUT]
        reals[at.LATE_VARIANCE] += SHORT * (
            min(square, MOST * max(reals[at.LATE_VARIANCE], least)) - reals[at.LATE_VARIANCE]
        )
        usual = max(reals[at.USUAL_VARIANCE], least)
        square = min(square, MOST * usual)
        power = square / usual if usual > 0.0 else 0.0
        if ints[at.HAS_NOISE_MODEL] == 1 and ints[at.DOUBT] == Doubt.NONE:
            power = innovation_power(reals, white * white / reals[at.VARIANCE_RATIO])
        if learned and reals[at.CUSUM_LIMIT] > 0.0:
            test_power(ints, reals, power)
        if ints[at.ALARM] == Alarm.NONE:
            share = max(1.0 / reals[at.RESIDUALS_SEEN], LONG)
            reals[at.USUAL_VARIANCE] += share * (square - reals[at.USUAL_VARIANCE])
            if ints[at.HAS_NOISE_MODEL] == 1 and ints[at.DOUBT] == Doubt.NONE:
                reals[at.USUAL_INNOVATION] += (
                    share * (power - 1.0) * max(reals[at.USUAL_INNOVATION], LEAST * reals[at.LARGEST_OUTPUT])
                )
    else:
        reals[at.USUAL_VARIANCE] += (square - reals[at.USUAL_VARIANCE]) / reals[at.RESIDUALS_SEEN]
        reals[at.LATE_VARIANCE] = reals[at.USUAL_VARIANCE]
