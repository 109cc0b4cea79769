"""solve: the estimate of a record and the samples it is made from, the same ones whoever asks.

`fit`, the start-up, the record solved again, the end of a run and the search all solve records here.  Outputs that are
missing, outliers, and those of a sensor that is stuck are left out, their inputs are not: in the filters the model's
own output takes their place.  Which outputs are bad is told with a model, so that both are found in turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from replant.arguments import BoolArray, FloatArray, IntArray
from replant.engine.record import Record
from replant.kernels.schema import Doubt
from replant.model.structure import Structure
from replant.offline.bad_samples import doubts, filled, suspicious
from replant.offline.refined import Refined
from replant.offline.srivc import first_model, refine
from replant.offline.srivc_steps import Problem

ROUNDS = 5
"""Times that a record is solved and its outputs judged, at the most [count].
Origin: records with stuck sensors and outliers need two or three.
Sensitivity: not measured.
"""


@dataclass(frozen=True, eq=False)
class Solution:
    """A model and the samples that it was made from.

    Attributes
    ----------
    found : Refined
    record : Record
        Its outputs that were not measured are the model's.
    doubt : (K,) array of int
        The `Doubt` in each output.
    bridged : (K,) array
        The record's outputs, with another working point perhaps.
    """

    found: Refined
    record: Record
    doubt: IntArray
    bridged: FloatArray

    @property
    def is_bad(self) -> BoolArray:
        """Which outputs (K,) were left out."""
        return np.asarray(self.doubt != Doubt.NONE)


def at_first(record: Record) -> Record:
    """Return a record without the outputs that may be bad by themselves."""
    return leaving_out(record, suspicious(record.u, np.where(record.is_measured, record.y, np.nan)))


def solve(
    structure: Structure, record: Record, given: Sequence[FloatArray] = (), *, afresh: bool = False
) -> Solution | None:
    """Solve a record; None where no start leads to a model.

    Parameters
    ----------
    structure : Structure
    record : Record
        As it was measured.
    given : sequence of (T,) arrays
        Estimates to start from; without any, the usual starts.
    afresh : bool
        Start from the usual ones as well.
    """
    y = np.where(record.is_measured, record.y, np.nan)
    doubt = suspicious(record.u, y)
    found, solution = None, None
    for _ in range(ROUNDS):
        used = leaving_out(record, doubt)
        if found is None:
            found = _solved(structure, used, given, afresh=afresh)
        else:
            found = refine(structure, used, [found.theta])
        if found is None:
            break
        modelled = _output(structure, used, found)
        bridged = np.where(used.is_measured, used.y, modelled)
        solution = Solution(found, replace(used, y=bridged), doubt, bridged)
        before, doubt = doubt, doubts(record.u, y, modelled, found.noise_model.coefficients)
        if (doubt == before).all():
            return solution
    missing = np.where(record.is_measured, Doubt.NONE, Doubt.MISSING)
    if solution is None and (suspicious(record.u, y) != missing).any():  # as they came
        used = leaving_out(record, missing)
        found = _solved(structure, used, given, afresh=afresh)
        if found is not None:
            solution = Solution(found, used, missing, used.y)
    return solution


def _solved(structure: Structure, record: Record, given: Sequence[FloatArray], *, afresh: bool) -> Refined | None:
    return refine(structure, record, given, afresh=afresh) if given else first_model(structure, record)


def leaving_out(record: Record, doubt: IntArray) -> Record:
    """Return a record without the outputs that are in doubt."""
    measured = np.asarray(doubt == Doubt.NONE)
    if measured.all():
        return replace(record, measured=None)
    return replace(record, y=filled(record.y, measured), measured=measured)


def _output(structure: Structure, record: Record, found: Refined) -> FloatArray:
    """Return a model's output over a record (K,)."""
    return Problem(structure, record).run_whole(found.theta).output
