"""Correlations of a residual with itself and with the input, and their confidence limits."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from replant.arguments import BoolArray, FloatArray

BAND_95, BAND_99 = 1.960, 2.576
"""Two-sided standard normal quantiles, at 95 and 99 % [standard deviations].
Level: 95 and 99 %.
"""

FEWEST = 8  # residuals below which a correlation says nothing [samples]


@dataclass(frozen=True, eq=False)
class Correlations:
    r"""Sample correlations of a residual e with itself and with the input u.

    Attributes
    ----------
    auto : (L + 1,) array
        :math:`\hat r_e(\tau) = \sum_k e_k e_{k+\tau} / \sum_k e_k^2` at lags of 0 to L samples.
    cross : (2 L + 1,) array
        :math:`\hat r_{ue}(\tau)`, input against later residual, at lags of -L to L samples.
    auto_std, cross_std : float
        Standard deviation of each lag if the residual is white, or independent of the input.
    """

    auto: FloatArray
    cross: FloatArray
    auto_std: float
    cross_std: float

    @property
    def outside(self) -> tuple[float, float]:
        """Part of the lags beyond the 95 % limits: of ``auto`` without lag 0, and of ``cross`` from lag 0 on.

        About 0.05 for a model that explains the record completely.
        """
        lags = self.auto.size - 1
        auto = np.abs(self.auto[1:]) > BAND_95 * self.auto_std
        cross = np.abs(self.cross[lags:]) > BAND_95 * self.cross_std
        return float(auto.mean()) if auto.size else 0.0, float(cross.mean())


def correlations(residual: FloatArray, u: FloatArray, lags: int) -> Correlations | None:
    r"""Return the correlations of a residual with itself and with the input; None if there are too few samples.

    None as well where one of the signals is constant.

    The limits of the autocorrelation are those of white noise, :math:`1/\sqrt N`.  Those of the cross-correlation
    allow for a coloured residual, :math:`\sqrt{\sum_\tau r_e(\tau) r_u(\tau) / N}`, with a triangular taper.

    >>> noise = np.random.default_rng(1).standard_normal((2, 4000))
    >>> found = correlations(*noise, lags=100)
    >>> float(found.auto[0]), max(found.outside) < 0.1
    (1.0, True)

    References
    ----------
    Ljung (1999), "System Identification: Theory for the User", section 16.6.
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
    """Return a sensible largest lag: five of the slowest time constants, at least 25, at most a quarter of the record.

    >>> correlation_lags([0.1, 2.0], samples=1000, dt=0.1)
    100
    """
    wanted = [math.ceil(min(5.0 * time / dt, samples)) for time in time_constants if math.isfinite(time) and time > 0]
    return max(1, min(max([25, *wanted]), samples // 4))
