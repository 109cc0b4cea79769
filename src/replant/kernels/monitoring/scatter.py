"""The data that standard deviations are computed from: power and colour of the residual, path of the estimate.

Noise that is not white makes the plain covariance sigma^2 P too small.  With the residual modelled as an
autoregression, e = w / D(q), the covariance of the instrumental-variable estimate is

    sigma_w^2 P Q P,   Q = sum zeta_f zeta_f',  zeta_f = zeta / D(q).

The path of a recursive estimate is kept at a few samples.  The scores of the samples between give a variance without a
noise model, see `replant.numerics.batch_means`.  Room is limited and the record is not: when the room is full every
second row is dropped, and later rows are kept half as often.

Source: Soderstrom and Stoica, "Instrumental Variable Methods for System Identification", 1983, chapter 4.
"""

import math

from replant.kernels.monitoring.outliers import LONG
from replant.kernels.native import Reals, kernel
from replant.kernels.schema import LAGS, Doubt


@kernel("covariances.size > LAGS and model.size > LAGS and previous.size > LAGS")
def autoregression(covariances: Reals, model: Reals, previous: Reals):
    """Fill ``model`` (LAGS + 1,) by Levinson and Durbin; return the innovation's power; ``previous`` is work."""
    model[0] = 1.0
    for i in range(1, LAGS + 1):
        model[i] = 0.0
    power = covariances[0]
    for order in range(1, LAGS + 1):
        if not power > 0.0:
            break
        total = covariances[order]
        for i in range(1, order):
            total += model[i] * covariances[order - i]
        reflection = -total / power
        for i in range(order):
            previous[i] = model[i]
        for i in range(1, order):
            model[i] = previous[i] + reflection * previous[order - i]
        model[order] = reflection
        power *= 1.0 - reflection * reflection
    return max(power, 0.0)


def record(colour, error, alpha, forgetting, zeta):
    """Add a residual with its alpha of `optimizers.covariance.measurement_update`; ``zeta`` is filtered in place."""
    newest = (int(colour.position) + 1) % LAGS
    add(colour, newest, error, alpha, forgetting, zeta)
    colour.position = newest


def add(colour, newest, error, alpha, forgetting, zeta):
    """Add a residual as `record` does, at row ``newest`` of the ring; the numbers may be vectors."""
    T = zeta.size
    colour.count = forgetting * colour.count + 1.0
    colour.power = forgetting * colour.power + error * error * forgetting / alpha
    for lag in range(LAGS + 1):
        other = error if lag == 0 else colour.errors[lag - 1]
        colour.covariances[lag] = forgetting * colour.covariances[lag] + error * other
    for lag in range(LAGS - 1, 0, -1):
        colour.errors[lag] = colour.errors[lag - 1]
    colour.errors[0] = error
    filtered = colour.filtered[newest]  # holds the row of LAGS samples ago, which the newest replaces
    for i in range(T):
        zeta[i] -= colour.model[LAGS] * filtered[i]
    for lag in range(1, LAGS):
        weight, earlier = colour.model[lag], colour.filtered[(newest + LAGS - lag) % LAGS]
        for i in range(T):
            zeta[i] -= weight * earlier[i]
    for i in range(T):
        filtered[i] = zeta[i]
    keep = forgetting * forgetting
    for i in range(T):
        one, sums = zeta[i], colour.squares[i]
        for j in range(T):
            sums[j] = keep * sums[j] + one * zeta[j]


def begin_last(colour, first, entries):
    """Forget the regressor's entries from ``first`` on, as `optimizers.covariance.begin_last` does."""
    for lag in range(LAGS):
        for i in range(first, entries):
            colour.filtered[lag, i] = 0.0
    for i in range(entries):
        for j in range(entries):
            if i >= first or j >= first:
                colour.squares[i, j] = 0.0


def lasting(s):
    """Return how many of the first entries last: the initial state is a new one after each gap."""
    return s.entries - s.order if s.refined else s.entries


def keep(path, theta, U, D, entries, samples, work):
    """Keep the scores W of the first ``entries`` and the diagonal of P = U D U' after so many learned ``samples``.

    The incomplete row holds the estimate theta' at the begin of its block.  The block adds its score
    (P_k)^-1 (theta_k - theta') to W, with the P_k of these entries alone.  The uncertainty of theta' makes this larger
    than a score at the true parameters; the root of the ratio of P_k to that of the previous row corrects it.  ``work``
    holds entries (entries + 1) numbers.
    """
    T, kept = theta.size, int(path.kept)
    path.step = max(path.step, 1.0)
    score, last, ratio = work[entries * entries :], max(kept - 1, 0), 0.0
    for i in range(entries):
        score[i] = theta[i] - path.rows[kept, 0, i]
        for j in range(i + 1):
            work[i * entries + j] = covariance_of(U, D, i, j)
    solve(work, score, entries)
    for i in range(T):
        variance = covariance_of(U, D, i, i)
        if i < entries:
            ratio += variance / (entries * path.rows[last, 1, i]) if kept > 0 else 0.0
        path.rows[kept, 1, i] = variance
    for i in range(T):
        path.rows[kept, 0, i] = 0.0
        if i < entries and ratio > 0.0:  # the first block does not begin at an estimate
            path.rows[kept, 0, i] = path.rows[last, 0, i] + math.sqrt(ratio) * score[i]
    kept += 1
    if kept == path.rows.shape[0]:
        kept //= 2
        for b in range(kept):
            for i in range(T):
                path.rows[b, 0, i] = path.rows[2 * b + 1, 0, i]
                path.rows[b, 1, i] = path.rows[2 * b + 1, 1, i]
        path.step *= 2.0
    for i in range(T):
        path.rows[kept, 0, i] = theta[i]
    path.kept = kept
    path.due = samples + path.step


def covariance_of(U, D, i, j):
    """Return an entry of U D U', i >= j."""
    total = 0.0
    for k in range(i, D.size):
        total += U[i, k] * U[j, k] * D[k]
    return total


def solve(matrix, vector, size):
    """Solve a system in place by Cholesky's factor of ``matrix`` (size^2,), overwritten; 0 in singular directions."""
    for i in range(size):
        for j in range(i + 1):
            left = matrix[i * size + j]
            for k in range(j):
                left -= matrix[i * size + k] * matrix[j * size + k]
            if j < i:
                matrix[i * size + j] = left / matrix[j * size + j]
            else:
                matrix[i * size + i] = math.sqrt(left) if left > 0.0 else math.inf
        for k in range(i):
            vector[i] -= matrix[i * size + k] * vector[k]
        vector[i] /= matrix[i * size + i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            vector[i] -= matrix[k * size + i] * vector[k]
        vector[i] /= matrix[i * size + i]


def follow(sums, y, error, doubt, at_rest):
    """Update the moments of output and a-priori error, both in the output's unit.

    With its mean m and variance v, and the share a of the newest: m += a (y - m), v = (1 - a)(v + a (y - m)^2).
    """
    if doubt == Doubt.MISSING:
        sums.missing += 1.0
        return
    sums.missing = 0.0
    if doubt != Doubt.NONE or at_rest:  # at rest the output has no variance that the error compares with
        return
    sums.count += 1.0
    share = max(1.0 / sums.count, LONG)
    away = y - sums.output_mean
    sums.output_mean += share * away
    sums.output_power = (1.0 - share) * (sums.output_power + share * away * away)
    sums.error_power += share * (error * error - sums.error_power)
