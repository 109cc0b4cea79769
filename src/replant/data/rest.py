"""A log that begins at rest: what its input and output were before the first sample is then known."""

from __future__ import annotations

import dataclasses

import numpy as np

from replant.arguments import FloatArray, instance
from replant.errors import InvalidArgumentError
from replant.log import Log
from replant.regressor.preprocess import accepted

BEFORE = 1.0
"""Time at rest that is put before a log [duration of the log].
Derivation: a plant that has not forgotten its initial state by then is slower than the record, and not known from it.
"""


def from_rest(log: Log) -> Log:
    r"""Put before a log the rest that it begins from: the plant had settled at the first value of the input.

    `fit`, `run` and `search` estimate the initial state and the offset.  A step test whose input moves within the first
    samples hardly tells these from the gain; knowing that it began at rest does.  Of a plant of 12 s in a test of 75 s
    the gain's standard deviation falls from 60 % to 1 % where the step is at the second sample, and to a third where a
    seventh of the record is before the step.  A plant that was not at rest then gives a wrong model.

    Parameters
    ----------
    log : Log

    Returns
    -------
    Log
        Twice as long: before the first sample the input has its first value.  The outputs up to the first move of the
        input are spread from the new beginning on; all others there are missing.

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
    1.1
    0.01
    """
    log = instance("log", log, Log)
    u, y = accepted(log.input)[0], accepted(log.output)[0]
    moves = np.flatnonzero(u[1:] != u[:-1])
    still = np.flatnonzero(np.isfinite(y[: moves[0] + 2] if moves.size else y))
    if not still.size or not np.isfinite(u[:1]).all():
        raise InvalidArgumentError("no output is known until the input moves: what it was at rest cannot be told")
    count = round(BEFORE * u.size)

    def held(signal: FloatArray) -> FloatArray:
        signal = accepted(signal)[0]
        return np.concatenate([np.full(count, signal[0]), signal])

    # at rest an output is as good at any time: as many of them as there were, so that none counts twice, and closer
    # at the beginning, where a dead time hides the first and the state has to be known
    output = np.concatenate([np.full(count, np.nan), y])
    output[count : count + still[-1] + 1] = np.nan
    places = (count + still[-1]) * np.linspace(0.0, 1.0, still.size) ** 2
    output[np.maximum(places.round().astype(int), np.arange(still.size))] = y[still]
    time = log.time
    if time is not None:
        time = np.concatenate([time[0] + log.dt * np.arange(-count, 0), time])
    return dataclasses.replace(
        log, input=held(log.input), output=output, time=time,
        reference=None if log.reference is None else held(log.reference),
        others={name: held(signal) for name, signal in log.others.items()},
    )  # fmt: skip
