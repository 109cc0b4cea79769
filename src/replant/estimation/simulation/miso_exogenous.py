"""What moves the inputs of a row from outside: references, and the inputs that nobody controls.

An input that a controller makes answers to the noise.  What the signals from outside explain of it, by Laguerre
functions of each, does not: instruments are made of that.  An error of the projection costs variance, and no bias as
long as it knows nothing of the noise that is there with it: a part of a record is projected by the weights of the rest.

Source: Van den Hof and Schrama (1993), "An indirect method for transfer function estimation from closed loop data",
Automatica 29.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from replant.kernels.schema import LAGUERRE
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.linear_algebra import combined
from replant.numerics.projections import best_pole, weights_of

# two of them are left out for each set of weights, so that their variance is a third larger
PARTS = 8  # parts of a record between whose ends the weights of the rest pass over into each other [count]


def windows(samples: int) -> FloatArray:
    """Return smooth weights (PARTS + 1, K) of the ends of parts, whose sum is one: edges would be jumps of an input."""
    ends, length = np.linspace(0.0, samples - 1.0, PARTS + 1), max(samples - 1.0, 1.0) / PARTS
    away = np.abs(np.arange(samples) - ends[:, None]) / length
    return np.where(away < 1.0, 0.5 + 0.5 * np.cos(np.pi * np.minimum(away, 1.0)), 0.0)


@dataclass(frozen=True, eq=False)
class Law:
    """How inputs follow signals from outside, by Laguerre functions of one pole for each signal."""

    poles: FloatArray  # (S,)
    origins: FloatArray  # (S,): what the functions count from
    states: FloatArray  # (S, L): of the functions, after the newest sample
    weights: FloatArray  # (M, S L + 1): of the functions and of a one, for each input

    @classmethod
    def of(cls, signals: FloatArray, inputs: FloatArray) -> Law:
        """Return the law by which inputs (K, M) follow signals (K, S), at rest before the first sample."""
        columns = [np.ascontiguousarray(each) for each in inputs.T]
        poles = np.array([best_pole(np.ascontiguousarray(each), *columns) for each in signals.T])
        rest = np.zeros((poles.size, LAGUERRE))
        law = cls(poles, signals.mean(axis=0), rest, np.zeros((0, poles.size * LAGUERRE + 1)))
        functions = np.column_stack([law.functions(signals)[0], np.ones(len(signals))])
        return replace(law, weights=np.array([weights_of(functions, each) for each in columns]))

    def functions(self, signals: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the functions (K, S L) of further signals (K, S), and their states after them."""
        from replant.kernels.filters.reference import functions

        written, states = np.empty((len(signals), self.poles.size * LAGUERRE)), self.states.copy()
        functions(np.ascontiguousarray(signals - self.origins), self.poles, states, written)
        return written, states

    def follow(self, signals: FloatArray) -> tuple[Law, FloatArray]:
        """Return the law after further signals (K, S), and what they explain of the inputs (K, M)."""
        functions, states = self.functions(signals)
        explained = np.tile(self.weights[:, -1], (len(signals), 1))
        for j in range(functions.shape[1]):  # one by one: the bits do not depend on K
            explained += functions[:, j : j + 1] * self.weights[:, j]
        return replace(self, states=states), explained


@dataclass(frozen=True, eq=False)
class Outside:
    """What signals from outside explain of the inputs of a record."""

    inputs: FloatArray  # (K, q): of each input what they explain; one that nobody controls is such a signal itself
    signals: FloatArray  # (K, S): the references, then those inputs
    is_moved: BoolArray  # (q,): which inputs the references move
    law: Law  # after the record

    @classmethod
    def of(cls, inputs: FloatArray, references: FloatArray, is_moved: BoolArray) -> Outside:
        """Return what references (K, p) explain of the inputs (K, q) that they move, beside those that they do not."""
        signals = np.column_stack([references, inputs[:, ~is_moved]])
        moved = inputs[:, is_moved]
        law = Law.of(signals, moved)
        functions, states = law.functions(signals)
        functions = np.column_stack([functions, np.ones(len(signals))])
        explained = np.zeros_like(moved)
        for window in windows(len(moved)):
            rest = window == 0.0
            for i, each in enumerate(moved.T):
                explained[:, i] += window * combined(functions, weights_of(functions[rest], each[rest]))
        return cls(with_moved(inputs, is_moved, explained), signals, is_moved, replace(law, states=states))

    def functions(self, rows: slice) -> FloatArray:
        """Return the Laguerre functions of the signals over some rows (K, S L), at rest before the first."""
        law = replace(self.law, states=np.zeros_like(self.law.states))
        return law.functions(self.signals[rows])[0]

    def of_inputs(self, chosen: list[int]) -> Outside:
        """Return what is explained of some of the inputs."""
        return replace(self, inputs=self.inputs[:, chosen], is_moved=self.is_moved[chosen])

    def last(self, samples: int) -> Outside:
        """Return the same of the newest samples."""
        return replace(self, inputs=self.inputs[-samples:], signals=self.signals[-samples:])


def with_moved(inputs: FloatArray, is_moved: BoolArray, explained: FloatArray) -> FloatArray:
    """Return inputs (K, q) with what is explained (K, M) in place of those that references move."""
    result = inputs.copy()
    result[:, is_moved] = explained
    return result
