"""What an ensemble's kernel does member by member: a sample that is rejected, an update that is undone, counting.

Arrays are those of `step.ensemble`, with a lane for each member.
"""

import numpy as np

from replant.kernels import schema as at
from replant.kernels.filters import bank as bk
from replant.kernels.lanes import LANES
from replant.kernels.native import inlined
from replant.kernels.step.fixed_filter import cut_rings, keep_input
from replant.kernels.step.stages import acceptable, keep_estimate, keep_sample

# Rows of the work space, after the 2 n that `fixed_filter.advance_states` uses.
INPUT, OUTPUT, ERROR, FINITE, ASIDE = range(5)
ASIDE_SCALARS = 3
"""Rows of the work space behind ASIDE [count]."""

# What is the same for level members.
LEVEL = (
    at.SAMPLES, at.RESTED, at.LEARNED, at.BUFFER_FILLED, at.BUFFER_HEAD, at.DRAWN, at.RING_HEAD, at.RECENT_HEAD,
    at.PAST_KEPT, at.PAST_DUE,
)  # fmt: skip


def are_level(ints):
    """Say whether all members have counted the same."""
    same = True
    for lane in range(1, LANES):
        for slot in LEVEL:
            same &= ints[lane, slot] == ints[0, slot]
    return same


def spread(ints):
    """Let all members know what the first has counted for them."""
    for lane in range(1, LANES):
        for slot in LEVEL:
            ints[lane, slot] = ints[0, slot]


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


def write_estimate(ints, reals, source, row, lane):
    """Give a member the estimate and the optimizer's memory that lie in ``source`` from ``row`` on."""
    T, M = ints[at.ENTRIES], ints[at.MEMORY_SIZE]
    for i in range(T):
        reals[ints[at.AT_THETA] + i, lane] = source[row + i, lane]
    for i in range(M):
        reals[ints[at.AT_MEMORY] + i, lane] = source[row + T + i, lane]


@inlined
def admit(ints, reals, rings, recent, u, y):
    """Put an accepted sample among the raw samples and the past inputs: those of one member, or level ones'."""
    interval = reals[at.INTERVAL]
    if ints[at.RECENT_SIZE] > 0:
        keep_sample(ints, recent, u, y, interval)
    keep_input(ints, rings, u, reals[at.INPUT_NOW], interval)


def admit_each(ints, reals, banks, recent, live):
    """Admit or reject the samples in the work space, member by member."""
    row = ints[0, at.AT_WORK] + 2 * ints[0, at.ORDER]
    for lane in range(LANES):
        u, y = reals[row + INPUT, lane], reals[row + OUTPUT, lane]
        if acceptable(ints[lane], u, y):
            live[lane] = 1
            own = reals[:, lane]
            admit(ints[lane], own, cut_rings(ints[lane], own), recent[:, :, lane], u, y)
        else:
            live[lane] = 0
            reals[row + INPUT, lane], reals[row + OUTPUT, lane] = reals[at.INPUT_NOW, lane], reals[at.LAST_OUTPUT, lane]
            set_aside(ints[lane], reals, banks[0], lane, False)


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


@inlined
def count(ints):
    """Count a sample, of one member or of level ones; return whether the estimate is to be kept."""
    ints[at.SAMPLES] += 1
    if ints[at.ADAPT] == 0:
        ints[at.RESTED] += 1
    else:
        ints[at.LEARNED] = ints[at.SAMPLES]
    return ints[at.SAMPLES] >= ints[at.PAST_DUE]


def count_each(ints, reals, live, counted):
    """Count the accepted samples member by member, unless that is done, and keep the estimates that are due."""
    for lane in range(LANES):
        if live[lane] == 1 and (counted or count(ints[lane])):
            keep_estimate(ints[lane], reals[:, lane])
