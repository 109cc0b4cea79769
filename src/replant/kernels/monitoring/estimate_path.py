"""The path of a recursive estimate, kept at a few samples: its scatter gives a variance without a noise model.

See `replant.statistics.batch_means` for what is made of it.  Room is limited and the record is not: when the room is
full every second row goes, and the next ones come half as often.
"""

from replant.kernels.schema import FIXED, ROOM, PathSlots

STEP, DUE, KEPT = PathSlots.step.index, PathSlots.due.index, PathSlots.kept.index
ROWS = PathSlots.begins(FIXED | {"T": 0})["rows"]


def keep(path, theta, U, D, samples):
    """Keep the estimate after so many learned ``samples`` and the diagonal of P = U D U', or make room for it."""
    T, kept = theta.size, int(path[KEPT])
    path[STEP] = max(path[STEP], 1.0)
    if kept == ROOM:
        kept //= 2
        for b in range(kept):
            for i in range(2 * T):
                path[ROWS + 2 * T * b + i] = path[ROWS + 2 * T * (2 * b + 1) + i]
        path[KEPT] = kept
        path[DUE] = samples + path[STEP]  # this row would be the first of a pair: the second one counts
        path[STEP] *= 2.0
        return
    row = ROWS + 2 * T * kept
    for i in range(T):
        variance = 0.0
        for k in range(i, T):
            variance += U[i * T + k] * U[i * T + k] * D[k]
        path[row + i] = theta[i]
        path[row + T + i] = variance
    path[KEPT] = kept + 1
    path[DUE] = samples + path[STEP]
