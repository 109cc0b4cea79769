"""From polynomials to difference equations: a companion form in scaled states, its discretisations, and its responses.

For a monic denominator D(s) of order n and a time scale c [rad/s] the states are

    w_i = c^(n-i) s^i / D(s) x,   i = n-1 .. 0,

each with a gain near one; the article's unscaled states s^i / D(s) x differ in size by c^n.  They obey

    dw/dt = c [ -D_scaled ; shift ] w + c e_1 x,   D_scaled_i = d_i / c^(n-i).

A dead time is a whole number of samples and a fraction of one.  A response is exact for the hold over every interval
and for any dead time: the output at the samples is that of the differential equation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from replant.numerics.arguments import FloatArray
from replant.numerics.limits import LONGEST, SHORTEST

# some million times the precision of float64, so that decimal multiples of a decimal sampling time count as whole
WHOLE = 1e-9  # distance of a dead time from a whole number of samples up to which it counts as whole [part of it]

# float64 does not hold every larger integer
NEVER = 2.0**53  # dead time that is longer than any record [samples]


@dataclass(frozen=True, eq=False)
class Companion:
    """The scaled companion form of 1/D(s): dw/dt = matrix w + column x."""

    matrix: FloatArray  # (n, n), in 1/s
    column: FloatArray  # (n,), in 1/s
    characteristic: FloatArray  # (n,): d_i / c^(n-i), so that s^n/D x = x - characteristic' w
    scale: FloatArray  # (n,): c^(n-i), so that s^i/D x = w_i / scale_i


def companion(denominator: FloatArray) -> Companion:
    """Return the scaled companion form of a monic ``denominator`` (descending powers, order >= 1)."""
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
    # powers of the scale of an extremely slow pole would underflow: such a plant is an integrator
    return float(np.clip(c, 1.0 / LONGEST, 1.0 / SHORTEST)) if c > 0 else 1.0


def exact(
    matrix: FloatArray, column: FloatArray, interval: float, hold: str
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Discretise dw/dt = matrix w + column x exactly: w(k+1) = Ad w(k) + before x(k) + after x(k+1).

    Both columns come from one augmented matrix exponential, as in Van Loan (1978), "Computing integrals involving the
    matrix exponential", IEEE Transactions on Automatic Control 23.
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

    Source: Zhang, Chen and Chen (2009); the article's (7).
    """
    identity = np.eye(matrix.shape[0])
    left = identity - alpha * interval * matrix
    right = identity + (1 - alpha) * interval * matrix
    solved = np.linalg.solve(left, np.column_stack([right, interval * column]))
    return np.asarray(solved[:, :-1], np.float64), np.asarray(solved[:, -1], np.float64)


def input_taps(matrix: FloatArray, column: FloatArray, interval: float, hold: str, fraction: float) -> FloatArray:
    """Return the exact weights (3, n) of x[k-2], x[k-1] and x[k] for an input delayed by a fraction of a sample."""
    # split at the corner of the delayed input: the first part lies on the older piece of the input
    early, late = fraction * interval, (1 - fraction) * interval
    carry, before, after = exact(matrix, column, late, hold)
    # the late part runs from the corner value x[k-1] to the point (1 - fraction) of the way to x[k]; for a held input
    # ``after`` is zero, and the older piece is x[k-2] throughout
    taps = np.stack([np.zeros(column.size), before + fraction * after, (1 - fraction) * after])
    if early > 0:
        _, before, after = exact(matrix, column, early, hold)
        older = 1.0 if hold == "zoh" else fraction
        taps[0] = carry @ (older * before)
        taps[1] += carry @ ((1 - older) * before + after)
    return taps


def unknown_outputs(delay: float, dt: float) -> int:
    """Return how many outputs of a record respond to inputs from before it, with a dead time in s.

    >>> unknown_outputs(0.3, 0.1), unknown_outputs(0.32, 0.1)
    (3, 4)
    """
    samples, fraction = split_delay(delay, dt)
    return samples + (fraction > 0.0)


def split_delay(delay: float, dt: float) -> tuple[int, float]:
    """Return a dead time in s as whole samples and a fraction of one; a fraction below `WHOLE` is rounded away."""
    samples = min(delay / dt, NEVER)
    nearest = round(samples)
    if abs(samples - nearest) < WHOLE * max(1.0, samples):
        return nearest, 0.0
    return int(samples), samples - int(samples)


class Rational(Protocol):
    """The properties of a `TransferFunction` that a simulation needs."""

    @property
    def den(self) -> FloatArray:
        """Denominator (n + 1,), monic, descending powers of s."""

    @property
    def delay(self) -> float:
        """Dead time in s."""

    @property
    def feedthrough(self) -> float:
        """Gain from the input to the output at the same instant."""

    def output_row(self, model: Companion) -> FloatArray:
        """Return the row (n,) from the companion states to the output."""


class Stretch(NamedTuple):
    """The response over K consecutive samples."""

    output: FloatArray  # (K,): response to the inputs alone
    free: FloatArray  # (L, n): responses to a unit of each initial state; from row L on they have decayed
    # number of first outputs that respond to inputs from before the record, because of a dead time; meanwhile
    # ``output`` and ``free`` are constant
    unknown: int


class Response:
    """The response of a model to a record, batch by batch; joined, the batches equal the whole to the bit."""

    def __init__(self, model: Rational, dt: float, input_hold: str = "zoh", *, at_rest: bool = True) -> None:
        from replant.kernels.filters import bank, simulate

        self._order = n = model.den.size - 1
        self._bank, self._work = np.zeros(bank.size(n, 0)), np.zeros(3 * (n + 2) ** 2)
        self._row, self._states = np.zeros(n), np.zeros(2 * n)
        if n:
            form = companion(model.den)
            self._bank[bank.SCALE] = form.column[0]
            self._bank[bank.DENOMINATOR + n : bank.DENOMINATOR + 2 * n] = form.characteristic
            self._row = self._states[n:] = model.output_row(form)
        self._feedthrough, self._dt, self._straight, self._at_rest = model.feedthrough, dt, input_hold == "foh", at_rest
        self._delay, self._progress = model.delay, np.zeros(simulate.PROGRESS)
        self._samples = self._lengths = np.zeros(0)  # the two before the piece that acts next, and all since

    def take(self, u: FloatArray, intervals: FloatArray | None = None) -> Stretch:
        """Return the response to the next inputs (K,)."""
        from replant.kernels.filters import simulate

        output, free = np.zeros(u.size), np.zeros((0 if self._at_rest else u.size, self._order))
        if u.size == 0:
            return Stretch(output, free, 0)
        if self._samples.size == 0:  # two samples stand for those before the first one
            self._samples, self._lengths = np.full(2, u[0]), np.full(2, self._dt)
            if intervals is None:
                samples, fraction = split_delay(self._delay, self._dt)
                self._progress[simulate.LAG], self._progress[simulate.WAIT] = samples, fraction * self._dt
            elif self._delay > WHOLE * self._dt:
                self._progress[simulate.WAIT] = self._delay
        inputs, lengths = np.concatenate([self._samples, u]), np.array([self._dt])
        if intervals is not None:
            lengths = np.concatenate([self._lengths, intervals])
            if not self._progress[simulate.BEGUN]:
                lengths[self._samples.size] = self._dt
        front, unknown, alive = simulate.simulate(
            self._bank, self._states, self._work, self._row, self._feedthrough, self._progress, inputs, lengths,
            self._dt, self._straight, output, free,
        )  # fmt: skip
        self._samples, self._lengths = inputs[front - 2 :].copy(), lengths[front - 2 :].copy()
        return Stretch(output, free[:alive], unknown)
