"""One step ahead: what the output's past adds to the simulation from the input."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray


def one_step(residual: FloatArray) -> FloatArray:
    """Return what is left of a free run's residual (K,) once its own past has been used to predict it.

    The residual is modelled as an autoregression of order 4, D(q) e = w; w is the error one step ahead.  Where it is
    not finite, and for four samples after, nothing is predicted.

    Examples
    --------
    >>> slow = np.sin(np.arange(200) / 10)
    >>> bool(np.std(one_step(slow)) < 0.1 * np.std(slow))
    True
    """
    from scipy.signal import lfilter

    from replant.kernels.monitoring import residual_colour

    lags = residual_colour.LAGS
    if residual.size <= lags:
        return residual
    known = np.isfinite(residual)
    filled = np.where(known, residual, 0.0)
    covariances = np.array([filled[lag:] @ filled[: filled.size - lag] for lag in range(lags + 1)])
    model = np.empty(lags + 1)
    residual_colour.autoregression(covariances, model, np.empty(lags + 1))
    error = lfilter(model, [1.0], filled)
    usable = np.convolve(~known, np.ones(lags + 1))[: known.size] == 0
    return np.where(usable, error, residual)
