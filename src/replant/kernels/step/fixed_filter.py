"""One sample of the article's method: gradient family, fixed filter, regular clock.

No instruments, no dead time, fewer zeros than poles.  The result equals that of `step.gradient` to the bit, so either
can go on where the other stopped.  With one interval there is one discretisation, so every array that a sample needs is
cut once a call; benchmarks/kernels.py measures the ratio to C.
"""

import numpy as np

from replant.kernels import schema as at
from replant.kernels.filters import bank as bk
from replant.kernels.filters import chain
from replant.kernels.native import AS_MANY, IS_SOUND, LEARNS, Ints, Matrix, Reals, inlined, kernel, short_loops
from replant.kernels.optimizers import gradient as loops
from replant.kernels.step.stages import (
    acceptable,
    cut_estimate,
    draw_rows,
    keep_and_write,
    keep_estimate,
    keep_sample,
    mapped_input,
    may_learn,
    undo_unless_finite,
)


@inlined
def place_of(bank, n, T, interval):
    """Return where in the bank the exact solution over ``interval`` lies, or will lie once it is computed."""
    kept, size = bk.at_kept(n, T), 1 + n * n + 2 * n
    for slot in range(bk.KEPT):
        if abs(bank[kept + slot * size] - interval) <= bk.SAME_INTERVAL * interval:
            return kept + slot * size
    return kept + int(bank[bk.NEXT]) * size


@inlined
def cut_filters(ints, reals, bank, place):
    """Return the arrays of `advance_states`, of the exact solution that begins at ``place``.

    A (n n,), the responses to a constant and to a ramp (n,); the states of the output, then of the input, and room for
    the new ones (2 n,).
    """
    n, states, room = ints[at.ORDER], bk.at_states(ints[at.ORDER], ints[at.ENTRIES]), ints[at.AT_WORK]
    constant = place + 1 + n * n
    return (
        bank[place + 1 : constant],
        bank[constant : constant + n],
        bank[constant + n : constant + 2 * n],
        bank[states : states + 2 * n],
        reals[room : room + 2 * n],
    )


@inlined
def cut_rings(ints, reals):
    """Return the rings of past inputs, held inputs and intervals (RING,)."""
    ring, inputs, held, intervals = ints[at.RING_SIZE], ints[at.AT_INPUTS], ints[at.AT_HELD], ints[at.AT_INTERVALS]
    return reals[inputs : inputs + ring], reals[held : held + ring], reals[intervals : intervals + ring]


@inlined
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


@inlined
def advance_states(A, constant, ramp, states, new, y, rise_y, u, rise):
    """Find the filter states after one interval: output and input start at y and u and rise along straight lines.

    They take the place of the others at the end (`settle`): the regressor, for which all else waits, is made of ``new``
    as it comes, not of a copy.
    """
    n = constant.size
    wy, wu, new_wy, new_wu = states, states[n:], new, new[n:]
    for i in range(n):
        row = A[i * n :]
        sy = constant[i] * y + ramp[i] * rise_y
        su = constant[i] * u + ramp[i] * rise
        for j in range(n):
            sy += row[j] * wy[j]
            su += row[j] * wu[j]
        new_wy[i] = sy
        new_wu[i] = su


@inlined
def settle(states, new):
    """Let the new states take the place of the others."""
    for i in range(states.size):
        states[i] = new[i]


def discretize(ints, reals, bank):
    """Make the one discretisation that a regular clock needs, unless it is there."""
    n, T = ints[at.ORDER], ints[at.ENTRIES]
    bk.discretization(bank, n, T, reals[at.INTERVAL], reals[ints[at.AT_WORK] :])


def begin(ints, reals, banks, u, y):
    """Take the first sample: the filters are at rest, and their discretisation is made."""
    chain.begin(ints, reals, banks, u, y)
    discretize(ints, reals, banks[0])
    states, new = bk.at_states(ints[at.ORDER], ints[at.ENTRIES]), ints[at.AT_WORK]
    for i in range(2 * ints[at.ORDER]):
        reals[new + i] = banks[0, states + i]


@inlined
def keep_input(ints, rings, u, last, interval):
    """Keep an input in the rings: a dead time, or stamps, may come into use where another kernel goes on."""
    inputs, held, intervals = rings
    newest = ints[at.RING_HEAD] + 1
    if newest == inputs.size:
        newest = 0
    ints[at.RING_HEAD] = newest
    inputs[newest], held[newest], intervals[newest] = u, last, interval


@inlined
def advance_filters(ints, reals, filters, last, u, y):
    """Carry the filter states from the sample before, of the input ``last``, to this one, as (6)-(7) do."""
    A, constant, ramp, states, new = filters
    last_y = reals[at.LAST_OUTPUT]
    rise = u - last if ints[at.STRAIGHT_INPUT] == 1 else 0.0
    advance_states(A, constant, ramp, states, new, last_y, y - last_y, last, rise)
    reals[at.INPUT_NOW] = u


@inlined
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


@inlined
def error_of(theta, phi, target):
    """Return the a-priori error y - theta' phi, scaled."""
    error = target
    for i in range(theta.size):
        error -= theta[i] * phi[i]
    return error


@inlined
def update_estimate(ints, buffer, estimate, target):
    """Learn the newest sample and its batch; undo what leaves float64.  Returns the a-priori error, scaled."""
    theta, memory, _, _, _, _, settings, rows = estimate
    error = keep_and_write(ints, buffer[ints[at.BUFFER_HEAD]], estimate, target)
    batch = draw_rows(ints, rows)
    loops.learn(ints[at.ALGORITHM], theta, memory, settings, buffer, rows, batch, 0)
    undo_unless_finite(ints, estimate)
    return error


@inlined
def cut(ints, reals, banks):
    """Return every array that a sample needs: `cut_filters`, `cut_rings`, `cut_regressor`, `cut_estimate`."""
    place = place_of(banks[0], ints[at.ORDER], ints[at.ENTRIES], reals[at.INTERVAL])
    return (
        cut_filters(ints, reals, banks[0], place),
        cut_rings(ints, reals),
        cut_regressor(ints, reals, banks),
        cut_estimate(ints, reals),
    )


@inlined
def take(ints, reals, banks, buffer, recent, cuts, u, y):
    """Take one sample; return the a-priori output error y - theta' phi in the unit of y, NaN if it was rejected.

    ``cuts`` are those of `cut`.
    """
    filters, rings, regressor, estimate = cuts
    u, y = mapped_input(ints, reals, u), y - reals[at.OUTPUT_OFFSET]
    if not acceptable(ints, u, y):
        return np.nan
    if ints[at.RECENT_SIZE] > 0:
        keep_sample(ints, recent, u, y, reals[at.INTERVAL])
    if ints[at.SAMPLES] > 0:
        reals[at.ELAPSED] += reals[at.INTERVAL]
    if ints[at.STARTED] == 0:
        begin(ints, reals, banks, u, y)
    else:
        last = reals[at.INPUT_NOW]
        keep_input(ints, rings, u, last, reals[at.INTERVAL])
        advance_filters(ints, reals, filters, last, u, y)
    reals[at.LAST_OUTPUT] = y
    target = fill_regressor(reals, regressor, y)
    settle(filters[3], filters[4])
    ints[at.SAMPLES] += 1
    if may_learn(ints, reals):
        error = update_estimate(ints, buffer, estimate, target)
        ints[at.LEARNED] = ints[at.SAMPLES]
    else:
        error = error_of(estimate[0], estimate[4], target)
        ints[at.RESTED] += 1
    if ints[at.SAMPLES] >= ints[at.PAST_DUE]:
        keep_estimate(ints, reals)
    return error * reals[at.OUTPUT_SCALE]


@kernel(IS_SOUND, LEARNS)
@short_loops
def step(
    ints: Ints, reals: Reals, banks: Matrix, buffer: Matrix, recent: Matrix, u: float, y: float, t: float, r: float
):  # fmt: skip
    """Take one sample; return its error as `take` does.

    ``t`` must be NaN: the clock is regular.  ``r``, a reference, is not used.
    """
    if ints[at.STARTED] == 1:
        discretize(ints, reals, banks[0])
    return take(ints, reals, banks, buffer, recent, cut(ints, reals, banks), u, y)


@kernel(IS_SOUND, LEARNS, *AS_MANY)
@short_loops
def steps(
    ints: Ints, reals: Reals, banks: Matrix, buffer: Matrix, recent: Matrix, u: Reals, y: Reals, t: Reals, r: Reals,
    errors: Reals, parameters: Matrix,
):  # fmt: skip
    """Take many samples; write the error and the estimate (physical units) after each.  ``t`` and ``r`` must be empty.

    Returns how many: all.
    """
    if ints[at.STARTED] == 1:
        discretize(ints, reals, banks[0])
    cuts = cut(ints, reals, banks)
    theta, unit = cuts[3][0], cuts[3][5]
    for k in range(u.size):
        errors[k] = take(ints, reals, banks, buffer, recent, cuts, u[k], y[k])
        for i in range(parameters.shape[1]):
            parameters[k, i] = theta[i] * unit[i]
    return u.size
