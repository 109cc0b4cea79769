"""The all-pole filter: what white noise becomes under an autoregression."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def all_pole(coefficients, signals):
    """Return x / D(q) of ``signals`` (channels, K), from rest: y(k) = x(k) - d_1 y(k-1) - ... - d_p y(k-p).

    ``coefficients`` (p + 1,) are 1, d_1 .. d_p.  In transposed direct form II the state (p,) holds the sums to come.
    """
    order = coefficients.size - 1
    result = np.empty(signals.shape)
    state = np.empty(order + 1)
    for channel in range(signals.shape[0]):
        state[:] = 0.0
        for k in range(signals.shape[1]):
            output = signals[channel, k] + state[0]
            for i in range(order):
                state[i] = state[i + 1] - coefficients[i + 1] * output
            result[channel, k] = output
    return result
