"""Response: what a model makes of an input that comes batch by batch."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.model import state_space
from replant.model.dead_time import split_delay
from replant.model.transfer_function import TransferFunction

NOTHING = 1e-200
"""Size of a free response below which it has died out; before its numbers become slow ones (denormal) [number]."""


class Response:
    """The output of a model from rest, and what an initial state adds, going on where the batch before ended.

    Joined, the batches are `TransferFunction.simulate` and `TransferFunction.free_responses` of the whole input.

    Parameters
    ----------
    model : TransferFunction
    dt : float
        Sampling time in s.
    input_hold : {"zoh", "foh"}
        What the input does between samples.

    Examples
    --------
    >>> response = Response(TransferFunction([1.0], [1.0, 1.0]), dt=1.0)
    >>> response.output(np.ones(2)).round(4), response.output(np.ones(1)).round(4)
    (array([0.    , 0.6321]), array([0.8647]))
    """

    def __init__(self, model: TransferFunction, dt: float, input_hold: str = "zoh") -> None:
        self._model, self._hold = model, input_hold
        companion = state_space.companion(model.den) if model.den.size > 1 else None
        self._runs: list[_Run] = [_Run(model, dt, "zoh", companion)]
        if input_hold == "foh":
            self._runs.append(_Run(model, dt, "foh", companion))
        self._first: float | None = None
        self._row = np.zeros(0)
        if companion is not None:
            self._transition, _, _ = state_space.exact(companion.matrix, companion.column, dt, "zoh")
            self._row = model.output_row(companion)

    def output(self, u: FloatArray) -> FloatArray:
        """Return the output (K,) for the next inputs (K,)."""
        if self._hold == "zoh" or u.size == 0:
            return self._runs[0].output(u)
        if self._first is None:
            self._first = float(u[0])
        # the jump from rest to the first sample is a step, the rest runs straight from zero
        return self._runs[0].output(np.full(u.size, self._first)) + self._runs[1].output(u - self._first)

    def free(self, samples: int) -> FloatArray:
        """Return the responses (K, n) to one unit of each state alone, over the next samples."""
        if self._row.size == 0 or samples == 0 or not np.abs(self._row).max() > NOTHING:
            return np.zeros((samples, self._row.size))
        from replant.kernels.filters.simulate import free_responses

        responses = np.asarray(free_responses(self._transition, self._row, samples + 1))
        self._row = responses[-1].copy()
        return responses[:-1]


class _Run:
    """One run from rest, for an input that is zero before it."""

    def __init__(
        self, model: TransferFunction, dt: float, input_hold: str, companion: state_space.Companion | None
    ) -> None:
        self._feedthrough, self._hold = model.feedthrough, input_hold
        lag, self._fraction = split_delay(model.delay, dt)
        self._past = np.zeros(lag + 2)
        self._begun, self._companion = False, companion
        if companion is not None:
            matrix, column = companion.matrix, companion.column
            self._transition, _, _ = state_space.exact(matrix, column, dt, input_hold)
            self._taps = state_space.input_taps(matrix, column, dt, input_hold, self._fraction)
            self._row, self._state = model.output_row(companion), np.zeros(column.size)

    def output(self, u: FloatArray) -> FloatArray:
        known = np.concatenate([self._past, u])
        self._past = known[u.size :].copy()
        inputs, output = known[: u.size + 2], np.zeros(u.size)
        if self._companion is not None:
            from replant.kernels.filters.simulate import go_on

            go_on(self._transition, self._taps, self._row, inputs, self._state, -1 if self._begun else 0, output)
            self._begun = self._begun or u.size > 0
        if self._feedthrough:
            now, before = inputs[2:], inputs[1:-1]
            if self._fraction:
                now = before if self._hold == "zoh" else (1 - self._fraction) * now + self._fraction * before
            output += self._feedthrough * now
        return output
