"""Recursive least squares and the Kalman filter on parameters, with the covariance in factors P = U D U'.

U is unit upper triangular and D diagonal.  P is symmetric by construction, and positive definite as long as D is
positive; both updates keep D positive for any length of the stream.  With instruments the gain is P zeta, while the
innovation remains y - phi' theta: refined instrumental variables in their symmetric form.

Sources: Bierman, "Factorization Methods for Discrete Sequential Estimation", 1977, chapters V and VII (the time
update is Thornton's); Young, "Recursive Estimation and Time-Series Analysis", 2011, chapters 7 and 8.
"""

import numpy as np

from replant.kernels.native import short_loops
from replant.kernels.optimizers.memory import MATRIX, ONE, VECTOR, Memory, Size, block, place

RECURSIVE_LEAST_SQUARES, KALMAN_TRACKING = 8, 9  # codes, as in `replant.estimation.optimizers` [code]

# A memory begins with the factors and ends with alpha, which the outlier test and the covariance read.
LEAST_SQUARES = Memory(U=MATRIX, D=VECTOR, caps=VECTOR, projected=VECTOR, gain=VECTOR, alpha=ONE)
TRACKING = Memory(
    U=MATRIX, D=VECTOR, noise=ONE, increase=VECTOR, projected=VECTOR, gain=VECTOR, work=Size(2, 2, 0), alpha=ONE
)

AT_D, AT_CAPS, AT_PROJECTED, AT_GAIN, AT_ALPHA = (
    LEAST_SQUARES.begins[name] for name in ("D", "caps", "projected", "gain", "alpha")
)
AT_NOISE, AT_INCREASE, AT_TRACKING_PROJECTED, AT_TRACKING_GAIN, AT_TRACKING_WORK, AT_TRACKING_ALPHA = (
    TRACKING.begins[name] for name in ("noise", "increase", "projected", "gain", "work", "alpha")
)


def factors_of(s):
    """Return U (T, T) and D (T,) of the covariance U D U' that the optimizer keeps."""
    T = s.entries
    return s.memory[: T * T].reshape(T, T), s.memory[T * T : T * T + T]


def alpha_of(s):
    """Return alpha of the newest update: the variance of its innovation, in the unit of the covariance."""
    return s.memory[s.memory_size - 1]


@short_loops
def measurement_update(P, U, D, zeta, noise, projected, gain):
    """Bierman's update of U (P, P) and D (P,) for a scalar observation zeta' theta of variance ``noise``.

    Fills ``gain`` (P) with P zeta of the old P and returns alpha = noise + zeta' P zeta: the Kalman gain is
    gain / alpha.  ``projected`` (P) is work.
    """
    for i in range(P):
        total = zeta[i]
        for j in range(i):
            total += U[j, i] * zeta[j]
        projected[i] = total
    alpha = noise
    for j in range(P):
        v = D[j] * projected[j]
        gain[j] = v
        before = alpha
        alpha = before + projected[j] * v
        D[j] *= before / alpha
        factor = -projected[j] / before
        for i in range(j):
            u = U[i, j]
            U[i, j] = u + gain[i] * factor
            gain[i] += u * v
    return alpha


@short_loops
def learn_row(estimate, U, D, row, direction, noise, projected, gain):
    """Update the estimate and U D U' with a row, whose zeta begins at ``direction``; return its error and alpha."""
    P = estimate.size
    error = row[P]
    for i in range(P):
        error -= estimate[i] * row[i]
    alpha = measurement_update(P, U, D, row[direction:], noise, projected, gain)
    for i in range(P):
        estimate[i] += gain[i] * error / alpha
    return error, alpha


def time_update(P, U, D, increase, work):
    """Thornton's update of U and D for P + diag(increase): weighted Gram-Schmidt; ``work`` holds 2 P^2 + 2 P."""
    width, weights = 2 * P, work[2 * P * P :]
    for i in range(P):
        row = work[i * width :]
        for j in range(P):
            row[j] = U[i, j]
            row[P + j] = 1.0 if i == j else 0.0
        weights[i] = D[i]
        weights[P + i] = increase[i]
    for i in range(P - 1, -1, -1):
        row, length = work[i * width :], 0.0
        for k in range(width):
            length += row[k] * row[k] * weights[k]
        D[i] = length
        for j in range(i):
            earlier, cross = work[j * width :], 0.0
            for k in range(width):
                cross += earlier[k] * row[k] * weights[k]
            cross = cross / length if length > 0.0 else 0.0
            U[j, i] = cross
            for k in range(width):
                earlier[k] -= cross * row[k]


def begin_last(U, D, first, variances, work):
    """Reset the entries from ``first`` on: independent of the others, with these ``variances``.

    The others keep their covariance: the contributions of the reset columns to it are added again, each by a rank-one
    update with the algorithm of Agee and Turner (Bierman, chapter III).  ``work`` holds P numbers.
    """
    P = D.size
    for k in range(first, P):
        weight = D[k]
        for i in range(first):
            work[i] = U[i, k]
            U[i, k] = 0.0
        for j in range(first - 1, -1, -1):
            v, before = work[j], D[j]
            D[j] = before + weight * v * v
            if not D[j] > 0.0:
                continue
            share = weight / D[j]
            for i in range(j):
                work[i] -= v * U[i, j]
                U[i, j] += share * v * work[i]
            weight = share * before
    for k in range(first, P):
        for i in range(first, k):
            U[i, k] = 0.0
        D[k] = variances[k - first]


def variance_along(U, D, zeta):
    """Return zeta' P zeta."""
    P = D.size
    total = 0.0
    for j in range(P):
        projected = zeta[j]
        for i in range(j):
            projected += U[i, j] * zeta[i]
        total += D[j] * projected * projected
    return total


@short_loops
def recursive_least_squares(theta, memory, settings, buffer, rows, batch, direction):
    """Settings [forgetting factor], memory `LEAST_SQUARES`; ``caps`` are the upper limits of D."""
    P, forgetting = theta.size, settings[0]
    U, D, caps = memory[: P * P].reshape(P, P), block(memory, AT_D, P), block(memory, AT_CAPS, P)
    projected, gain, newest = block(memory, AT_PROJECTED, P), block(memory, AT_GAIN, P), block(memory, AT_ALPHA, P)
    for k in range(batch):
        _, newest[0] = learn_row(theta, U, D, buffer[rows[k]], direction, forgetting, projected, gain)
        # forgetting divides P: without excitation D would grow without bound, so it is capped
        if forgetting < 1.0:
            for i in range(P):
                D[i] = min(D[i] / forgetting, caps[i])


def kalman_tracking(theta, memory, settings, buffer, rows, batch, direction, interval):
    """Kalman filter for a random walk; settings [1 / time constant of the noise, q (P)], memory `TRACKING`."""
    P = theta.size
    U, D, tracked = memory[: P * P].reshape(P, P), block(memory, AT_D, P), block(memory, AT_NOISE, P)
    increase, projected = block(memory, AT_INCREASE, P), block(memory, AT_TRACKING_PROJECTED, P)
    gain, work = block(memory, AT_TRACKING_GAIN, P), block(memory, AT_TRACKING_WORK, P)
    newest = block(memory, AT_TRACKING_ALPHA, P)
    for k in range(batch):
        noise = tracked[0]
        for i in range(P):
            increase[i] = settings[1 + i] * interval
        time_update(P, U, D, increase, work)
        error, alpha = learn_row(theta, U, D, buffer[rows[k]], direction, noise, projected, gain)
        newest[0] = alpha
        # R += (e^2 R / alpha - R) h / T: unbiased by the uncertainty of the parameters
        share = min(settings[0] * interval, 1.0)
        tracked[0] = max(noise + (error * error * noise / alpha - noise) * share, np.finfo(np.float64).tiny)


#: Code of each optimizer, its loop, the layout of its memory, the least number of its settings: Kalman's has T more.
OPTIMIZERS = (
    (RECURSIVE_LEAST_SQUARES, recursive_least_squares, LEAST_SQUARES, 1),
    (KALMAN_TRACKING, kalman_tracking, TRACKING, 1),
)
MEMORY = {code: memory for code, _, memory, _ in OPTIMIZERS}


def learn(algorithm, theta, memory, settings, buffer, rows, batch, direction, interval):
    """Let the optimizer with this code learn the first ``batch`` of the drawn rows; ``interval`` is in s."""
    if algorithm == RECURSIVE_LEAST_SQUARES:
        recursive_least_squares(theta, memory, settings, buffer, rows, batch, direction)
    elif algorithm == KALMAN_TRACKING:
        kalman_tracking(theta, memory, settings, buffer, rows, batch, direction, interval)


def own_noise(s):
    """Return the residual's variance in the unit of the covariance: the tracked one, or the forgetting factor."""
    if s.algorithm == KALMAN_TRACKING:
        return s.memory[place(AT_NOISE, s.entries)]
    return s.settings[0]
