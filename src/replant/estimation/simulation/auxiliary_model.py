r"""The run of a model over a record on any clock, with regressors and instruments filtered by its own denominator.

For a model B/A the compiled chain gives, sample by sample, the regressor :math:`\varphi` of :math:`s^n/D\, y =
\varphi^T \theta`, the instruments :math:`\zeta` (the same regressor built from the model's own output, or from the
parts of input and output that a reference explains) and the predicted output.  D is A, or A with its unstable poles
reflected.  If D = A, the predicted output is B/A u, exact for the hold over every interval, so that the clock may be
irregular.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.engine.state import State
from replant.estimation.filters import RefinedFilter
from replant.kernels.schema import STATE_ARRAYS
from replant.model.structure import Structure
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.linear_algebra import combined, poles_of, sum_of_squares
from replant.numerics.projections import amounts_of, without

SLOWEST = 0.01  # least distance of a filter's pole from the axis: within 1 % of an integrator [1 / duration]

SLOWEST_BY_REFERENCE = 5.0
"""Least distance of a filter's pole from the axis, of a record with a reference [1 / duration of the record].
Origin: the part of the input that the reference explains has an error by the noise; a filter near an integrator
accumulates it, until it dominates the instruments. In 8 records of a double integrator with a controller the 95 %
interval of b0 contained the truth in 1 at 0.01, in 2 at 1, in all at 5 and 20; at 20 that of a0 is four times as wide.
Sensitivity: halved or doubled, nothing changes on these records.
"""

PREDICTED = 2  # times that missing outputs are predicted: from the record's guesses, then from predictions [count]
NOTHING = np.zeros((0, 2))  # the explained parts without a reference


def stability_margin(record: Record) -> float:
    """Return the least distance in rad/s of the poles of a record's filters from the imaginary axis."""
    return (SLOWEST if record.r is None else SLOWEST_BY_REFERENCE) / record.span


@dataclass(frozen=True, eq=False)
class Pass:
    """One pass of a model over a record of K samples; T entries, in the order of `AuxiliaryModel.run`."""

    phi: FloatArray  # (K, T): regressors
    zeta: FloatArray  # (K, T): instruments
    target: FloatArray  # (K,): s^n/A y
    output: FloatArray  # (K,): predicted, offset and initial state included: B/A u, or one step ahead if not stable
    error: FloatArray  # (K,): the residual e = A/D y - B/D u, offset and initial state included
    # (K,): measured minus predicted output: e if D = A.  Else e over the weight of the newest output in it, which is
    # small with a fast reflected pole: e is then small for any model, and this is not
    ahead: FloatArray

    def since(self, sample: int) -> Pass:
        """Return the pass from a sample on."""
        return self if sample == 0 else Pass(*(signal[sample:] for signal in self.signals))

    def of(self, measured: BoolArray) -> Pass:
        """Return the pass with zero rows where no output was measured."""
        phi, zeta, target, output, error, ahead = self.signals
        rows = measured[:, None]
        seen = phi * rows
        return Pass(
            seen, seen if zeta is phi else zeta * rows, target * measured, output, error * measured, ahead * measured
        )

    def without(self, columns: FloatArray) -> Pass:
        """Return the pass with columns (K, P) projected out of its signals; unchanged if any is not finite."""
        signals = np.column_stack([self.phi, self.zeta, self.target, self.error, self.ahead])
        if not (np.isfinite(signals).all() and np.isfinite(columns).all()):
            return self
        left, count = without(signals, columns), self.phi.shape[1]
        target, error, ahead = left[:, 2 * count :].T.copy()
        return Pass(left[:, :count], left[:, count : 2 * count], target, self.output + self.ahead - ahead, error, ahead)

    @property
    def signals(self) -> tuple[FloatArray, ...]:
        """All signals, in the order of the fields."""
        return self.phi, self.zeta, self.target, self.output, self.error, self.ahead

    @property
    def power(self) -> float:
        """Sum of squares of measured minus predicted output."""
        return self.ahead.size * self.cost

    @cached_property
    def cost(self) -> float:
        """Mean square of measured minus predicted output; infinite if that is not finite."""
        with np.errstate(over="ignore", invalid="ignore"):
            cost = sum_of_squares(self.ahead) / self.ahead.size
        return cost if math.isfinite(cost) else math.inf


@lru_cache(maxsize=16)  # a solution builds the same state ten times, and each takes as long as three passes
def _state_of(structure: Structure, dt: float, input_hold: str, *, reference: bool) -> State:
    return State.build(structure, dt, RefinedFilter(input_hold), reference=reference)


@lru_cache(maxsize=16)  # each stretch of a point asks three times
def _slowest(denominators: tuple[bytes, ...]) -> int:
    return int(np.argmax([float(poles_of(each).real.max()) for each in denominators]))


class AuxiliaryModel:
    """Runs models of one structure over records."""

    def __init__(
        self, structure: Structure, dt: float, input_hold: str = "zoh", *, margin: float = 0.0, reference: bool = False
    ) -> None:
        self._state = _state_of(structure, dt, input_hold, reference=reference).copy()
        self._state.stability_margin = margin
        self._delay, self._order, self._bias = structure.delay, structure.poles, structure.bias

    @property
    def entries(self) -> int:
        """The number of entries of a model, T."""
        return self._state.entries

    @property
    def arrays(self) -> tuple[np.ndarray[Any, Any], ...]:
        """The arrays of its state."""
        return self._state.arrays

    def copy(self) -> AuxiliaryModel:
        """Return an independent copy in the same state."""
        twin = copy.copy(self)
        twin._state = self._state.copy()
        return twin

    def run(
        self, theta: FloatArray, record: Record, by_reference: FloatArray | None = None, *, alone: bool = False
    ) -> Pass:
        """Run a model over a record from rest, each part anew; rows that depend on earlier inputs are zero.

        With ``alone``, a stable model without a reference runs from the input alone, in half the time: phi is zeta.
        """
        parts = record.parts
        if len(parts) > 1:
            explained = [None if by_reference is None else by_reference[rows] for rows in parts]
            runs = [
                self.run(theta, record.part(rows), of_it, alone=alone)
                for rows, of_it in zip(parts, explained, strict=True)
            ]
            # its own offset also takes the column of the constant, unless that is a parameter
            most = self._order + (not self._bias)
            return _of_parts(runs, [most if rows.start in record.begins else self._order for rows in parts], most)
        self.begin(theta)
        from_input = by_reference is None and not self._state.serves_reflected
        if alone and from_input:
            done = self._run_alone(theta, record)
            return done if record.measured is None else done.of(record.measured)
        if by_reference is None:
            by_reference = NOTHING
        if record.measured is not None and not record.measured.all():
            return self._run_filled(theta, record, by_reference, from_input=from_input)
        return self._run(theta, record, by_reference)

    def _run_alone(self, theta: FloatArray, record: Record) -> Pass:
        slopes, output = self.branch(theta, record, constant=True)
        away = record.y - output
        away[: record.unknown(self._delay)] = 0.0
        return Pass(slopes, slopes, away, output, away, away)

    def _run_filled(self, theta: FloatArray, record: Record, by_reference: FloatArray, *, from_input: bool) -> Pass:
        """Run a model over a record with its own output in place of missing ones, whose rows are zero."""
        assert record.measured is not None
        known, filled = record.measured, record.y
        done = self._run_alone(theta, record) if from_input else self._run(theta, record, by_reference)
        for _ in range(PREDICTED if self._state.serves_reflected else 1):
            # offset and initial state are fitted to the measured outputs: theta may not have them yet
            nuisances, away = done.phi[:, -self._order - 1 :], record.y - done.output
            weights = amounts_of(nuisances[known], away[known])
            filled = np.where(known, record.y, done.output + combined(nuisances, weights))
            done = self._run(theta, replace(record, y=filled), by_reference)
        return done.of(known)

    def _run(self, theta: FloatArray, record: Record, by_reference: FloatArray) -> Pass:
        self.begin(theta)
        done = self.go_on(theta, record, by_reference)
        unknown = record.unknown(self._delay)
        if unknown:
            done.output[:unknown] = done.output[min(unknown, record.u.size - 1)]
            for signal in (done.phi, done.zeta, done.target, done.ahead, done.error):
                signal[:unknown] = 0.0
        return done

    def begin(self, theta: FloatArray) -> None:
        """Put a model at rest."""
        from replant.kernels.filters.chain import install_model

        install_model(*self._state.arrays, 1, theta)  # its unit is 1, and bank 1 serves from the beginning
        self._state.started = False

    def go_on(self, theta: FloatArray, record: Record, by_reference: FloatArray = NOTHING) -> Pass:
        """Run a model over further samples, from the end of its last run."""
        from replant.kernels.step.stages import regressors

        state, size, samples = self._state, self.entries, record.u.size
        phi, zeta = np.empty((samples, size)), np.empty((samples, size))
        target, output = np.empty(samples), np.empty(samples)
        regressors(
            *state.arrays, record.u, record.y, record.intervals, by_reference,
            phi, zeta, target, output,
        )  # fmt: skip
        ahead = record.y - output
        error = target - combined(phi, theta) if state.serves_reflected else ahead
        return Pass(phi, zeta, target, output, error, ahead)

    def branch(
        self, theta: FloatArray | None, record: Record, *, constant: bool = False, rows: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return instruments (K, T), output (K,) of a record without a gap, from rest; 0 where earlier inputs act.

        Without a model it continues from the end of the last run.  The instruments are written to ``rows`` (K, T or
        more), if given; the column of the constant is zero unless ``constant``.
        """
        from replant.kernels.step.miso import branch

        if theta is not None:
            self.begin(theta)
        output = np.empty(record.u.size)
        rows = np.empty((record.u.size, self.entries)) if rows is None else rows
        branch(*self._state.arrays, record.u, record.intervals, constant, rows, output)
        unknown = record.unknown(self._delay) if theta is not None else 0
        if unknown:
            output[:unknown] = output[min(unknown, record.u.size - 1)]
            rows[:unknown] = 0.0
        return rows, output


def records_of(inputs: FloatArray, intervals: FloatArray, input_hold: str = "zoh") -> tuple[Record, ...]:
    """Return a record for each of several inputs (K, q), with outputs of zero."""
    none = np.zeros(len(inputs))
    return tuple(Record(np.ascontiguousarray(each), none, intervals, input_hold) for each in inputs.T)


class Branches:
    """Runs B_i/A_i over the inputs of a record, from rest, or from the end of the last run.

    Weights (N,) are those of the nuisances: a constant at the input of the branch with the slowest pole, then the
    initial states of each branch.  Behind a pole at 0 a constant makes a ramp, behind others an offset of the output.
    """

    def __init__(self, structures: tuple[Structure, ...], dt: float, input_hold: str = "zoh") -> None:
        self.structures = structures
        self.models = [AuxiliaryModel(each, dt, input_hold) for each in structures]
        ends = np.cumsum([0, *(each.poles for each in structures)]).tolist()
        self._states = [slice(begin, end) for begin, end in pairwise(ends)]

    def slowest(self, coefficients: Sequence[FloatArray]) -> int:
        """Return the number of the branch with the slowest pole."""
        pairs = zip(self.structures, coefficients, strict=True)
        return _slowest(tuple(each[structure.denominator].tobytes() for structure, each in pairs))

    def copy(self) -> Branches:
        """Return an independent copy in the same state."""
        twin = copy.copy(self)
        twin.models = [each.copy() for each in self.models]
        return twin

    @property
    def arrays(self) -> list[dict[str, np.ndarray[Any, Any]]]:
        """The state of each, by name."""
        return [dict(zip(STATE_ARRAYS, each.arrays, strict=True)) for each in self.models]

    @property
    def are_sound(self) -> bool:
        """Whether the indices in a state that was read lie within its arrays."""
        from replant.kernels.filters.bank import KEPT, NEXT

        kept = np.concatenate([each["banks"][:, NEXT] for each in self.arrays])
        return bool(((kept >= 0) & (kept < KEPT) & (kept == np.rint(kept))).all())

    def run(
        self, coefficients: Sequence[FloatArray], weights: FloatArray, records: Sequence[Record], *, on: bool = False
    ) -> tuple[list[FloatArray], list[FloatArray], FloatArray]:
        """Return output (K,) and slopes of each branch, with the part of its nuisances, and the nuisances (K, N)."""
        outputs, slopes, free, slowest = [], [], [np.empty(0)], self.slowest(coefficients)
        entries = self._entries(coefficients, weights)
        for i, (model, theta, record) in enumerate(zip(self.models, entries, records, strict=True)):
            structure, constant = self.structures[i], i == slowest
            rows, output = model.branch(None if on else theta, record, constant=constant)
            outputs.append(output)
            slopes.append(rows[:, : structure.coefficients])
            free.append(rows[:, -structure.poles :])
            if constant:
                free[0] = rows[:, structure.coefficients]
        return outputs, slopes, np.column_stack(free)

    def parts(self, coefficients: Sequence[FloatArray], weights: FloatArray, nuisances: FloatArray) -> list[FloatArray]:
        """Return the part (K,) of the nuisances (K, N) in the output of each branch."""
        made = [combined(nuisances[:, 1:][:, rows], weights[1:][rows]) for rows in self._states]
        made[self.slowest(coefficients)] += weights[0] * nuisances[:, 0]
        return made

    def begin(self, coefficients: Sequence[FloatArray], weights: FloatArray) -> None:
        """Put the branches at rest, so that a run with ``on`` begins at rest."""
        for model, theta in zip(self.models, self._entries(coefficients, weights), strict=True):
            model.begin(theta)

    def _entries(self, coefficients: Sequence[FloatArray], weights: FloatArray) -> list[FloatArray]:
        """Return the entries of each model: coefficients, constant, initial states."""
        slowest = self.slowest(coefficients)
        parts = enumerate(zip(coefficients, self._states, strict=True))
        return [np.concatenate([theta, weights[:1] * (i == slowest), weights[1:][rows]]) for i, (theta, rows) in parts]


def _of_parts(runs: list[Pass], nuisances: list[int], most: int) -> Pass:
    """Return the passes over the parts of a record as one.

    After a gap the initial state is unknown again, in another record also the offset.  Those of the first part that
    determines them are entries of the model.  Those of the other parts, the last ``nuisances`` columns of each ``phi``,
    are projected out of all signals, which is equivalent to estimating them together with the entries.
    """
    own = next((i for i, run in enumerate(runs) if int(run.phi[:, -most:].any(axis=1).sum()) > most), 0)
    # a part before that one may be of another record: its offset is unknown as well as its initial state
    counts = [most if i < own else count for i, count in enumerate(nuisances)]
    joined = [run if i == own else _without_last(run, counts[i]) for i, run in enumerate(runs)]
    return Pass(*(np.concatenate(signals) for signals in zip(*(run.signals for run in joined), strict=True)))


def _without_last(run: Pass, count: int) -> Pass:
    """Return a pass with the last ``count`` columns of its regressors projected out, and then zero."""
    columns, states = run.phi.shape[1] - count, run.phi[:, -count:]
    left = replace(run, phi=run.phi[:, :columns], zeta=run.zeta[:, :columns]).without(states)
    none = np.zeros_like(states)
    return replace(left, phi=np.hstack([left.phi, none]), zeta=np.hstack([left.zeta, none]))
