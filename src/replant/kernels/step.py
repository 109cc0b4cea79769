"""What happens to one sample: filters, regressor, buffer, updates.  One kernel serves `update` and `update_many`."""

import math

import numpy as np
from numba import njit

from replant.kernels import first_order as first
from replant.kernels import layout as at
from replant.kernels.random_stream import draw_below

# The optimizers' codes; `replant.optimizers` names them by the same numbers.
GRADIENT, ADAM, AMSGRAD, ADAGRAD, RMSPROP, NADAM, ADADELTA, INTEGRAL_COST = range(8)


@njit(cache=True, nogil=True, error_model="numpy")
def learn(ints, reals, buffer, rows):
    """Let the optimizer consume the drawn rows."""
    P, M, S = ints[at.ENTRIES], ints[at.MEMORY_SIZE], ints[at.SETTINGS_SIZE]
    theta = reals[ints[at.AT_THETA] : ints[at.AT_THETA] + P]
    memory = reals[ints[at.AT_MEMORY] : ints[at.AT_MEMORY] + M]
    settings = reals[ints[at.AT_SETTINGS] : ints[at.AT_SETTINGS] + S]
    algorithm = ints[at.ALGORITHM]
    if algorithm == GRADIENT:
        first.gradient(theta, memory, settings, buffer, rows)
    elif algorithm == ADAM:
        first.adam(theta, memory, settings, buffer, rows)
    elif algorithm == AMSGRAD:
        first.amsgrad(theta, memory, settings, buffer, rows)
    elif algorithm == ADAGRAD:
        first.adagrad(theta, memory, settings, buffer, rows)
    elif algorithm == RMSPROP:
        first.rmsprop(theta, memory, settings, buffer, rows)
    elif algorithm == NADAM:
        first.nadam(theta, memory, settings, buffer, rows)
    elif algorithm == ADADELTA:
        first.adadelta(theta, memory, settings, buffer, rows)
    elif algorithm == INTEGRAL_COST:
        first.integral_cost(theta, memory, settings, buffer, rows)


@njit(cache=True, nogil=True, error_model="numpy")
def advance_filters(ints, reals, u, y):
    """Carry the filter states of (6)-(7) from the sample before to this one.

    The newest sample enters through the last tap of each filter.  That tap is zero where the article's strictly
    causal form, or the zero-order hold of the input, does not use it.
    """
    n = ints[at.ORDER]
    A, G, H = ints[at.AT_TRANSITION], ints[at.AT_OUTPUT_TAPS], ints[at.AT_INPUT_TAPS]
    wy, wu, past = ints[at.AT_OUTPUT_STATE], ints[at.AT_INPUT_STATE], ints[at.AT_PAST]
    ring = ints[at.LAG] + 3
    if ints[at.STARTED] == 0:
        # Before the record the input is taken to have stood at its first value.
        for i in range(ring):
            reals[past + i] = u
        reals[at.LAST_OUTPUT] = y
        ints[at.STARTED] = 1
        return
    newest = ints[at.PAST] + 1
    if newest == ring:
        newest = 0
    ints[at.PAST] = newest
    reals[past + newest] = u
    u2 = reals[past + (newest + 1) % ring]  # u[k-LAG-2], the oldest in the ring
    u1 = reals[past + (newest + 2) % ring]  # u[k-LAG-1]
    u0 = reals[past + (newest + 3) % ring]  # u[k-LAG]
    y1 = reals[at.LAST_OUTPUT]
    # new states go through the backup area, which is free until the updates begin
    spare = ints[at.AT_BACKUP]
    for i in range(n):
        sy = reals[G + i] * y1 + reals[G + n + i] * y
        su = reals[H + i] * u2 + reals[H + n + i] * u1 + reals[H + 2 * n + i] * u0
        for j in range(n):
            sy += reals[A + i * n + j] * reals[wy + j]
            su += reals[A + i * n + j] * reals[wu + j]
        reals[spare + i] = sy
        reals[spare + n + i] = su
    for i in range(n):
        reals[wy + i] = reals[spare + i]
        reals[wu + i] = reals[spare + n + i]
    reals[at.LAST_OUTPUT] = y


@njit(cache=True, nogil=True, error_model="numpy")
def regressor(ints, reals, y):
    """Fill the scaled regressor phi of (12) and return the scaled target s^n/Lambda y.

    The linear form is (4) with lambda moved to the left: s^n/Lambda y = phi' [a, b], so that the estimate itself is
    in the plant's parameters and the prediction error is the one of (8).
    """
    n, P, inputs = ints[at.ORDER], ints[at.ENTRIES], ints[at.INPUT_ENTRIES]
    wy, wu, gain, phi = ints[at.AT_OUTPUT_STATE], ints[at.AT_INPUT_STATE], ints[at.AT_GAIN], ints[at.AT_PHI]
    characteristic = ints[at.AT_CHARACTERISTIC]
    target = y
    for i in range(n):
        target -= reals[characteristic + i] * reals[wy + i]
        reals[phi + i] = reals[gain + i] * reals[wy + i]
    for i in range(inputs):
        reals[phi + n + i] = reals[gain + n + i] * reals[wu + n - inputs + i]
    if P > n + inputs:
        reals[phi + P - 1] = reals[gain + P - 1]
    return target / reals[at.OUTPUT_SCALE]


@njit(cache=True, nogil=True, error_model="numpy")
def remember(ints, reals, buffer, target):
    """Store the sample in the buffer (over the oldest once it is full) and draw the rows of this sample's batch.

    Algorithm 3 of the article, mended: as printed it takes the buffer for empty again each time the index wraps.
    """
    P = ints[at.ENTRIES]
    phi = ints[at.AT_PHI]
    row = ints[at.HEAD]
    squares = 0.0
    for i in range(P):
        buffer[row, i] = reals[phi + i]
        squares += reals[phi + i] * reals[phi + i]
    buffer[row, P] = target
    buffer[row, P + 1] = 1.0 / (1.0 + squares) if ints[at.NORMALIZE] == 1 else 1.0
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
def step(ints, reals, buffer, u, y):
    """Take one sample; return the a-priori output error y - theta' phi in the unit of y, NaN if it was rejected."""
    if ints[at.SQUARE_INPUT] == 1:
        u = u * u
    u -= reals[at.INPUT_OFFSET]
    y -= reals[at.OUTPUT_OFFSET]
    if not acceptable(ints, u, y):
        return np.nan
    P, M = ints[at.ENTRIES], ints[at.MEMORY_SIZE]
    theta, phi, memory, backup = ints[at.AT_THETA], ints[at.AT_PHI], ints[at.AT_MEMORY], ints[at.AT_BACKUP]
    advance_filters(ints, reals, u, y)
    target = regressor(ints, reals, y)
    error = target
    for i in range(P):
        error -= reals[theta + i] * reals[phi + i]
        reals[backup + i] = reals[theta + i]
    for i in range(M):
        reals[backup + P + i] = reals[memory + i]
    batch = remember(ints, reals, buffer, target)
    learn(ints, reals, buffer, ints[at.ROWS : at.ROWS + batch])
    finite = True
    for i in range(P):
        finite &= math.isfinite(reals[theta + i] * reals[ints[at.AT_UNIT] + i])
    for i in range(M):
        finite &= math.isfinite(reals[memory + i])
    if not finite:
        ints[at.REFUSED] += 1
        for i in range(P):
            reals[theta + i] = reals[backup + i]
        for i in range(M):
            reals[memory + i] = reals[backup + P + i]
    ints[at.SAMPLES] += 1
    return error * reals[at.OUTPUT_SCALE]


@njit(cache=True, nogil=True, error_model="numpy")
def steps(ints, reals, buffer, u, y, errors, parameters):
    """Take many samples; write the error and the estimate (physical units) after each."""
    theta, unit = ints[at.AT_THETA], ints[at.AT_UNIT]
    for k in range(u.size):
        errors[k] = step(ints, reals, buffer, u[k], y[k])
        for i in range(ints[at.ENTRIES]):
            parameters[k, i] = reals[theta + i] * reals[unit + i]


@njit(cache=True, nogil=True, error_model="numpy")
def regressors(ints, reals, u, y, phi, target):
    """Run the filters alone over a record: scaled regressor and target of each sample, for offline use.

    Rows of rejected samples are NaN.
    """
    P = ints[at.ENTRIES]
    for k in range(u.size):
        uk = u[k] * u[k] if ints[at.SQUARE_INPUT] == 1 else u[k]
        uk -= reals[at.INPUT_OFFSET]
        yk = y[k] - reals[at.OUTPUT_OFFSET]
        if acceptable(ints, uk, yk):
            advance_filters(ints, reals, uk, yk)
            target[k] = regressor(ints, reals, yk)
            for i in range(P):
                phi[k, i] = reals[ints[at.AT_PHI] + i]
        else:
            target[k] = np.nan
            for i in range(P):
                phi[k, i] = np.nan
