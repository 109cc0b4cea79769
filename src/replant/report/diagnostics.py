"""Diagnostics of a result: residual correlations with their confidence limits, and excitation over time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.engine.offline_regressors import regressors
from replant.regressor.filters import StateVariableFilter
from replant.regressor.preprocess import Preprocess, screen
from replant.runs.result import Result

IntArray = np.ndarray[tuple[int], np.dtype[np.int64]]

BAND_95, BAND_99 = 1.960, 2.576
"""Two-sided standard normal quantiles, at 95 and 99 % [standard deviations].
Level: 95 and 99 %.
"""

FEWEST = 8
"""Residuals below which a correlation says nothing [samples]."""
WINDOWS = 100
"""Windows in a record, unless they become too short for the parameters [count]."""
STRIDES = 4
"""Steps in which a window moves by its length [count]."""


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

    Parameters
    ----------
    residual, u : (K,) arrays
        Samples that are not finite count as zero.
    lags : int
        Largest lag in samples.

    Examples
    --------
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


def _centred(signal: FloatArray, kept: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> FloatArray:
    """Return a signal without its mean, scaled so that no product overflows, zero where it is not kept."""
    centred = np.where(kept, signal - signal[kept].mean(), 0.0)
    largest = float(np.abs(centred).max())
    return centred / largest if largest > 0.0 else centred


def _correlate(a: FloatArray, b: FloatArray, lags: int) -> FloatArray:
    """Return sum_k a[k + tau] b[k] at lags -L to L."""
    from scipy.signal import correlate

    whole = correlate(a, b, method="auto")
    return np.asarray(whole[a.size - 1 - lags : a.size + lags])


def correlation_lags(result: Result, samples: int, dt: float) -> int:
    """Return a sensible largest lag: five of the slowest time constants, at least 25, at most a quarter of the record.

    Parameters
    ----------
    result : Result
    samples : int
        Length of the record.
    dt : float
        Sampling time in s.
    """
    times = [mode.time_constant for mode in result.transfer_function.modes]
    wanted = [math.ceil(min(5.0 * t / dt, samples)) for t in times if math.isfinite(t) and t > 0]
    return max(1, min(max([25, *wanted]), samples // 4))


@dataclass(frozen=True, eq=False)
class Excitation:
    """How well the samples of each window of a record determine the parameters.

    Attributes
    ----------
    samples : (W,) array of int
        The sample after which each window ends.
    window : int
        Samples in a window.
    smallest : (W,) array
        Smallest eigenvalue of the window's scaled information matrix: 1 at best, 0 where a combination of parameters
        is undetermined.
    condition : (W,) array
        Condition number of the window's scaled regressors, as in the verdict on the whole record.
    """

    samples: IntArray
    window: int
    smallest: FloatArray
    condition: FloatArray


def excitation(phi: FloatArray) -> Excitation | None:
    r"""Return the excitation along regressors phi (K, P), each entry scaled by its root mean square over the record.

    The information matrix of a window is :math:`\frac{1}{N} \sum_k \varphi_k \varphi_k^T`, over its N finite rows.

    Examples
    --------
    >>> phi = np.random.default_rng(0).standard_normal((8000, 2))
    >>> phi[4000:, 1] = phi[4000:, 0]                  # two equal columns
    >>> found = excitation(phi)
    >>> found.smallest[[0, -1]].round(1)
    array([0.8, 0. ])
    """
    count, size = phi.shape
    finite = np.asarray(np.isfinite(phi).all(axis=1))
    if not finite.any():
        return None
    rows = np.where(finite[:, None], phi, 0.0)
    largest = np.abs(rows).max(axis=0)
    largest[largest == 0.0] = 1.0
    rows = rows / largest
    scale = np.sqrt((rows**2).sum(axis=0) / finite.sum())
    rows = rows / np.where(scale > 0.0, scale, 1.0)
    stride = max(1, -(-max(20 * size, count // WINDOWS) // STRIDES))
    blocks = max(1, count // stride)
    ends = count - stride * np.arange(blocks - 1, -1, -1)
    matrices, totals = _blocks(rows, ends), np.diff(np.cumsum(finite)[ends - 1], prepend=0)
    span = min(STRIDES, blocks)
    windows, weights = _moving_sum(matrices, span), _moving_sum(totals, span)
    values = np.linalg.eigvalsh(windows / np.maximum(weights, 1)[:, None, None])
    least, most = np.maximum(values[:, 0], 0.0), values[:, -1]
    with np.errstate(divide="ignore", invalid="ignore"):
        condition = np.where(most > 0.0, np.sqrt(most / least), np.inf)
    return Excitation(ends[span - 1 :], min(span * stride, count), least, condition)


def _blocks(rows: FloatArray, ends: IntArray) -> FloatArray:
    """Return sum phi phi' over each block of rows, (B, P, P); a block ends before each of ``ends``."""
    begins = [0, *ends[:-1].tolist()]
    parts = [rows[begin:end] for begin, end in zip(begins, ends.tolist(), strict=True)]
    return np.stack([part.T @ part for part in parts])


def _moving_sum(values: FloatArray, span: int) -> FloatArray:
    """Return the sums of ``span`` consecutive entries along the first axis."""
    return np.asarray(sum(values[i : values.shape[0] - span + 1 + i] for i in range(span)))


def regressors_of(
    result: Result, state_filter: StateVariableFilter, preprocess: Preprocess, u: FloatArray, y: FloatArray, dt: float
) -> FloatArray:
    """Return the regressors (K, P) of a result's record; rejected samples are rows of NaN.

    Parameters
    ----------
    result : Result
    state_filter : StateVariableFilter
    preprocess : Preprocess
        With a working point in numbers.
    u, y : (K,) arrays
        Raw input and output.
    dt : float
        Sampling time in s.
    """
    accepted, _ = screen(preprocess.map_input(u), y)
    return regressors(result.structure, dt, state_filter, preprocess, u, np.where(accepted, y, np.nan))[0]
