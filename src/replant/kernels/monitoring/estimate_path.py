"""The path of a recursive estimate, kept at a few samples: its scatter gives a variance without a noise model.

See `replant.statistics.batch_means` for what is made of it.  Room is limited and the record is not: when the room is
full every second row goes, and the next ones come half as often.
"""

from replant.kernels.schema import ROOM


def keep(path, theta, U, D, samples):
    """Keep the estimate after so many learned ``samples`` and the diagonal of P = U D U', or make room for it."""
    T, kept = theta.size, int(path.kept)
    path.step = max(path.step, 1.0)
    if kept == ROOM:
        kept //= 2
        for b in range(kept):
            for i in range(T):
                path.rows[b, 0, i] = path.rows[2 * b + 1, 0, i]
                path.rows[b, 1, i] = path.rows[2 * b + 1, 1, i]
        path.kept = kept
        path.due = samples + path.step  # this row would be the first of a pair: the second one counts
        path.step *= 2.0
        return
    for i in range(T):
        variance = 0.0
        for k in range(i, T):
            variance += U[i, k] * U[i, k] * D[k]
        path.rows[kept, 0, i] = theta[i]
        path.rows[kept, 1, i] = variance
    path.kept = kept + 1
    path.due = samples + path.step
