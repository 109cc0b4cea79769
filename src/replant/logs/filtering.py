r"""Filters of a log, one for every signal, which leave G(s) unchanged: a band-pass, decimation, resampling.

The model is linear, y = G u + v.  A filter L(q) commutes with it: L y = G L u + L v; between its samples the filtered
input is held, or straight, as the input was.  L is a Butterworth filter with two poles for each edge, which runs
forward from the first sample.  Below the band its gain falls with the square of the frequency, which removes a linear
drift.  Outputs are missing until the filter's transient has decayed.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError, shown
from replant.logs.log import Log, changed
from replant.model.preprocess import accepted
from replant.numerics.arguments import FloatArray, instance, positive, whole
from replant.numerics.limits import duration, increasing

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


HALF_LENGTH = 10  # half the length of the filter; its transition band is 0.13 new rates wide [new sampling times]
ATTENUATION = 60.0  # attenuation of frequencies that would be aliased [dB]
CUTOFF = 0.8  # frequency at which the filter's gain is a half [new Nyquist frequency]
LONGEST_GAP = 3.0  # distance of two stamps that is a gap, in which samples are lost [usual intervals]
FINEST = 0.5  # shortest new sampling time: twice as many samples as were measured [usual intervals]
MOST_ROWS = 100.0  # most new samples: of more, nearly all would lie in gaps [samples of the log]
SAME = 1e-9  # part of an interval that is a rounding error [intervals]
COARSEST = 2.0  # longest new sampling time without an anti-aliasing filter [usual intervals]


def decimate(log: Log, factor: int) -> Log:
    """Lower the rate of a log: filter every signal against aliasing, then keep every ``factor``-th sample.

    The filter is a symmetric FIR filter of 20 new sampling times, 60 dB down at the new Nyquist frequency; its phase is
    zero.  The filtered input is not held between samples: the log declares it piecewise linear, and a fit uses that.
    Ten new sampling times at either end, which the filter does not reach, are left out; samples within ten of a missing
    one are missing.  The filter spreads outliers: mark them as missing before.

    Parameters
    ----------
    log : Log
        With a regular clock.
    factor : int
        At least 2.

    Returns
    -------
    Log
        With the sampling time ``factor * log.dt`` and the ``input_hold`` "foh".

    Raises
    ------
    InvalidArgumentError
        If the clock is irregular, or the log is shorter than the filter.

    Examples
    --------
    >>> import replant as rp
    >>> log = rp.decimate(rp.examples.motor(), 2)
    >>> len(log), log.dt, log.input_hold
    (2027, 0.04, 'foh')
    """
    from scipy import signal as filters  # slow to import

    log = instance("log", log, Log)
    factor = whole("factor", factor, 2)
    if log.stamps is not None:
        raise InvalidArgumentError("the clock is irregular: decimation needs a regular clock; resample the log before")
    half = HALF_LENGTH * factor
    if log.input.size <= 2 * half:
        raise InvalidArgumentError(
            f"the log has {log.input.size} samples: decimation by {shown(factor)} needs more than {shown(2 * half)}"
        )
    weights = filters.firwin(2 * half + 1, CUTOFF / factor, window=("kaiser", filters.kaiser_beta(ATTENUATION)))

    def thinned(signal: FloatArray) -> FloatArray:
        signal, known = accepted(signal)
        level = float(signal[known].mean()) if known.any() else 0.0
        smooth = level + filters.oaconvolve(np.where(known, signal - level, 0.0), weights, mode="valid")
        if not known.all():
            unknown = np.concatenate([[0], np.cumsum(~known)])
            smooth[unknown[2 * half + 1 :] > unknown[: -2 * half - 1]] = np.nan
        return np.asarray(smooth[::factor])

    def centred(signal: FloatArray) -> FloatArray:
        """Return a held signal as a piecewise linear one: at each stamp the mean of the two values that meet there."""
        signal, _ = accepted(signal)
        before = np.concatenate([signal[:1], signal[:-1]])
        return np.asarray((before + signal) / 2 if log.input_hold == "zoh" else signal)

    time = None if log.time is None else log.time[half : log.input.size - half : factor]
    rest = len(range(half, log.rest, factor))
    # so that stretches of time still count from the first row of the file
    begin = (log.begin or 0.0) + (half + rest * factor - log.rest) * log.dt
    return changed(
        log, lambda signal: thinned(centred(signal)), thinned(log.output),
        dt=log.dt * factor, time=time, input_hold="foh", rest=rest, withheld=0, begin=begin,
    )  # fmt: skip


def resample(log: Log, dt: float) -> Log:
    """Put a log onto a regular clock, for the methods that need one.

    The input, which is held between its stamps, becomes its mean over each new interval, which preserves its integral.
    The output is interpolated linearly between its stamps.  In a gap of more than three usual intervals both are
    missing.  The methods with instruments handle an irregular clock exactly, without resampling: prefer them.

    Parameters
    ----------
    log : Log
    dt : float
        New sampling time in s, from half the usual interval to twice the usual interval.  `decimate` lowers the rate
        further, without aliasing.

    Returns
    -------
    Log
        With a regular clock.

    Raises
    ------
    InvalidArgumentError
        If ``dt`` is too short or too long, or the log has fewer than two samples, or nearly all of it is gaps.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> t = np.array([0.0, 1.0, 2.5, 3.0, 4.0])
    >>> late = Log(np.array([0.0, 1.0, 2.0, 3.0, 3.0]), 2 * t, 1.0, t, "u", "y", Path("log.csv"))
    >>> again = resample(late, 1.0)
    >>> again.input, again.output
    (array([0. , 1. , 1.5, 3. , 3. ]), array([0., 2., 4., 6., 8.]))
    """
    log = instance("log", log, Log)
    dt = duration("dt", dt)
    t = clock_of(log)
    if t.size < 2:
        raise InvalidArgumentError(f"the log has {t.size} samples: resampling needs at least two")
    usual = float(np.median(np.diff(t)))
    if dt > COARSEST * usual * (1 + 1e-9):
        raise InvalidArgumentError(
            f"the new sampling time of {dt:g} s is more than twice the usual interval of {usual:g} s: samples in "
            "between would be lost; decimate lowers the rate, with a filter against aliasing"
        )
    if dt < FINEST * usual * (1 - 1e-9):
        raise InvalidArgumentError(
            f"the new sampling time of {dt:g} s is less than half the usual interval of {usual:g} s: a fit would count "
            "interpolated outputs as measured ones"
        )
    longest = int(np.argmax(np.diff(t)))
    if t[-1] - t[0] > MOST_ROWS * t.size * dt:
        raise InvalidArgumentError(
            f"nearly all of the new samples would be missing: a gap of {t[longest + 1] - t[longest]:g} s follows "
            f"sample {longest}; leave out the part before or after it"
        )
    count = math.floor((t[-1] - t[0]) / dt * (1 + 1e-12)) + 1
    grid = t[0] + dt * np.arange(count)
    lost = np.diff(t) > LONGEST_GAP * usual
    after = np.clip(np.searchsorted(t, grid, "right"), 1, t.size - 1) - 1
    missing = lost[after] & (grid > t[after]) & (grid < t[after + 1])

    edges = np.append(grid, grid[-1] + dt)

    def integral(signal: FloatArray) -> FloatArray:
        within = np.concatenate([[0.0], np.cumsum(signal[:-1] * np.diff(t))])
        return np.asarray(np.interp(edges, t, within) + np.maximum(edges - t[-1], 0.0) * signal[-1])

    def averaged(signal: FloatArray) -> FloatArray:
        signal, known = accepted(signal)
        means = np.diff(integral(np.where(known, signal, 0.0))) / dt
        unknown = np.diff(integral((~known).astype(float))) > SAME * dt
        return np.asarray(np.where(missing | unknown, np.nan, means))

    def interpolated(signal: FloatArray) -> FloatArray:
        return np.asarray(np.where(missing, np.nan, np.interp(grid, t, accepted(signal)[0])))

    rest = int(np.searchsorted(grid, t[log.rest])) if log.rest < t.size else grid.size
    return changed(
        log, averaged, interpolated(log.output), dt=dt, time=grid, irregular=False, earlier=0, rest=rest, withheld=0
    )


def clock_of(log: Log) -> FloatArray:
    """Return the time of each sample of a log in s; stamps are checked."""
    samples = log.input.size
    return np.arange(samples, dtype=np.float64) * log.dt if log.stamps is None else increasing(log.stamps, samples)
