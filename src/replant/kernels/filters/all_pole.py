"""The all-pole filter: what white noise becomes under an autoregression."""

import numpy as np

from replant.kernels.native import Matrix, Reals, kernel


@kernel(
    "coefficients.size >= 1 and state.size >= coefficients.size",
    "result.shape[0] >= signals.shape[0] and result.shape[1] == signals.shape[1]",
)
def fill_all_pole(coefficients: Reals, signals: Matrix, result: Matrix, state: Reals):
    """Write what `all_pole` returns into ``result``; ``state`` (p + 1,) is work."""
    order = coefficients.size - 1
    for channel in range(signals.shape[0]):
        for i in range(order + 1):
            state[i] = 0.0
        for k in range(signals.shape[1]):
            output = signals[channel, k] + state[0]
            for i in range(order):
                state[i] = state[i + 1] - coefficients[i + 1] * output
            result[channel, k] = output


def all_pole(coefficients: Reals, signals: Matrix) -> Matrix:
    """Return x / D(q) of ``signals`` (channels, K), from rest: y(k) = x(k) - d_1 y(k-1) - ... - d_p y(k-p).

    ``coefficients`` (p + 1,) are 1, d_1 .. d_p.  In transposed direct form II the state (p,) holds the sums to come.
    """
    signals = np.ascontiguousarray(signals, float)
    result = np.empty(signals.shape)
    fill_all_pole(np.ascontiguousarray(coefficients, float), signals, result, np.empty(coefficients.size))
    return result
