r"""How far an estimate scatters, told from the path that led to it: no model of the noise is needed.

The instrumental-variable estimate after k samples is theta_k = P_k sum zeta z.  In the coordinate i, with p = P_ii,
the process W = (theta_k - theta) / p_k is the sum of what each sample had to say, in the time tau = 1 / p_k that counts
information.  Under white noise it is a Brownian motion; under noise of any colour its increments over blocks of samples are
nearly independent once the blocks are longer than the noise remembers.  Their mean square over blocks, the method of
batch means, therefore gives the variance of the estimate whatever the noise is, slow drifts included that an
autoregression of low order takes for something else.

With the last estimate in the place of the unknown true value W is a bridge, and sum dW^2 falls short by the factor
1 - sum w^2, w = d tau / tau: so

    var(theta_i) = p^2 sum dW^2 / (1 - sum w^2).

Sources: Chen, Lee, Tong and Zhang, "Statistical inference for model parameters in stochastic gradient descent", Annals
of Statistics 48, 2020 (batch means of an estimate's path); Flegal and Jones, Annals of Statistics 38, 2010.
"""

from __future__ import annotations

import numpy as np

from replant.factors import compose, factor_information
from replant.validation import FloatArray

LEAST_ROWS = 16  # blocks that tell a variance
LEAST_BLOCKS = 6.0  # as many of equal information, 1 / sum w^2


def path_variances(estimates: FloatArray, known: FloatArray) -> FloatArray:
    """Return the variances (T,) of the last estimate; 0 where the path is too short to tell, or too uneven.

    Parameters
    ----------
    estimates, known : (B, T) arrays
        Estimate and diagonal of P after each block; the last row is the present.

    Examples
    --------
    The mean of 400 numbers, after each 20 of them:

    >>> x = np.random.default_rng(0).standard_normal(400)
    >>> count = np.arange(20, 401, 20)
    >>> variance = path_variances((np.cumsum(x)[count - 1] / count)[:, None], 1.0 / count[:, None])
    >>> bool(abs(variance[0] * 400 - 1) < 0.5)
    True
    """
    blocks, size = estimates.shape
    if blocks < LEAST_ROWS:
        return np.zeros(size)
    walked = np.diff((estimates - estimates[-1]) / known, axis=0, prepend=0.0)
    weights = np.diff(known[-1] / known, axis=0, prepend=0.0)
    concentrated = (weights**2).sum(axis=0)
    even = concentrated <= 1.0 / LEAST_BLOCKS
    variances = known[-1] ** 2 * (walked**2).sum(axis=0) / np.where(even, 1.0 - concentrated, 1.0)
    return np.asarray(np.where(even, variances, 0.0))


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


def path_of_record(zeta: FloatArray, error: FloatArray, theta: FloatArray) -> FloatArray:
    """Return the path, as `replant.kernels.path` keeps it, that a recursion would have taken to ``theta``.

    Parameters
    ----------
    zeta : (K, T) array
    error : (K,) array
        What ``theta`` leaves.
    theta : (T,) array
    """
    from replant.kernels import path as kept

    samples, size = zeta.shape
    step = -(-samples // kept.ROOM)
    path = np.zeros(kept.size(size))
    information, score = np.zeros((size, size)), np.zeros(size)
    rows = path[kept.ROWS :].reshape(kept.ROOM, 2, size)
    for row in range(samples // step):
        block = slice(row * step, (row + 1) * step)
        information += zeta[block].T @ zeta[block]
        score += zeta[block].T @ error[block]
        inverse = compose(*factor_information(information))
        rows[row] = theta + inverse @ score, np.diag(inverse)
    path[kept.STEP], path[kept.DUE], path[kept.KEPT] = step, step * (samples // step + 1), samples // step
    return path


def rows_of(path: FloatArray, theta: FloatArray, known: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return estimates and diagonals of P (B, T) along a path as it is kept, the present ones last."""
    from replant.kernels import path as kept

    rows = path[kept.ROWS :].reshape(kept.ROOM, 2, theta.size)[: int(path[kept.KEPT])]
    return np.vstack([rows[:, 0], theta]), np.vstack([rows[:, 1], known])
