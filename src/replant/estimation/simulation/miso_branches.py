"""The branches of a row, one per input: output, slopes and free responses of each, sample by sample."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from replant.estimation.engine.record import Record
from replant.estimation.simulation.auxiliary_model import AuxiliaryModel
from replant.kernels.filters.bank import KEPT, NEXT
from replant.kernels.schema import STATE_ARRAYS
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray


class Branches:
    """Runs B_i/A_i over the inputs of a record, from rest, and on from where that ended."""

    def __init__(self, structures: tuple[Structure, ...], dt: float, input_hold: str = "zoh") -> None:
        self.structures = structures
        self.models = [AuxiliaryModel(each, dt, input_hold) for each in structures]

    def copy(self) -> Branches:
        """Return branches in the same state, which go on by themselves."""
        twin = copy.copy(self)
        twin.models = [each.copy() for each in self.models]
        return twin

    @property
    def arrays(self) -> list[dict[str, npt.NDArray[Any]]]:
        """The state of each, by name."""
        return [dict(zip(STATE_ARRAYS, each.arrays, strict=True)) for each in self.models]

    @property
    def are_sound(self) -> bool:
        """Whether what serves as an index is within the arrays of a state that was read."""
        kept = np.concatenate([each["banks"][:, NEXT] for each in self.arrays])
        return bool(((kept >= 0) & (kept < KEPT) & (kept == np.rint(kept))).all())

    def run(
        self, coefficients: Sequence[FloatArray], states: FloatArray, records: Sequence[Record], *, on: bool = False
    ) -> tuple[list[FloatArray], list[FloatArray], list[FloatArray]]:
        """Return of each branch the output (K,) with that of its initial state, the slopes and the responses."""
        outputs, slopes, free = [], [], []
        for model, structure, theta, record in self._each(coefficients, states, records):
            rows, output = model.branch_on(record) if on else model.branch(theta, record)
            outputs.append(output)
            slopes.append(rows[:, : structure.coefficients])
            free.append(rows[:, -structure.poles :])
        return outputs, slopes, free

    def begin(self, coefficients: Sequence[FloatArray], states: FloatArray) -> None:
        """Come to rest, so that a run goes on as one from rest."""
        for model, _, theta, _ in self._each(coefficients, states, self.structures):
            model.begin(theta)

    def _each(
        self, coefficients: Sequence[FloatArray], states: FloatArray, given: Sequence[Any]
    ) -> Iterator[tuple[Any, ...]]:
        """Yield of each branch model, structure, entries of the model, and what is given for it."""
        ends = np.cumsum([each.poles for each in self.structures])[:-1].tolist()
        parts = zip(coefficients, np.split(states, ends), strict=True)
        entries = [np.concatenate([theta, [0.0], state]) for theta, state in parts]
        return zip(self.models, self.structures, entries, given, strict=True)
