"""What happens to one sample: checks, chain, buffer, updates.  One kernel serves `update` and `update_many`."""

import math

import numpy as np
from numba import njit

from replant.kernels import bank as bk
from replant.kernels import chain, residuals
from replant.kernels import first_order as first
from replant.kernels import layout as at
from replant.kernels import second_order as second
from replant.kernels.random_stream import draw_below
from replant.kernels.stability import slowest_decay

# The optimizers' codes; `replant.optimizers` names them by the same numbers.
GRADIENT, ADAM, AMSGRAD, ADAGRAD, RMSPROP, NADAM, ADADELTA, INTEGRAL_COST = range(8)
RECURSIVE_LEAST_SQUARES, KALMAN_TRACKING = 8, 9

AT_REST = 1e-6  # moving variance of the input, relative to its largest, below which the input rests
SETTLE = 5.0  # of the slowest time constant, to wait after a gap


@njit(cache=True, nogil=True, error_model="numpy")
def learn(ints, reals, buffer, rows, interval):
    """Let the optimizer consume the drawn rows."""
    T, M, S = ints[at.ENTRIES], ints[at.MEMORY_SIZE], ints[at.SETTINGS_SIZE]
    theta = reals[ints[at.AT_THETA] : ints[at.AT_THETA] + T]
    memory = reals[ints[at.AT_MEMORY] : ints[at.AT_MEMORY] + M]
    settings = reals[ints[at.AT_SETTINGS] : ints[at.AT_SETTINGS] + S]
    direction = T + 2 if ints[at.INSTRUMENTS] == 1 else 0
    algorithm = ints[at.ALGORITHM]
    if algorithm == GRADIENT:
        first.gradient(theta, memory, settings, buffer, rows, direction)
    elif algorithm == ADAM:
        first.adam(theta, memory, settings, buffer, rows, direction)
    elif algorithm == AMSGRAD:
        first.amsgrad(theta, memory, settings, buffer, rows, direction)
    elif algorithm == ADAGRAD:
        first.adagrad(theta, memory, settings, buffer, rows, direction)
    elif algorithm == RMSPROP:
        first.rmsprop(theta, memory, settings, buffer, rows, direction)
    elif algorithm == NADAM:
        first.nadam(theta, memory, settings, buffer, rows, direction)
    elif algorithm == ADADELTA:
        first.adadelta(theta, memory, settings, buffer, rows, direction)
    elif algorithm == INTEGRAL_COST:
        first.integral_cost(theta, memory, settings, buffer, rows, direction)
    elif algorithm == RECURSIVE_LEAST_SQUARES:
        second.recursive_least_squares(theta, memory, settings, buffer, rows, direction)
    elif algorithm == KALMAN_TRACKING:
        second.kalman_tracking(theta, memory, settings, buffer, rows, direction, interval)


@njit(cache=True, nogil=True, error_model="numpy")
def remember(ints, reals, buffer, target):
    """Store the sample in the buffer (over the oldest once it is full) and draw the rows of this sample's batch.

    Algorithm 3 of the article, mended: as printed it takes the buffer for empty again each time the index wraps.
    """
    T = ints[at.ENTRIES]
    phi, zeta = ints[at.AT_PHI], ints[at.AT_ZETA]
    row = ints[at.HEAD]
    squares = 0.0
    for i in range(T):
        buffer[row, i] = reals[phi + i]
    if ints[at.INSTRUMENTS] == 1:
        for i in range(T):
            buffer[row, T + 2 + i] = reals[zeta + i]
            squares += reals[zeta + i] * reals[zeta + i]
    else:
        for i in range(T):
            squares += reals[phi + i] * reals[phi + i]
    buffer[row, T] = target
    buffer[row, T + 1] = 1.0 / (1.0 + squares) if ints[at.NORMALIZE] == 1 else 1.0
    ints[at.HEAD] = row + 1 if row + 1 < ints[at.CAPACITY] else 0
    if ints[at.FILLED] < ints[at.CAPACITY]:
        ints[at.FILLED] += 1
    filled, batch = ints[at.FILLED], ints[at.BATCH]
    if filled <= ints[at.WARMUP]:
        batch = 1
    for i in range(batch - 1):
        ints[at.ROWS + i] = draw_below(ints[at.SEED], ints[at.DRAWN] + i, filled)
    ints[at.DRAWN] += batch - 1
    ints[at.ROWS + batch - 1] = row
    return batch


@njit(cache=True, nogil=True, error_model="numpy")
def acceptable(ints, u, y):
    """Count and turn away a sample that no filter may see; all else stays as it was, to the bit."""
    if not (math.isfinite(u) and math.isfinite(y)):
        ints[at.NOT_FINITE] += 1
        return False
    if abs(u) > at.LARGEST or abs(y) > at.LARGEST:
        ints[at.TOO_LARGE] += 1
        return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def input_rests(ints, reals, u):
    """Follow the input's moving variance; return whether it has come to rest."""
    if ints[at.SAMPLES] == 0:
        reals[at.INPUT_MEAN] = u
    share = reals[at.FORGET_INPUT]
    away = u - reals[at.INPUT_MEAN]
    reals[at.INPUT_MEAN] += share * away
    reals[at.INPUT_POWER] += share * (away * away - reals[at.INPUT_POWER])
    reals[at.LARGEST_POWER] = max(reals[at.LARGEST_POWER], reals[at.INPUT_POWER])
    return reals[at.INPUT_POWER] < AT_REST * reals[at.LARGEST_POWER]


@njit(cache=True, nogil=True, error_model="numpy")
def interrupt(ints, reals, banks):
    """Begin the filters anew after a gap: parameters stay, learning waits until what is unknown has died out."""
    n = ints[at.ORDER]
    ints[at.GAPS] += 1
    ints[at.STARTED] = 0
    ints[at.WARMING] = 0
    bank = banks[ints[at.ACTIVE]] if ints[at.INSTRUMENTS] == 1 else banks[0]
    work = reals[ints[at.AT_WORK] : ints[at.AT_WORK] + 4 * (n + 2) * (n + 2)]
    decay = slowest_decay(bank[bk.DENOMINATOR : bk.DENOMINATOR + n], work)
    reals[at.LEARN_FROM] = reals[at.ELAPSED] + (SETTLE / decay if decay > 0.0 else 0.0)
    reals[at.READY] = reals[at.LEARN_FROM]


@njit(cache=True, nogil=True, error_model="numpy")
def update_estimate(ints, reals, buffer, target, interval):
    """Learn the newest sample and its batch; undo what leaves float64."""
    T, M = ints[at.ENTRIES], ints[at.MEMORY_SIZE]
    theta, memory, backup = ints[at.AT_THETA], ints[at.AT_MEMORY], ints[at.AT_BACKUP]
    for i in range(T):
        reals[backup + i] = reals[theta + i]
    for i in range(M):
        reals[backup + T + i] = reals[memory + i]
    batch = remember(ints, reals, buffer, target)
    learn(ints, reals, buffer, ints[at.ROWS : at.ROWS + batch], interval)
    finite = True
    for i in range(T):
        finite &= math.isfinite(reals[theta + i] * reals[ints[at.AT_UNIT] + i])
    for i in range(M):
        finite &= math.isfinite(reals[memory + i])
    if not finite:
        ints[at.REFUSED] += 1
        for i in range(T):
            reals[theta + i] = reals[backup + i]
        for i in range(M):
            reals[memory + i] = reals[backup + T + i]


@njit(cache=True, nogil=True, error_model="numpy")
def record_residual(ints, reals, error):
    """Keep power and colour of the residual, where the optimizer keeps a covariance."""
    T = ints[at.ENTRIES]
    colour = reals[ints[at.AT_COLOUR] :]  # the last block
    zeta = reals[ints[at.AT_ZETA] : ints[at.AT_ZETA] + T]
    phi = reals[ints[at.AT_PHI] : ints[at.AT_PHI] + T]
    if ints[at.INSTRUMENTS] == 0:
        for i in range(T):
            zeta[i] = phi[i]
    forgetting = reals[ints[at.AT_SETTINGS]]
    alpha = reals[ints[at.AT_MEMORY] + ints[at.MEMORY_SIZE] - 1]
    residuals.record(colour, error, alpha, forgetting, zeta)


@njit(cache=True, nogil=True, error_model="numpy")
def step(ints, reals, banks, buffer, recent, u, y, t):
    """Take one sample; return the a-priori output error y - theta' phi in the unit of y, NaN if it was rejected.

    ``t`` is its time stamp in s, or NaN where the clock is regular.
    """
    if ints[at.SQUARE_INPUT] == 1:
        u = u * u
    u -= reals[at.INPUT_OFFSET]
    y -= reals[at.OUTPUT_OFFSET]
    if not acceptable(ints, u, y):
        return np.nan
    interval = reals[at.INTERVAL]
    if not math.isnan(t):
        if math.isinf(t):
            ints[at.NOT_FINITE] += 1
            return np.nan
        if ints[at.SAMPLES] > 0:
            interval = t - reals[at.LAST_TIME]
            if not interval > 0.0:
                ints[at.NOT_LATER] += 1
                return np.nan
            if interval > reals[at.LONGEST_GAP]:
                interrupt(ints, reals, banks)
        reals[at.LAST_TIME] = t
    at_rest = input_rests(ints, reals, u) and ints[at.GUARD] == 1
    if ints[at.RECENT] > 0:
        newest = ints[at.SAMPLES] % ints[at.RECENT]
        recent[newest, 0], recent[newest, 1], recent[newest, 2] = u, y, interval
    if ints[at.INSTRUMENTS] == 1 and chain.renew_model(ints, reals, banks):
        colour = ints[at.AT_COLOUR]
        if ints[at.COLOURED] == 1:
            residuals.autoregression(
                reals[colour + residuals.COVARIANCES : colour + residuals.COVARIANCES + residuals.LAGS + 1],
                reals[colour + residuals.MODEL : colour + residuals.MODEL + residuals.LAGS + 1],
            )
    target = chain.observe(ints, reals, banks, u, y, interval)
    T = ints[at.ENTRIES]
    error = target
    for i in range(T):
        error -= reals[ints[at.AT_THETA] + i] * reals[ints[at.AT_PHI] + i]
    ints[at.SAMPLES] += 1
    if at_rest or ints[at.ADAPT] == 0 or reals[at.ELAPSED] < reals[at.LEARN_FROM]:
        ints[at.RESTED] += 1
    else:
        update_estimate(ints, reals, buffer, target, interval)
        if ints[at.COLOURED] == 1:
            record_residual(ints, reals, error)
    return error * reals[at.OUTPUT_SCALE]


@njit(cache=True, nogil=True, error_model="numpy")
def steps(ints, reals, banks, buffer, recent, u, y, t, errors, parameters):
    """Take many samples; write the error and the estimate (physical units) after each.

    ``t`` holds a time stamp for each sample, or is empty where the clock is regular.
    """
    theta, unit = ints[at.AT_THETA], ints[at.AT_UNIT]
    for k in range(u.size):
        stamp = t[k] if t.size > 0 else np.nan
        errors[k] = step(ints, reals, banks, buffer, recent, u[k], y[k], stamp)
        for i in range(parameters.shape[1]):
            parameters[k, i] = reals[theta + i] * reals[unit + i]


@njit(cache=True, nogil=True, error_model="numpy")
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
                output[k] = banks[ints[at.ACTIVE], bk.MODEL_OUTPUT]
        else:
            target[k] = np.nan
            for i in range(T):
                phi[k, i] = np.nan
