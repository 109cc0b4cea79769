"""Simulation of B/A on any clock: the response to the input, and the free response to an initial state.

The input consists of pieces from sample to sample, held or linear, which act after the dead time.  Over an interval
between two samples the companion states are advanced piece by piece, exactly.
"""

from replant.kernels.filters import bank as bk
from replant.kernels.filters.chain import moved_share
from replant.kernels.native import Matrix, Reals, kernel

# places in ``progress``: whole samples, then time in s, until the first input acts; time in s that the present piece
# has acted; the delayed input; a flag: whether there was a sample
LAG, WAIT, USED, NOW, BEGUN = range(5)
PROGRESS = 5  # numbers in ``progress`` [count]
NOTHING = 1e-200  # size below which a free response has decayed; denormal numbers would be slow [number]


def advance_free(n, solution, free, new):
    """Advance the responses (n,) to a unit of each state by one interval, free' = free' Ad."""
    for j in range(n):
        total = 0.0
        for i in range(n):
            total += free[i] * solution[i * n + j]
        new[j] = total
    for j in range(n):
        free[j] = new[j]


def lives(n, free):
    """Return whether a response (n,) has not decayed yet; true for NaN."""
    for i in range(n):
        if not abs(free[i]) <= NOTHING:
            return True
    return False


@kernel(
    "bank.size >= bk.size(row.size, 0) and 0 <= bank[bk.NEXT] < bk.KEPT and states.size >= 2 * row.size",
    "work.size >= 3 * (row.size + 2) * (row.size + 2)",
    "progress.size >= PROGRESS and samples.size >= output.size + 2",
    "lengths.size == 1 or lengths.size >= samples.size",
    "free.shape[0] == 0 or (free.shape[0] >= output.size and free.shape[1] >= row.size)",
)
def simulate(
    bank: Reals, states: Reals, work: Reals, row: Reals, feedthrough: float, progress: Reals, samples: Reals,
    lengths: Reals, dt: float, straight: bool, output: Reals, free: Matrix,
):  # fmt: skip
    """Simulate the newest samples (K,).

    Returns the place of the sample at the end of the piece that acts next; how many of the newest samples respond to
    inputs from before the record; for how many of them the free responses last.

    Parameters
    ----------
    bank : array
        `bank.size(n, 0)` numbers, with scale and characteristic; it stores the discretisations.
    states : (2 n,) array
        The companion states, and the responses to a unit of each state.
    work : (3 (n + 2)^2,) array
    row : (n,) array
        Output row for the companion states; ``feedthrough`` is the factor of the input.
    progress : (PROGRESS,) array
        See `LAG`; changed in place.
    samples : (2 + W + K,) array
        Inputs: the two before the piece that acts next, W that wait for the dead time, the newest.
    lengths : (2 + W + K,) or (1,) array
        Interval before each of these, or one for all, in s.
    dt : float
        Usual interval in s: a held input is assumed to have moved in intervals longer than 1.5 times this.
    straight : bool
        Whether the input is linear between samples; else it is held.
    output : (K,) array
        Written.
    free : (K, n) array of zeros, or (0, n)
        Free responses, written until they have decayed.  Without rows the plant is at rest and its input zero before
        the first sample.  With rows it is at rest at the first sample that responds to the inputs of the record, and
        earlier inputs equal the first one.
    """
    n, regular, at_rest = row.size, lengths.size == 1, free.shape[0] == 0
    inputs, intervals = samples, lengths
    kept, x, response, spare = bank, states, states[n:], work
    new, front, slot, step, unknown, alive = samples.size - output.size, 2, 0, 0.0, 0, 0
    for k in range(output.size):
        left = intervals[0 if regular else new + k]
        same = bk.SAME_INTERVAL * max(left, 0.0)
        waits = progress[LAG] > 0.0 or progress[WAIT] > 0.0
        if progress[BEGUN] == 0.0:
            progress[BEGUN], left, front = 1.0, 0.0, new + 1
            if not (at_rest and waits):
                progress[NOW] = inputs[new]
        elif progress[LAG] > 0.0:
            progress[LAG], left = progress[LAG] - 1.0, 0.0
        elif progress[WAIT] > left + same:
            progress[WAIT], left = progress[WAIT] - left, 0.0
        else:
            left, progress[WAIT] = left - progress[WAIT], 0.0
        if waits:
            if progress[LAG] > 0.0 or progress[WAIT] > 0.0:
                unknown += 1
            else:
                progress[NOW] = inputs[front - 1]
        while left > same and front < inputs.size:  # negative lengths would lead beyond the end
            last, coming, length = inputs[front - 1], inputs[front], intervals[0 if regular else front]
            wanted = length - progress[USED]
            ends = wanted <= left + same
            if not ends:
                wanted = left
            start = end = last
            if straight:
                slope = (coming - last) / length
                start = last + slope * progress[USED]
                end = coming if ends else start + slope * wanted
            elif not regular:
                start = end = last + (coming - last) * moved_share(
                    length, intervals[front - 1], intervals[front - 2], dt
                )
            if n > 0:
                if wanted != step:
                    slot, step = bk.discretization(bank, n, 0, wanted, work), wanted
                bk.advance_states(n, kept[slot + 1 :], start, end - start, x, spare)
                if not waits and alive == k and not at_rest:
                    advance_free(n, kept[slot + 1 :], response, spare)
            left -= wanted
            if ends:
                front, progress[USED], progress[NOW] = front + 1, 0.0, coming
            else:
                progress[USED], progress[NOW] = progress[USED] + wanted, end
        total = feedthrough * progress[NOW]
        for i in range(n):
            if waits and not at_rest:  # the state after unknown inputs is free: the run begins here
                x[i] = 0.0
            total += row[i] * x[i]
        output[k] = total
        if not at_rest and alive == k and lives(n, response):
            for i in range(n):
                free[k, i] = response[i]
            alive = k + 1
    return front, unknown, alive
