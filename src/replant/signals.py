"""Test signals, sampled: square wave, PRBS, random steps, multisine, chirp.  Amplitudes may have any unit."""

from __future__ import annotations

import math

import numpy as np

from replant.errors import InvalidArgumentError, shown
from replant.numerics.arguments import FloatArray, between, finite, positive, vector, whole
from replant.numerics.limits import count, duration

# Feedback taps (stages counted from 1) that give a shift register its maximum period of 2^n - 1 states.  SciPy's
# default taps give other sequences of the same length; these taps are fixed so that a seed keeps its sequence.
_TAPS = {
    2: (2, 1), 3: (3, 2), 4: (4, 3), 5: (5, 3), 6: (6, 5), 7: (7, 6), 8: (8, 6, 5, 4), 9: (9, 5), 10: (10, 7),
    11: (11, 9), 12: (12, 11, 10, 4), 13: (13, 12, 11, 8), 14: (14, 13, 12, 2), 15: (15, 14), 16: (16, 15, 13, 4),
    17: (17, 14), 18: (18, 11),
}  # fmt: skip

LARGEST_RMS = 1e300  # largest standard deviation of noise that stays within float64 [the signal's unit]
LONGEST_STEP = 40.0  # longest step, longer than any signal in memory [logarithm of samples]
MOST_TURNS = 1e15  # most turns of a sine whose angle float64 still resolves [turns]


def square(samples: int, period: float, dt: float, amplitude: float = 1.0) -> FloatArray:
    """Return a square wave (K,) that starts at +amplitude and switches every half period, in whole samples.

    Parameters
    ----------
    samples : int
    period : float
        Period in s.
    dt : float
        Sampling time in s.
    amplitude : float

    Raises
    ------
    InvalidArgumentError
        If the period is shorter than two samples, or an argument is outside of its range.

    Examples
    --------
    >>> square(6, period=0.4, dt=0.1)
    array([ 1.,  1., -1., -1.,  1.,  1.])
    """
    period, dt, amplitude = duration("period", period), duration("dt", dt), finite("amplitude", amplitude)
    samples = count("samples", samples, 0, 4)
    half = min(round(period / 2 / dt), samples + 1)
    if half < 1:
        raise InvalidArgumentError(f"period must be at least 2 dt, got {period:g} s with dt {dt:g} s")
    return np.where(np.arange(samples) // half % 2 == 0, amplitude, -amplitude)


def prbs(samples: int, *, bits: int = 10, hold: int = 1, amplitude: float = 1.0, seed: int = 1) -> FloatArray:
    """Return a maximum-length pseudorandom binary sequence (K,), repeated after (2^bits - 1) hold samples.

    Parameters
    ----------
    samples : int
    bits : int
        Stages of the shift register, 2 to 18.
    hold : int
        Samples that each value is held.
    amplitude : float
    seed : int
        First state of the register, 1 to 2^bits - 1; it determines where the sequence starts.

    Raises
    ------
    InvalidArgumentError
        If ``bits`` is not 2 to 18, or another argument is outside of its range.

    Examples
    --------
    >>> prbs(7, bits=3)
    array([ 1., -1., -1.,  1., -1.,  1.,  1.])
    >>> float(prbs(1023, bits=10).sum())          # one sign occurs once more than the other
    1.0
    """
    samples, bits, hold = count("samples", samples, 0, 4), whole("bits", bits, 2, max(_TAPS)), whole("hold", hold, 1)
    amplitude = finite("amplitude", amplitude)
    from scipy.signal import max_len_seq

    number = whole("seed", seed, 1) % (2**bits - 1) or 1
    state = [number >> stage & 1 for stage in range(bits)]
    length = -(-samples // hold)
    taps = [bits - tap for tap in _TAPS[bits][1:]]
    sequence, _ = max_len_seq(bits, state, min(length, 2**bits - 1), taps)
    return amplitude * np.repeat(np.resize(2.0 * sequence - 1.0, length), min(hold, samples))[:samples]


def random_steps(samples: int, *, shortest: int, longest: int, low: float, high: float, seed: int = 0) -> FloatArray:
    """Return steps (K,) of random height, uniform in [low, high], and random length, uniform in its logarithm.

    Long and short steps together excite slow and fast modes.

    Parameters
    ----------
    samples : int
    shortest, longest : int
        Bounds of a step's length in samples.
    low, high : float
        Bounds of a step's height.
    seed : int

    Raises
    ------
    InvalidArgumentError
        If ``shortest`` exceeds ``longest``, or an argument is outside of its range.

    Examples
    --------
    >>> u = random_steps(1000, shortest=5, longest=50, low=-1.0, high=1.0)
    >>> u.shape, bool(abs(u).max() <= 1.0)
    ((1000,), True)
    """
    samples, low, high = count("samples", samples, 0, 4), finite("low", low), finite("high", high)
    shortest, longest = whole("shortest", shortest, 1), whole("longest", longest, 1)
    if shortest > longest:
        raise InvalidArgumentError(f"shortest must not exceed longest, got {shown(shortest)} and {shown(longest)}")
    if low > high or not math.isfinite(high - low):
        raise InvalidArgumentError(f"low must not exceed high, nor be further off than 1e308, got {low:g} and {high:g}")
    generator = np.random.default_rng(whole("seed", seed, 0))
    u = np.empty(samples)
    start = 0
    while start < samples:
        length = round(math.exp(min(generator.uniform(math.log(shortest), math.log(longest)), LONGEST_STEP)))
        u[start : start + length] = generator.uniform(low, high)
        start += length
    return u


def multisine(samples: int, dt: float, frequencies: FloatArray, amplitude: float = 1.0) -> FloatArray:
    """Return a sum of sines (K,) with Schroeder's phases, which keep the peaks low, scaled to a peak of ``amplitude``.

    Parameters
    ----------
    samples : int
    dt : float
        Sampling time in s.
    frequencies : (F,) array
        In Hz, each below 1 / (2 dt).
    amplitude : float

    Raises
    ------
    InvalidArgumentError
        If a frequency is outside of its range.

    References
    ----------
    Schroeder (1970), "Synthesis of low-peak-factor signals and binary sequences with low autocorrelation".

    Examples
    --------
    >>> u = multisine(1000, 0.01, np.array([0.1, 0.2, 0.4]))
    >>> float(abs(u).max())
    1.0
    """
    dt, amplitude, frequencies = duration("dt", dt), finite("amplitude", amplitude), vector("frequencies", frequencies)
    samples = count("samples", samples, 1, 4 * (frequencies.size + 1))
    if frequencies.size == 0 or not ((frequencies > 0.0) & (frequencies < 0.5 / dt)).all():
        raise InvalidArgumentError(f"frequencies must lie between 0 and {0.5 / dt:g} Hz")
    k = np.arange(frequencies.size)
    phases = -np.pi * k * (k + 1) / frequencies.size
    t = np.arange(samples) * dt
    u = np.sin(2 * np.pi * np.outer(t, frequencies) + phases).sum(axis=1)
    peak = float(np.abs(u).max())
    return np.asarray(amplitude * (u / peak)) if peak > 0.0 else u


def chirp(samples: int, dt: float, first: float, last: float, amplitude: float = 1.0) -> FloatArray:
    """Return a sine (K,) whose frequency changes exponentially with time.

    Parameters
    ----------
    samples : int
    dt : float
        Sampling time in s.
    first, last : float
        Frequencies in Hz at the beginning and the end.
    amplitude : float

    Examples
    --------
    >>> float(chirp(5, 0.1, first=0.5, last=2.0)[0])
    0.0
    """
    # `scipy.signal.chirp` is a cosine: with a phase of -90 degrees it has rounding errors and is not exactly 0 at t = 0
    samples, dt, amplitude = count("samples", samples, 1, 8), duration("dt", dt), finite("amplitude", amplitude)
    first, last = positive("first", first), positive("last", last)
    t, lasts = np.arange(samples) * dt, samples * dt
    if max(first, last) * lasts > MOST_TURNS:
        raise InvalidArgumentError(
            f"first and last must be smaller, got {first:g} and {last:g} Hz: float64 cannot resolve so many turns"
        )
    if first == last:
        return np.asarray(amplitude * np.sin(2 * np.pi * first * t))
    rate = (math.log(last) - math.log(first)) / lasts
    return np.asarray(amplitude * np.sin(2 * np.pi * first * (np.exp(rate * t) - 1) / rate))


def white_noise(samples: int, rms: float, seed: int = 0) -> FloatArray:
    """Return normally distributed white noise (K,).

    Parameters
    ----------
    samples : int
    rms : float
        Standard deviation.
    seed : int

    Examples
    --------
    >>> float(white_noise(1000, rms=2.0).std().round(1))
    2.0
    """
    samples, rms = count("samples", samples, 0, 4), between("rms", rms, 0.0, LARGEST_RMS, closed="both")
    return np.asarray(rms * np.random.default_rng(whole("seed", seed, 0)).standard_normal(samples))
