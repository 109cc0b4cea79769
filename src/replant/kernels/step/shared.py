"""What happens to one sample: checks, chain, buffer, updates.  One kernel serves `update` and `update_many`."""

import math

import numpy as np

from replant.kernels import schema as at
from replant.kernels.codegen.decorators import (
    cold,
    inline_llvm,
    inline_source,
    kernel,
    outlined,
)
from replant.kernels.codegen.pointer import pointer
from replant.kernels.filters import bank as bk
from replant.kernels.filters import chain
from replant.kernels.monitoring import estimate_path as trail
from replant.kernels.monitoring import outliers, residual_colour
from replant.kernels.monitoring.interruptions import (
    begin_initial_state,
    input_leaps,
    input_rests,
    interval_of,
    is_far,
)
from replant.kernels.optimizers import covariance as second
from replant.kernels.optimizers import gradient as first
from replant.kernels.optimizers.covariance import KALMAN_TRACKING, RECURSIVE_LEAST_SQUARES
from replant.kernels.optimizers.random_stream import draw_below
from replant.kernels.schema import LAGS, Alarm, Doubt

KEEP_AFTER_PART = 8
"""Part by which the samples must have grown until the estimate is kept again [part: one in so many].
Derivation: of the four kept the oldest lies then three to four of these steps back, so that a quarter to a third of
all samples, and later three to four times PAST_STEP, are held out from it.
Sensitivity: not measured.
"""

KEEP_AFTER_LEAST = 32
"""Samples between two past estimates kept, at the least [samples].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

FEW = 16
"""Numbers up to which they are looked at one by one: just written one by one, they cannot be read as vectors before
they have all reached the cache, for which everything after would wait [count].
"""


@outlined
def learn_with_covariance(ints, reals, theta, memory, buffer, batch, interval):
    """Let an optimizer that keeps a covariance consume the drawn rows."""
    settings, rows = reals[ints[at.AT_SETTINGS] : ints[at.AT_SETTINGS] + ints[at.SETTINGS_SIZE]], ints[at.ROWS :]
    direction = theta.size + 2 if ints[at.INSTRUMENTS] == 1 else 0
    if ints[at.ALGORITHM] == RECURSIVE_LEAST_SQUARES:
        second.recursive_least_squares(theta, memory, settings, buffer, rows, batch, direction)
    elif ints[at.ALGORITHM] == KALMAN_TRACKING:
        second.kalman_tracking(theta, memory, settings, buffer, rows, batch, direction, interval)


@outlined
def learn_by_gradient(ints, reals, theta, memory, buffer, batch, interval):
    """Let an optimizer that follows the gradient consume the drawn rows."""
    settings, rows = reals[ints[at.AT_SETTINGS] : ints[at.AT_SETTINGS] + ints[at.SETTINGS_SIZE]], ints[at.ROWS :]
    direction = theta.size + 2 if ints[at.INSTRUMENTS] == 1 else 0
    first.learn(ints[at.ALGORITHM], theta, memory, settings, buffer, rows, batch, direction)


@inline_llvm
def draw_rows(ints, rows):
    """Draw the rows of the newest sample's batch into ``rows``, and move on in the buffer; return how many."""
    head, capacity = ints[at.BUFFER_HEAD], ints[at.CAPACITY]
    ints[at.BUFFER_HEAD] = head + 1 if head + 1 < capacity else 0
    filled = min(ints[at.BUFFER_FILLED] + 1, capacity)
    ints[at.BUFFER_FILLED] = filled
    batch = ints[at.BATCH_SIZE] if filled > ints[at.WARMUP] else 1
    seed, drawn = ints[at.SEED], ints[at.DRAWN]
    for i in range(batch - 1):
        rows[i] = draw_below(seed, drawn + i, filled)
    rows[batch - 1] = head
    ints[at.DRAWN] = drawn + batch - 1
    return batch


@outlined
def remember(ints, reals, buffer, target):
    """Store the sample in the buffer (over the oldest once it is full) and draw the rows of this sample's batch.

    Algorithm 3 of the article, mended: as printed it takes the buffer for empty again each time the index wraps.
    """
    T, row = ints[at.ENTRIES], buffer[ints[at.BUFFER_HEAD]]
    phi = reals[ints[at.AT_PHI] : ints[at.AT_PHI] + T]
    squares = 0.0
    for i in range(phi.size):
        row[i] = phi[i]
        squares += phi[i] * phi[i]
    if ints[at.INSTRUMENTS] == 1:
        zeta, companion = reals[ints[at.AT_ZETA] : ints[at.AT_ZETA] + T], row[T + 2 :]
        squares = 0.0
        for i in range(zeta.size):
            companion[i] = zeta[i]
            squares += zeta[i] * zeta[i]
    row[T] = target
    row[T + 1] = 1.0 / (1.0 + squares) if ints[at.NORMALIZE] == 1 else 1.0
    return draw_rows(ints, ints[at.ROWS :])


@inline_llvm
def acceptable(ints, u, y):
    """Count and turn away a sample that no filter may see; all else stays as it was, to the bit."""
    if abs(u) <= at.LARGEST and abs(y) <= at.LARGEST:
        return True
    if math.isfinite(u) and math.isfinite(y):
        ints[at.TOO_LARGE] += 1
    else:
        ints[at.NOT_FINITE] += 1
    return False


@outlined
def lacks_output_alone(ints, u, y):
    """Return whether a sample that was turned away has an input that can be used, and no output."""
    if not (math.isnan(y) and abs(u) <= at.LARGEST):
        return False
    ints[at.NOT_FINITE] -= 1
    return True


@outlined
def all_finite(size, numbers):
    """Say whether all numbers behind the pointer are finite."""
    if size <= FEW:
        for i in range(size):
            if not math.isfinite(numbers[i]):
                return False
        return True
    finite = True
    for i in range(size):  # no return from within: a loop that runs to its end is vectorised
        finite &= math.isfinite(numbers[i])
    return finite


@inline_llvm
def left_float64(theta, unit, memory):
    """Say whether a physical parameter, or a number of the optimizer's memory, is not finite."""
    for i in range(theta.size):
        if not math.isfinite(theta[i] * unit[i]):
            return True
    return memory.size > 0 and not all_finite(memory.size, pointer(memory, 0))


@inline_source
def update_estimate(ints, reals, buffer, target, interval, learn):
    """Let ``learn`` take in the newest sample and its batch; undo what leaves float64."""
    T, M, kept = ints[at.ENTRIES], ints[at.MEMORY_SIZE], ints[at.AT_BACKUP]
    theta = reals[ints[at.AT_THETA] : ints[at.AT_THETA] + T]
    memory = reals[ints[at.AT_MEMORY] : ints[at.AT_MEMORY] + M]
    unit = reals[ints[at.AT_UNIT] : ints[at.AT_UNIT] + T]
    kept_theta, kept_memory = reals[kept : kept + T], reals[kept + T : kept + T + M]
    for i in range(theta.size):
        kept_theta[i] = theta[i]
    for i in range(memory.size):
        kept_memory[i] = memory[i]
    batch = remember(ints, reals, buffer, target)
    learn(ints, reals, theta, memory, buffer, batch, interval)
    if left_float64(theta, unit, memory):
        ints[at.REFUSED] += 1
        for i in range(theta.size):
            theta[i] = kept_theta[i]
        for i in range(memory.size):
            memory[i] = kept_memory[i]


@outlined
def record_residual(ints, reals, error):
    """Keep power and colour of the residual, and the estimate's path, where the optimizer keeps a covariance."""
    T = ints[at.ENTRIES]
    colour, path = reals[ints[at.AT_COLOUR] :], reals[ints[at.AT_PATH] :]
    zeta = reals[ints[at.AT_ZETA] : ints[at.AT_ZETA] + T]
    phi = reals[ints[at.AT_PHI] : ints[at.AT_PHI] + T]
    if ints[at.INSTRUMENTS] == 0:
        for i in range(T):
            zeta[i] = phi[i]
    forgetting = reals[ints[at.AT_SETTINGS]]
    alpha = reals[ints[at.AT_MEMORY] + ints[at.MEMORY_SIZE] - 1]
    residual_colour.record(colour, error, alpha, forgetting, zeta)
    if colour[residual_colour.COUNT] >= path[trail.DUE]:
        theta, memory = reals[ints[at.AT_THETA] : ints[at.AT_THETA] + T], ints[at.AT_MEMORY]
        U, D = reals[memory : memory + T * T], reals[memory + T * T : memory + T * T + T]
        trail.keep(path, theta, U, D, colour[residual_colour.COUNT])


@cold
def keep_estimate(ints, reals):
    """Keep the estimate as it is now, in the place of the oldest one kept: later samples are held out from it."""
    T, samples = ints[at.ENTRIES], ints[at.SAMPLES]
    theta = reals[ints[at.AT_THETA] : ints[at.AT_THETA] + T]
    row = ints[at.AT_PAST] + (ints[at.PAST_KEPT] % at.PAST) * (1 + T)
    kept = reals[row + 1 : row + 1 + T]
    reals[row] = samples
    for i in range(theta.size):
        kept[i] = theta[i]
    ints[at.PAST_KEPT] += 1
    ints[at.PAST_DUE] = samples + min(max(samples // KEEP_AFTER_PART, KEEP_AFTER_LEAST), ints[at.PAST_STEP])


@inline_llvm
def keep_sample(ints, recent, u, y, interval):
    """Keep the raw sample, over the oldest one."""
    head = ints[at.RECENT_HEAD]
    row = recent[head]
    row[0], row[1], row[2] = u, y, interval
    ints[at.RECENT_HEAD] = head + 1 if head + 1 < ints[at.RECENT_SIZE] else 0


@inline_llvm
def keep_guarded_sample(ints, reals, recent, u, y, interval):
    """Keep the raw sample, over the oldest one, with the output that the filters saw and why.

    Where there is no output, what the filters saw stands for it.
    """
    head = ints[at.RECENT_HEAD]
    row = recent[head]
    row[at.INPUT], row[at.STEP] = u, interval
    row[at.OUTPUT] = reals[at.USED_OUTPUT] if ints[at.DOUBT] == Doubt.MISSING else y
    row[at.BRIDGED], row[at.DOUBTED] = reals[at.USED_OUTPUT], ints[at.DOUBT]
    ints[at.RECENT_HEAD] = head + 1 if head + 1 < ints[at.RECENT_SIZE] else 0


@inline_source
def renew_model(ints, reals, banks):
    """Let the newest estimate take over as auxiliary model where it is due, and the residual's colour with it."""
    if chain.renew_model(ints, reals, banks):
        colour = ints[at.AT_COLOUR]
        if ints[at.COLOURED] == 1:
            residual_colour.autoregression(
                reals[colour + residual_colour.COVARIANCES : colour + residual_colour.COVARIANCES + LAGS + 1],
                reals[colour + residual_colour.MODEL : colour + residual_colour.MODEL + LAGS + 1],
                reals[ints[at.AT_WORK] :],
            )


@inline_source
def take_by_gradient(ints, reals, banks, buffer, recent, u, y, t):
    """Take one sample; return the a-priori output error y - theta' phi in the unit of y, NaN if it was rejected.

    ``t`` is its time stamp in s, or NaN where the clock is regular.
    """
    if ints[at.SQUARE_INPUT] == 1:
        u = u * u
    u -= reals[at.INPUT_OFFSET]
    y -= reals[at.OUTPUT_OFFSET]
    if not acceptable(ints, u, y):
        return np.nan
    interval = interval_of(ints, reals, banks, u, y, t)
    if math.isnan(interval):
        return np.nan
    at_rest = ints[at.RESTS_WITH_INPUT] == 1 and input_rests(ints, reals, u)
    if ints[at.RECENT_SIZE] > 0:
        keep_sample(ints, recent, u, y, interval)
    if ints[at.INSTRUMENTS] == 1:
        renew_model(ints, reals, banks)
    target = chain.observe(ints, reals, banks, u, y, interval)
    error = outliers.equation_error(ints, reals, target)
    ints[at.SAMPLES] += 1
    if at_rest or ints[at.ADAPT] == 0 or reals[at.ELAPSED] < reals[at.LEARN_FROM]:
        ints[at.RESTED] += 1
    else:
        update_estimate(ints, reals, buffer, target, interval, learn_by_gradient)
        ints[at.LEARNED] = ints[at.SAMPLES]
    if ints[at.SAMPLES] >= ints[at.PAST_DUE]:
        keep_estimate(ints, reals)
    return error * reals[at.OUTPUT_SCALE]


@inline_source
def take_guarded(ints, reals, banks, buffer, recent, u, y, t):
    """Take one sample as `take_by_gradient` does, with an optimizer that keeps a covariance.

    Its output is examined; of a sample whose output alone is missing, NaN, the input is used.
    """
    if ints[at.SQUARE_INPUT] == 1:
        u = u * u
    u -= reals[at.INPUT_OFFSET]
    y -= reals[at.OUTPUT_OFFSET]
    if not (acceptable(ints, u, y) or lacks_output_alone(ints, u, y)):
        return np.nan
    if is_far(reals, u) and input_leaps(ints, reals, u, y, t):
        return np.nan
    interval = interval_of(ints, reals, banks, u, y, t)
    if math.isnan(interval):
        return np.nan
    at_rest = ints[at.RESTS_WITH_INPUT] == 1 and input_rests(ints, reals, u)
    if ints[at.INSTRUMENTS] == 1:
        renew_model(ints, reals, banks)
    if ints[at.STARTED] == 0 and ints[at.GAP_AT] > 0 and ints[at.REFINED] * ints[at.COLOURED] == 1:
        begin_initial_state(ints, reals, banks, y)
    target = outliers.observe(ints, reals, banks, u, y, interval)
    if ints[at.RECENT_SIZE] > 0:
        keep_guarded_sample(ints, reals, recent, u, y, interval)
    ints[at.SAMPLES] += 1
    tells = not (at_rest or ints[at.ADAPT] == 0 or reals[at.ELAPSED] < reals[at.LEARN_FROM])
    if not tells or ints[at.ALARM] >= Alarm.RESTS:
        ints[at.RESTED] += 1
    elif ints[at.DOUBT] == Doubt.NONE and outliers.is_calm(ints, reals):
        update_estimate(ints, reals, buffer, target, interval, learn_with_covariance)
        ints[at.LEARNED] = ints[at.SAMPLES]
        if ints[at.COLOURED] == 1 and not outliers.begins_anew(ints, reals):
            record_residual(ints, reals, reals[at.ERROR])
    outliers.watch(ints, reals, tells)
    if ints[at.SAMPLES] >= ints[at.PAST_DUE]:
        keep_estimate(ints, reals)
    if ints[at.SAMPLES] == ints[at.ATTENTION_AT] or ints[at.ALARM] == Alarm.RAISED:
        ints[at.ATTENTION] = 1
    return reals[at.ERROR] * reals[at.OUTPUT_SCALE]


@inline_source
def take_many(ints, reals, banks, buffer, recent, u, y, t, errors, parameters, take):
    """Take samples by ``take``, until the identifier has something to do; return how many.

    Writes the error and the estimate (physical units) after each.  ``t`` holds a time stamp for each sample, or is
    empty where the clock is regular.
    """
    theta, unit = ints[at.AT_THETA], ints[at.AT_UNIT]
    for k in range(u.size):
        stamp = t[k] if t.size > 0 else np.nan
        errors[k] = take(ints, reals, banks, buffer, recent, u[k], y[k], stamp)
        for i in range(parameters.shape[1]):
            parameters[k, i] = reals[theta + i] * reals[unit + i]
        if ints[at.ATTENTION] == 1:
            return k + 1
    return u.size


# A user needs one pair, and mostly one of the two: each is compiled by itself.


@kernel
def step(ints, reals, banks, buffer, recent, u, y, t):
    """Take one sample with an optimizer that keeps a covariance."""
    return take_guarded(ints, reals, banks, buffer, recent, u, y, t)


@kernel
def steps(ints, reals, banks, buffer, recent, u, y, t, errors, parameters):
    """Take many samples as `take_many` does, with an optimizer that keeps a covariance."""
    return take_many(ints, reals, banks, buffer, recent, u, y, t, errors, parameters, take_guarded)


@kernel
def gradient_step(ints, reals, banks, buffer, recent, u, y, t):
    """Take one sample with an optimizer that follows the gradient."""
    return take_by_gradient(ints, reals, banks, buffer, recent, u, y, t)


@kernel
def gradient_steps(ints, reals, banks, buffer, recent, u, y, t, errors, parameters):
    """Take many samples as `take_many` does, with an optimizer that follows the gradient."""
    return take_many(ints, reals, banks, buffer, recent, u, y, t, errors, parameters, take_by_gradient)


@kernel
def regressors(ints, reals, banks, u, y, intervals, phi, zeta, target, output):
    """Run the chain alone over a record, for offline use: regressors, instruments, target, auxiliary output.

    Rows of rejected samples are NaN.  ``zeta`` and ``output`` are left alone where there are no instruments.
    """
    T = ints[at.ENTRIES]
    regular = intervals.size == 1
    for k in range(u.size):
        interval = intervals[0] if regular else intervals[k]
        uk = u[k] * u[k] if ints[at.SQUARE_INPUT] == 1 else u[k]
        uk -= reals[at.INPUT_OFFSET]
        yk = y[k] - reals[at.OUTPUT_OFFSET]
        if acceptable(ints, uk, yk):
            target[k] = chain.observe(ints, reals, banks, uk, yk, interval)
            for i in range(T):
                phi[k, i] = reals[ints[at.AT_PHI] + i]
                if ints[at.INSTRUMENTS] == 1:
                    zeta[k, i] = reals[ints[at.AT_ZETA] + i]
            if ints[at.INSTRUMENTS] == 1:
                output[k] = banks[ints[at.SERVING_BANK], bk.MODEL_OUTPUT]
        else:
            target[k] = np.nan
            for i in range(T):
                phi[k, i] = np.nan
