r"""How much one signal foretells another, and after which delay: the direction from input to output.

Geweke's measure of what the past of a adds to the past of b,

.. math:: F_{a \to b} = \ln \frac{\text{residual power of } b \text{ from its own past}}
          {\text{residual power of } b \text{ from its own past and that of } a},

is large for an input a of the output b, and near zero the other way round, unless a controller closes the loop.

Source: Geweke (1982), "Measurement of linear dependence and feedback between multiple time series".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.numerics.arguments import FloatArray

MOST_SAMPLES = 1 << 16  # samples that the measures are taken from [samples]
ORDER = 3  # past stretches of each signal [count]
STRETCHES_OF_MEMORY = 5  # stretches in the time over which the output's correlation with itself falls to 1/e [count]
FEWEST_STRETCHES = 200  # stretches that a record is cut into, if it has as many samples [count]
SPREAD = 20.0  # distance from the median beyond which a value is cut off [ranges of the middle 90 %]
CEILING = 10.0  # largest measure: a residual of 1/150 of the other is a rounding error [number]
CHANCE = 4.5  # correlation that is no chance at any of thousands of lags [standard deviations]
WHITENING = 8  # order of the autoregression that whitens the input [count]
ROUNDING = 1e-9  # change of a prepared input that is rounding [its standard deviation]


def prepared(values: FloatArray) -> FloatArray:
    """Return a signal (K,) for the measures: at most `MOST_SAMPLES`, gaps interpolated, scaled to unit power."""
    head = values[:MOST_SAMPLES]
    known = np.isfinite(head)
    if not known.any():
        return np.zeros(head.size)
    head = head / (float(np.abs(head[known]).max()) or 1.0)
    low, middle, high = np.quantile(head[known], [0.05, 0.5, 0.95])
    if high > low:
        head = np.clip(head, middle - SPREAD * (high - low), middle + SPREAD * (high - low))
    at = np.arange(head.size)
    filled = np.interp(at, at[known], head[known])
    centred = filled - filled.mean()
    power = float(centred.std())
    return np.asarray(centred / power if power > 0.0 else centred)


def influence(a: FloatArray, b: FloatArray) -> float:
    """Return Geweke's measure from ``a`` (K,) to ``b`` (K,), both prepared, less what chance would give.

    It is the largest of three: ``b`` foretold one sample ahead, a fifth of its memory ahead, and over the geometric
    mean of both.  Where the sampling rate is high nothing can be foretold from one sample to the next but noise.
    """
    widest = min(max(1, memory(b) // STRETCHES_OF_MEMORY), max(1, b.size // FEWEST_STRETCHES))
    return max(_influence(a, b, width) for width in {1, round(widest**0.5), widest})


def _influence(a: FloatArray, b: FloatArray, width: int) -> float:
    """Return the measure for stretches of ``width`` samples: of each the last value and the mean are the past."""
    count = b.size // width
    order = min(ORDER, count // 16)
    if order < 1:
        return 0.0
    now = _stretches(b, width)[0][order:]
    own, others = [np.ones(now.size)], list[FloatArray]()
    for signal, columns in ((b, own), (a, others)):
        for past in _stretches(signal, width):
            columns += [past[order - lag : count - lag] for lag in range(1, order + 1)]
    alone, both = _residual(own, now), _residual([*own, *others], now)
    floor = np.exp(-CEILING) * float(now @ now) + np.finfo(float).tiny
    by_chance = 2 * order / max(1, now.size - 4 * order - 1)
    return max(0.0, float(np.log((alone + floor) / (both + floor))) - 2.0 * by_chance)


def _stretches(signal: FloatArray, width: int) -> tuple[FloatArray, FloatArray]:
    """Return the last value and the mean of each stretch of a signal."""
    stretches = signal[: signal.size // width * width].reshape(-1, width)
    return stretches[:, -1], stretches.mean(axis=1)


def _residual(columns: list[FloatArray], target: FloatArray) -> float:
    regressors = np.column_stack(columns)
    solution = np.linalg.lstsq(regressors, target, rcond=1e-10)[0]
    residual = target - regressors @ solution
    return float(residual @ residual)


def memory(b: FloatArray) -> int:
    """Return the lag at which the autocorrelation of a prepared signal falls to 1/e, in samples."""
    sums = _correlation(b, b)
    low = np.flatnonzero(sums <= sums[0] / np.e)
    return int(low[0]) if low.size else b.size


def _correlation(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the sums of a[k] b[k + lag] for the lags 0 .. K - 1."""
    size = 1 << (2 * a.size - 1).bit_length()
    product = np.conj(np.fft.rfft(a, size)) * np.fft.rfft(b, size)
    return np.asarray(np.fft.irfft(product, size)[: a.size])


@dataclass(frozen=True)
class Response:
    """What the cross-correlation of an input and an output shows; lags in samples."""

    # lag at which the response seems to begin, behind the first sample after a change of the input: a dead time, or the
    # slow beginning of a plant with several poles
    delay: float
    half: int  # lag of half the response at ``peak``
    peak: int  # lag of the largest correlation
    correlation: float  # that of the changes of the input with the changes of the output up to that lag


def response(u: FloatArray, y: FloatArray) -> Response | None:
    """Return the response of ``y`` (K,) to the changes of ``u`` (K,) that its own past does not foretell.

    None if no lag has a correlation beyond chance.
    """
    changes = _whitened(u)
    if not np.abs(changes).max(initial=0.0) > ROUNDING:  # all moves lie within the samples that foretell the others
        return None
    longest = min(u.size // 4, 50 + 5 * memory(y))
    now = changes[1:]
    before = float(now @ y[:-1])
    sums = _correlation(now, y[1:])[:longest] - before
    if not sums.size:
        return None
    spread = np.array([(y[1 + lag :] - y[: y.size - 1 - lag]).std() for lag in _few(longest)])
    spread = np.interp(np.arange(longest), _few(longest), spread)
    correlation = sums / np.maximum(float(np.sqrt(now @ now)) * spread * np.sqrt(now.size), np.finfo(float).tiny)
    significant = np.abs(correlation) > CHANCE / np.sqrt(now.size)
    if not significant.any():
        return None
    best = int(np.argmax(np.where(significant, np.abs(correlation), 0.0)))
    rising = np.sign(sums[best]) * sums[: best + 1] / abs(sums[best])
    fifth, half = _crossing(rising, 0.2), _crossing(rising, 0.5)
    onset = fifth - (half - fifth) * 0.2 / 0.3
    return Response(max(0.0, onset - 1.0), round(half), best, float(correlation[best]))


def _few(longest: int) -> FloatArray:
    """Return some lags, evenly spaced in their logarithm."""
    return np.unique(np.geomspace(1, max(longest, 2), 40).astype(int) - 1)


def _crossing(rising: FloatArray, level: float) -> float:
    """Return the position at which a curve that ends at 1 last rises through ``level``, between two samples."""
    below = np.flatnonzero(rising < level)
    if not below.size:
        return 0.0
    at = int(below[-1])
    return float(at + (level - rising[at]) / (rising[at + 1] - rising[at]))


def _whitened(u: FloatArray) -> FloatArray:
    """Return what the past of ``u`` (K,) does not foretell of it; zero over the first samples."""
    order = min(WHITENING, u.size // 10)
    if order < 1:
        return np.zeros(u.size)
    past = np.column_stack([u[order - lag : u.size - lag] for lag in range(1, order + 1)])
    model = np.linalg.lstsq(past, u[order:], rcond=1e-10)[0]
    return np.concatenate([np.zeros(order), u[order:] - past @ model])
