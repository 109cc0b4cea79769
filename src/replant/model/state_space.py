"""From polynomials to difference equations: a companion form in scaled states, and its discretisations.

For a monic denominator D(s) of order n and a time scale c [rad/s] the states are

    w_i = c^(n-i) s^i / D(s) x,   i = n-1 .. 0,

each of which has a gain near one.  The article's unscaled states s^i / D(s) x differ in size by c^n.  They obey

    dw/dt = c [ -D_scaled ; shift ] w + c e_1 x,   D_scaled_i = d_i / c^(n-i).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.numerics.arguments import FloatArray
from replant.numerics.limits import LONGEST, SHORTEST


@dataclass(frozen=True, eq=False)
class Companion:
    """The scaled companion form of 1/D(s): dw/dt = matrix w + column x.

    Attributes
    ----------
    matrix : (n, n) array, 1/s
    column : (n,) array, 1/s
    characteristic : (n,) array
        d_i / c^(n-i), so that s^n/D x = x - characteristic' w.
    scale : (n,) array
        c^(n-i), so that s^i/D x = w_i / scale_i.
    """

    matrix: FloatArray
    column: FloatArray
    characteristic: FloatArray
    scale: FloatArray


def companion(denominator: FloatArray) -> Companion:
    """Return the scaled companion form of a monic ``denominator`` (descending powers, order >= 1).

    Examples
    --------
    >>> companion(np.array([1.0, 10.0, 25.0])).characteristic       # (s+5)^2
    array([2., 1.])
    """
    n = denominator.size - 1
    c = _time_scale(denominator)
    scale = c ** np.arange(1.0, n + 1.0)
    characteristic = denominator[1:] / scale
    matrix = np.zeros((n, n))
    matrix[0] = -c * characteristic
    matrix[np.arange(1, n), np.arange(n - 1)] = c
    column = np.zeros(n)
    column[0] = c
    return Companion(matrix, column, characteristic, scale)


def _time_scale(denominator: FloatArray) -> float:
    """Return the geometric mean of the poles' magnitudes; with a pole at zero, the largest abs(d_(n-i))^(1/i)."""
    n = denominator.size - 1
    powers = np.arange(1, n + 1)
    with np.errstate(divide="ignore"):
        suggested = np.exp(np.log(np.abs(denominator[1:])) / powers)
    c = suggested[-1] if suggested[-1] > 0 else suggested.max()
    # of a pole slower than any time the scale would leave float64 in its powers: such a plant integrates
    return float(np.clip(c, 1.0 / LONGEST, 1.0 / SHORTEST)) if c > 0 else 1.0


def exact(
    matrix: FloatArray, column: FloatArray, interval: float, hold: str
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Discretise dw/dt = matrix w + column x exactly: w(k+1) = Ad w(k) + before x(k) + after x(k+1).

    >>> Ad, before, after = exact(np.array([[-1.0]]), np.array([1.0]), 1.0, "zoh")
    >>> Ad.round(4), before.round(4), after
    (array([[0.3679]]), array([0.6321]), array([0.]))

    References
    ----------
    Van Loan (1978), "Computing integrals involving the matrix exponential", IEEE Transactions on Automatic Control 23:
    both columns come from one augmented matrix exponential.
    """
    from scipy.linalg import expm

    n = matrix.shape[0]
    augmented = np.zeros((n + 2, n + 2))
    augmented[:n, :n] = matrix * interval
    augmented[:n, n] = column * interval
    augmented[n, n + 1] = 1.0
    power = expm(augmented)
    constant, ramp = power[:n, n], power[:n, n + 1]
    if hold == "zoh":
        return power[:n, :n], constant, np.zeros(n)
    return power[:n, :n], constant - ramp, ramp


def bilinear(matrix: FloatArray, column: FloatArray, interval: float, alpha: float) -> tuple[FloatArray, FloatArray]:
    """Return Ad (n, n) and Bd (n,) of the generalised bilinear transform of dw/dt = matrix w + column x.

    References
    ----------
    Zhang, Chen and Chen (2009); the article's (7).
    """
    identity = np.eye(matrix.shape[0])
    left = identity - alpha * interval * matrix
    right = identity + (1 - alpha) * interval * matrix
    solved = np.linalg.solve(left, np.column_stack([right, interval * column]))
    return np.asarray(solved[:, :-1], np.float64), np.asarray(solved[:, -1], np.float64)


def input_taps(matrix: FloatArray, column: FloatArray, interval: float, hold: str, fraction: float) -> FloatArray:
    """Return the exact weights (3, n) of x[k-2], x[k-1] and x[k] for an input delayed by a fraction of a sample.

    The delayed input has a corner within the interval.  The interval is split there: its first part lies on the older
    piece of the input.
    """
    n = matrix.shape[0]
    taps = np.zeros((3, n))
    early, late = fraction * interval, (1 - fraction) * interval
    _, before, after = exact(matrix, column, late, hold)
    if hold == "zoh":
        taps[1] += before
    else:
        # the late part runs from the corner value x[k-1] to the point (1 - fraction) of the way to x[k]
        taps[1] += before + fraction * after
        taps[2] += (1 - fraction) * after
    if early > 0:
        carry, _, _ = exact(matrix, column, late, hold)
        _, before, after = exact(matrix, column, early, hold)
        if hold == "zoh":
            taps[0] += carry @ before
        else:
            taps[0] += carry @ (fraction * before)
            taps[1] += carry @ ((1 - fraction) * before + after)
    return taps
