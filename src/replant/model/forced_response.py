"""Forced response: the output of a transfer function under an input on any clock, whole or batch by batch.

Exact for the hold over every interval, and for a dead time of any length: the output at the samples is that of the
differential equation.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from replant.model import state_space
from replant.model.dead_time import WHOLE, split_delay
from replant.numerics.arguments import FloatArray


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


class Stretch(NamedTuple):
    """The response over K samples that follow each other.

    Attributes
    ----------
    output : (K,) array
        By the inputs alone.
    free : (L, n) array
        Responses to a unit of each state at the beginning; from row L on they have died out.
    unknown : int
        How many outputs, the first ones, answer to inputs from before the record, because of a dead time; in them
        ``output`` and ``free`` stand still.
    """

    output: FloatArray
    free: FloatArray
    unknown: int


class Response:
    """The response of a model to a record, continued from batch to batch.

    A batch ends where the next one begins: joined, the responses of the batches are that of the whole to the bit.

    >>> from replant.model.transfer_function import TransferFunction
    >>> response = Response(TransferFunction([1.0], [1.0, 1.0]), dt=1.0)
    >>> response.take(np.ones(2)).output.round(4), response.take(np.ones(1)).output.round(4)
    (array([0.    , 0.6321]), array([0.8647]))
    >>> found = Response(TransferFunction([1.0], [1.0, 1.0], delay=2.0), dt=1.0, at_rest=False).take(np.ones(4))
    >>> found.output.round(4), found.free.round(4).ravel(), found.unknown
    (array([0.    , 0.    , 0.    , 0.6321]), array([1.    , 1.    , 1.    , 0.3679]), 2)
    """

    def __init__(self, model: Rational, dt: float, input_hold: str = "zoh", *, at_rest: bool = True) -> None:
        from replant.kernels.filters import bank, simulate

        self._order = n = model.den.size - 1
        self._bank, self._work = np.zeros(bank.size(n, 0)), np.zeros(3 * (n + 2) ** 2)
        self._row, self._states = np.zeros(n), np.zeros(2 * n)
        if n:
            companion = state_space.companion(model.den)
            self._bank[bank.SCALE] = companion.column[0]
            self._bank[bank.DENOMINATOR + n : bank.DENOMINATOR + 2 * n] = companion.characteristic
            self._row = self._states[n:] = model.output_row(companion)
        self._feedthrough, self._dt, self._straight, self._at_rest = model.feedthrough, dt, input_hold == "foh", at_rest
        self._delay, self._progress = model.delay, np.zeros(simulate.PROGRESS)
        self._samples = self._lengths = np.zeros(0)  # two before the piece of the input that acts next, and all since

    def take(self, u: FloatArray, intervals: FloatArray | None = None) -> Stretch:
        """Return the response to the next inputs (K,)."""
        from replant.kernels.filters import simulate

        output, free = np.zeros(u.size), np.zeros((0 if self._at_rest else u.size, self._order))
        if u.size == 0:
            return Stretch(output, free, 0)
        if self._samples.size == 0:
            self._begin(u[0], regular=intervals is None)
        samples, lengths = np.concatenate([self._samples, u]), np.array([self._dt])
        if intervals is not None:
            lengths = np.concatenate([self._lengths, intervals])
            if not self._progress[simulate.BEGUN]:
                lengths[self._samples.size] = self._dt
        front, unknown, alive = simulate.simulate(
            self._bank, self._states, self._work, self._row, self._feedthrough, self._progress, samples, lengths,
            self._dt, self._straight, output, free,
        )  # fmt: skip
        self._samples, self._lengths = samples[front - 2 :].copy(), lengths[front - 2 :].copy()
        return Stretch(output, free[:alive], unknown)

    def _begin(self, first: float, *, regular: bool) -> None:
        """Get ready for the first sample: its input, and two that stand for those before it."""
        from replant.kernels.filters import simulate

        self._samples, self._lengths = np.full(2, first), np.full(2, self._dt)
        samples, fraction = split_delay(self._delay, self._dt)
        if regular:
            self._progress[simulate.LAG], self._progress[simulate.WAIT] = samples, fraction * self._dt
        elif self._delay > WHOLE * self._dt:
            self._progress[simulate.WAIT] = self._delay
