"""Conditioning of a log before identification: detrending, a start from rest, stretches left out; filters beside it.

Each step is applied only on request.  It returns another `Log` with the same G(s): the same linear operation is applied
to input, output and reference.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError, shown
from replant.logs.filtering import bandpass, clock_of, decimate, resample
from replant.logs.log import Log, changed
from replant.logs.recording import ROUND_OFF
from replant.model.preprocess import accepted
from replant.numerics.arguments import BoolArray, FloatArray, instance, number

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
    clock = clock_of(log)
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
    since = clock_of(log)

    def without_line(signal: FloatArray) -> FloatArray:
        signal, known = accepted(signal)
        if known.sum() < 2:
            return signal
        t = since - since[known].mean()
        t /= np.abs(t[known]).max()  # so that no square overflows float64
        slope = float(t[known] @ signal[known]) / float(t[known] @ t[known])
        return np.asarray(signal - slope * t)

    return changed(log, without_line, without_line(log.output))


STEPS: Mapping[str, Callable[[Log, Any], Log]] = {
    "resample": resample,
    "decimate": decimate,
    "detrend": lambda log, _: detrend(log),
    "band": lambda log, edges: bandpass(log, *edges),
}  # the steps on request, in the order in which they are applied: filters need a regular clock
