"""Conditioning of a log before identification: detrending, decimation, resampling, and a start from rest.

Each step is applied only on request.  It returns another `Log` with the same G(s): the same linear operation is applied
to input, output and reference.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError, shown
from replant.logs.frequency_band import bandpass
from replant.logs.log import Log, changed
from replant.logs.recording import ROUND_OFF
from replant.model.preprocess import accepted
from replant.numerics.arguments import BoolArray, FloatArray, instance, number, whole
from replant.numerics.limits import duration, increasing

BEFORE = 1.0  # rest put before a log: a plant that settles more slowly is too slow for the log [duration of the log]


def from_rest(log: Log) -> Log:
    r"""Extend a log by the rest before it, if the plant had settled at the first value of the input.

    `fit`, `run` and `search` estimate the initial state and the offset.  A step test whose input moves within the first
    samples hardly separates these from the gain; the knowledge that it began at rest does.  Example: for a time
    constant of 12 s and a test of 75 s, the gain's standard deviation falls from 60 % to 1 % if the step is at the
    second sample, and to a third if a seventh of the record is before the step.  If the plant was not at rest, the
    model is wrong.

    Parameters
    ----------
    log : Log

    Returns
    -------
    Log
        Twice as long: before the first sample the input has its first value.  The outputs up to the first move of the
        input are spread over the time before that move; the other outputs there are missing.

    Raises
    ------
    InvalidArgumentError
        If no output is known until the input first moves.

    Examples
    --------
    >>> import numpy as np
    >>> import replant as rp
    >>> u = np.where(np.arange(150) < 1, 0.0, 1.0)
    >>> y = 5.0 + rp.TransferFunction([2.0], [12.0, 1.0]).simulate(u, 0.5)
    >>> log = rp.Log(u, y + 0.05 * np.random.default_rng(1).standard_normal(150), 0.5)
    >>> for each in log, rp.from_rest(log):
    ...     print(round(float(rp.fit(each, poles=1).uncertainty.dc_gain_std), 2))
    1.12
    0.01
    """
    log = instance("log", log, Log)
    u, y = accepted(log.input)[0], accepted(log.output)[0]
    output = outputs_from_rest(u, y)
    if output is None or not np.isfinite(u[:1]).all():
        raise InvalidArgumentError("no output is known until the input moves: the output at rest is unknown")
    count = output.size - y.size

    def held(signal: FloatArray) -> FloatArray:
        signal = accepted(signal)[0]
        return np.concatenate([np.full(count, signal[0]), signal])

    time = log.time
    if time is not None:
        time = np.concatenate([time[0] + log.dt * np.arange(-count, 0), time])
    return changed(log, held, output, time=time, rest=log.rest + count)


def outputs_from_rest(u: FloatArray, y: FloatArray) -> FloatArray | None:
    """Return an output (K,) extended by the rest before it, NaN if unknown; None if no output precedes a move of u."""
    moves = np.flatnonzero(u[1:] != u[:-1])
    still = np.flatnonzero(np.isfinite(y[: moves[0] + 2] if moves.size else y))
    if not still.size:
        return None
    count = round(BEFORE * u.size)
    output = np.concatenate([np.full(count, np.nan), y])
    output[count : count + still[-1] + 1] = np.nan
    # at rest an output may be placed at any time: each is used once, so that none counts twice, and they are denser at
    # the beginning, where a dead time hides the first ones and the state has to be determined
    places = (count + still[-1]) * np.linspace(0.0, 1.0, still.size) ** 2
    output[np.maximum(places.round().astype(int), np.arange(still.size))] = y[still]
    return output


Stretch = tuple[float | None, float | None]


def leave_out(log: Log, stretches: Sequence[Stretch] = (), *, use: Sequence[Stretch] = ()) -> Log:
    """Leave out the outputs of stretches of time, in which they are wrong, or which are kept to validate on.

    The inputs stay: they act on the outputs that follow.  Leave out last: after `decimate`, `resample` or `bandpass`,
    which make one output of several, those left out before count as rejected.

    Parameters
    ----------
    log : Log
    stretches : sequence of tuples
        Begin and end of each stretch, in s from the first sample of the file.  The output at its begin is left out,
        that at its end stays.  None is the begin or the end of the log.
    use : sequence of tuples, optional
        Stretches outside of which all outputs are left out.

    Returns
    -------
    Log
        The log up to the last output that remains; those left out are missing.

    Raises
    ------
    InvalidArgumentError
        If a stretch has no sample, or no output remains.

    Examples
    --------
    >>> log = Log([0.0, 1.0, 1.0, 1.0, 0.0], [0.0, 0.1, 9.0, 0.3, 0.4], dt=0.5)
    >>> leave_out(log, [(1.0, 1.5), (2.0, None)]).output
    array([0. , 0.1, nan, 0.3])
    """
    log = instance("log", log, Log)
    clock = _clock(log)
    clock = clock - clock[min(log.rest, clock.size - 1) :][:1] + (log.begin or 0.0)
    used = np.ones(clock.size, bool) if _items(use) == () else _within(clock, log.dt, use)
    left = used & ~_within(clock, log.dt, stretches)
    if not (left & np.isfinite(log.output)).any():
        raise InvalidArgumentError("no output is left to make a model of")
    end = int(np.flatnonzero(left)[-1]) + 1  # missing outputs at the end would look like a failed sensor
    withheld = int((np.isfinite(log.output) & ~left)[:end].sum())
    return changed(
        log, lambda signal: signal[:end], np.where(left, log.output, np.nan)[:end],
        time=None if log.time is None else log.time[:end], withheld=log.withheld + withheld,
    )  # fmt: skip


def _items(value: object) -> tuple[Any, ...] | None:
    """Return the items of a list, a tuple or an array; None for anything else."""
    return tuple(value) if isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim) else None


def _within(clock: FloatArray, dt: float, stretches: Sequence[Stretch]) -> BoolArray:
    """Return which samples (K,) lie in stretches of time, where rounding moves no sample over an end."""
    found, slack = np.zeros(clock.size, bool), ROUND_OFF * dt
    for stretch in [stretches] if (given := _items(stretches)) is None else given:
        ends = _items(stretch) or ()
        if len(ends) != 2:
            raise InvalidArgumentError(
                f"stretches must be begins and ends in s, as [(12.0, 32.0)]; got {shown(stretch)}"
            )
        begin = 0.0 if ends[0] is None else number("the begin of a stretch", ends[0])
        end = math.inf if ends[1] is None else number("the end of a stretch", ends[1])
        if math.isnan(begin) or math.isnan(end):
            raise InvalidArgumentError(f"{begin:g}:{end:g}: begin and end of a stretch must be numbers, not NaN")
        if begin >= end:
            raise InvalidArgumentError(f"{begin:g}:{end:g}: a stretch must begin before it ends")
        inside = (clock >= begin - slack) & (clock < end - slack)
        if not inside.any():
            lasts = f"{clock[0]:.6g} to {clock[-1]:.6g} s" if clock.size else "no time"
            raise InvalidArgumentError(f"{begin:g}:{end:g}: no sample lies there; the log has {lasts}")
        found |= inside
    return found


HALF_LENGTH = 10  # half the length of the filter; its transition band is 0.13 new rates wide [new sampling times]
ATTENUATION = 60.0  # attenuation of frequencies that would be aliased [dB]
CUTOFF = 0.8  # frequency at which the filter's gain is a half [new Nyquist frequency]
LONGEST_GAP = 3.0  # distance of two stamps that is a gap, in which samples are lost [usual intervals]
FINEST = 0.5  # shortest new sampling time: twice as many samples as were measured [usual intervals]
MOST_ROWS = 100.0  # most new samples: of more, nearly all would lie in gaps [samples of the log]
SAME = 1e-9  # part of an interval that is a rounding error [intervals]
COARSEST = 2.0  # longest new sampling time without an anti-aliasing filter [usual intervals]


def detrend(log: Log) -> Log:
    """Subtract the best-fitting straight line from each signal of a log, and keep its mean.

    A drifting sensor or a growing load adds a line to the output.  The trend of the input and the plant's response to
    it are removed, too.  Do not detrend a record that is not much longer than the plant's slowest time constant, a
    single step, or the record of an integrating plant: there the line is part of the response.

    Parameters
    ----------
    log : Log

    Returns
    -------
    Log
        Missing samples stay missing.

    Examples
    --------
    >>> import numpy as np
    >>> import replant as rp
    >>> log = rp.examples.motor()
    >>> drifting = rp.Log(log.input, log.output + np.linspace(0, 500, len(log)), log.dt, None, "u", "y", log.path)
    >>> for each in log, drifting, rp.detrend(drifting):
    ...     print(rp.fit(each, poles=1).transfer_function)
    3623 / (s + 2.127)
    408.4 / (s - 0.008127)
    3632 / (s + 2.163)
    """
    log = instance("log", log, Log)
    since = _clock(log)

    def without_line(signal: FloatArray) -> FloatArray:
        signal, known = accepted(signal)
        if known.sum() < 2:
            return signal
        t = since - since[known].mean()
        t /= np.abs(t[known]).max()  # so that no square overflows float64
        slope = float(t[known] @ signal[known]) / float(t[known] @ t[known])
        return np.asarray(signal - slope * t)

    return changed(log, without_line, without_line(log.output))


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
    t = _clock(log)
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


def _clock(log: Log) -> FloatArray:
    """Return the time of each sample of a log in s; stamps are checked."""
    samples = log.input.size
    return np.arange(samples, dtype=np.float64) * log.dt if log.stamps is None else increasing(log.stamps, samples)


STEPS: Mapping[str, Callable[[Log, Any], Log]] = {
    "resample": resample,
    "decimate": decimate,
    "detrend": lambda log, _: detrend(log),
    "band": lambda log, edges: bandpass(log, *edges),
}  # the steps on request, in the order in which they are applied: filters need a regular clock
