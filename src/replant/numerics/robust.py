"""Statistics that outliers do not move, outputs that stand still, and the variance of an estimate by batch means.

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

from replant.kernels.schema import FIXED, ROOM, PathSlots
from replant.numerics.arguments import BoolArray, FloatArray, IntArray
from replant.numerics.linear_algebra import compose, factor_information

MEDIAN_TO_STD = 1.4826  # standard deviation of a normal distribution over the median of its absolute values [ratio]
GROSS = 2.0  # distance from the neighbours' median that no plant makes: a spike [ranges of the median over the record]
SPIKE_NEIGHBOURS = 5  # whose median tells an output without spikes: two in a row are outvoted [samples]
SECTIONS = 8  # of a record, one of which at least tells how often neighbours are equal by chance [count]
LEAST_ROWS = 16  # blocks below which a path tells no variance: half of ROOM / 2 [count]
LEAST_BLOCKS = 6.0  # of equal weight, 1 / sum w^2, that know a deviation to a third; of longer ones half [count]
BEYOND_CHANCE = 4.0  # excess of a variance that longer blocks are asked about, at 3e-5 [standard deviations]
LONGER = (2, 4, 8)  # lengths of the longer blocks [blocks]


def robust_std(values: FloatArray) -> float:
    """Return the standard deviation of normal numbers (K,) about zero, whatever up to half of them are."""
    return MEDIAN_TO_STD * float(np.median(np.abs(values)))


def without_spikes(y: FloatArray) -> FloatArray:
    """Return an output with gross outliers (`GROSS`) replaced by the median of five neighbours."""
    if y.size < SPIKE_NEIGHBOURS or not np.isfinite(y).all():
        return y
    half = SPIKE_NEIGHBOURS // 2
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(y, half, mode="reflect"), SPIKE_NEIGHBOURS)
    median = np.median(windows, axis=1)
    limit = GROSS * float(np.ptp(median))
    with np.errstate(over="ignore"):
        gross = (np.abs(y - median) > limit) & (limit > 0.0)
    return np.where(gross, median, y) if gross.any() else y


def normal_scores(values: FloatArray) -> FloatArray:
    """Return the normal quantiles of the ranks of values (K,), van der Waerden's scores: their order without size."""
    from scipy.special import ndtri  # slow to import

    _, of_each, counts = np.unique(values, return_inverse=True, return_counts=True)
    ranks = np.cumsum(counts) - 0.5 * (counts - 1.0)  # equal values share the mean of theirs
    return np.asarray(ndtri(ranks[of_each] / (values.size + 1.0)))


def still_runs(y: FloatArray) -> IntArray:
    """Return the runs of samples (K,) equal to the bit, (R, 2): where each begins and ends."""
    begins = np.flatnonzero(np.concatenate([[True], y[1:] != y[:-1]]))
    return np.column_stack([begins, np.append(begins[1:], y.size)])


def usual_step(y: FloatArray) -> float:
    """Return the step of a sensor's scale, the median distance of the values (K,) that it gave; 0 of a single one."""
    values = np.unique(y[np.isfinite(y)])
    return float(np.median(np.diff(values))) if values.size > 1 else 0.0


def tie_share(equal: BoolArray) -> float:
    """Return the share of equal neighbours (K - 1,) in the part of the record with the fewest: the sensor may fail."""
    return min(float(part.mean()) for part in np.array_split(equal, SECTIONS))


def never_ties(y: FloatArray) -> bool:
    """Return whether noise keeps any two samples (K,) in a row from being equal, unless the sensor fails."""
    return y.size >= 2 * SECTIONS and tie_share(y[1:] == y[:-1]) * y.size < SECTIONS


def path_variances(
    estimates: FloatArray, known: FloatArray, least: float = LEAST_BLOCKS
) -> tuple[FloatArray, FloatArray]:
    """Return the variances (T,) of the last estimate, 0 where blocks are too few, and how many blocks each has."""
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
    """Return a covariance (T, T) with at least the given variances (T,) and the same correlations."""
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
