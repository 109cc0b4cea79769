r"""The distance from an estimate to the estimate that a record gives: one Gauss-Newton step on the output error.

The step :math:`(\sum \zeta\zeta^T)^{-1} \sum \zeta e`, slopes and residual filtered by the noise model, is that of
refined instrumental variables at the estimate: it is zero for an estimate made from the same record.  Filtered, the
residual is independent of the slopes under feedback, too.  The step's covariance takes the colour that is left into
account.  A significant step means that noise has biased the estimate, that the estimate is frozen while the plant
changes, or that it lags.

Source: Soderstrom and Stoica (1983), "Instrumental Variable Methods for System Identification", chapter 4.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.simulation.model_run import ModelRun
from replant.statistics.autoregression import Autoregression
from replant.statistics.linear_algebra import chi2_quantile, larger, pseudo_inverse
from replant.statistics.projections import lengths_of, orthogonal, products, without

RANK_TOLERANCE = 1e-14
"""Eigenvalue of the step's covariance below which a direction counts as not there [part of the largest].
Derivation: some fifty times the precision of float64.
"""

FEWEST_STRETCHES = 4
"""Earlier stretches from which the scatter of steps is taken, at the least [count].
Derivation: the median of four is not moved far by one that lies across a change.
"""

MOST_STRETCHES = 8
"""... and at the most [count].
Derivation: the median of eight is known to a third; each costs as much as the test itself.
"""


@dataclass(frozen=True)
class Distance:
    """The distance from an estimate to the estimate that a record gives.

    Attributes
    ----------
    step : (n + m + 1,) array
        From the one to the other, to first order.
    statistic : float
        The test statistic over its limit: above 1 the step is statistically significant.
    covariance : (n + m + 1, n + m + 1) array
        Of an estimate from this record alone, the residual's colour taken into account.
    """

    step: FloatArray
    statistic: float
    covariance: FloatArray


def distance(run: ModelRun, rows: slice, false_alarm: float) -> Distance:
    """Return the Gauss-Newton step from an estimate towards the one that a record gives, with its significance."""
    nuisances = np.hstack([run.nuisances[rows], np.ones((len(run.error[rows]), 1))])
    noise = _noise_of(run, rows, nuisances)
    nuisances = noise.whiten(nuisances)
    zeta = without(noise.whiten(run.zeta[rows]), nuisances)
    error = without(noise.whiten(run.error[rows])[:, None], nuisances)[:, 0]
    lengths = lengths_of(zeta)
    zeta = zeta / lengths
    instruments = _instruments(
        zeta, None if run.instruments is None else noise.whiten(run.instruments[rows]), nuisances
    )
    inverse = _inverse(instruments, zeta)
    step = inverse @ products(instruments, error[:, None])[:, 0]
    left = error - np.einsum("ij,j->i", zeta, step)
    rest = Autoregression.of(left)
    innovation, coloured = rest.whiten(left), rest.colour(instruments)
    variance = float(innovation @ innovation) / max(innovation.size - len(step), 1)
    covariance = variance * inverse @ products(coloured, coloured) @ inverse.T
    plain = inverse @ products(instruments, instruments) @ inverse.T
    covariance = larger(covariance, float(np.mean(left**2)) * plain)
    square = float(step @ pseudo_inverse(covariance, RANK_TOLERANCE) @ step)
    statistic = math.inf if math.isnan(square) else square / float(chi2_quantile(1.0 - false_alarm, len(step)))
    return Distance(step / lengths, statistic, covariance / np.outer(lengths, lengths))


def _noise_of(run: ModelRun, rows: slice, nuisances: FloatArray) -> Autoregression:
    """Return the noise model of a residual over ``rows``, less what slopes and nuisances (K, N) explain of it.

    With instruments from a reference it is that of the residual itself: they are right whatever the filter is, and in a
    loop the slopes explain much of what a load makes of the residual, so that its rest has another colour.
    """
    if run.instruments is not None:
        return Autoregression.of(without(run.error[rows, None], nuisances)[:, 0])
    columns = np.hstack([run.zeta[rows], nuisances])
    return Autoregression.of(without(run.error[rows, None], columns)[:, 0])


def _instruments(zeta: FloatArray, by_reference: FloatArray | None, nuisances: FloatArray) -> FloatArray:
    """Return the instruments (K, n) scaled: those made from a reference, less the nuisances, or the slopes."""
    if by_reference is None:
        return zeta
    moved = without(by_reference, nuisances)
    return moved / lengths_of(moved)


def _inverse(instruments: FloatArray, zeta: FloatArray) -> FloatArray:
    """Return (Z' zeta)^-1 (n, n) of instruments Z and slopes."""
    if instruments is zeta:
        basis = orthogonal(products(zeta, zeta))
        return np.asarray(basis @ basis.T)
    return pseudo_inverse(products(instruments, zeta), RANK_TOLERANCE)


def newest_distances(run: ModelRun, counts: Iterable[int], false_alarm: float) -> Iterator[tuple[int, Distance]]:
    """Yield the Gauss-Newton step that the newest samples alone ask of an estimate, for each number of them.

    A few samples do not tell the colour of their own residual: tested with it, coloured noise would be taken for a
    change.  So colour and power are those of the residual over the whole run, and instruments and residual are whitened
    by them (generalised least squares).  Where the few samples leave more power, that is used.  Slow noise makes steps
    scatter more than this says: by how much is measured on earlier stretches of the same length.  (The scatter of the
    estimate's path is no measure of it: the path moves after a change, which would so excuse itself.)
    """
    noise = Autoregression.of(run.error - run.error.mean())
    white = noise.whiten(run.error)
    nuisances = noise.whiten(np.hstack([run.nuisances, np.ones((len(run.error), 1))]))
    slopes = noise.whiten(run.zeta)
    by_reference = None if run.instruments is None else noise.whiten(run.instruments)
    usual, wider = float(white.var()), 1.0
    for count in counts:
        if count > len(white):
            return
        newest = len(white) - count
        whitened = Whitened(slopes, by_reference, nuisances, white, usual)
        wider = max(_scatter(whitened, range(newest % count, newest, count)) or wider, 1.0)
        step, covariance, square = whitened.step(slice(newest, None))
        limit = wider * chi2_quantile(1.0 - false_alarm, len(step))
        yield count, Distance(step, math.inf if math.isnan(square) else square / limit, wider * covariance)


@dataclass(frozen=True, eq=False)
class Whitened:
    """Slopes (K, n), instruments (K, n) where a reference makes them, nuisances and residual (K,), filtered.

    ``usual`` is the residual's variance over the whole run.
    """

    slopes: FloatArray
    by_reference: FloatArray | None
    nuisances: FloatArray
    white: FloatArray
    usual: float

    def step(self, rows: slice) -> tuple[FloatArray, FloatArray, float]:
        """Return the step (n,) that some rows ask for, its covariance C (n, n), and step' C^-1 step."""
        nuisances = self.nuisances[rows]
        moving = without(np.column_stack([self.slopes[rows], self.white[rows]]), nuisances)
        zeta, error = moving[:, :-1], moving[:, -1]
        lengths = lengths_of(zeta)
        zeta = zeta / lengths
        instruments = _instruments(zeta, None if self.by_reference is None else self.by_reference[rows], nuisances)
        inverse = _inverse(instruments, zeta)
        step = inverse @ products(instruments, error[:, None])[:, 0]
        left = error - np.einsum("ij,j->i", zeta, step)
        free = max(len(error) - len(step) - nuisances.shape[1], 1)
        spread = inverse @ products(instruments, instruments) @ inverse.T
        covariance = max(self.usual, float(left @ left) / free) * spread
        square = float(step @ pseudo_inverse(covariance, RANK_TOLERANCE) @ step)
        return step / lengths, covariance / np.outer(lengths, lengths), square


def _scatter(whitened: Whitened, begins: range) -> float | None:
    """Return the variance of the steps of earlier stretches over what is computed; None where there are few of them.

    The median of several: some of the stretches may lie after a change.
    """
    if len(begins) < FEWEST_STRETCHES:
        return None
    chosen = [begins[k] for k in np.linspace(0, len(begins) - 1, min(len(begins), MOST_STRETCHES)).astype(int)]
    squares = [whitened.step(slice(begin, begin + begins.step))[2] for begin in chosen]
    return float(np.median(squares)) / chi2_quantile(0.5, whitened.slopes.shape[1])
