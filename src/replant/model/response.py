"""Response: the output of a transfer function under an input on a regular clock, whole or batch by batch.

The clock's interval is split where a fractional dead time puts the input's corner (`state_space.input_taps`), so the
output at the sampling instants is exact for the hold.
"""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import numpy as np

from replant.arguments import FloatArray
from replant.model import state_space
from replant.model.dead_time import split_delay

NOTHING = 1e-200
"""Size of a free response below which it has died out; before its numbers become slow ones (denormal) [number]."""


class Rational(Protocol):
    """What is simulated: a `TransferFunction`, by what a simulation needs of it."""

    @property
    def den(self) -> FloatArray:
        """Denominator (n + 1,), monic, descending powers of s."""

    @property
    def delay(self) -> float:
        """Dead time in s."""

    @property
    def feedthrough(self) -> float:
        """Gain from the input to the output at the same instant."""

    def output_row(self, model: state_space.Companion) -> FloatArray:
        """Return the row (n,) from the companion states to the output."""


class Response:
    """The output of a model from rest, and the responses to its initial state, continued from batch to batch.

    A batch ends where the next one begins: joined, the outputs of the batches are the output of the whole input.

    Parameters
    ----------
    model : TransferFunction
    dt : float
        Sampling time in s.
    input_hold : {"zoh", "foh"}
        What the input does between samples.

    Examples
    --------
    >>> from replant.model.transfer_function import TransferFunction
    >>> response = Response(TransferFunction([1.0], [1.0, 1.0]), dt=1.0)
    >>> response.output(np.ones(2)).round(4), response.output(np.ones(1)).round(4)
    (array([0.    , 0.6321]), array([0.8647]))
    """

    def __init__(self, model: Rational, dt: float, input_hold: str = "zoh") -> None:
        self._hold = input_hold
        companion = state_space.companion(model.den) if model.den.size > 1 else None
        self._held = _FromRest(model, dt, "zoh", companion)
        self._joined = _FromRest(model, dt, "foh", companion)
        self._first: float | None = None
        self._free: FloatArray | None = None  # the response to each state at the next sample

    def output(self, u: FloatArray) -> FloatArray:
        """Return the output (K,) for the next inputs (K,)."""
        if self._hold == "zoh" or u.size == 0:
            return self._held.output(u)
        if self._first is None:
            self._first = float(u[0])
        # an input joined by straight lines is a step from zero to the first sample, and the rest, which begins at zero
        return self._held.output(np.full(u.size, self._first)) + self._joined.output(u - self._first)

    def free(self, samples: int) -> FloatArray:
        """Return the responses (K, n) to one unit of each state alone, over the next ``samples``."""
        row = self._held.row if self._free is None else self._free
        died_out = self._free is not None and not np.abs(row).max(initial=0.0) > NOTHING
        if row.size == 0 or samples == 0 or died_out:
            return np.zeros((samples, row.size))
        from replant.kernels.filters.simulate import free_responses

        responses = np.asarray(free_responses(self._held.transition, row, samples + 1))
        self._free = responses[-1].copy()
        return responses[:-1]


class _FromRest:
    """The output for an input that is zero before its first sample and, where it is joined by lines, at it."""

    def __init__(self, model: Rational, dt: float, input_hold: str, companion: state_space.Companion | None) -> None:
        self._feedthrough, self._dt, self._hold = model.feedthrough, dt, input_hold
        self._companion = companion
        lag, self._fraction = split_delay(model.delay, dt)
        self._past = np.zeros(lag + 2)  # the inputs that the dead time still holds back
        self._begun = False
        self.row = np.zeros(0) if companion is None else model.output_row(companion)
        self._state = np.zeros(self.row.size)

    @cached_property
    def transition(self) -> FloatArray:
        """Ad (n, n) over one interval."""
        assert self._companion is not None
        return state_space.exact(self._companion.matrix, self._companion.column, self._dt, self._hold)[0]

    @cached_property
    def _taps(self) -> FloatArray:
        assert self._companion is not None
        matrix, column = self._companion.matrix, self._companion.column
        return state_space.input_taps(matrix, column, self._dt, self._hold, self._fraction)

    def output(self, u: FloatArray) -> FloatArray:
        """Return the output (K,) for the next inputs (K,)."""
        known = np.concatenate([self._past, u])
        self._past = known[u.size :].copy()
        inputs, output = known[: u.size + 2], np.zeros(u.size)
        if self._companion is not None:
            from replant.kernels.filters.simulate import continued_states

            first = -1 if self._begun else 0
            states = continued_states(self.transition, self._taps, inputs, self._state, first)
            output = states @ self.row
            self._begun = self._begun or u.size > 0
        if self._feedthrough:
            now, before = inputs[2:], inputs[1:-1]
            if self._fraction:
                now = before if self._hold == "zoh" else (1 - self._fraction) * now + self._fraction * before
            output = output + self._feedthrough * now
        return np.asarray(output)
