"""One sample of each of `LANES` identifiers at once: `fixed_filter`, in SIMD vectors.

The arrays are those of one identifier (see `kernels.schema`), stacked: with the member axis last, so that a quantity of
all members is one vector, but for ``ints``, where it comes first.  All arithmetic is that of `fixed_filter` and
`optimizers.gradient`, compiled for vectors (see `codegen.simd`), so a member gets the same bits here as there and can
go on at either place.

As long as no member rejects a sample that others accept, they are level: what counts samples is kept by the first of
them for all.  Where they have the same random stream too, the drawn rows are the same, and each is read where it lies;
else every member draws for itself, and the rows of the batch are gathered first.

A member whose sample is rejected goes through the arithmetic with the others, on its last sample over again, and is put
back afterwards.
"""

import numpy as np

from replant.kernels import schema as at
from replant.kernels.codegen.decorators import (
    inline_llvm,
    inline_source,
    kernel,
    outlined,
)
from replant.kernels.codegen.simd import (
    LANES,
    all_within,
    load,
    prefetch,
    store,
    vectors,
)
from replant.kernels.filters import bank as bk
from replant.kernels.optimizers import gradient as first
from replant.kernels.optimizers.random_stream import draw_below
from replant.kernels.step import fixed_filter
from replant.kernels.step.shared import (
    acceptable,
    draw_rows,
    keep_estimate,
    keep_sample,
)

# Rows of the work space, after the 2 n that `fixed_filter.advance_states` uses.
INPUT, OUTPUT, ERROR, FINITE, ASIDE = range(5)
ASIDE_SCALARS = 3
"""Rows of the work space behind ASIDE [count]."""

AHEAD = 16
"""Rows that the memory is asked for before they are copied [count]."""

# What is the same for level members.
LEVEL = (
    at.SAMPLES, at.RESTED, at.LEARNED, at.BUFFER_FILLED, at.BUFFER_HEAD, at.DRAWN, at.RING_HEAD, at.RECENT_HEAD,
    at.PAST_KEPT, at.PAST_DUE,
)  # fmt: skip


@inline_source
def cut_filters(ints, reals, banks):
    """Return the arrays of `fixed_filter.advance_states`.  The regular clock's discretisation is the bank's first."""
    n, T, bank = ints[at.ORDER], ints[at.ENTRIES], banks[0]
    A, states, room = bk.at_kept(n, T) + 1, bk.at_states(n, T), ints[at.AT_WORK]
    constant = A + n * n
    return (
        bank[A:constant],
        bank[constant : constant + n],
        bank[constant + n : constant + 2 * n],
        bank[states : states + 2 * n],
        reals[room : room + 2 * n],
    )


@outlined
def are_level(ints):
    """Say whether all members have counted the same."""
    same = True
    for lane in range(1, LANES):
        for slot in LEVEL:
            same &= ints[lane, slot] == ints[0, slot]
    return same


@outlined
def spread(ints):
    """Let all members know what the first has counted for them."""
    for lane in range(1, LANES):
        for slot in LEVEL:
            ints[lane, slot] = ints[0, slot]


@outlined
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


@outlined
def write_estimate(ints, reals, source, row, lane):
    """Give a member the estimate and the optimizer's memory that lie in ``source`` from ``row`` on."""
    T, M = ints[at.ENTRIES], ints[at.MEMORY_SIZE]
    for i in range(T):
        reals[ints[at.AT_THETA] + i, lane] = source[row + i, lane]
    for i in range(M):
        reals[ints[at.AT_MEMORY] + i, lane] = source[row + T + i, lane]


@inline_llvm
def mapped(ints, r, u):
    """Return the members' inputs as the filters see them."""
    return (u * u if ints[at.SQUARE_INPUT] == 1 else u) - r[at.INPUT_OFFSET]


@inline_llvm
def admit(ints, reals, recent, u, y, interval):
    """Put an accepted sample among the raw samples and the past inputs: those of one member, or level ones'."""
    if ints[at.RECENT_SIZE] > 0:
        keep_sample(ints, recent, u, y, interval)
    newest = ints[at.RING_HEAD] + 1
    if newest == ints[at.RING_SIZE]:
        newest = 0
    ints[at.RING_HEAD] = newest
    reals[ints[at.AT_INPUTS] + newest] = u
    reals[ints[at.AT_HELD] + newest] = reals[at.INPUT_NOW]
    reals[ints[at.AT_INTERVALS] + newest] = interval


@outlined
def admit_each(ints, reals, banks, recent, live):
    """Admit or reject the samples in the work space, member by member."""
    row = ints[0, at.AT_WORK] + 2 * ints[0, at.ORDER]
    for lane in range(LANES):
        u, y = reals[row + INPUT, lane], reals[row + OUTPUT, lane]
        if acceptable(ints[lane], u, y):
            live[lane] = 1
            admit(ints[lane], reals[:, lane], recent[:, :, lane], u, y, reals[at.INTERVAL, lane])
        else:
            live[lane] = 0
            reals[row + INPUT, lane], reals[row + OUTPUT, lane] = reals[at.INPUT_NOW, lane], reals[at.LAST_OUTPUT, lane]
            set_aside(ints[lane], reals, banks[0], lane, False)


@outlined
def fetch_ahead(ints, buffer):
    """Ask the memory for the rows that the next sample will draw: where a sample is, no cache can guess."""
    filled, drawn = min(ints[at.BUFFER_FILLED] + 1, ints[at.CAPACITY]), ints[at.DRAWN]
    for i in range(ints[at.BATCH_SIZE] - 1):
        row = draw_below(ints[at.SEED], drawn + i, filled)
        for j in range(buffer.shape[1]):
            prefetch(buffer, row, j)


@outlined
def learn(ints, theta, memory, settings, buffer, rows, batch):
    """Let the members' optimizer consume the first ``batch`` of the rows."""
    first.learn(ints[at.ALGORITHM], theta, memory, settings, buffer, rows, batch, 0)


@outlined
def draw_each(ints, live, buffer, newest, apart):
    """Store each member's newest sample and draw its rows; return the smallest and the largest batch."""
    fewest, most, width = ints[0, at.BATCH_SIZE], 0, newest.shape[0]
    for lane in range(LANES):
        if live[lane] == 1:
            head = ints[lane, at.BUFFER_HEAD]
            for i in range(width):
                if apart:
                    buffer[lane, head, i] = newest[i, lane]
                else:
                    buffer[head, i, lane] = newest[i, lane]
            batch = draw_rows(ints[lane], ints[lane, at.ROWS :])
            fewest, most = min(fewest, batch), max(most, batch)
            if apart:
                for k in range(batch - 1):
                    prefetch(buffer[lane], ints[lane, at.ROWS + k], 0)
                    prefetch(buffer[lane], ints[lane, at.ROWS + k], width - 1)  # may lie on the next line
    return fewest, most


@outlined
def gather(ints, buffer, drawn, picked, most, apart):
    """Lay the batch that each member has drawn before its newest sample, the last row of ``drawn``."""
    for k in range(most - 1):
        row = drawn[drawn.shape[0] - most + k]
        for lane in range(LANES):
            picked[lane] = ints[lane, at.ROWS + k]
        for i in range(row.shape[0]):
            if apart:
                for lane in range(LANES):
                    row[i, lane] = buffer[lane, picked[lane], i]
            else:
                for lane in range(LANES):
                    row[i, lane] = buffer[picked[lane], i, lane]


@inline_source
def learn_each_its_own(ints, reals, live, buffer, apart, work, estimate):
    """Let every member learn the rows that it draws for itself."""
    theta, memory, kept_theta, kept_memory, _, _, settings, _ = estimate
    drawn, order, picked, spare = work
    rows, last, learned = vectors(drawn), order.size - 1, vectors(spare)
    fewest, most = draw_each(ints, live, buffer, drawn[last], apart)
    gather(ints, buffer, drawn, picked, most, apart)
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
            if ints[lane, at.BUFFER_FILLED] <= ints[lane, at.WARMUP]:
                write_estimate(ints[0], reals, spare, 0, lane)


@inline_source
def update_estimate(ints, reals, live, shared, buffer, apart, work, estimate, target):
    """Learn the newest samples and their batches.

    Returns the a-priori errors, scaled, and 0 for members all of whose numbers are finite, else NaN.
    """
    theta, memory, _, _, _, unit, settings, rows = estimate
    if shared:
        stored = vectors(buffer)
        error = fixed_filter.keep_and_write(ints[0], stored[ints[0, at.BUFFER_HEAD]], estimate, target)
        batch = draw_rows(ints[0], rows)
        if ints[0, at.BATCH_SIZE] > 1:
            fetch_ahead(ints[0], stored)
        learn(ints[0], theta, memory, settings, stored, rows, batch)
    else:
        error = fixed_filter.keep_and_write(ints[0], vectors(work[0])[ints[0, at.BATCH_SIZE] - 1], estimate, target)
        learn_each_its_own(ints, reals, live, buffer, apart, work, estimate)
    finite = 0.0
    for i in range(theta.size):
        finite += 0.0 * (theta[i] * unit[i])
    for i in range(memory.size):
        finite += 0.0 * memory[i]
    return error, finite


@inline_llvm
def take(ints, reals, live, shared, buffer, apart, work, filters, regressor, estimate, u, y):
    """Take samples that were admitted; ``shared``: all draw the same rows.

    Returns their errors, and 0 for members all of whose numbers are finite, else NaN.
    """
    r = vectors(reals)
    A, constant, ramp, states, new = filters
    last_u, last_y = r[at.INPUT_NOW], r[at.LAST_OUTPUT]
    r[at.ELAPSED] += r[at.INTERVAL]
    rise = u - last_u if ints[0, at.STRAIGHT_INPUT] == 1 else 0.0
    fixed_filter.advance_states(A, constant, ramp, states, new, last_y, y - last_y, last_u, rise)
    r[at.INPUT_NOW], r[at.LAST_OUTPUT] = u, y
    target = fixed_filter.fill_regressor(r, regressor, y)
    fixed_filter.settle(states, new)
    if ints[0, at.ADAPT] == 1:
        error, finite = update_estimate(ints, reals, live, shared, buffer, apart, work, estimate, target)
    else:
        error, finite = fixed_filter.error_of(estimate[0], estimate[4], target), 0.0 * y
    return error * r[at.OUTPUT_SCALE], finite


@outlined
def undo(ints, reals, bank, live):
    """Undo the updates that left float64, and all that rejected samples did."""
    work, backup, adapts = ints[0, at.AT_WORK] + 2 * ints[0, at.ORDER], ints[0, at.AT_BACKUP], ints[0, at.ADAPT] == 1
    for lane in range(LANES):
        if live[lane] == 0:
            set_aside(ints[lane], reals, bank, lane, True)
            reals[work + ERROR, lane] = np.nan
        elif not adapts or reals[work + FINITE, lane] == 0.0:
            continue
        else:
            ints[lane, at.REFUSED] += 1
        if adapts:
            write_estimate(ints[lane], reals, reals, backup, lane)


@inline_llvm
def count(ints):
    """Count a sample, of one member or of level ones; return whether the estimate is to be kept."""
    ints[at.SAMPLES] += 1
    if ints[at.ADAPT] == 0:
        ints[at.RESTED] += 1
    else:
        ints[at.LEARNED] = ints[at.SAMPLES]
    return ints[at.SAMPLES] >= ints[at.PAST_DUE]


@outlined
def count_each(ints, reals, live, counted):
    """Count the accepted samples member by member, unless that is done, and keep the estimates that are due."""
    for lane in range(LANES):
        if live[lane] == 1 and (counted or count(ints[lane])):
            keep_estimate(ints[lane], reals[:, lane])


@outlined
def take_tile(ints, reals, banks, buffer, recent, apart, live, drawn, order, picked, spare, u, y, errors, parameters):
    """Take the samples of a tile: ``u``, ``y`` and ``errors`` have a row a sample, ``parameters`` one a parameter."""
    r, b, written = vectors(reals), vectors(banks), vectors(parameters)
    inputs, outputs, told = vectors(u), vectors(y), vectors(errors)
    filters, regressor = cut_filters(ints[0], r, b), fixed_filter.cut_regressor(ints[0], r, b)
    estimate = fixed_filter.cut_estimate(ints[0], r)
    theta, unit, row = estimate[0], estimate[5], ints[0, at.AT_WORK] + 2 * ints[0, at.ORDER]
    level, work = are_level(ints), (drawn, order, picked, spare)
    for lane in range(LANES):
        live[lane] = 1
    for k in range(inputs.size):
        now_u, now_y = mapped(ints[0], r, inputs[k]), outputs[k] - r[at.OUTPUT_OFFSET]
        if level and not (all_within(now_u, at.LARGEST) and all_within(now_y, at.LARGEST)):
            spread(ints)
            level = False
        if level:
            admit(ints[0], r, vectors(recent), now_u, now_y, r[at.INTERVAL])
        else:
            r[row + INPUT], r[row + OUTPUT] = now_u, now_y
            admit_each(ints, reals, banks, recent, live)
            now_u, now_y = r[row + INPUT], r[row + OUTPUT]
        error, finite = take(
            ints, reals, live, level and not apart, buffer, apart, work, filters, regressor, estimate, now_u, now_y
        )
        if not (level and all_within(finite, 0.0)):
            r[row + ERROR], r[row + FINITE] = error, finite
            undo(ints, reals, banks[0], live)
            error = r[row + ERROR]
        if not level:
            count_each(ints, reals, live, False)
        elif count(ints[0]):
            spread(ints)
            count_each(ints, reals, live, True)
        told[k] = error
        for i in range(written.shape[1]):
            written[k, i] = theta[i] * unit[i]
    if level:
        spread(ints)


@inline_llvm
def are_neighbours(numbers):
    """Say whether the members are one after the other in the ensemble: then so are their numbers in a row."""
    neighbours = True
    for lane in range(LANES):
        neighbours &= numbers[lane] == numbers[0] + lane
    return neighbours


@outlined
def fetch(samples, numbers, start, own):
    """Copy the members' columns of the samples from a row on, or the one for all."""
    rows, width = vectors(own), samples.shape[1]
    if width == 1:
        for k in range(rows.size):
            rows[k] = samples[start + k, 0]
    elif are_neighbours(numbers):
        for k in range(rows.size):
            ahead = min(start + k + AHEAD, samples.shape[0] - 1)
            prefetch(samples, ahead, numbers[0])
            prefetch(samples, ahead, numbers[LANES - 1])  # their last line
            rows[k] = load(samples, start + k, numbers[0])
    else:
        for k in range(rows.size):
            for lane in range(LANES):
                own[k, lane] = samples[start + k, numbers[lane]]


@outlined
def deliver(numbers, members, start, told, estimates, errors, parameters):
    """Copy errors and estimates of a tile to where they are wanted."""
    rows = vectors(told)
    if members == LANES and are_neighbours(numbers):
        for k in range(rows.size):
            store(errors, start + k, numbers[0], rows[k])
    else:
        for k in range(rows.size):
            for lane in range(members):
                errors[start + k, numbers[lane]] = told[k, lane]
    if parameters.shape[2] > 0:
        for lane in range(members):
            for k in range(rows.size):
                for i in range(parameters.shape[2]):
                    parameters[numbers[lane], start + k, i] = estimates[k, i, lane]


@kernel
def steps(
    ints, reals, banks, buffer, recent, apart, live, drawn, order, picked, spare, tile, estimates, numbers, members,
    start, u, y, errors, parameters,
):  # fmt: skip
    """Take the samples from row ``start`` on; write error and estimate (physical units) of each member.

    ``u`` and ``y`` (K, M) have a column for each of the ensemble's members or (K, 1) one for all; ``errors`` is (K, M),
    ``parameters`` (M, K, size).  ``numbers`` says which of the ensemble's members these are; lanes beyond ``members``
    repeat the first.  ``apart`` says that the members have random streams of their own, and that ``buffer`` has the
    member axis first, so that a row of one member lies together.

    Work: ``live``, ``drawn``, ``order`` (0, 1, 2, ...), ``picked`` and ``spare``; ``tile`` (3, R, LANES) and
    ``estimates`` (R, size, LANES) for R samples at once.  To fetch them ahead costs less than to pick them one by one:
    the copies of many rows overlap, a step of the identifier waits for its input.
    """
    for row in range(start, u.shape[0], tile.shape[1]):
        rows = min(tile.shape[1], u.shape[0] - row)
        own_u, own_y, told = tile[0, :rows], tile[1, :rows], tile[2, :rows]
        fetch(u, numbers, row, own_u)
        fetch(y, numbers, row, own_y)
        take_tile(
            ints, reals, banks, buffer, recent, apart, live, drawn, order, picked, spare, own_u, own_y, told,
            estimates[:rows],
        )  # fmt: skip
        deliver(numbers, members, row, told, estimates, errors, parameters)
