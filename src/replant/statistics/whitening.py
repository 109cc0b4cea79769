r"""The residual's colour: the autoregression that makes it white, and a test whether it is white as it is.

The residual of a right model may have any colour, as that is the noise's.  What matters is that tests and standard
deviations take it into account.

Sources: Ljung (1999), "System Identification: Theory for the User", section 16.6; Soderstrom and Stoica (1989), "System
Identification", section 11.2.
"""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray

WHITENESS_LAGS = 25


def autoregression(error: FloatArray) -> FloatArray:
    """Return D(q), 1 first, of the autoregression D(q) e = w that makes the error white."""
    from replant.kernels.monitoring import residual_colour

    lags = residual_colour.LAGS
    covariances = np.array([error[lag:] @ error[: error.size - lag] for lag in range(lags + 1)])
    model = np.empty(lags + 1)
    residual_colour.autoregression(covariances, model, np.empty(lags + 1))
    return model


def filtered(model: FloatArray, signals: FloatArray) -> FloatArray:
    """Return D(q) x along the first axis, without the samples where the filter still fills."""
    lags = model.size - 1
    result = model[0] * signals[lags:]
    for lag in range(1, lags + 1):
        result = result + model[lag] * signals[lags - lag : signals.shape[0] - lag]
    return np.asarray(result)


def whiteness(error: FloatArray) -> float:
    r"""Return the portmanteau statistic :math:`N \sum_\tau \hat r_e^2(\tau)` over its 99 % limit.

    Examples
    --------
    >>> noise = np.random.default_rng(0).standard_normal(2000)
    >>> whiteness(noise) < 1.0 < whiteness(noise[1:] + noise[:-1])
    True
    """
    from scipy.stats import chi2

    lags = min(WHITENESS_LAGS, error.size // 4)
    power = float(error @ error)
    if lags < 1 or not power > 0.0:
        return 0.0
    correlations = np.array([error[lag:] @ error[: error.size - lag] for lag in range(1, lags + 1)]) / power
    return float(error.size * (correlations @ correlations) / chi2.ppf(0.99, lags))
