r"""The variance of an estimate from the path that led to it, by batch means: no model of the noise is needed.

The instrumental-variable estimate after k samples is theta_k = P_k sum zeta z.  For one of its coordinates let p_k be
the diagonal entry of P_k, and tau_k = 1 / p_k the information so far, which serves as time.  Then

    W_k = (theta_k - theta) / p_k

is a sum with one term from each sample.  Under white noise W is a Brownian motion in tau.  Under coloured noise its
increments over blocks of samples are nearly independent once the blocks are longer than the noise's correlation.  The
mean square of these increments is the method of batch means: it gives the variance of the estimate for any stationary
noise, slow drifts included, which an autoregression of low order underestimates.

The last estimate takes the place of the unknown theta.  W is then a Brownian bridge, whose sum of squares is smaller by
the factor 1 - sum w^2, where w = dtau / tau are the weights of the blocks.  Hence

    var(theta) = p^2 sum dW^2 / (1 - sum w^2).

Source: Chen, Lee, Tong and Zhang (2020), "Statistical inference for model parameters in stochastic gradient descent",
Annals of Statistics 48 (batch means of an estimate's path).
"""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.kernels.schema import FIXED, ROOM, PathSlots
from replant.statistics.udu import compose, factor_information

LEAST_ROWS = 16
"""Blocks below which a path tells no variance [count].
Derivation: half of what the path of a long record has at the least, ROOM / 2.
Sensitivity: halved or doubled, nothing changes on these records.
"""

LEAST_BLOCKS = 6.0
"""Blocks of equal weight, 1 / sum w^2, below which a path tells no variance; of longer blocks half as many [count].
Derivation: six blocks know a standard deviation to a third.
Sensitivity: halved or doubled, nothing changes on these records.
"""

BEYOND_CHANCE = 4.0
"""Excess of a variance, told by so many blocks, over what the residual's colour makes it, beyond which there is noise
slower than the colour knows, and longer blocks are asked as well. Where there is none, they would only add to the
scatter of the figure [standard deviations].
Level: a normal deviate beyond 4 has the chance 3e-5.
Sensitivity: halved, no verdict changes, and no error by a quarter; doubled, nothing changes on these records.
"""

LONGER = (2, 4, 8)
"""Lengths of the longer blocks [blocks].
Derivation: powers of two: each asks a path of half as many.
Sensitivity: halved, nothing changes on these records; doubled, no verdict changes, and no error by a quarter.
"""


def path_variances(
    estimates: FloatArray, known: FloatArray, least: float = LEAST_BLOCKS
) -> tuple[FloatArray, FloatArray]:
    """Return the variances (T,) of the last estimate, and the number of blocks (T,) that each one is made from.

    A variance is 0 where the path has too few blocks.

    The mean of 400 numbers, after each 20 of them:

    >>> x = np.random.default_rng(0).standard_normal(400)
    >>> count = np.arange(20, 401, 20)
    >>> variances, blocks = path_variances((np.cumsum(x)[count - 1] / count)[:, None], 1.0 / count[:, None])
    >>> bool(abs(variances[0] * 400 - 1) < 0.5), round(blocks[0])
    (True, 20)
    """
    steps = np.diff((estimates - estimates[-1]) / known, axis=0, prepend=0.0)
    weights = np.diff(known[-1] / known, axis=0, prepend=0.0)
    blocks = 1.0 / (weights**2).sum(axis=0)
    enough = blocks >= least
    variances = known[-1] ** 2 * (steps**2).sum(axis=0) / np.where(enough, 1.0 - 1.0 / blocks, np.inf)
    return np.asarray(variances), np.asarray(blocks)


def no_less_than_scattered(covariance: FloatArray, estimates: FloatArray, known: FloatArray) -> FloatArray:
    """Return a covariance (T, T), stretched where the variances along the path exceed its own."""
    if len(estimates) < LEAST_ROWS:
        return covariance
    variances, blocks = path_variances(estimates, known)
    slow = variances > np.diag(covariance) * (1.0 + BEYOND_CHANCE * np.sqrt(2.0 / blocks))
    for length in LONGER:
        rows = slice((len(estimates) - 1) % length, None, length)  # includes the last one
        longer, _ = path_variances(estimates[rows], known[rows], LEAST_BLOCKS / 2)
        variances = np.where(slow, np.maximum(variances, longer), variances)
    return stretch(covariance, variances)


def stretch(covariance: FloatArray, variances: FloatArray) -> FloatArray:
    """Return a covariance (T, T) with at least the given variances (T,) and the same correlations.

    Examples
    --------
    >>> stretch(np.array([[1.0, 0.5], [0.5, 1.0]]), np.array([4.0, 0.0]))
    array([[4., 1.],
           [1., 1.]])
    """
    known = np.diag(covariance)
    factors = np.sqrt(np.maximum(variances / np.where(known > 0.0, known, np.inf), 1.0))
    return np.asarray(covariance * np.outer(factors, factors))


def path_of_record(
    zeta: FloatArray, error: FloatArray, theta: FloatArray, known: FloatArray, pull: FloatArray
) -> PathSlots:
    """Return the path on which a recursion would have come to ``theta``, as `kernels.monitoring.scatter`."""
    samples, size = zeta.shape
    step = -(-samples // ROOM)
    path = PathSlots.zeros(FIXED | {"T": size, "PATH": ROOM})
    blocks = samples // step
    each, residuals = zeta[: blocks * step].reshape(blocks, step, size), error[: blocks * step].reshape(blocks, step, 1)
    transposed = each.swapaxes(1, 2)
    information = np.cumsum(np.concatenate([known[None], transposed @ each]), axis=0)[1:]
    score = np.cumsum(np.concatenate([pull[None, :, None], transposed @ residuals]), axis=0)[1:]
    inverse = compose(*factor_information(information))
    path.rows[:blocks, 0] = theta + (inverse @ score)[:, :, 0]
    path.rows[:blocks, 1] = np.diagonal(inverse, axis1=1, axis2=2)
    path.step, path.due, path.kept = step, step * (blocks + 1), blocks
    return path


def rows_of(path: PathSlots, theta: FloatArray, known: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return estimates and diagonals of P, (B, T) each, along a path that is kept."""
    rows = path.rows[: int(path.kept)]
    return np.vstack([rows[:, 0], theta]), np.vstack([rows[:, 1], known])
