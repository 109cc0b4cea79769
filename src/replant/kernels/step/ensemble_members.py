"""Rejected samples, learning and counting in an ensemble, by member or for all members at once.

Arrays are those of `step.ensemble`, with a lane for each member: ``arrays`` is (ints, reals, banks, buffer, recent),
``s`` the fields of all members, ``estimate`` their `stages.cut_estimate`, ``work`` as in `step.ensemble.steps`.
"""

import numpy as np

from replant.kernels.filters import bank as bk
from replant.kernels.lanes import LANES, gathered, member, prefetch, vectors
from replant.kernels.native import inlined
from replant.kernels.optimizers import gradient as loops
from replant.kernels.optimizers.memory import draw_below
from replant.kernels.step.fixed_filter import keep_input
from replant.kernels.step.stages import acceptable, draw_rows, keep_and_write, keep_estimate, keep_sample

# Vectors of the work space, after the 2 n that `fixed_filter.advance_filters` uses.
INPUT, OUTPUT, ERROR, FINITE, ASIDE = range(5)
ASIDE_SCALARS = 3  # vectors of the work space behind ASIDE [count]

#: The integers that are equal in level members.
LEVEL = (
    "samples", "rested", "learned", "buffer_filled", "buffer_head", "drawn", "ring_head", "recent_head", "past_kept",
    "past_due",
)  # fmt: skip


def are_level(ints, reals):
    """Return whether all members have the same counts."""
    same, first = True, member(ints, reals, 0)
    for lane in range(1, LANES):
        s = member(ints, reals, lane)
        for name in LEVEL:
            same &= getattr(s, name) == getattr(first, name)
    return same


def spread(ints, reals):
    """Copy the counts of the first member to all others."""
    first = member(ints, reals, 0)
    for lane in range(1, LANES):
        s = member(ints, reals, lane)
        for name in LEVEL:
            setattr(s, name, getattr(first, name))


@inlined
def exchange(one, other, back):
    """Return the contents of two places after the first is saved in the second, or restored (``back``) from it."""
    return (other, other) if back else (one, one)


def set_aside(s, bank, back):
    """Save what one sample of a member changes, or restore it (``back``); the estimate is saved elsewhere."""
    n, T = s.order, s.entries
    room = s.work[2 * n + ASIDE :]
    s.elapsed, room[0] = exchange(s.elapsed, room[0], back)
    s.input_now, room[1] = exchange(s.input_now, room[1], back)
    s.last_output, room[2] = exchange(s.last_output, room[2], back)
    states, kept = bank[bk.at_states(n, T) :], room[ASIDE_SCALARS:]
    for i in range(2 * n):  # the states of output and input, one after the other
        states[i], kept[i] = exchange(states[i], kept[i], back)
    kept = room[ASIDE_SCALARS + 2 * n :]
    for i in range(T):
        s.phi[i], kept[i] = exchange(s.phi[i], kept[i], back)


def write_estimate(s, kept):
    """Set estimate and optimizer memory of a member from ``kept``, which holds one after the other."""
    for i in range(s.entries):
        s.theta[i] = kept[i]
    for i in range(s.memory_size):
        s.memory[i] = kept[s.entries + i]


@inlined
def admit(s, rings, recent, u, y):
    """Add an accepted sample to the raw samples and the past inputs, of one member or of all level members."""
    if s.recent_size > 0:
        keep_sample(s, recent, u, y, s.interval)
    keep_input(s, rings, u, s.input_now, s.interval)


def admit_each(ints, reals, banks, recent, live):
    """Admit or reject the samples in the work space, member by member."""
    for lane in range(LANES):
        s = member(ints, reals, lane)
        work = s.work[2 * s.order :]
        u, y = work[INPUT], work[OUTPUT]
        if acceptable(s, u, y):
            live[lane] = 1
            admit(s, (s.inputs, s.held, s.intervals), recent[:, :, lane], u, y)
        else:
            live[lane] = 0
            work[INPUT], work[OUTPUT] = s.input_now, s.last_output
            own = banks[:, :, lane]
            set_aside(s, own[0], False)


def undo(ints, reals, banks, live):
    """Undo updates that overflowed, and all effects of rejected samples."""
    for lane in range(LANES):
        s, own = member(ints, reals, lane), banks[:, :, lane]
        work, adapts = s.work[2 * s.order :], s.adapt
        if live[lane] == 0:
            set_aside(s, own[0], True)
            work[ERROR] = np.nan
        elif not adapts or work[FINITE] == 0.0:
            continue
        else:
            s.refused += 1
        if adapts:
            write_estimate(s, s.backup)


@inlined
def count(s):
    """Count a sample of one member or of all level members; return whether a past estimate is due to be kept."""
    s.samples += 1
    if not s.adapt:
        s.rested += 1
    else:
        s.learned = s.samples
    return s.samples >= s.past_due


def count_each(ints, reals, live, counted):
    """Count the accepted samples member by member, unless already ``counted``, and keep the estimates that are due."""
    for lane in range(LANES):
        s = member(ints, reals, lane)
        if live[lane] == 1 and (counted or count(s)):
            keep_estimate(s)


def fetch_ahead(s, buffer):
    """Prefetch the rows that the next sample will draw: the hardware cannot predict random rows."""
    filled, drawn = min(s.buffer_filled + 1, s.capacity), s.drawn
    for i in range(s.batch_size - 1):
        row = draw_below(s.seed, drawn + i, filled)
        for j in range(buffer.shape[1]):
            prefetch(buffer, row, j)


def learn(s, estimate, buffer, rows, batch):
    """Let the optimizer of the members learn the first ``batch`` of the rows."""
    theta, memory, _, _, _, _, settings, _ = estimate
    loops.learn(s.algorithm, theta, memory, settings, buffer, rows, batch, 0, 0.0)


def draw_each(ints, reals, live, buffer, newest, apart):
    """Store each member's newest sample and draw its rows; return the smallest and the largest batch."""
    fewest, most, width = member(ints, reals, 0).batch_size, 0, newest.shape[0]
    for lane in range(LANES):
        s = member(ints, reals, lane)
        if live[lane] == 1:
            head = s.buffer_head
            for i in range(width):
                if apart:
                    buffer[lane, head, i] = newest[i, lane]
                else:
                    buffer[head, i, lane] = newest[i, lane]
            batch = draw_rows(s, s.rows)
            fewest, most = min(fewest, batch), max(most, batch)
            if apart:
                own = buffer[lane]
                for k in range(batch - 1):
                    prefetch(own, s.rows[k], 0)
                    prefetch(own, s.rows[k], width - 1)  # may lie on the next cache line
    return fewest, most


def gather(ints, reals, buffer, drawn, picked, most, apart):
    """Copy the batch that each member has drawn in front of its newest sample, the last row of ``drawn``."""
    batches, width = vectors(drawn), drawn.shape[1]
    capacity, step = buffer.shape[1], 1 if apart else LANES
    for k in range(most - 1):
        row = batches[drawn.shape[0] - most + k]
        for lane in range(LANES):
            s = member(ints, reals, lane)
            picked[lane] = width * (lane * capacity + s.rows[k]) if apart else width * LANES * s.rows[k] + lane
        for i in range(width):
            row[i] = gathered(buffer, picked, i * step)


@inlined
def learn_each_its_own(arrays, s, apart, work, estimate):
    """Let every member learn the rows that it draws for itself."""
    ints, reals, _, buffer, _ = arrays
    live, drawn, order, picked, spare = work
    theta, memory, kept_theta, kept_memory, _, _, _, _ = estimate
    learned = vectors(spare)
    fewest, most = draw_each(ints, reals, live, buffer, drawn[order.size - 1], apart)
    gather(ints, reals, buffer, drawn, picked, most, apart)
    if fewest < most:  # some buffers are not warm yet: their members learn the newest sample alone
        learn(s, estimate, vectors(drawn), order[order.size - fewest :], fewest)  # fewest is 1
        for i in range(theta.size):
            learned[i] = theta[i]
            theta[i] = kept_theta[i]
        for i in range(memory.size):
            learned[theta.size + i] = memory[i]
            memory[i] = kept_memory[i]
    learn(s, estimate, vectors(drawn), order[order.size - most :], most)
    if fewest < most:
        for lane in range(LANES):
            one = member(ints, reals, lane)
            if one.buffer_filled <= one.warmup:
                write_estimate(one, spare[:, lane])


@inlined
def nought(numbers):
    """Return 0 if all numbers are finite, else NaN; in groups of four, to shorten the chain of dependent sums."""
    total, rest = 0.0, numbers.size % 4
    for i in range(rest):
        total += 0.0 * numbers[i]
    for i in range(rest, numbers.size, 4):
        total += (0.0 * numbers[i] + 0.0 * numbers[i + 1]) + (0.0 * numbers[i + 2] + 0.0 * numbers[i + 3])
    return total


@inlined
def update_estimate(arrays, s, apart, shared, work, estimate, target):
    """Learn the newest samples and their batches; ``shared``: all draw the same rows.

    Returns the a-priori errors, scaled, and for each member 0 if its new numbers are finite, else NaN.
    """
    _, _, _, buffer, _ = arrays
    theta, memory, _, _, _, unit, _, rows = estimate
    if shared:
        stored = vectors(buffer)
        error = keep_and_write(s, stored[s.buffer_head], estimate, target)
        batch = draw_rows(s, rows)
        if s.batch_size > 1:
            fetch_ahead(s, stored)
        learn(s, estimate, stored, rows, batch)
    else:
        drawn = vectors(work[1])
        error = keep_and_write(s, drawn[s.batch_size - 1], estimate, target)
        learn_each_its_own(arrays, s, apart, work, estimate)
    finite = nought(memory)  # first, as memory is known before theta
    for i in range(theta.size):
        finite += 0.0 * (theta[i] * unit[i])
    return error, finite
