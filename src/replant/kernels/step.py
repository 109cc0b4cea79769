"""What happens to one sample: filters, regressor, buffer, updates.  One kernel serves `update` and `update_many`."""

import math

import numpy as np

from replant.kernels import first_order as first
from replant.kernels import layout as at
from replant.kernels.compiled import cut, kernel, part
from replant.kernels.random_stream import draw_below
from replant.kernels.regressor import advance_filters, cut_filters, cut_regressor, fill_regressor, next_slot

# The optimizers' codes; `replant.optimizers` names them by the same numbers.
GRADIENT, ADAM, AMSGRAD, ADAGRAD, RMSPROP, NADAM, ADADELTA, INTEGRAL_COST = range(8)


@part
def acceptable(ints, u, y):
    """Count and turn away a sample that no filter may see; all else stays as it was, to the bit."""
    if abs(u) <= at.LARGEST and abs(y) <= at.LARGEST:
        return True
    if math.isfinite(u) and math.isfinite(y):
        ints[at.TOO_LARGE] += 1
    else:
        ints[at.NOT_FINITE] += 1
    return False


@part
def remember(ints, reals, buffer, target):
    """Store the sample in the buffer (over the oldest once it is full) and draw the rows of this sample's batch.

    Algorithm 3 of the article, mended: as printed it takes the buffer for empty again each time the index wraps.
    """
    phi = reals[ints[at.AT_PHI] : ints[at.AT_PHI] + ints[at.ENTRIES]]
    P, head, capacity = phi.size, ints[at.HEAD], ints[at.CAPACITY]
    row = buffer[head]
    squares = 0.0
    for i in range(P):
        row[i] = phi[i]
        squares += phi[i] * phi[i]
    row[P] = target
    row[P + 1] = 1.0 / (1.0 + squares) if ints[at.NORMALIZE] == 1 else 1.0
    ints[at.HEAD] = next_slot(head, capacity)
    filled = min(ints[at.FILLED] + 1, capacity)
    ints[at.FILLED] = filled
    batch = ints[at.BATCH] if filled > ints[at.WARMUP] else 1
    seed, drawn = ints[at.SEED], ints[at.DRAWN]
    for i in range(batch - 1):
        ints[at.ROWS + i] = draw_below(seed, drawn + i, filled)
    ints[at.ROWS + batch - 1] = head
    ints[at.DRAWN] = drawn + batch - 1
    return batch


@cut
def cut_estimate(ints, reals):
    """Return what is learned, and with what.

    theta (P,) and the optimizer's memory (M,); both as they were before the newest sample; phi (P,); the unit of
    theta (P,); the optimizer's settings (S,); the drawn rows (BATCH,).
    """
    P, M, S = ints[at.ENTRIES], ints[at.MEMORY_SIZE], ints[at.SETTINGS_SIZE]
    theta, memory, backup = ints[at.AT_THETA], ints[at.AT_MEMORY], ints[at.AT_BACKUP]
    phi, unit, settings = ints[at.AT_PHI], ints[at.AT_UNIT], ints[at.AT_SETTINGS]
    return (
        reals[theta : theta + P],
        reals[memory : memory + M],
        reals[backup : backup + P],
        reals[backup + P : backup + P + M],
        reals[phi : phi + P],
        reals[unit : unit + P],
        reals[settings : settings + S],
        ints[at.ROWS : at.ROWS + ints[at.BATCH]],
    )


@part
def learn(algorithm, theta, memory, settings, buffer, rows, batch):
    """Let the optimizer consume the first ``batch`` of the drawn rows."""
    if algorithm == GRADIENT:
        first.gradient(theta, memory, settings, buffer, rows, batch)
    elif algorithm == ADAM:
        first.adam(theta, memory, settings, buffer, rows, batch)
    elif algorithm == AMSGRAD:
        first.amsgrad(theta, memory, settings, buffer, rows, batch)
    elif algorithm == ADAGRAD:
        first.adagrad(theta, memory, settings, buffer, rows, batch)
    elif algorithm == RMSPROP:
        first.rmsprop(theta, memory, settings, buffer, rows, batch)
    elif algorithm == NADAM:
        first.nadam(theta, memory, settings, buffer, rows, batch)
    elif algorithm == ADADELTA:
        first.adadelta(theta, memory, settings, buffer, rows, batch)
    elif algorithm == INTEGRAL_COST:
        first.integral_cost(theta, memory, settings, buffer, rows, batch)


@part
def left_float64(theta, unit, memory):
    """Say whether a physical parameter, or a number of the optimizer's memory, is not finite."""
    for i in range(theta.size):
        if not math.isfinite(theta[i] * unit[i]):
            return True
    finite = True  # no return from within: the memory may be P^2 long, and a loop that runs to its end is vectorised
    for i in range(memory.size):
        finite &= math.isfinite(memory[i])
    return not finite


@part
def take(ints, reals, buffer, filters, regressor, estimate, u, y):
    """Take one sample; return the a-priori output error y - theta' phi in the unit of y, NaN if it was rejected."""
    if ints[at.SQUARE_INPUT] == 1:
        u = u * u
    u -= reals[at.INPUT_OFFSET]
    y -= reals[at.OUTPUT_OFFSET]
    if not acceptable(ints, u, y):
        return np.nan
    advance_filters(ints, reals, filters, u, y)
    target = fill_regressor(reals, regressor, y)
    theta, memory, kept_theta, kept_memory, phi, unit, settings, rows = estimate
    error = target
    for i in range(theta.size):
        error -= theta[i] * phi[i]
        kept_theta[i] = theta[i]
    for i in range(memory.size):
        kept_memory[i] = memory[i]
    batch = remember(ints, reals, buffer, target)
    learn(ints[at.ALGORITHM], theta, memory, settings, buffer, rows, batch)
    if left_float64(theta, unit, memory):
        ints[at.REFUSED] += 1
        for i in range(theta.size):
            theta[i] = kept_theta[i]
        for i in range(memory.size):
            memory[i] = kept_memory[i]
    ints[at.SAMPLES] += 1
    return error * reals[at.OUTPUT_SCALE]


@kernel
def step(ints, reals, buffer, u, y):
    """Take one sample; return its error as `take` does."""
    filters, regressor, estimate = cut_filters(ints, reals), cut_regressor(ints, reals), cut_estimate(ints, reals)
    return take(ints, reals, buffer, filters, regressor, estimate, u, y)


@kernel
def steps(ints, reals, buffer, u, y, errors, parameters):
    """Take many samples; write the error and the estimate (physical units) after each."""
    filters, regressor, estimate = cut_filters(ints, reals), cut_regressor(ints, reals), cut_estimate(ints, reals)
    theta, _, _, _, _, unit, _, _ = estimate
    for k in range(u.size):
        errors[k] = take(ints, reals, buffer, filters, regressor, estimate, u[k], y[k])
        for i in range(theta.size):
            parameters[k, i] = theta[i] * unit[i]


@kernel
def regressors(ints, reals, u, y, phi, target):
    """Run the filters alone over a record: scaled regressor and target of each sample, for offline use.

    Rows of rejected samples are NaN.
    """
    filters, regressor = cut_filters(ints, reals), cut_regressor(ints, reals)
    newest = reals[ints[at.AT_PHI] : ints[at.AT_PHI] + ints[at.ENTRIES]]
    for k in range(u.size):
        uk = u[k] * u[k] if ints[at.SQUARE_INPUT] == 1 else u[k]
        uk -= reals[at.INPUT_OFFSET]
        yk = y[k] - reals[at.OUTPUT_OFFSET]
        if acceptable(ints, uk, yk):
            advance_filters(ints, reals, filters, uk, yk)
            target[k] = fill_regressor(reals, regressor, yk)
            for i in range(newest.size):
                phi[k, i] = newest[i]
        else:
            target[k] = np.nan
            for i in range(newest.size):
                phi[k, i] = np.nan
