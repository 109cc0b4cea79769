"""The anchor: an output-error fit that shares no code with replant.

The simulated output is linear in the numerator, the offset and the initial state, so that least squares gives them for
each denominator (Golub and Pereyra 1973), and SciPy's ``least_squares`` has only the denominator to look for.  From
many starts; the best is kept.  The input is held between samples; the discretisation is exact (matrix exponential).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm
from scipy.optimize import least_squares

from compiled import compiled
from replant.kernels.native import Matrix, Reals, kernel

FloatArray = npt.NDArray[np.float64]
DAMPINGS = (0.05, 0.5)
SWINGING, PEAKS = (0.003, 0.03), 6  # dampings of pairs at the highest peaks of the output's spectrum
TIMES = 8  # time constants that starts begin from
RANDOM = 12
PROMISING, SHORT = 10, 12  # starts that are improved, and model evaluations of each but those of derivatives
FINALISTS, LONG = 3, 200


def _responses(step: FloatArray, drive: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """States (K, n) driven by u from rest, and from n unit states first rows (K, n) of a free run."""
    forced, free = np.zeros((2, u.size + 1, drive.size))
    free[0, 0] = 1.0
    compiled(fill_responses)(np.ascontiguousarray(step), np.ascontiguousarray(drive), u, forced, free)
    return forced[:-1], free[:-1]


@kernel("forced.shape[0] > u.size and free.shape[0] > u.size and step.shape[0] == step.shape[1] == drive.size")
def fill_responses(step: Matrix, drive: Reals, u: Reals, forced: Matrix, free: Matrix):
    for k in range(u.size):
        for i in range(drive.size):
            following, next_row = drive[i] * u[k], 0.0
            for j in range(drive.size):
                following += step[i, j] * forced[k, j]
                next_row += free[k, j] * step[j, i]
            forced[k + 1, i], free[k + 1, i] = following, next_row


class OutputError:
    """Output-error fits of one structure to one record.

    Parameters
    ----------
    u, y : (K,) arrays
    dt : float
        Sampling time in s.
    poles, zeros : int
    delay : float
        Dead time in s, a multiple of the sampling time.
    """

    def __init__(self, u: FloatArray, y: FloatArray, dt: float, poles: int, zeros: int, delay: float) -> None:
        lag = round(delay / dt)
        u = np.concatenate([np.full(lag, u[0]), u[: u.size - lag]]) - u.mean()
        self.unknown, self.u, self.y, self.dt, self.poles, self.zeros = lag, u, y, dt, poles, zeros
        self.spread = float(np.linalg.norm(y[lag:] - y[lag:].mean()))

    def tamed(self, den: FloatArray) -> FloatArray:
        """Return the denominator (n,) with the poles that grow more than e-fold within the record mirrored."""
        poles, limit = np.roots(np.r_[1.0, den]), 1.0 / (self.u.size * self.dt)
        if poles.real.max(initial=-limit) <= limit:
            return den
        return np.asarray(np.poly(limit - np.abs(poles.real - limit) + 1j * poles.imag)[1:].real)

    def columns(self, den: FloatArray) -> FloatArray:
        """Return what the output is a sum of, for a denominator (n,) without its leading 1, highest power first.

        A pole that grows faster than e-fold within the record counts as its mirror image: it would fit drifts.
        """
        den = self.tamed(den)
        rate = max(float(np.max(np.abs(den) ** (1.0 / np.arange(1, den.size + 1)))), 1e-300)
        n = den.size
        a = np.zeros((n + 1, n + 1))  # companion matrix in units of 1 / rate, and the input
        a[range(n - 1), range(1, n)] = 1.0
        a[n - 1, :n] = -(den / rate ** np.arange(1, n + 1))[::-1]
        a[n - 1, n] = 1.0
        whole = expm(a * rate * self.dt)
        forced, free = _responses(whole[:n, :n].copy(), whole[:n, n].copy(), self.u)
        return np.hstack([forced[:, : self.zeros + 1], free, np.ones((self.u.size, 1))])[self.unknown :]

    def residual(self, den: FloatArray) -> FloatArray:
        """Return the residual over the spread of the output: its norm is 1 - fit / 100."""
        y = self.y[self.unknown :]
        with np.errstate(all="ignore"):
            columns = self.columns(den)
            if not np.isfinite(columns).all() or np.abs(columns).max() > 1e100:
                return np.full(y.size, 10.0 / math.sqrt(y.size))
            lengths = np.linalg.norm(columns, axis=0)
            columns = columns / np.where(lengths > 0, lengths, 1.0)
            basis, upper = np.linalg.qr(columns)
            basis = basis[:, np.abs(np.diag(upper)) > 1e-10]
            centred = y - y.mean()
            return (centred - basis @ (basis.T @ centred)) / self.spread

    def fit(self, den: FloatArray) -> float:
        """Return the fit in percent that a denominator reaches."""
        return 100.0 * (1.0 - float(np.linalg.norm(self.residual(den))))

    def polished(self, den: FloatArray, evaluations: int) -> FloatArray:
        """Return the denominator that least squares comes to from another."""
        size = np.arange(1, den.size + 1)
        rate = max(float(np.max(np.abs(den) ** (1.0 / size))), 1e-300)
        found = least_squares(
            lambda x: self.residual(x * rate**size), den / rate**size, x_scale="jac", max_nfev=evaluations, xtol=1e-10
        )
        return np.asarray(found.x * rate**size)

    def starts(self) -> Iterator[FloatArray]:
        """Yield denominators: real and swinging poles over all time constants that the record can show."""
        random = np.random.default_rng(1)
        rates = np.geomspace(2.0 / (self.u.size * self.dt), 1.0 / self.dt, TIMES)
        for rate in rates:
            yield np.poly(-rate * 3.0 ** np.arange(self.poles))[1:]
            for damping in DAMPINGS if self.poles > 1 else ():
                yield self._with_pair(rate, damping)
        power = np.abs(np.fft.rfft(self.y - self.y.mean())) ** 2
        peaks = np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])) + 1
        for peak in peaks[np.argsort(power[peaks])[::-1][:PEAKS]]:
            for damping in SWINGING if self.poles > 1 else ():
                yield self._with_pair(2.0 * math.pi * peak / (self.u.size * self.dt), damping)
        for _ in range(RANDOM):
            logarithms = random.uniform(np.log(rates[0]), np.log(rates[-1]), self.poles)
            yield np.poly(-np.exp(logarithms))[1:]

    def _with_pair(self, frequency: float, damping: float) -> FloatArray:
        """Return a denominator with a swinging pair, the other poles beyond it."""
        others = np.poly(-3.0 * frequency * 2.0 ** np.arange(self.poles - 2))
        return np.asarray(np.polymul([1.0, 2.0 * damping * frequency, frequency**2], others)[1:])

    def best(self) -> FloatArray:
        """Return the best denominator of all starts."""
        promising = sorted(self.starts(), key=self.fit, reverse=True)[:PROMISING]
        short = sorted((self.polished(den, SHORT) for den in promising), key=self.fit, reverse=True)
        return self.better(short[0], short[:FINALISTS])

    def better(self, known: FloatArray, given: Sequence[FloatArray]) -> FloatArray:
        """Return the best of a denominator and of what others lead to."""
        tried = [self.polished(den, LONG) for den in given]
        return self.tamed(max([known, *given, *tried], key=self.fit))
