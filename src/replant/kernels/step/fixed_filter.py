"""One sample of the article's method: gradient family, fixed filter, regular clock.

No instruments, no dead time, fewer zeros than poles.  The result equals that of `single.take_gradient` to the bit, so
each kernel can continue from the state of the other.  One interval needs one discretisation, so the arrays that a
sample needs are cut once a call.  benchmarks/kernels.py measures the ratio to C.
"""

import numpy as np

from replant.kernels.filters import bank as bk
from replant.kernels.filters import chain
from replant.kernels.monitoring.outliers import equation_error
from replant.kernels.native import AS_MANY, IS_SOUND, LEARNS, Matrix, Reals, inlined, kernel, short_loops
from replant.kernels.optimizers import gradient as loops
from replant.kernels.schema import StateSlots
from replant.kernels.step import stages


@inlined
def place_of(bank, n, T, interval):
    """Return the index in the bank of the exact solution over ``interval``, even before it is computed."""
    kept, size = bk.at_kept(n, T), 1 + n * n + 2 * n
    for slot in range(bk.KEPT):
        if abs(bank[kept + slot * size] - interval) <= bk.SAME_INTERVAL * interval:
            return kept + slot * size
    return kept + int(bank[bk.NEXT]) * size


@inlined
def cut_filters(s, bank, place):
    """Return the arrays of `bank.follow_two`, of the exact solution that begins at ``place``.

    A (n n,), the responses to constant and ramp (n,); the states of output, then input, and room for new ones (2 n,).
    """
    n, states = s.order, bk.at_states(s.order, s.entries)
    constant = place + 1 + n * n
    return (
        bank[place + 1 : constant],
        bank[constant : constant + n],
        bank[constant + n : constant + 2 * n],
        bank[states : states + 2 * n],
        s.work[: 2 * n],
    )


@inlined
def cut_regressor(s, bank):
    """Return the arrays of `fill_regressor`: those of the output (n numbers each), then those of the input.

    d_i / c^(n-i), gain, new filter state, phi; gain, the new states that enter the regressor, phi.  If there is a
    constant, it is the last entry of phi and of its gain.
    """
    n, T, inputs = s.order, s.entries, s.input_entries
    characteristic, gain = bk.DENOMINATOR + n, bk.at_gain(n)
    return (
        bank[characteristic : characteristic + n],
        bank[gain : gain + n],
        s.work[:n],
        s.phi[:n],
        bank[gain + n : gain + T],
        s.work[2 * n - inputs : 2 * n],
        s.phi[n:T],
    )


def discretize(s):
    """Make the one discretisation that a regular clock needs, unless it is there."""
    bk.discretization(s.banks[0], s.order, s.entries, s.interval, s.work)


def begin(s, u, y):
    """Take the first sample: the filters are at rest, and their discretisation is computed."""
    chain.begin(s, u, y)
    discretize(s)
    states, new = bk.at_states(s.order, s.entries), s.work
    for i in range(2 * s.order):
        new[i] = s.banks[0, states + i]


@inlined
def keep_input(s, rings, u, last, interval):
    """Keep an input in the rings: a kernel that continues from here may need them for a dead time or for stamps."""
    inputs, held, intervals = rings
    newest = s.ring_head + 1
    if newest == inputs.size:
        newest = 0
    s.ring_head = newest
    inputs[newest], held[newest], intervals[newest] = u, last, interval


@inlined
def advance_filters(s, filters, last, u, y):
    """Compute the filter states one interval after the previous sample, whose input was ``last``, by (6)-(7).

    `bank.settle` copies them at the end: the regressor is on the critical path, so it is made of the new ones.
    """
    A, constant, ramp, states, new = filters
    last_y = s.last_output
    rise = u - last if s.straight_input else 0.0
    bk.follow_two(A, constant, ramp, states, new, last_y, y - last_y, last, rise)
    s.input_now = u


@inlined
def fill_regressor(s, regressor, y):
    """Fill the scaled regressor phi of (12) and return the scaled target s^n/Lambda y."""
    characteristic, gain_y, wy, phi_y, gain_u, wu, phi_u = regressor
    target = y
    for i in range(wy.size):
        target -= characteristic[i] * wy[i]  # s^n/Lambda y: lambda of (4) on the left
        phi_y[i] = gain_y[i] * wy[i]  # phi of (12): a filter state over its sigma
    for i in range(wu.size):
        phi_u[i] = gain_u[i] * wu[i]
    if phi_u.size > wu.size:
        phi_u[wu.size] = gain_u[wu.size]
    return target / s.output_scale  # y of (12)


@inlined
def update_estimate(s, estimate, target):
    """Learn the newest sample and its batch; undo an update that overflows.  Returns the a-priori error, scaled."""
    theta, memory, _, _, _, _, settings, rows = estimate
    error = stages.keep_and_write(s, s.buffer[s.buffer_head], estimate, target)
    batch = stages.draw_rows(s, rows)
    loops.learn(s.algorithm, theta, memory, settings, s.buffer, rows, batch, 0, s.interval)
    stages.undo_unless_finite(s, estimate)
    return error


@inlined
def cut(s):
    """Return every array that a sample needs: `cut_filters`, the rings, `cut_regressor`, `stages.cut_estimate`."""
    place = place_of(s.banks[0], s.order, s.entries, s.interval)
    return (
        cut_filters(s, s.banks[0], place),
        (s.inputs, s.held, s.intervals),
        cut_regressor(s, s.banks[0]),
        stages.cut_estimate(s),
    )


@inlined
def take(s, cuts, u, y):
    """Take one sample with the arrays of `cut`; return the a-priori error in the unit of y, NaN if rejected."""
    filters, rings, regressor, estimate = cuts
    u, y = stages.mapped_input(s, u), y - s.output_offset
    if not stages.acceptable(s, u, y):
        return np.nan
    if s.recent_size > 0:
        stages.keep_sample(s, s.recent, u, y, s.interval)
    if s.samples > 0:
        s.elapsed += s.interval
    if not s.started:
        begin(s, u, y)
    else:
        last = s.input_now
        keep_input(s, rings, u, last, s.interval)
        advance_filters(s, filters, last, u, y)
    s.last_output = y
    target = fill_regressor(s, regressor, y)
    bk.settle(filters[3], filters[4])
    s.samples += 1
    if stages.may_learn(s):
        error = update_estimate(s, estimate, target)
        s.learned = s.samples
    else:
        error = equation_error(s, target)
        s.rested += 1
    if s.samples >= s.past_due:
        stages.keep_estimate(s)
    return error * s.output_scale


@kernel(IS_SOUND, LEARNS)
@short_loops
def step(s: StateSlots, u: float, y: float, t: float, r: float):
    """Take one sample; return its error as `take` does; ``t`` and ``r`` are not used, as the clock is regular."""
    if s.started:
        discretize(s)
    return take(s, cut(s), u, y)


@kernel(IS_SOUND, LEARNS, *AS_MANY)
@short_loops
def steps(s: StateSlots, u: Reals, y: Reals, t: Reals, r: Reals, errors: Reals, parameters: Matrix):
    """Take all K samples; write errors and estimates (physical units); return K; ``t`` and ``r`` are empty."""
    if s.started:
        discretize(s)
    cuts = cut(s)
    theta, unit = cuts[3][0], cuts[3][5]
    for k in range(u.size):
        errors[k] = take(s, cuts, u[k], y[k])
        for i in range(parameters.shape[1]):
            parameters[k, i] = theta[i] * unit[i]
    return u.size
