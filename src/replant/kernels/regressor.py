"""From a sample to the regressor: the state-variable filters (6)-(7) and the linear form (12)."""

import numpy as np

from replant.kernels import layout as at
from replant.kernels.compiled import cut, part


@part
def next_slot(slot, size):
    """Return the slot after ``slot`` in a ring; unsigned, so that it need not be checked when it serves as index."""
    after = np.int64(slot) + 1
    return np.uint64(after) if after < size else np.uint64(0)


@cut
def cut_filters(ints, reals):
    """Return the arrays of `advance_filters`, n numbers each but A (n n) and the ring of past inputs.

    Transition A; taps G1, G0 of y[k-1], y[k]; taps H2, H1, H0 of u[k-LAG-2], u[k-LAG-1], u[k-LAG]; the states wy, wu;
    room for the new states, in the backup area, which is free until the updates begin; the ring.
    """
    n = ints[at.ORDER]
    A, G, H = ints[at.AT_TRANSITION], ints[at.AT_OUTPUT_TAPS], ints[at.AT_INPUT_TAPS]
    wy, wu, room, past = ints[at.AT_OUTPUT_STATE], ints[at.AT_INPUT_STATE], ints[at.AT_BACKUP], ints[at.AT_PAST]
    return (
        reals[A : A + n * n],
        reals[G : G + n],
        reals[G + n : G + 2 * n],
        reals[H : H + n],
        reals[H + n : H + 2 * n],
        reals[H + 2 * n : H + 3 * n],
        reals[wy : wy + n],
        reals[wu : wu + n],
        reals[room : room + n],
        reals[room + n : room + 2 * n],
        reals[past : past + ints[at.LAG] + 3],
    )


@part
def advance_filters(ints, reals, filters, u, y):
    """Carry the filter states of (6)-(7) from the sample before to this one.

    The newest sample enters through the last tap of each filter.  That tap is zero where the article's strictly
    causal form, or the zero-order hold of the input, does not use it.
    """
    A, G1, G0, H2, H1, H0, wy, wu, new_wy, new_wu, past = filters
    n, ring = wy.size, past.size
    if ints[at.STARTED] == 0:
        # Before the record the input is taken to have stood at its first value.
        for i in range(ring):
            past[i] = u
        reals[at.LAST_OUTPUT] = y
        ints[at.STARTED] = 1
        return
    newest = next_slot(ints[at.PAST], ring)
    oldest = next_slot(newest, ring)
    middle = next_slot(oldest, ring)
    latest = next_slot(middle, ring)
    past[newest] = u
    ints[at.PAST] = newest
    u2, u1, u0 = past[oldest], past[middle], past[latest]  # u[k-LAG-2], u[k-LAG-1], u[k-LAG]
    y1 = reals[at.LAST_OUTPUT]
    for i in range(n):
        sy = G1[i] * y1 + G0[i] * y
        su = H2[i] * u2 + H1[i] * u1 + H0[i] * u0
        for j in range(n):
            sy += A[i * n + j] * wy[j]
            su += A[i * n + j] * wu[j]
        new_wy[i] = sy
        new_wu[i] = su
    for i in range(n):
        wy[i] = new_wy[i]
        wu[i] = new_wu[i]
    reals[at.LAST_OUTPUT] = y


@cut
def cut_regressor(ints, reals):
    """Return the arrays of `fill_regressor`: those of the output (n numbers each), then those of the input.

    lambda_i / lambda^(n-i), gain, filter state, phi; gain, the filter states that enter the regressor, phi.  The last
    entry of phi and of its gain is the bias where there is one.
    """
    n, P, inputs = ints[at.ORDER], ints[at.ENTRIES], ints[at.INPUT_ENTRIES]
    characteristic, gain, phi = ints[at.AT_CHARACTERISTIC], ints[at.AT_GAIN], ints[at.AT_PHI]
    wy, wu = ints[at.AT_OUTPUT_STATE], ints[at.AT_INPUT_STATE]
    return (
        reals[characteristic : characteristic + n],
        reals[gain : gain + n],
        reals[wy : wy + n],
        reals[phi : phi + n],
        reals[gain + n : gain + P],
        reals[wu + n - inputs : wu + n],
        reals[phi + n : phi + P],
    )


@part
def fill_regressor(reals, regressor, y):
    """Fill the scaled regressor phi of (12) and return the scaled target s^n/Lambda y.

    The linear form is (4) with lambda moved to the left: s^n/Lambda y = phi' [a, b], so that the estimate itself is
    in the plant's parameters and the prediction error is the one of (8).
    """
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
