"""What happens to one sample of each of `LANES` identifiers at once: `plain`, in vectors.

The arrays are those of one identifier (see `layout`), stacked: ``reals``, ``banks`` and ``buffer`` with the member
axis last, so that a quantity of all members is one vector; ``ints`` and ``recent``, which are taken member by member,
with the member axis first.  All arithmetic is that of `plain` and `first_order`, compiled for vectors (see `vector`),
so a member gets the same bits here as there and can go on at either place.

Where every member has the same random stream and as many samples in its buffer, the drawn rows are the same, and each
is read where it lies.  Else every member draws for itself, and the rows of the batch are gathered first.

A member whose sample is rejected goes through the arithmetic with the others, on its last sample over again, and is put
back afterwards.
"""

import numpy as np

from replant.kernels import bank as bk
from replant.kernels import first_order as first
from replant.kernels import layout as at
from replant.kernels import plain
from replant.kernels.compiled import cut, kernel, part, rare
from replant.kernels.step import acceptable, draw_rows, keep_estimate, keep_sample
from replant.kernels.vector import LANES, vectors

# Rows of the work space, after the 2 n that `plain.advance_states` uses.
INPUT, OUTPUT, ERROR, FINITE, ASIDE = range(5)
ASIDE_SCALARS = 3


@cut
def cut_filters(ints, reals, banks):
    """Return the arrays of `plain.advance_states`.  The regular clock's discretisation is the bank's first."""
    n, T, bank = ints[at.ORDER], ints[at.ENTRIES], banks[0]
    A, states, room = bk.at_kept(n, T) + 1, bk.at_states(n, T), ints[at.AT_WORK]
    constant = A + n * n
    return (
        bank[A:constant],
        bank[constant : constant + n],
        bank[constant + n : constant + 2 * n],
        bank[states + bk.OUTPUT * n : states + bk.OUTPUT * n + n],
        bank[states + bk.INPUT * n : states + bk.INPUT * n + n],
        reals[room : room + n],
        reals[room + n : room + 2 * n],
    )


@part
def in_step(ints):
    """Say whether all members draw the same rows: the same stream, at the same place, from as full a buffer."""
    same = True
    for lane in range(1, LANES):
        for slot in (at.SEED, at.DRAWN, at.FILLED, at.HEAD):
            same &= ints[lane, slot] == ints[0, slot]
    return same


@rare
def set_aside(ints, reals, bank, lane, back):
    """Keep what one sample changes outside the estimate, which is kept anyway; or put it ``back``."""
    n, T = ints[at.ORDER], ints[at.ENTRIES]
    room, states, phi = ints[at.AT_WORK] + 2 * n + ASIDE, bk.at_states(n, T), ints[at.AT_PHI]
    for i, slot in enumerate((at.ELAPSED, at.INPUT_NOW, at.LAST_OUTPUT)):
        if back:
            reals[slot, lane] = reals[room + i, lane]
        else:
            reals[room + i, lane] = reals[slot, lane]
    room += ASIDE_SCALARS
    for i in range(2 * n):  # the states of output and input, one after the other
        if back:
            bank[states + i, lane] = reals[room + i, lane]
        else:
            reals[room + i, lane] = bank[states + i, lane]
    room += 2 * n
    for i in range(T):
        if back:
            reals[phi + i, lane] = reals[room + i, lane]
        else:
            reals[room + i, lane] = reals[phi + i, lane]


@rare
def write_estimate(ints, reals, source, row, lane):
    """Give a member the estimate and the optimizer's memory that lie in ``source`` from ``row`` on."""
    T, M = ints[at.ENTRIES], ints[at.MEMORY_SIZE]
    for i in range(T):
        reals[ints[at.AT_THETA] + i, lane] = source[row + i, lane]
    for i in range(M):
        reals[ints[at.AT_MEMORY] + i, lane] = source[row + T + i, lane]


@part
def admit(ints, reals, recent, lane, u, y):
    """Take one member's sample in, into its rings of past inputs and raw samples; return whether it is accepted."""
    if ints[at.SQUARE_INPUT] == 1:
        u = u * u
    u -= reals[at.INPUT_OFFSET, lane]
    y -= reals[at.OUTPUT_OFFSET, lane]
    row = ints[at.AT_WORK] + 2 * ints[at.ORDER]
    if not acceptable(ints, u, y):
        reals[row + INPUT, lane], reals[row + OUTPUT, lane] = reals[at.INPUT_NOW, lane], reals[at.LAST_OUTPUT, lane]
        return False
    reals[row + INPUT, lane], reals[row + OUTPUT, lane] = u, y
    interval = reals[at.INTERVAL, lane]
    if ints[at.RECENT] > 0:
        keep_sample(ints, recent, u, y, interval)
    newest = ints[at.NEWEST] + 1
    if newest == ints[at.RING]:
        newest = 0
    ints[at.NEWEST] = newest
    reals[ints[at.AT_INPUTS] + newest, lane] = u
    reals[ints[at.AT_HELD] + newest, lane] = reals[at.INPUT_NOW, lane]
    reals[ints[at.AT_INTERVALS] + newest, lane] = interval
    return True


@rare
def learn(ints, theta, memory, settings, buffer, rows, batch):
    """Let the members' optimizer consume the first ``batch`` of the rows."""
    first.learn(ints[at.ALGORITHM], theta, memory, settings, buffer, rows, batch, 0)


@rare
def gather(ints, live, buffer, drawn):
    """Store each member's newest sample, the last row of ``drawn``, draw its batch, and lay that before it there.

    Returns the smallest and the largest batch.
    """
    last, width = drawn.shape[0] - 1, drawn.shape[1]
    fewest, most = drawn.shape[0], 0
    for lane in range(LANES):
        if live[lane] == 1:
            head = ints[lane, at.HEAD]
            for i in range(width):
                buffer[head, i, lane] = drawn[last, i, lane]
            batch = draw_rows(ints[lane], ints[lane, at.ROWS :])
            fewest, most = min(fewest, batch), max(most, batch)
    for k in range(most - 1):
        row = drawn[last + 1 - most + k]
        for i in range(width):
            for lane in range(LANES):
                row[i, lane] = buffer[ints[lane, at.ROWS + k], i, lane]
    return fewest, most


@cut
def learn_each_its_own(ints, reals, live, buffer, drawn, order, spare, estimate):
    """Let every member learn the rows that it draws for itself."""
    theta, memory, kept_theta, kept_memory, _, _, settings, _ = estimate
    rows, last, learned = vectors(drawn), order.size - 1, vectors(spare)
    fewest, most = gather(ints, live, buffer, drawn)
    if fewest < most:  # some buffers are not warm yet: their members learn the newest sample alone
        learn(ints[0], theta, memory, settings, rows, order[last:], fewest)  # which is one
        for i in range(theta.size):
            learned[i] = theta[i]
            theta[i] = kept_theta[i]
        for i in range(memory.size):
            learned[theta.size + i] = memory[i]
            memory[i] = kept_memory[i]
    learn(ints[0], theta, memory, settings, rows, order[last + 1 - most :], most)
    if fewest < most:
        for lane in range(LANES):
            if ints[lane, at.FILLED] <= ints[lane, at.WARMUP]:
                write_estimate(ints[0], reals, spare, 0, lane)


@cut
def update_estimate(ints, reals, live, together, buffer, drawn, order, spare, estimate, target):
    """Learn the newest samples and their batches; return 0 for members all of whose numbers are finite, else NaN."""
    theta, memory, kept_theta, kept_memory, phi, unit, settings, rows = estimate
    for i in range(theta.size):
        kept_theta[i] = theta[i]
    for i in range(memory.size):
        kept_memory[i] = memory[i]
    if together:
        stored = vectors(buffer)
        batch = plain.remember(ints[0], phi, stored, rows, target)
        for lane in range(1, LANES):
            for slot in (at.HEAD, at.FILLED, at.DRAWN):
                ints[lane, slot] = ints[0, slot]
        learn(ints[0], theta, memory, settings, stored, rows, batch)
    else:
        plain.write_row(ints[0], vectors(drawn)[order.size - 1], phi, target)
        learn_each_its_own(ints, reals, live, buffer, drawn, order, spare, estimate)
    finite = 0.0
    for i in range(theta.size):
        finite += 0.0 * (theta[i] * unit[i])
    for i in range(memory.size):
        finite += 0.0 * memory[i]
    return finite


@part
def take(ints, reals, banks, buffer, recent, live, drawn, order, spare, together, filters, regressor, estimate):
    """Take the samples that were admitted; leave the errors in the work space, NaN where a sample was rejected."""
    r, work = vectors(reals), ints[0, at.AT_WORK] + 2 * ints[0, at.ORDER]
    A, constant, ramp, wy, wu, new_wy, new_wu = filters
    u, y, last_u, last_y = r[work + INPUT], r[work + OUTPUT], r[at.INPUT_NOW], r[at.LAST_OUTPUT]
    r[at.ELAPSED] += r[at.INTERVAL]
    rise = u - last_u if ints[0, at.STRAIGHT_INPUT] == 1 else 0.0
    plain.advance_states(A, constant, ramp, wy, wu, new_wy, new_wu, last_y, y - last_y, last_u, rise)
    r[at.INPUT_NOW], r[at.LAST_OUTPUT] = u, y
    target = plain.fill_regressor(r, regressor, y)
    error, theta, phi = target, estimate[0], estimate[4]
    for i in range(theta.size):
        error -= theta[i] * phi[i]
    r[work + ERROR] = error * r[at.OUTPUT_SCALE]
    if ints[0, at.ADAPT] == 1:
        r[work + FINITE] = update_estimate(ints, reals, live, together, buffer, drawn, order, spare, estimate, target)


@part
def settle(ints, reals, bank, live, lane):
    """Count one member's sample; undo an update that left float64, and all that a rejected sample did."""
    work, backup = ints[at.AT_WORK] + 2 * ints[at.ORDER], ints[at.AT_BACKUP]
    adapts = ints[at.ADAPT] == 1
    if not live:
        set_aside(ints, reals, bank, lane, True)
        if adapts:
            write_estimate(ints, reals, reals, backup, lane)
        reals[work + ERROR, lane] = np.nan
        return
    ints[at.SAMPLES] += 1
    if not adapts:
        ints[at.RESTED] += 1
    else:
        if not reals[work + FINITE, lane] == 0.0:
            ints[at.REFUSED] += 1
            write_estimate(ints, reals, reals, backup, lane)
        ints[at.LEARNED] = ints[at.SAMPLES]
    if ints[at.SAMPLES] >= ints[at.PAST_DUE]:
        keep_estimate(ints, reals[:, lane])


@kernel
def steps(
    ints, reals, banks, buffer, recent, live, drawn, order, spare, numbers, members, start, u, y, errors, parameters
):
    """Take the samples from ``start`` on; write error and estimate (physical units) of each of the first ``members``.

    ``u`` and ``y`` have a row a sample, and a column for each of the ensemble's members or one for all; ``errors`` and
    ``parameters`` have a row a member.  ``numbers`` says which of the ensemble's members these are; lanes beyond
    ``members`` repeat the first.  ``live``, ``drawn``, ``order`` (0, 1, 2, ...) and ``spare`` are work.
    """
    r, b = vectors(reals), vectors(banks)
    filters, regressor = cut_filters(ints[0], r, b), plain.cut_regressor(ints[0], r, b)
    estimate = plain.cut_estimate(ints[0], r)
    theta, unit, error = ints[0, at.AT_THETA], ints[0, at.AT_UNIT], ints[0, at.AT_WORK] + 2 * ints[0, at.ORDER] + ERROR
    own_u, own_y = min(u.shape[1] - 1, 1), min(y.shape[1] - 1, 1)
    together = in_step(ints)
    for k in range(start, u.shape[0]):
        accepted = True
        for lane in range(LANES):
            number = numbers[lane]
            live[lane] = admit(ints[lane], reals, recent[lane], lane, u[k, own_u * number], y[k, own_y * number])
            if live[lane] == 0:
                set_aside(ints[lane], reals, banks[0], lane, False)
                accepted = together = False
        take(ints, reals, banks, buffer, recent, live, drawn, order, spare, together, filters, regressor, estimate)
        for lane in range(LANES):
            settle(ints[lane], reals, banks[0], live[lane], lane)
        if not accepted:
            together = in_step(ints)
        for lane in range(members):
            errors[numbers[lane], k] = reals[error, lane]
            for i in range(parameters.shape[2]):
                parameters[numbers[lane], k, i] = reals[theta + i, lane] * reals[unit + i, lane]
