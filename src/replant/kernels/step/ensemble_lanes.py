"""What an ensemble's kernel does member by member: a sample that is rejected, an update that is undone, counting.

Arrays are those of `step.ensemble`, with a lane for each member.
"""

import numpy as np

from replant.kernels.filters import bank as bk
from replant.kernels.lanes import LANES, member
from replant.kernels.native import inlined
from replant.kernels.step.fixed_filter import cut_rings, keep_input
from replant.kernels.step.stages import acceptable, keep_estimate, keep_sample

# Vectors of the work space, after the 2 n that `fixed_filter.advance_states` uses.
INPUT, OUTPUT, ERROR, FINITE, ASIDE = range(5)
ASIDE_SCALARS = 3
"""Vectors of the work space behind ASIDE [count]."""

#: The whole numbers that are the same for level members.
LEVEL = (
    "samples", "rested", "learned", "buffer_filled", "buffer_head", "drawn", "ring_head", "recent_head", "past_kept",
    "past_due",
)  # fmt: skip


def are_level(ints, reals):
    """Say whether all members have counted the same."""
    same, first = True, member(ints, reals, 0)
    for lane in range(1, LANES):
        s = member(ints, reals, lane)
        for name in LEVEL:
            same &= getattr(s, name) == getattr(first, name)
    return same


def spread(ints, reals):
    """Let all members know what the first has counted for them."""
    first = member(ints, reals, 0)
    for lane in range(1, LANES):
        s = member(ints, reals, lane)
        for name in LEVEL:
            setattr(s, name, getattr(first, name))


@inlined
def exchange(one, other, back):
    """Return what two places hold after the first was kept in the second, or put ``back`` from there."""
    return (other, other) if back else (one, one)


def set_aside(s, bank, back):
    """Keep what one sample of a member changes outside the estimate, which is kept anyway; or put it ``back``."""
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
    """Give a member the estimate and the optimizer's memory, one behind the other."""
    for i in range(s.entries):
        s.theta[i] = kept[i]
    for i in range(s.memory_size):
        s.memory[i] = kept[s.entries + i]


@inlined
def admit(s, rings, recent, u, y):
    """Put an accepted sample among the raw samples and the past inputs: those of one member, or level ones'."""
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
            admit(s, cut_rings(s), recent[:, :, lane], u, y)
        else:
            live[lane] = 0
            work[INPUT], work[OUTPUT] = s.input_now, s.last_output
            own = banks[:, :, lane]
            set_aside(s, own[0], False)


def undo(ints, reals, banks, live):
    """Undo the updates that left float64, and all that rejected samples did."""
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
    """Count a sample, of one member or of level ones; return whether the estimate is to be kept."""
    s.samples += 1
    if not s.adapt:
        s.rested += 1
    else:
        s.learned = s.samples
    return s.samples >= s.past_due


def count_each(ints, reals, live, counted):
    """Count the accepted samples member by member, unless that is done, and keep the estimates that are due."""
    for lane in range(LANES):
        s = member(ints, reals, lane)
        if live[lane] == 1 and (counted or count(s)):
            keep_estimate(s)
