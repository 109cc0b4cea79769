"""The covariance of an estimate by batch means: from what blocks of samples say of it, whatever the noise is.

The instrumental-variable estimate after k samples is theta_k = P_k sum zeta z.  Then

    W_k = (P_k)^-1 (theta_k - theta) = sum zeta (z - zeta' theta)

is a sum with one term from each sample.  Under white noise it is a Brownian motion in the information.  Under coloured
noise its increments over blocks of samples are nearly independent once the blocks are longer than the noise's
correlation.  The sum of their squares is the method of batch means: it gives the covariance of the estimate for any
stationary noise, slow drifts included, which an autoregression of low order underestimates.

The last estimate takes the place of the unknown theta.  W is then a Brownian bridge, whose sum of squares is smaller by
the factor 1 - sum w^2, where w = dtau / tau are the weights of the blocks, tau = 1 / p that of a coordinate with the
diagonal entry p of P.  Hence

    var(theta_i) = (P sum dW dW' P)_ii / (1 - sum w^2).

P is that of the first entries, without the last, the initial state: that is another one after each gap.

Source: Chen, Lee, Tong and Zhang (2020), "Statistical inference for model parameters in stochastic gradient descent",
Annals of Statistics 48 (batch means of an estimate's path).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from replant.kernels.schema import FIXED, ROOM, PathSlots
from replant.numerics.arguments import FloatArray
from replant.numerics.linear_algebra import compose, factor_information

LEAST_ROWS = 16  # blocks below which a path tells no variance: half of ROOM / 2 [count]
LEAST_BLOCKS = 6.0  # of equal weight, 1 / sum w^2, that know a deviation to a third; of longer ones half [count]
BEYOND_CHANCE = 4.0  # excess of a variance that longer blocks are asked about, at 3e-5 [standard deviations]
SWEEPS = 100  # over the coordinates, each of which reaches its variance in turn, at most [count]
CLOSE = 1e-9  # largest change within a sweep that is none any more [part of a variance]
LONGER = (2, 4, 8)  # lengths of the longer blocks [blocks]


@dataclass(frozen=True, eq=False)
class Scatter:
    """How an estimate scatters by its path: by blocks of rows, whose lengths may be multiplied."""

    scores: FloatArray  # (B, C): W along the path
    diagonals: FloatArray  # (B, C): of P
    inverse: FloatArray  # (C, C): the last P, the inverse of the information

    def steps(self, length: int = 1) -> FloatArray:
        """Return P dW (B, C) of blocks of so many rows."""
        return np.asarray(np.diff(self.scores[self._rows(length)], axis=0, prepend=0.0) @ self.inverse)

    def blocks(self, length: int = 1) -> FloatArray:
        """Return how many blocks of equal weight tell each coordinate (C,)."""
        diagonals = self.diagonals[self._rows(length)]
        weights = np.diff(diagonals[-1] / diagonals, axis=0, prepend=0.0)
        return np.asarray(1.0 / (weights**2).sum(axis=0))

    def variances(self, length: int = 1, least: float = LEAST_BLOCKS) -> FloatArray:
        """Return the variances (C,) of the last estimate, 0 where blocks are too few."""
        blocks = self.blocks(length)
        left = np.where(blocks >= least, 1.0 - 1.0 / blocks, np.inf)
        return np.asarray((self.steps(length) ** 2).sum(axis=0) / left)

    def along(self, direction: FloatArray) -> float:
        """Return the largest variance of a direction (C,) that `LEAST_BLOCKS` blocks of one length give."""
        squares = [float(np.sum((self.steps(length) @ direction) ** 2)) for length in (1, *LONGER)]
        counts = [float(self.blocks(length).min()) for length in (1, *LONGER)]
        told = zip(squares, counts, strict=True)
        return max((square / (1.0 - 1.0 / count) for square, count in told if count >= LEAST_BLOCKS), default=0.0)

    def _rows(self, length: int) -> slice:
        return slice((len(self.scores) - 1) % length, None, length)  # includes the last one


def no_less_than_scattered(covariance: FloatArray, scatter: Scatter) -> FloatArray:
    """Return a covariance (T, T), widened where the variances along the path exceed its own."""
    size = len(scatter.inverse)
    if len(scatter.scores) < LEAST_ROWS:
        return covariance
    # noise that is slow may be so in one direction only: what errors that go together leave known stays known
    for direction in _slow_directions(covariance[:size, :size], scatter):
        together = covariance[:, :size] @ direction  # its own variance is one
        covariance = covariance + max(scatter.along(direction) - 1.0, 0.0) * np.outer(together, together)
    variances, own = scatter.variances(), np.diag(covariance)[:size]
    slow = variances > own * (1.0 + BEYOND_CHANCE * np.sqrt(2.0 / scatter.blocks()))
    for length in LONGER:
        variances = np.where(slow, np.maximum(variances, scatter.variances(length, LEAST_BLOCKS / 2)), variances)
    return stretch(covariance, variances)


def _slow_directions(covariance: FloatArray, scatter: Scatter) -> FloatArray:
    """Return the directions (D, C) in which the path scatters beyond chance, independent, each of variance one."""
    size, blocks = len(covariance), float(scatter.blocks().min())
    scale, steps = np.sqrt(np.diag(covariance)), scatter.steps()
    if blocks < LEAST_BLOCKS:
        return np.zeros((0, size))
    try:
        root = np.linalg.inv(np.linalg.cholesky(covariance / np.outer(scale, scale))) / scale
        white = steps @ root.T
        ratios, axes = np.linalg.eigh(white.T @ white / (1.0 - 1.0 / blocks))
    except np.linalg.LinAlgError:  # singular, or outside of float64
        return np.zeros((0, size))
    # by chance alone the largest ratio is (1 + sqrt(C / B))^2 (Marchenko and Pastur)
    chance = (1.0 + math.sqrt(size / blocks)) ** 2 + BEYOND_CHANCE * math.sqrt(2.0 / blocks)
    return np.asarray(axes[:, ratios > chance].T @ root)


def stretch(covariance: FloatArray, variances: FloatArray) -> FloatArray:
    """Return the nearest covariance (T, T), by relative entropy, whose first entries have at least some variances (C,).

    It is (C^-1 - D)^-1 with a diagonal D >= 0, zero where a variance is larger than it has to be: the error of one
    coordinate moves the others as the covariance says, and errors that cancel still do.
    """
    taken, known = np.zeros(len(variances)), np.diag(covariance)[: len(variances)].copy()  # in units of these
    ratios = variances / np.where(known > 0.0, known, np.inf)
    for _ in range(SWEEPS):
        worst = 0.0
        for i in np.flatnonzero(np.isfinite(ratios) & (ratios > 0.0)):
            own = float(covariance[i, i] / known[i])
            if not 0.0 < own < math.inf:
                continue
            before = 1.0 / own + float(taken[i])
            wanted = max(float(ratios[i]), 1.0 / before if before > 0.0 else own)
            taken[i] += 1.0 / own - 1.0 / wanted
            together = covariance[i] / np.sqrt(covariance[i, i])
            covariance = covariance + (wanted / own - 1.0) * np.outer(together, together)
            worst = max(worst, abs(wanted / own - 1.0))
        if worst < CLOSE:
            break
    return covariance


def path_of_record(
    zeta: FloatArray, error: FloatArray, theta: FloatArray, known: FloatArray, pull: FloatArray, entries: int
) -> PathSlots:
    """Return the path on which a recursion would have come to ``theta``, as `kernels.monitoring.scatter`."""
    samples, size = zeta.shape
    step = -(-samples // (ROOM - 1))
    path = PathSlots.zeros(FIXED | {"T": size, "PATH": ROOM})
    blocks = samples // step
    each, residuals = zeta[: blocks * step].reshape(blocks, step, size), error[: blocks * step].reshape(blocks, step, 1)
    transposed = each.swapaxes(1, 2)
    information = np.cumsum(np.concatenate([known[None], transposed @ each]), axis=0)[1:]
    score = np.cumsum(np.concatenate([pull[None, :, None], transposed @ residuals]), axis=0)[1:]
    inverse = compose(*factor_information(information))
    away = (inverse @ score)[:, :, 0]
    scores = solved(inverse[:, :entries, :entries], away[:, :entries])
    # what was known before pulls by no noise of these samples: the first block, which holds the pull, is left out
    path.rows[:blocks, 0, :entries] = scores - scores[:1] if pull.any() else scores
    path.rows[:blocks, 1] = np.diagonal(inverse, axis1=1, axis2=2)
    path.rows[blocks, 0] = theta + (away[-1] if blocks else 0.0)
    path.step, path.due, path.kept = step, step * (blocks + 1), blocks
    return path


def scatter_of(path: PathSlots, theta: FloatArray, inverse: FloatArray, entries: int) -> Scatter:
    """Return the scatter of the first entries along a path up to ``theta`` (T,), where P is ``inverse`` (T, T)."""
    kept, inverse = int(path.kept), inverse[:entries, :entries]
    rows, known = path.rows[:kept, :, :entries], np.diag(inverse)
    if not kept:
        return Scatter(rows[:, 0], rows[:, 1], inverse)
    score = solved(inverse, (theta - path.rows[kept, 0])[:entries])
    last = rows[-1, 0] + np.sqrt((known / rows[-1, 1]).mean()) * score
    return Scatter(np.vstack([rows[:, 0], last]), np.vstack([rows[:, 1], known]), inverse)


def solved(covariances: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return C^-1 v (..., C) of each covariance C (..., C, C) and vector; zero where one is singular."""
    scale = np.sqrt(np.diagonal(covariances, axis1=-2, axis2=-1))
    try:
        found = np.linalg.solve(covariances / (scale[..., None] * scale[..., None, :]), (vectors / scale)[..., None])
    except np.linalg.LinAlgError:
        return np.zeros_like(vectors)
    return np.asarray(found[..., 0] / scale)
