"""Residuals: their correlations with themselves and the input, and running sums of a record.

The sums of the products e_{k-i} e_{k-j} of a residual are those that its autoregression is made from, so that no second
pass is needed, whatever mean is subtracted in the end.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from replant.kernels.schema import LAGS
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.autoregression import LEAST, Autoregression
from replant.numerics.linear_algebra import products, sum_of_squares

BAND_95, BAND_99 = 1.960, 2.576  # two-sided standard normal quantiles, at 95 and 99 % [standard deviations]

FEWEST = 8  # residuals below which a correlation says nothing [samples]


@dataclass(frozen=True, eq=False)
class Correlations:
    r"""Sample correlations of a residual e with itself and with the input u."""

    # (L + 1,): :math:`\hat r_e(\tau) = \sum_k e_k e_{k+\tau} / \sum_k e_k^2` at lags of 0 to L samples
    auto: FloatArray
    cross: FloatArray  # (2 L + 1,): :math:`\hat r_{ue}(\tau)`, input against later residual, at lags of -L to L samples
    # auto_std, cross_std: standard deviation of each lag if the residual is white, or independent of the input
    auto_std: float
    cross_std: float

    @property
    def outside(self) -> tuple[float, float]:
        """Part of the lags beyond 95 % limits, of ``auto`` without lag 0 and of ``cross``: 0.05 of a right model."""
        lags = self.auto.size - 1
        auto = np.abs(self.auto[1:]) > BAND_95 * self.auto_std
        cross = np.abs(self.cross[lags:]) > BAND_95 * self.cross_std
        return float(auto.mean()) if auto.size else 0.0, float(cross.mean())


def correlations(residual: FloatArray, u: FloatArray, lags: int) -> Correlations | None:
    r"""Return the correlations of a residual with itself and the input; None of a constant, or of too few samples.

    The limits of the autocorrelation are those of white noise, :math:`1/\sqrt N`.  Those of the cross-correlation
    allow for a coloured residual, :math:`\sqrt{\sum_\tau r_e(\tau) r_u(\tau) / N}`, with a triangular taper: Ljung
    (1999), "System Identification: Theory for the User", section 16.6.
    """
    kept = np.isfinite(residual) & np.isfinite(u)
    count = int(kept.sum())
    if count < FEWEST:
        return None
    e, v = _centred(residual, kept), _centred(u, kept)
    if not (e.any() and v.any()):
        return None
    lags = max(1, min(lags, e.size - 1))
    auto, own, cross = _correlate(e, e, lags)[lags:], _correlate(v, v, lags)[lags:], _correlate(e, v, lags)
    auto, own, cross = auto / auto[0], own / own[0], cross / math.sqrt(auto[0] * own[0])
    taper = 1.0 - np.arange(lags + 1) / (lags + 1)
    spread = 2.0 * float((taper * auto * own).sum()) - 1.0
    return Correlations(auto, cross, 1.0 / math.sqrt(count), math.sqrt(max(spread, 1.0 / count) / count))


def _centred(signal: FloatArray, kept: BoolArray) -> FloatArray:
    """Return a signal without its mean, scaled so that no product overflows, zero where it is not kept."""
    centred = np.where(kept, signal - signal[kept].mean(), 0.0)
    largest = float(np.abs(centred).max())
    return centred / largest if largest > 0.0 else centred


def _correlate(a: FloatArray, b: FloatArray, lags: int) -> FloatArray:
    """Return sum_k a[k + tau] b[k] at lags -L to L."""
    from scipy.signal import correlate

    whole = correlate(a, b, method="auto")
    return np.asarray(whole[a.size - 1 - lags : a.size + lags])


def correlation_lags(time_constants: Iterable[float], samples: int, dt: float) -> int:
    """Return a sensible largest lag: five of the slowest time constants, 25 to a quarter of the record."""
    wanted = [math.ceil(min(5.0 * time / dt, samples)) for time in time_constants if math.isfinite(time) and time > 0]
    return max(1, min(max([25, *wanted]), samples // 4))


class OutputSums:
    """Number and spread of the measured outputs."""

    def __init__(self) -> None:
        self.count, self._level, self._sum, self._squares = 0, 0.0, 0.0, 0.0
        self._least, self._most = math.inf, -math.inf

    def take(self, y: FloatArray) -> None:
        """Take outputs (K,)."""
        if y.size == 0:
            return
        if self.count == 0:
            self._level = float(y.mean())
        self._least, self._most = min(self._least, float(y.min())), max(self._most, float(y.max()))
        moved = y - self._level
        self.count += y.size
        self._sum += float(moved.sum())
        self._squares += sum_of_squares(moved)

    @property
    def spread(self) -> float:
        """Sum of (y - mean y)^2; 0 for a constant output."""
        if self._least == self._most:
            return 0.0
        return self._squares - self._sum**2 / self.count


class ErrorSums:
    """Sums of products of the residual and its past, from which any mean can be subtracted afterwards."""

    def __init__(self) -> None:
        self._past, self._known_past = np.zeros(LAGS), np.zeros(LAGS, bool)
        self._samples, self._count, self._sum, self._squares = 0, 0, 0.0, 0.0  # the last three of known ones
        #: Products of (e_k .. e_{k-LAGS}, 1) over the samples with a known past, of (e_k, 1) over the known ones that
        #: remain
        self._usable, self._rest = np.zeros((LAGS + 2, LAGS + 2)), np.zeros((2, 2))
        self._head, self._known_head = np.zeros(0), np.zeros(0, bool)  # the first samples

    def take(self, error: FloatArray, known: BoolArray) -> None:
        """Take residuals (K,), zero where they are not known."""
        count = error.size
        whole, there = np.concatenate([self._past, error]), np.concatenate([self._known_past, known])
        stack = np.ones((LAGS + 2, count))
        for lag in range(LAGS + 1):
            stack[lag] = whole[LAGS - lag : LAGS - lag + count]
        if there.all():
            self._usable += products(stack.T, stack.T)
        else:
            self._take_some(stack, there)
        self._past, self._known_past = whole[-LAGS:].copy(), there[-LAGS:].copy()
        self._samples += count
        self._count += int(np.count_nonzero(known))
        self._sum, self._squares = self._sum + float(error.sum()), self._squares + sum_of_squares(error)

    def _take_some(self, stack: FloatArray, there: BoolArray) -> None:
        """Take residuals of which some are unknown: row i of ``stack`` has lag i, ``there`` says which are known."""
        known, error = there[LAGS:], stack[0]
        follows = np.convolve(~there, np.ones(LAGS + 1))[LAGS : LAGS + error.size] == 0  # all lags are known
        alone = known & ~follows
        if self._samples == 0:  # the first samples have zeros, without a mean, as their past: `_of_head` sums them
            self._head, self._known_head = error[:LAGS].copy(), known[:LAGS].copy()
            alone[:LAGS] = False
        usable = stack[:, follows]
        self._usable += products(usable.T, usable.T)
        single = np.stack([error[alone], np.ones(np.count_nonzero(alone))])
        self._rest += products(single.T, single.T)

    @property
    def mean(self) -> float:
        """Mean of the residuals that are known."""
        return self._sum / self._count

    def power(self, mean: float) -> float:
        """Return the sum of (e - mean)^2."""
        return self._squares - 2.0 * mean * self._sum + mean**2 * self._count

    def innovation(self, mean: float) -> float:
        """Return the sum of w^2; where the past of a residual is not known, w is the residual itself."""
        count = float(self._usable[-1, -1])
        if self._samples <= LAGS or count < LEAST:
            return self.power(mean)
        # with (e_k - mean) for e_k
        shift = mean * self._usable[:-1, -1]
        sums = self._usable[:-1, :-1] - shift[:, None] - shift[None, :] + mean**2 * count
        model = np.zeros(LAGS + 1)
        chosen = Autoregression.of_sums(sums, count).coefficients
        model[: chosen.size] = chosen
        weights = np.append(model, -mean * model.sum())
        alone = np.array([1.0, -mean])
        return float(weights @ self._usable @ weights + alone @ self._rest @ alone) + self._of_head(model, mean)

    def _of_head(self, model: FloatArray, mean: float) -> float:
        """Return the sum of w^2 over the first samples, which have no past of full length."""
        error = np.where(self._known_head, self._head - mean, 0.0)
        predicted = np.convolve(model, error)[: error.size]
        follows = np.cumsum(~self._known_head) == 0
        return float((np.where(follows, predicted, error) ** 2).sum())


SEGMENTS = 8  # stretches, half overlapping, over whose periodograms the measured spectrum is the mean [count]
SHORTEST = 64  # samples that a stretch needs [samples]


def periodogram(residual: FloatArray, dt: float) -> tuple[FloatArray, FloatArray] | None:
    """Return angular frequencies and the two-sided density of a residual (K,) per Hz, by Welch; None if too short."""
    from scipy.signal import welch  # slow to import

    known = np.isfinite(residual)
    if known.sum() < SHORTEST:
        return None
    filled = np.where(known, residual - residual[known].mean(), 0.0)
    length = max(2 * filled.size // (SEGMENTS + 1), SHORTEST)
    frequencies, density = welch(filled, 1.0 / dt, np.hanning(length), noverlap=length - length // 2, detrend=False)
    return 2.0 * math.pi * frequencies[1:-1], np.asarray(density[1:-1] / 2.0)  # which is one-sided
