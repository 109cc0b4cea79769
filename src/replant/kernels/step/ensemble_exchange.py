"""Copy the state of single identifiers into lanes, which are stepped together, and back.

A lane has the numbers of one identifier that ordinary samples read or change: all of ``ints``, the scalars and some
blocks of ``reals``, and the two banks of its auxiliary model, the serving one first.  Rings are rotated so that the
newest row has the same index in every lane.  The recent samples of an identifier (past inputs, raw samples, the row of
the buffer) stay in its own arrays; they are written once all samples of a stretch are known to be ordinary.
"""

import math

import numpy as np

from replant.kernels import schema as at
from replant.kernels.filters import bank as bk
from replant.kernels.lanes import member
from replant.kernels.monitoring import interruptions, outliers
from replant.kernels.native import inlined
from replant.kernels.schema import LAGS, Alarm, Doubt, StateSlots
from replant.kernels.step.ensemble_members import exchange
from replant.kernels.step.ensemble_ordinary import ANEW, BEGAN, COUNT, MODEL, ODD, REST_AFTER, STILL, TIES, WEIGHT
from replant.kernels.step.fixed_filter import place_of

#: Blocks that samples read, and that they change: the place in ``ints`` that holds the begin of each, and its name.
READ = tuple((block.index, block.name) for block in StateSlots.blocks if block.name in ("unit", "settings"))
CHANGED = tuple(
    (block.index, block.name)
    for block in StateSlots.blocks
    if block.name in ("phi", "zeta", "theta", "memory", "colour", "noise")
)


def turned(row, size, newest, place):
    """Return the row, in a ring with its newest row at ``newest``, that is ``row`` in one with it at ``place``."""
    return (row - place + newest + size) % size


def width_of(s):
    """Return how many numbers of a bank are copied into a lane."""
    n = s.order
    return bk.at_kept(n, s.entries) + 1 + n * n + 2 * n


def enter(own, ints, reals, models, lane, places):
    """Copy an identifier into a lane."""
    for place, name in READ:
        begin = own.ints[place]
        for i in range(getattr(own, name).size):
            reals[begin + i, lane] = own.reals[begin + i]
    n, T = own.order, own.entries
    end = bk.at_kept(n, T)
    for b in range(2):
        bank = own.banks[own.serving_bank if b == 0 else 3 - own.serving_bank]
        for i in range(end):
            models[b, i, lane] = bank[i]
        begin = place_of(bank, n, T, own.interval)
        for i in range(1 + n * n + 2 * n):
            models[b, end + i, lane] = bank[begin + i]
    exchange_numbers(own, ints, reals, models, lane, places, False)


def leave(own, ints, reals, models, lane, places):
    """Copy a lane back to its identifier."""
    exchange_numbers(own, ints, reals, models, lane, places, True)


@inlined
def exchange_numbers(own, ints, reals, models, lane, places, back):
    """Copy what samples change into a lane, or ``back``."""
    for i in range(own.ints.size):
        own.ints[i], ints[lane, i] = exchange(own.ints[i], ints[lane, i], back)
    for i in range(at.SCALARS):
        own.reals[i], reals[i, lane] = exchange(own.reals[i], reals[i, lane], back)
    for place, name in CHANGED:
        begin = own.ints[place]
        for i in range(getattr(own, name).size):
            own.reals[begin + i], reals[begin + i, lane] = exchange(own.reals[begin + i], reals[begin + i, lane], back)
    s, n, T = member(ints, reals, lane), own.order, own.entries
    rows, filtered = s.noise.rows, s.colour.filtered
    for row in range(LAGS + 1):
        other = turned(row, LAGS + 1, int(own.noise.position), places[0])
        for i in range(2 * T + 1):
            own.noise.rows[other, i], rows[row, i] = exchange(own.noise.rows[other, i], rows[row, i], back)
    for row in range(LAGS):
        other = turned(row, LAGS, int(own.colour.position), places[1])
        for i in range(T):
            own.colour.filtered[other, i], filtered[row, i] = exchange(
                own.colour.filtered[other, i], filtered[row, i], back
            )
    for b in range(2 if back else 0):  # the identifier's banks have the rest of a bank themselves
        bank = own.banks[own.serving_bank if b == 0 else 3 - own.serving_bank]
        for i in range(bk.at_states(n, T), bk.at_kept(n, T)):
            bank[i] = models[b, i, lane]
        bank[bk.MODEL_OUTPUT], bank[bk.INSTRUMENT] = models[b, bk.MODEL_OUTPUT, lane], models[b, bk.INSTRUMENT, lane]


def is_ready(own, bank):
    """Return whether a bank is of a stable model, and has the discretisation for the sampling time."""
    begin, interval = place_of(bank, own.order, own.entries, own.interval), own.interval
    return bank[bk.REFLECTED] == 0.0 and abs(bank[begin] - interval) <= bk.SAME_INTERVAL * interval


@inlined
def is_ordinary(s, own, samples):
    """Return whether no action and no exception is expected within the next ``samples`` of a member.

    ``s`` has its newest fields, in a lane or in its own arrays; ``own`` has the fields that are never in a lane.
    """
    end = s.samples + samples
    if s.attention or not (s.started and s.adapt and s.warming) or s.alarm != Alarm.NONE or s.stuck_outputs > 0:
        return False
    if s.earlier_stamps > 0:  # a rejected sample has taken its time
        return False
    if end >= s.past_due or s.samples < s.attention_at <= end or s.buffer_filled < 1 or s.unknown_input > 0.0:
        return False
    if s.residuals_seen < outliers.ENOUGH or s.elapsed < s.learn_from:
        return False
    if not s.elapsed + (samples - 1) * s.interval < s.ready_at:
        return False
    if s.rests_with_input and s.input_power < interruptions.AT_REST * s.largest_power:
        return False
    if s.has_noise_model and s.noise.known <= LAGS:
        return False
    if s.coloured and s.colour.count + samples >= own.path.due:
        return False
    return is_ready(own, own.banks[1]) and is_ready(own, own.banks[2])


def prepare(s, beside, lane):
    """Fill the vectors beside the fields of a member; return whether its noise model filters."""
    noise = s.noise
    beside[ODD, lane] = 0.0
    beside[TIES, lane], beside[STILL, lane] = float(s.ties), float(s.input_still)
    beside[BEGAN, lane], beside[COUNT, lane] = float(s.change_began), float(s.samples)
    beside[REST_AFTER, lane] = float(s.rest_after)
    beside[ANEW, lane] = outliers.UNKNOWN * s.settings[0] if s.gap_at > 0 else np.inf
    order = int(noise.order)
    filters = order > 0 and noise.filters != 0.0
    weight = math.sqrt(noise.gain * noise.variances[0] / noise.variances[order]) if filters else 0.0
    beside[WEIGHT, lane] = weight
    for i in range(LAGS):
        beside[MODEL + i, lane] = noise.models[order, 1 + i]
    return filters


def note(own, s, beside, companion, lane, samples, inputs, outputs):
    """Store ordinary samples in the arrays of their identifier, and count them.

    ``inputs`` and ``outputs`` (samples, LANES) are less the working points; ``s`` are the fields of its lane, which
    have already advanced to the newest sample.
    """
    last = own.inputs[s.ring_head]
    interval, recent = s.interval, own.recent
    for k in range(samples):
        u, y = inputs[k, lane], outputs[k, lane]
        newest = s.ring_head + 1 if s.ring_head + 1 < s.ring_size else 0
        s.ring_head = newest
        own.inputs[newest], own.held[newest], own.intervals[newest] = u, last + 0.0 * (u - last), interval
        last = u
        if s.recent_size > 0:
            head = s.recent_head
            recent[head, at.INPUT], recent[head, at.OUTPUT], recent[head, at.STEP] = u, y, interval
            recent[head, at.BRIDGED], recent[head, at.DOUBTED] = y, float(Doubt.NONE)
            s.recent_head = head + 1 if head + 1 < s.recent_size else 0
    T = s.entries
    row, squares = own.buffer[s.buffer_head], 0.0
    for i in range(T):
        row[i] = s.phi[i]
        row[T + 2 + i] = companion[i, lane]
        squares += companion[i, lane] * companion[i, lane]
    row[T] = companion[T, lane]
    row[T + 1] = 1.0 / (1.0 + squares) if s.normalize else 1.0
    s.samples += samples
    s.learned = s.samples
    s.doubt = Doubt.NONE
    s.ties, s.input_still = int(beside[TIES, lane]), int(beside[STILL, lane])
    s.change_began = int(beside[BEGAN, lane])
    if s.has_noise_model:
        s.noise.position = float((int(s.noise.position) + samples) % (LAGS + 1))
    if s.coloured:
        s.colour.position = float((int(s.colour.position) + samples) % LAGS)
