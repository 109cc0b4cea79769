"""Robust location and spread of rigs whose figures are each uncertain by an amount of their own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray

KEPT = 0.975
"""Probability within which a rig takes part in location and spread; the spread is corrected for the cut [probability].
Level: an odd rig is far outside, a usual one is left out in one of forty cases.
"""
STEPS = 60  # steps of the iteration: later ones move the spread by less than a hundredth [count]
MOST_USED = 20_000
"""Rigs that location and spread are made from, evenly chosen from more: their own uncertainty is then below 1 %
[count]."""
SCALED_AT = (0.5, 0.75)
"""Quantiles of the squared distances that the scale is made from [probability].
Origin: with the quantile of 0.9 three odd rigs of 20, 8 deviations off, hide each other (1 of 600 named); with that of
0.75 434 of 600 are, and of 30 in 300 99 % instead of 45 %.
Sensitivity: halved or doubled, nothing changes on these records.
"""
MAD = 1.4826  # standard deviation of a normal variable over its median absolute deviation [number]
LEAST = 1e-6  # variance that is taken for none, beside the spread of the estimates [part]


@dataclass(frozen=True, eq=False)
class Location:
    """What is usual in a fleet.

    Attributes
    ----------
    centre : (p,) array
    spread : (p, p) array
        Covariance of the rigs themselves, without the uncertainty of their estimates.
    scale : float
        By how much squared distances exceed what the covariances say, at least 1.
    """

    centre: FloatArray
    spread: FloatArray
    scale: float

    def squared_distances(self, x: FloatArray, covariances: FloatArray) -> FloatArray:
        """Return (x_i - m)' (S + P_i)^-1 (x_i - m) over the scale, (N,), for x (N, p) and P (N, p, p)."""
        return np.asarray(_squared(x - self.centre, self.spread + covariances) / self.scale)


def located(x: FloatArray, covariances: FloatArray) -> Location:
    r"""Return location and spread of :math:`x_i \sim N(m, S + P_i)`, of which some are something else.

    The iteration is that of expectation and maximization, over the rigs within the quantile `KEPT`.  The scale makes
    two quantiles of the squared distances at most those of the distribution that they should have: where
    covariances are too small, or the fleet is no normal one, fewer rigs are odd.

    >>> rng = np.random.default_rng(0)
    >>> x = rng.normal(5.0, 2.0, (500, 1)) + rng.normal(0.0, 1.0, (500, 1))
    >>> x[:20] = 100.0
    >>> found = located(x, np.ones((500, 1, 1)))
    >>> found.centre.round(0), np.sqrt(found.spread).round(0)
    (array([5.]), array([[2.]]))
    """
    from scipy.stats import chi2

    used = np.linspace(0, len(x) - 1, min(len(x), MOST_USED)).astype(np.int64)
    x, covariances = x[used], covariances[used]
    size = x.shape[1]
    unit = _spread_of(x)
    y, P = x / unit, covariances / np.outer(unit, unit)
    limit = chi2.ppf(KEPT, size)
    shrunk = chi2.cdf(limit, size + 2) / KEPT
    m = np.median(y, axis=0)
    own = np.median(np.diagonal(P, axis1=1, axis2=2), axis=0)
    S = np.diag(np.maximum(1.0 - own, LEAST))
    for _ in range(STEPS):
        total = np.linalg.inv(S + P)
        off = y - m
        distance = np.einsum("ni,nij,nj->n", off, total, off)
        kept = distance <= max(limit, float(np.median(distance)))
        weights, off = total[kept], off[kept]
        m = m + np.linalg.solve(weights.sum(0), np.einsum("nij,nj->i", weights, off))
        share = S @ weights
        seen = np.einsum("nij,nj->ni", share, off)
        S = np.einsum("ni,nj->ij", seen, seen) / (shrunk * len(seen)) + S - share.mean(0) @ S
        S = 0.5 * (S + S.T) + LEAST * np.eye(size) * 1e-3
    squared = _squared(y - m, S + P)
    scale = max(1.0, *(float(np.quantile(squared, level)) / chi2.ppf(level, size) for level in SCALED_AT))
    return Location(m * unit, S * np.outer(unit, unit), scale)


def _squared(off: FloatArray, covariances: FloatArray) -> FloatArray:
    solved = np.linalg.solve(covariances, off[..., None])[..., 0]
    return np.asarray(np.einsum("ni,ni->n", off, solved))


def _spread_of(x: FloatArray) -> FloatArray:
    """Return the robust standard deviation of each column; of one that hardly varies its size."""
    found = MAD * np.median(np.abs(x - np.median(x, axis=0)), axis=0)
    small = 1e-12 * np.maximum(np.abs(np.median(x, axis=0)), 1e-300)
    return np.asarray(np.where(found > small, found, np.maximum(np.abs(np.median(x, axis=0)), 1.0)))
