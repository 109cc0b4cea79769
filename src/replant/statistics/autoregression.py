r"""Autoregression: the model :math:`D(q)\, e_k = w_k` that whitens a residual.

Its order is that of the online recursion, `replant.kernels.monitoring.residual_colour`.

Sources: Ljung (1999), "System Identification: Theory for the User", section 16.6; Soderstrom and Stoica (1989), "System
Identification", section 11.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.kernels.schema import LAGS
from replant.statistics.chi2 import chi2_quantile
from replant.statistics.linear_algebra import quiet

WHITENESS_LAGS = 25
"""Lags of the portmanteau statistic [samples].
Origin: a usual number for records of hundreds to thousands of samples.
Sensitivity: not measured.
"""

WHITENESS_LEVEL = 0.99
"""Level of the portmanteau statistic's limit [probability].
Level: 99 %.
"""


@dataclass(frozen=True, eq=False)
class Autoregression:
    r"""The model :math:`e_k + d_1 e_{k-1} + \ldots + d_p e_{k-p} = w_k`, w white.

    Attributes
    ----------
    coefficients : (p + 1,) array
        1, d_1 .. d_p, in falling powers of the shift q.
    power : float
        Sum of w^2 over the samples that the model was fitted to.
    """

    coefficients: FloatArray
    power: float

    @classmethod
    def of(cls, error: FloatArray) -> Autoregression:
        """Return the model of ``error`` (K,), K larger than the order, every sample finite.

        Examples
        --------
        >>> noise = np.random.default_rng(0).standard_normal(5000)
        >>> slow = np.convolve(noise, 0.9 ** np.arange(100))
        >>> Autoregression.of(slow).coefficients[:2].round(1)
        array([ 1. , -0.9])
        """
        return cls.of_covariances(np.array([error[lag:] @ error[: error.size - lag] for lag in range(LAGS + 1)]))

    @classmethod
    def of_covariances(cls, covariances: FloatArray) -> Autoregression:
        """Return the model with these sums (p + 1,) of e_k e_{k-lag}, by Levinson's recursion."""
        from replant.kernels.monitoring import residual_colour

        coefficients = np.empty(covariances.size)
        power = residual_colour.autoregression(covariances, coefficients, np.empty(covariances.size))
        return cls(coefficients, float(power))

    def whiten(self, signals: FloatArray) -> FloatArray:
        """Return D(q) x of ``signals`` (K, ...) along the first axis, from the first sample with p predecessors on."""
        model = self.coefficients
        lags = model.size - 1
        result = model[0] * signals[lags:]
        for lag in range(1, lags + 1):
            result = result + model[lag] * signals[lags - lag : signals.shape[0] - lag]
        return np.asarray(result)

    def colour(self, signals: FloatArray) -> FloatArray:
        """Return x / D(q) of ``signals`` (K, ...) along the first axis, from rest: (K, ...)."""
        from replant.kernels.filters.all_pole import all_pole

        channels = all_pole(self.coefficients, signals.reshape(signals.shape[0], -1).T)
        return np.ascontiguousarray(channels.T).reshape(signals.shape)


@quiet
def one_step(residual: FloatArray) -> FloatArray:
    """Return the one-step prediction error (K,) of a free run's residual (K,), modelled as an autoregression.

    A sample without a complete finite past keeps its residual: it cannot be predicted.

    Examples
    --------
    >>> slow = np.sin(np.arange(200) / 10)
    >>> bool(np.std(one_step(slow)) < 0.1 * np.std(slow))
    True
    """
    if residual.size <= LAGS:
        return residual
    known = np.isfinite(residual)
    filled = np.where(known, residual, 0.0)
    error = np.convolve(filled, Autoregression.of(filled).coefficients)[: filled.size]
    usable = np.convolve(~known, np.ones(LAGS + 1))[: known.size] == 0
    return np.where(usable, error, residual)


def whiteness(error: FloatArray) -> float:
    r"""Return the portmanteau statistic :math:`N \sum_\tau \hat r_e^2(\tau)` of a residual (K,) over its 99 % limit.

    Examples
    --------
    >>> noise = np.random.default_rng(0).standard_normal(2000)
    >>> whiteness(noise) < 1.0 < whiteness(noise[1:] + noise[:-1])
    True
    """
    lags = min(WHITENESS_LAGS, error.size // 4)
    power = float(error @ error)
    if lags < 1 or not power > 0.0:
        return 0.0
    correlations = np.array([error[lag:] @ error[: error.size - lag] for lag in range(1, lags + 1)]) / power
    return float(error.size * (correlations @ correlations) / chi2_quantile(WHITENESS_LEVEL, lags))
