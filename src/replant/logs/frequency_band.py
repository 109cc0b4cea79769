r"""Band-pass filtering of a log: one linear filter for every signal, which leaves G(s) unchanged.

The model is linear, y = G u + v.  A filter L(q) commutes with it: L y = G L u + L v; between its samples the filtered
input is held, or straight, as the input was.  L is a Butterworth filter with two poles for each edge, which runs
forward from the first sample.  Below the band its gain falls with the square of the frequency, which removes a linear
drift.  Outputs are missing until the filter's transient has decayed.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError
from replant.logs.log import Log, changed
from replant.model.preprocess import accepted
from replant.numerics.arguments import FloatArray, instance, positive

ORDER = 2  # poles at each edge of the band: the fewest that remove a linear drift [count]
FORGOTTEN = 0.01  # part of the filter's transient that may remain when outputs count again [number]


def bandpass(log: Log, low: float | None = None, high: float | None = None) -> Log:
    r"""Filter every signal of a log with the same band-pass, so that frequencies outside the band no longer count.

    .. math:: L(q)\, y = G(s)\, L(q)\, u + L(q)\, v

    G(s) is unchanged.  The band selects the frequencies at which a model that is too simple is accurate, and removes
    drift below the band and hum above it.  The static gain is then extrapolated from the band.  Each signal keeps its
    mean.

    Parameters
    ----------
    log : Log
        With a regular clock.
    low, high : float, optional
        Edges of the band in Hz; None leaves that side open.

    Returns
    -------
    Log
        Outputs are missing until the filter's transient has decayed, about one period of ``low``; likewise after a
        gap.

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
    >>> rp.fit(rp.bandpass(drifting, low=0.1), poles=1, delay=0.01).transfer_function
    <TransferFunction 3773 / (s + 2.415) exp(-0.01 s)>
    """
    log = instance("log", log, Log)
    sections = _sections(log, low, high)
    count = _memory(sections)
    if 2 * count > log.input.size:
        lowest = min(edge for edge in (low, high) if edge is not None)
        allowed = 2.0 * count / max(log.input.size, 1) * lowest
        raise InvalidArgumentError(
            f"an edge of {lowest:g} Hz is too low: the filter's transient lasts {count * log.dt:.3g} s, more than half "
            f"of the log's {log.duration:.3g} s; the log allows {allowed:.2g} Hz"
        )
    unknown = ~(accepted(log.input)[1] & accepted(log.output)[1])
    gaps = np.cumsum(unknown & np.concatenate([[False], unknown[:-1]]))  # a gap is two missing samples or more
    recent = gaps - np.concatenate([np.zeros(min(count, gaps.size), gaps.dtype), gaps[:-count]])
    settled = (recent == 0) & (np.arange(unknown.size) >= count)
    output = _filtered(log.output, sections)
    return changed(log, lambda signal: _filtered(signal, sections), np.where(settled & ~unknown, output, np.nan))


def _sections(log: Log, low: float | None, high: float | None) -> Any:
    """Return the filter as second-order sections."""
    from scipy import signal as filters  # slow to import

    if log.stamps is not None:
        raise InvalidArgumentError("the clock is irregular: a band needs a regular clock; resample the log before")
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
    """Return the number of samples after which the filter's slowest mode has decayed to `FORGOTTEN`."""
    from scipy import signal as filters

    slowest = float(np.abs(filters.sos2zpk(sections)[1]).max())
    return math.ceil(math.log(FORGOTTEN) / math.log(min(max(slowest, 1e-300), 1.0 - np.finfo(float).epsneg)))


def _filtered(signal: FloatArray, sections: Any) -> FloatArray:
    """Return a signal (K,) filtered from rest at its first value, with its mean; missing samples stay missing."""
    from scipy import signal as filters

    signal, known = accepted(signal)
    if not known.any():
        return signal
    at = np.arange(signal.size)
    filled = np.interp(at, at[known], signal[known])
    moved = filters.sosfilt(sections, filled - filled[0])
    moved += float(signal[known].mean()) - float(moved[known].mean())
    return np.where(known, moved, np.nan)
