r"""A band of frequencies of a log: every signal through one linear filter, so that G(s) stays.

What links the samples is linear, y = G u + v.  A filter L(q) applied to both commutes with it: L y = G L u + L v, and
between its samples the filtered input is what the input was, held or straight.  L is a Butterworth filter of two poles
an edge, which runs forward from the first sample: below the band it falls with the square of the frequency, so that of
a drift along a straight line nothing is left.  Until it has forgotten its beginning, outputs are missing.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError
from replant.logs.log import Log, changed
from replant.model.preprocess import accepted
from replant.numerics.arguments import BoolArray, FloatArray, instance, positive

ORDER = 2  # poles at each edge of the band: the fewest of which a straight drift leaves nothing [count]
FORGOTTEN = 0.01  # part of its beginning that the filter may still remember where outputs count again [number]


def bandpass(log: Log, low: float | None = None, high: float | None = None) -> Log:
    r"""Filter every signal of a log alike, so that frequencies outside a band no longer count.

    .. math:: L(q)\, y = G(s)\, L(q)\, u + L(q)\, v

    G(s) stays as it is.  Of a model that is too simple, the filter says over which frequencies it is to be right; of
    drift below the band, or hum above it, that it is no part of the response.  The gain at rest is then known from the
    band alone.  Each signal keeps its mean.

    Parameters
    ----------
    log : Log
        With a regular clock.
    low, high : float, optional
        Edges of the band in Hz; None leaves that side open.

    Returns
    -------
    Log
        Outputs are missing until the filter has forgotten its beginning, about one period of ``low``, and as long
        behind a gap.

    Raises
    ------
    InvalidArgumentError
        If the clock is irregular, an edge lies beyond half the sampling rate, or the log is too short for ``low``.

    References
    ----------
    Ljung (1999), "System Identification: Theory for the User", section 14.4.

    Examples
    --------
    >>> import numpy as np
    >>> import replant as rp
    >>> log = rp.examples.motor()
    >>> drift = 3000 * np.sin(0.05 * np.arange(len(log)) * log.dt)
    >>> drifting = rp.Log(log.input, log.output + drift, log.dt)
    >>> for each in drifting, rp.bandpass(drifting, low=0.1):
    ...     print(rp.fit(each, poles=1, delay=0.01).transfer_function)
    3207 / (s + 0.03388) exp(-0.01 s)
    3773 / (s + 2.415) exp(-0.01 s)
    """
    log = instance("log", log, Log)
    sections = _sections(log, low, high)
    count = _memory(sections)
    if 2 * count > log.input.size:
        lowest = min(edge for edge in (low, high) if edge is not None)
        allowed = 2.0 * count / max(log.input.size, 1) * lowest
        raise InvalidArgumentError(
            f"an edge of {lowest:g} Hz is too low: the filter forgets its beginning after {count * log.dt:.3g} s, and "
            f"the log lasts {log.duration:.3g} s; half of that allows {allowed:.2g} Hz"
        )
    unknown = ~(accepted(log.input)[1] & accepted(log.output)[1])
    forgets = _calm(unknown, count) & (np.arange(unknown.size) >= count)
    output = _filtered(log.output, sections)
    return changed(log, lambda signal: _filtered(signal, sections), np.where(forgets & ~unknown, output, np.nan))


def _sections(log: Log, low: float | None, high: float | None) -> Any:
    """Return the filter as sections of second order."""
    from scipy import signal as filters  # slow to import

    if log.stamps is not None:
        raise InvalidArgumentError("the clock is irregular: a band is cut on a regular clock; resample the log before")
    if low is None and high is None:
        raise InvalidArgumentError("a band needs a low or a high edge in Hz")
    edges = [positive(name, edge) for name, edge in (("low", low), ("high", high)) if edge is not None]
    half = 0.5 / log.dt
    if not edges[0] < edges[-1] and len(edges) == 2:
        raise InvalidArgumentError(f"the low edge must be below the high edge, got {edges[0]:g} and {edges[1]:g} Hz")
    if not edges[-1] < half:
        raise InvalidArgumentError(
            f"an edge of {edges[-1]:g} Hz is no lower than half the sampling rate, {half:g} Hz: leave that side open"
        )
    kind = "bandpass" if len(edges) == 2 else "highpass" if low is not None else "lowpass"
    return filters.butter(ORDER, edges if len(edges) == 2 else edges[0], kind, fs=1.0 / log.dt, output="sos")


def _memory(sections: Any) -> int:
    """Return after how many samples the slowest mode of the filter has fallen to `FORGOTTEN`."""
    from scipy import signal as filters

    slowest = float(np.abs(filters.sos2zpk(sections)[1]).max())
    return math.ceil(math.log(FORGOTTEN) / math.log(min(max(slowest, 1e-300), 1.0 - np.finfo(float).epsneg)))


def _calm(unknown: BoolArray, count: int) -> BoolArray:
    """Return which samples (K,) have no gap of two samples or more in their past ``count`` samples."""
    gap = unknown & np.concatenate([[False], unknown[:-1]])
    past = np.cumsum(gap)
    return np.asarray(past - np.concatenate([np.zeros(min(count, past.size), past.dtype), past[:-count]]) == 0)


def _filtered(signal: FloatArray, sections: Any) -> FloatArray:
    """Return a signal (K,) filtered from rest at its first value, with its mean; what is missing stays so."""
    from scipy import signal as filters

    signal, known = accepted(signal)
    if not known.any():
        return signal
    at = np.arange(signal.size)
    filled = np.interp(at, at[known], signal[known])
    moved = filters.sosfilt(sections, filled - filled[0])
    moved += float(signal[known].mean()) - float(moved[known].mean())
    return np.where(known, moved, np.nan)
