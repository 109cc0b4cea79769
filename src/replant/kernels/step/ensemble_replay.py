"""How an ensemble's members learn: from rows that all draw alike, or each from rows of its own.

Arrays are those of `step.ensemble`: ``arrays`` is (ints, reals, banks, buffer, recent), ``s`` the fields of all
members, ``estimate`` what `stages.cut_estimate` cuts of them, ``work`` what `step.ensemble.steps` says.
"""

from replant.kernels.lanes import LANES, member, prefetch, vectors
from replant.kernels.native import inlined
from replant.kernels.optimizers import gradient as loops
from replant.kernels.optimizers.random_stream import draw_below
from replant.kernels.step.ensemble_lanes import write_estimate
from replant.kernels.step.stages import draw_rows, keep_and_write


def fetch_ahead(s, buffer):
    """Ask the memory for the rows that the next sample will draw: where a sample is, no cache can guess."""
    filled, drawn = min(s.buffer_filled + 1, s.capacity), s.drawn
    for i in range(s.batch_size - 1):
        row = draw_below(s.seed, drawn + i, filled)
        for j in range(buffer.shape[1]):
            prefetch(buffer, row, j)


def learn(s, theta, memory, settings, buffer, rows, batch):
    """Let the members' optimizer consume the first ``batch`` of the rows."""
    loops.learn(s.algorithm, theta, memory, settings, buffer, rows, batch, 0)


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
                    prefetch(own, s.rows[k], width - 1)  # may lie on the next line
    return fewest, most


def gather(ints, reals, buffer, drawn, picked, most, apart):
    """Lay the batch that each member has drawn before its newest sample, the last row of ``drawn``."""
    for k in range(most - 1):
        row = drawn[drawn.shape[0] - most + k]
        for lane in range(LANES):
            s = member(ints, reals, lane)
            picked[lane] = s.rows[k]
        if apart:
            for lane in range(LANES):
                own = buffer[lane, picked[lane]]
                for i in range(row.shape[0]):
                    row[i, lane] = own[i]
        else:
            for i in range(row.shape[0]):
                for lane in range(LANES):
                    row[i, lane] = buffer[picked[lane], i, lane]


@inlined
def learn_each_its_own(arrays, s, apart, work, estimate):
    """Let every member learn the rows that it draws for itself."""
    ints, reals, _, buffer, _ = arrays
    live, drawn, order, picked, spare = work
    theta, memory, kept_theta, kept_memory, _, _, settings, _ = estimate
    rows, last, learned = vectors(drawn), order.size - 1, vectors(spare)
    fewest, most = draw_each(ints, reals, live, buffer, drawn[last], apart)
    gather(ints, reals, buffer, drawn, picked, most, apart)
    if fewest < most:  # some buffers are not warm yet: their members learn the newest sample alone
        learn(s, theta, memory, settings, rows, order[last:], fewest)  # which is one
        for i in range(theta.size):
            learned[i] = theta[i]
            theta[i] = kept_theta[i]
        for i in range(memory.size):
            learned[theta.size + i] = memory[i]
            memory[i] = kept_memory[i]
    learn(s, theta, memory, settings, rows, order[last + 1 - most :], most)
    if fewest < most:
        for lane in range(LANES):
            one = member(ints, reals, lane)
            if one.buffer_filled <= one.warmup:
                write_estimate(one, spare[:, lane])


@inlined
def update_estimate(arrays, s, apart, shared, work, estimate, target):
    """Learn the newest samples and their batches; ``shared``: all draw the same rows.

    Returns the a-priori errors, scaled, and 0 for members all of whose numbers are finite, else NaN.
    """
    _, _, _, buffer, _ = arrays
    theta, memory, _, _, _, unit, settings, rows = estimate
    if shared:
        stored = vectors(buffer)
        error = keep_and_write(s, stored[s.buffer_head], estimate, target)
        batch = draw_rows(s, rows)
        if s.batch_size > 1:
            fetch_ahead(s, stored)
        learn(s, theta, memory, settings, stored, rows, batch)
    else:
        drawn = vectors(work[1])
        error = keep_and_write(s, drawn[s.batch_size - 1], estimate, target)
        learn_each_its_own(arrays, s, apart, work, estimate)
    finite = 0.0
    for i in range(theta.size):
        finite += 0.0 * (theta[i] * unit[i])
    for i in range(memory.size):
        finite += 0.0 * memory[i]
    return error, finite
