r"""How far an estimate scatters, told from the path that led to it: no model of the noise is needed.

The instrumental-variable estimate after k samples is theta_k = P_k sum zeta z.  In one of its coordinates, with p the
entry of P on the diagonal, W = (theta_k - theta) / p_k is the sum of what each sample had to say, in the time
tau = 1 / p_k that counts information.  Under white noise it is a Brownian motion; under noise of any colour its steps
over blocks of samples are nearly independent once the blocks are longer than the noise remembers.  So their mean
square, the method of batch means, gives the variance of the estimate whatever the noise is, slow drifts included, which
an autoregression of low order takes for little.

The last estimate takes the place of the unknown true value.  That makes a bridge of W, whose sum of squares falls short
by the factor 1 - sum w^2, with w = d tau / tau the weights of the blocks: hence

    var(theta) = p^2 sum dW^2 / (1 - sum w^2).

Source: Chen, Lee, Tong and Zhang, "Statistical inference for model parameters in stochastic gradient descent", Annals
of Statistics 48, 2020 (batch means of an estimate's path).
"""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.kernels.schema import FIXED, ROOM, PathSlots
from replant.statistics.udu import compose, factor_information

LEAST_ROWS = 16
"""Blocks below which a path tells no variance [count].
Origin: half of what the path of a long record has at the least, ROOM / 2.
Sensitivity: not measured.
"""

LEAST_BLOCKS = 6.0
"""Blocks of equal weight, 1 / sum w^2, below which a path tells no variance; of longer blocks half as many [count].
Derivation: six blocks know a standard deviation to a third.
Sensitivity: not measured.
"""

BEYOND_CHANCE = 4.0
"""Excess of a variance, told by so many blocks, over what the residual's colour makes it, beyond which there is noise
slower than the colour knows, and longer blocks are asked as well. Where there is none, they would only add to the
scatter of the figure [standard deviations].
Origin: a normal deviate beyond 4 has the chance 3e-5.
Sensitivity: not measured.
"""

LONGER = (2, 4, 8)
"""Lengths of the longer blocks [blocks].
Origin: powers of two: each asks a path of half as many.
Sensitivity: not measured.
"""


def path_variances(
    estimates: FloatArray, known: FloatArray, least: float = LEAST_BLOCKS
) -> tuple[FloatArray, FloatArray]:
    """Return the variances (T,) of the last estimate, 0 where its path cannot tell, and how many blocks told each (T,).

    Parameters
    ----------
    estimates, known : (B, T) arrays
        Estimate and diagonal of P after each block; the last row is the present.
    least : float
        Blocks of equal weight that a variance must be made of.

    Examples
    --------
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
    tells = blocks >= least
    variances = known[-1] ** 2 * (steps**2).sum(axis=0) / np.where(tells, 1.0 - 1.0 / blocks, np.inf)
    return np.asarray(variances), np.asarray(blocks)


def no_less_than_scattered(covariance: FloatArray, estimates: FloatArray, known: FloatArray) -> FloatArray:
    """Return a covariance (T, T), stretched where the path scatters more than it says.

    Parameters
    ----------
    covariance : (T, T) array
        By the residual's power and colour.
    estimates, known : (B, T) arrays
        Estimate and diagonal of P after each block; the last row is the present.
    """
    if len(estimates) < LEAST_ROWS:
        return covariance
    variances, blocks = path_variances(estimates, known)
    slow = variances > np.diag(covariance) * (1.0 + BEYOND_CHANCE * np.sqrt(2.0 / blocks))
    for length in LONGER:
        rows = slice((len(estimates) - 1) % length, None, length)  # the last one stays
        longer, _ = path_variances(estimates[rows], known[rows], LEAST_BLOCKS / 2)
        variances = np.where(slow, np.maximum(variances, longer), variances)
    return stretch(covariance, variances)


def stretch(covariance: FloatArray, variances: FloatArray) -> FloatArray:
    """Return a covariance stretched, its correlations kept, where its variances are below these.

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
    """Return the path that a recursion would have taken to ``theta``, as `kernels.monitoring.estimate_path` keeps it.

    Parameters
    ----------
    zeta : (K, T) array
    error : (K,) array
        What ``theta`` leaves.
    theta : (T,) array
    known : (T, T) array
        Information before the record,
    pull : (T,) array
        ... and that times how far from ``theta`` the estimate was.
    """
    samples, size = zeta.shape
    step = -(-samples // ROOM)
    path = PathSlots.zeros(FIXED | {"T": size})
    information, score, rows = known.copy(), pull.copy(), path.rows
    for row in range(samples // step):
        block = slice(row * step, (row + 1) * step)
        information += zeta[block].T @ zeta[block]
        score += zeta[block].T @ error[block]
        inverse = compose(*factor_information(information))
        rows[row] = theta + inverse @ score, np.diag(inverse)
    path.step, path.due, path.kept = step, step * (samples // step + 1), samples // step
    return path


def rows_of(path: PathSlots, theta: FloatArray, known: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return estimates and diagonals of P (B, T) along a path as it is kept, the present ones last."""
    rows = path.rows[: int(path.kept)]
    return np.vstack([rows[:, 0], theta]), np.vstack([rows[:, 1], known])
