"""What happens to one sample in the article's method: a fixed filter and a regular clock.

No instruments, no dead time, fewer zeros than poles, no covariance.
The same numbers as `step` makes of the same arrays, to the bit, so that either can go on where the other stopped; but
as fast as C.  With one interval there is one discretisation, so every array that a sample needs is cut once a call.
"""

import numpy as np

from replant.kernels import schema as at
from replant.kernels.codegen.decorators import (
    inline_llvm,
    inline_source,
    kernel,
    outlined,
)
from replant.kernels.codegen.pointer import pointer
from replant.kernels.filters import bank as bk
from replant.kernels.filters import chain
from replant.kernels.optimizers import gradient as first
from replant.kernels.step.shared import (
    acceptable,
    draw_rows,
    keep_estimate,
    keep_sample,
    left_float64,
)


@inline_llvm
def place_of(bank, n, T, interval):
    """Return where in the bank the exact solution over ``interval`` lies, or will lie once it is computed."""
    kept, size = bk.at_kept(n, T), 1 + n * n + 2 * n
    for slot in range(bk.KEPT):
        if abs(bank[kept + slot * size] - interval) <= bk.SAME_INTERVAL * interval:
            return kept + slot * size
    return kept + int(bank[bk.NEXT]) * size


@inline_source
def cut_filters(ints, reals, banks):
    """Return the arrays of the filters.

    A (n n,), the responses to a constant and to a ramp (n,); the states of the output, then of the input, and room for
    the new ones (2 n,); the rings of past inputs, held inputs and intervals.
    """
    n, T, ring, bank = ints[at.ORDER], ints[at.ENTRIES], ints[at.RING_SIZE], banks[0]
    place, states, room = place_of(bank, n, T, reals[at.INTERVAL]), bk.at_states(n, T), ints[at.AT_WORK]
    constant = place + 1 + n * n
    inputs, held, intervals = ints[at.AT_INPUTS], ints[at.AT_HELD], ints[at.AT_INTERVALS]
    return (
        bank[place + 1 : constant],
        bank[constant : constant + n],
        bank[constant + n : constant + 2 * n],
        bank[states : states + 2 * n],
        reals[room : room + 2 * n],
        reals[inputs : inputs + ring],
        reals[held : held + ring],
        reals[intervals : intervals + ring],
    )


@inline_source
def cut_regressor(ints, reals, banks):
    """Return the arrays of `fill_regressor`: those of the output (n numbers each), then those of the input.

    d_i / c^(n-i), gain, new filter state, phi; gain, the new states that enter the regressor, phi.  The last entry of
    phi and of its gain is the constant where there is one.
    """
    n, T, inputs, bank = ints[at.ORDER], ints[at.ENTRIES], ints[at.INPUT_ENTRIES], banks[0]
    characteristic, gain, room, phi = bk.DENOMINATOR + n, bk.at_gain(n), ints[at.AT_WORK], ints[at.AT_PHI]
    return (
        bank[characteristic : characteristic + n],
        bank[gain : gain + n],
        reals[room : room + n],
        reals[phi : phi + n],
        bank[gain + n : gain + T],
        reals[room + 2 * n - inputs : room + 2 * n],
        reals[phi + n : phi + T],
    )


@inline_source
def cut_estimate(ints, reals):
    """Return what is learned, and with what.

    theta (T,) and the optimizer's memory (M,); both as they were before the newest sample; phi (T,); the unit of
    theta (T,); the optimizer's settings (S,); the drawn rows (BATCH,).
    """
    T, M, S = ints[at.ENTRIES], ints[at.MEMORY_SIZE], ints[at.SETTINGS_SIZE]
    theta, memory, backup = ints[at.AT_THETA], ints[at.AT_MEMORY], ints[at.AT_BACKUP]
    phi, unit, settings = ints[at.AT_PHI], ints[at.AT_UNIT], ints[at.AT_SETTINGS]
    return (
        reals[theta : theta + T],
        reals[memory : memory + M],
        reals[backup : backup + T],
        reals[backup + T : backup + T + M],
        reals[phi : phi + T],
        reals[unit : unit + T],
        reals[settings : settings + S],
        ints[at.ROWS : at.ROWS + ints[at.BATCH_SIZE]],
    )


@inline_source
def advance_states(A, constant, ramp, states, new, y, rise_y, u, rise):
    """Find the filter states after one interval: output and input start at y and u and rise along straight lines.

    They take the place of the others at the end (`settle`): the regressor, for which all else waits, is made of ``new``
    as it comes, not of a copy.
    """
    n = constant.size
    wy, wu, new_wy, new_wu = pointer(states, 0), pointer(states, n), pointer(new, 0), pointer(new, n)
    for i in range(n):
        row = pointer(A, i * n)
        sy = constant[i] * y + ramp[i] * rise_y
        su = constant[i] * u + ramp[i] * rise
        for j in range(n):
            sy += row[j] * wy[j]
            su += row[j] * wu[j]
        new_wy[i] = sy
        new_wu[i] = su


@inline_source
def settle(states, new):
    """Let the new states take the place of the others."""
    for i in range(states.size):
        states[i] = new[i]


@outlined
def discretize(ints, reals, bank):
    """Make the one discretisation that a regular clock needs, unless it is there."""
    n, T = ints[at.ORDER], ints[at.ENTRIES]
    bk.discretization(bank, n, T, reals[at.INTERVAL], reals[ints[at.AT_WORK] :])


@outlined
def begin(ints, reals, banks, u, y):
    """Take the first sample: the filters are at rest, and their discretisation is made."""
    chain.begin(ints, reals, banks, u, y)
    discretize(ints, reals, banks[0])
    states, new = bk.at_states(ints[at.ORDER], ints[at.ENTRIES]), ints[at.AT_WORK]
    for i in range(2 * ints[at.ORDER]):
        reals[new + i] = banks[0, states + i]


@inline_source
def advance_filters(ints, reals, filters, u, y):
    """Carry the filter states from the sample before to this one, as (6)-(7) do."""
    A, constant, ramp, states, new, inputs, held, intervals = filters
    interval, last, last_y = reals[at.INTERVAL], reals[at.INPUT_NOW], reals[at.LAST_OUTPUT]
    newest = np.uint64(ints[at.RING_HEAD] + 1)  # unsigned: need not be checked when it serves as index
    if newest == np.uint64(inputs.size):
        newest = np.uint64(0)
    ints[at.RING_HEAD] = newest
    inputs[newest], held[newest], intervals[newest] = u, last, interval
    rise = u - last if ints[at.STRAIGHT_INPUT] == 1 else 0.0
    advance_states(A, constant, ramp, states, new, last_y, y - last_y, last, rise)
    reals[at.INPUT_NOW] = u


@inline_source
def fill_regressor(reals, regressor, y):
    """Fill the scaled regressor phi of (12) and return the scaled target s^n/Lambda y."""
    characteristic, gain_y, wy, phi_y, gain_u, wu, phi_u = regressor
    target = y
    for i in range(wy.size):
        target -= characteristic[i] * wy[i]
        phi_y[i] = gain_y[i] * wy[i]
    for i in range(wu.size):
        phi_u[i] = gain_u[i] * wu[i]
    if phi_u.size > wu.size:
        phi_u[wu.size] = gain_u[wu.size]
    return target / reals[at.OUTPUT_SCALE]


@inline_source
def error_of(theta, phi, target):
    """Return the a-priori error y - theta' phi, scaled."""
    error = target
    for i in range(theta.size):
        error -= theta[i] * phi[i]
    return error


@inline_source
def keep_and_write(ints, row, estimate, target):
    """Keep the estimate as it is and write a sample into its row of the buffer; return the a-priori error, scaled.

    In one pass: for a few parameters to begin a loop takes longer than to run it.
    """
    theta, memory, kept_theta, kept_memory, phi = estimate[:5]
    T, squares, error = phi.size, 0.0, target
    for i in range(phi.size):
        entry, parameter = phi[i], theta[i]
        row[i], kept_theta[i] = entry, parameter
        squares += entry * entry
        error -= parameter * entry
    row[T] = target
    row[T + 1] = 1.0 / (1.0 + squares) if ints[at.NORMALIZE] == 1 else 1.0
    for i in range(memory.size):
        kept_memory[i] = memory[i]
    return error


@inline_source
def update_estimate(ints, buffer, estimate, target):
    """Learn the newest sample and its batch; undo what leaves float64.  Returns the a-priori error, scaled."""
    theta, memory, kept_theta, kept_memory, _, unit, settings, rows = estimate
    error = keep_and_write(ints, first.row_of(buffer, ints[at.BUFFER_HEAD]), estimate, target)
    batch = draw_rows(ints, rows)
    first.learn(ints[at.ALGORITHM], theta, memory, settings, buffer, rows, batch, 0)
    if left_float64(theta, unit, memory):
        ints[at.REFUSED] += 1
        for i in range(theta.size):
            theta[i] = kept_theta[i]
        for i in range(memory.size):
            memory[i] = kept_memory[i]
    return error


@inline_llvm
def take(ints, reals, banks, buffer, recent, filters, regressor, estimate, u, y):
    """Take one sample; return the a-priori output error y - theta' phi in the unit of y, NaN if it was rejected."""
    if ints[at.SQUARE_INPUT] == 1:
        u = u * u
    u -= reals[at.INPUT_OFFSET]
    y -= reals[at.OUTPUT_OFFSET]
    if not acceptable(ints, u, y):
        return np.nan
    if ints[at.RECENT_SIZE] > 0:
        keep_sample(ints, recent, u, y, reals[at.INTERVAL])
    if ints[at.SAMPLES] > 0:
        reals[at.ELAPSED] += reals[at.INTERVAL]
    if ints[at.STARTED] == 0:
        begin(ints, reals, banks, u, y)
    else:
        advance_filters(ints, reals, filters, u, y)
    reals[at.LAST_OUTPUT] = y
    target = fill_regressor(reals, regressor, y)
    settle(filters[3], filters[4])
    ints[at.SAMPLES] += 1
    if ints[at.ADAPT] == 0 or reals[at.ELAPSED] < reals[at.LEARN_FROM]:
        error = error_of(estimate[0], estimate[4], target)
        ints[at.RESTED] += 1
    else:
        error = update_estimate(ints, buffer, estimate, target)
        ints[at.LEARNED] = ints[at.SAMPLES]
    if ints[at.SAMPLES] >= ints[at.PAST_DUE]:
        keep_estimate(ints, reals)
    return error * reals[at.OUTPUT_SCALE]


@kernel
def step(ints, reals, banks, buffer, recent, u, y, t):
    """Take one sample; return its error as `take` does.  ``t`` must be NaN: the clock is regular."""
    if ints[at.STARTED] == 1:
        discretize(ints, reals, banks[0])
    filters, regressor = cut_filters(ints, reals, banks), cut_regressor(ints, reals, banks)
    return take(ints, reals, banks, buffer, recent, filters, regressor, cut_estimate(ints, reals), u, y)


@kernel
def steps(ints, reals, banks, buffer, recent, u, y, t, errors, parameters):
    """Take many samples; write the error and the estimate (physical units) after each.  ``t`` must be empty.

    Returns how many: all.
    """
    if ints[at.STARTED] == 1:
        discretize(ints, reals, banks[0])
    filters, regressor = cut_filters(ints, reals, banks), cut_regressor(ints, reals, banks)
    estimate = cut_estimate(ints, reals)
    theta, unit = estimate[0], estimate[5]
    for k in range(u.size):
        errors[k] = take(ints, reals, banks, buffer, recent, filters, regressor, estimate, u[k], y[k])
        for i in range(parameters.shape[1]):
            parameters[k, i] = theta[i] * unit[i]
    return u.size
