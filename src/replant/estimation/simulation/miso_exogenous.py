"""External signals of a row: references, and the inputs that no controller makes.

An input that a controller makes responds to the noise.  The part of it that the external signals explain, by Laguerre
functions of each, does not: it gives the instruments.  An error of the projection costs variance, but no bias if it is
independent of the noise at the same time: each part of a record is projected with the weights of the other parts.

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
PARTS = 8  # parts of a record, between whose ends the sets of weights are blended [count]


def windows(samples: int) -> FloatArray:
    """Return smooth windows (PARTS + 1, K) about the ends of the parts, with sum one, as edges would be input jumps."""
    ends, length = np.linspace(0.0, samples - 1.0, PARTS + 1), max(samples - 1.0, 1.0) / PARTS
    away = np.abs(np.arange(samples) - ends[:, None]) / length
    return np.where(away < 1.0, 0.5 + 0.5 * np.cos(np.pi * np.minimum(away, 1.0)), 0.0)


@dataclass(frozen=True, eq=False)
class Law:
    """How inputs follow external signals, by Laguerre functions of one pole for each signal."""

    poles: FloatArray  # (S,)
    origins: FloatArray  # (S,): means, which are subtracted from the signals
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
        """Return the law after further signals (K, S), and the inputs (K, M) by the law."""
        functions, states = self.functions(signals)
        explained = np.tile(self.weights[:, -1], (len(signals), 1))
        for j in range(functions.shape[1]):  # one by one: the bits do not depend on K
            explained += functions[:, j : j + 1] * self.weights[:, j]
        return replace(self, states=states), explained


@dataclass(frozen=True, eq=False)
class Outside:
    """The parts of the inputs of a record that external signals explain."""

    inputs: FloatArray  # (K, q): the explained part of each input; an input that no controller makes itself
    signals: FloatArray  # (K, S): the references, then those inputs
    is_moved: BoolArray  # (q,): which inputs the references move
    law: Law  # after the record

    @classmethod
    def of(cls, inputs: FloatArray, references: FloatArray, is_moved: BoolArray) -> Outside:
        """Return the parts of the moved inputs (K, q) that references (K, p) and the other inputs explain."""
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
        """Return the parts of some of the inputs."""
        return replace(self, inputs=self.inputs[:, chosen], is_moved=self.is_moved[chosen])

    def last(self, samples: int) -> Outside:
        """Return the same for the newest samples."""
        return replace(self, inputs=self.inputs[-samples:], signals=self.signals[-samples:])


def with_moved(inputs: FloatArray, is_moved: BoolArray, explained: FloatArray) -> FloatArray:
    """Return inputs (K, q) with the explained parts (K, M) in place of those that references move."""
    result = inputs.copy()
    result[:, is_moved] = explained
    return result
