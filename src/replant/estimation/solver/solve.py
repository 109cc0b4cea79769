"""solve: the estimate of a record and the samples it is made from, the same ones whoever asks.

`fit`, the start-up, the record solved again, the end of a run and the search all solve records here.  Outputs that are
missing, outliers, and those of a sensor that is stuck are left out, their inputs are not: in the filters the model's
own output takes their place.  Which outputs are bad is told with a model, so that both are found in turn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.solver.bad_samples import doubts, filled, suspicious
from replant.estimation.solver.refined_estimate import Refined
from replant.estimation.solver.srivc import refine
from replant.estimation.solver.srivc_steps import Problem
from replant.estimation.solver.undetermined_poles import with_untold
from replant.kernels.schema import Doubt
from replant.model.structure import Structure
from replant.numerics.arguments import BoolArray, FloatArray, IntArray
from replant.numerics.levels import ALPHA, ROUNDING

# a reading before the sensor is ready, and one more
FIRST = 2  # first outputs that may be bad together [count]
ROUNDS = 5  # times that a record is solved and its outputs judged, at the most [count]


@dataclass(frozen=True, eq=False)
class Solution:
    """A model and the samples that it was made from."""

    found: Refined
    record: Record  # its outputs that were not measured are the model's
    doubt: IntArray  # (K,), the `Doubt` in each output
    bridged: FloatArray  # (K,), the record's outputs, with another working point perhaps

    @property
    def is_bad(self) -> BoolArray:
        """Which outputs (K,) were left out."""
        return np.asarray(self.doubt != Doubt.NONE)


def at_first(record: Record) -> Record:
    """Return a record without the outputs that may be bad by themselves."""
    return leaving_out(record, suspected(record))


def solve(
    structure: Structure, record: Record, given: Sequence[FloatArray] = (), *, afresh: bool = False,
    nested: bool = False,
) -> Solution | None:  # fmt: skip
    """Solve a record, see `refine`; None where no start leads to a model."""
    solution = _solved(structure, record, given, afresh=afresh, nested=nested)
    first = first_jump(record)
    if solution is None or not first or record.r is not None:
        return solution
    # a fast pole with an initial state explains any first output: whether it is bad is told by all others
    measured = record.is_measured & (np.arange(record.u.size) >= first)
    left = replace(record, y=filled(record.y, measured), measured=measured)
    without = _solved(structure, left, given, afresh=afresh, nested=nested)
    usual, less = solution.found.innovation, 0.0 if without is None else without.found.innovation
    if without is None or not less > 0.0 or usual <= ROUNDING * float(np.mean(solution.record.y**2)):
        return solution
    likelier = 0.5 * record.count * math.log(usual / less)
    if likelier <= first * (math.log(record.count) - math.log(ALPHA)):
        return solution
    is_first = ~measured & record.is_measured
    return replace(without, doubt=np.where(is_first, Doubt.OUTLIER, without.doubt))


def first_jump(record: Record) -> int:
    """Return how many first outputs lie before the largest jump of a record; 0 where it is not near the beginning."""
    y = np.where(record.is_measured, record.y, np.nan)
    y[suspected(record) != Doubt.NONE] = np.nan
    known = np.flatnonzero(np.isfinite(y))
    if known.size < 2 * FIRST + 2:
        return 0
    jumps = np.abs(np.diff(y[known]))
    largest = int(jumps.argmax())
    is_alone = largest < FIRST and known[largest] <= FIRST and jumps[largest] > 2.0 * jumps[largest + 1 :].max()
    return int(known[largest]) + 1 if is_alone else 0


def _solved(
    structure: Structure, record: Record, given: Sequence[FloatArray], *, afresh: bool, nested: bool
) -> Solution | None:
    """Solve a record, its outputs being judged by the model."""
    answers, doubt = record.answers(structure.delay), suspected(record)
    found = _first(structure, leaving_out(record, doubt), given, afresh=afresh, nested=nested)
    if found is None and (doubt > Doubt.MISSING).any():  # as they came
        doubt = np.where(record.is_measured, Doubt.NONE, Doubt.MISSING)
        found = _first(structure, leaving_out(record, doubt), given, afresh=afresh, nested=nested)
    solution = None
    for _ in range(ROUNDS):
        if found is None:
            break
        used = leaving_out(record, doubt)
        modelled = Problem(structure, used).run_whole(found.theta).output
        bridged = np.where(used.is_measured, used.y, modelled)
        solution = Solution(found, replace(used, y=bridged), doubt, bridged)
        before, doubt = doubt, doubted(record, np.where(answers, modelled, np.nan), found.noise_model.coefficients)
        if (doubt == before).all():
            break
        found = refine(structure, leaving_out(record, doubt), [found.theta])
    if solution is None:
        return None
    return replace(solution, found=with_untold(structure, leaving_out(record, solution.doubt), solution.found))


def _first(
    structure: Structure, record: Record, given: Sequence[FloatArray], *, afresh: bool, nested: bool
) -> Refined | None:
    """Return the estimate of a record; None where it has no samples, or input or reference is constant."""
    if not given and not _moves(record):
        return None
    return refine(structure, record, given, afresh=afresh, nested=nested)


def _moves(record: Record) -> bool:
    """Return whether input and reference move."""
    signals = (record.u,) if record.r is None else (record.u, record.r)
    return record.u.size > 0 and all(float(np.ptp(signal)) > 0.0 for signal in signals)


def suspected(record: Record, inputs: FloatArray | None = None) -> IntArray:
    """Return the `Doubt` in each output (K,) without a model; ``inputs`` (K, q) where there are several."""
    u, y = record.u if inputs is None else inputs, np.where(record.is_measured, record.y, np.nan)
    return np.concatenate([suspicious(u[rows], y[rows]) for rows in record.records])


def doubted(record: Record, modelled: FloatArray, noise: FloatArray, inputs: FloatArray | None = None) -> IntArray:
    """Return the `Doubt` in each output (K,) by a model's (K,), NaN where that is not known, and its noise model."""
    u, y = record.u if inputs is None else inputs, np.where(record.is_measured, record.y, np.nan)
    return np.concatenate([doubts(u[rows], y[rows], modelled[rows], noise) for rows in record.records])


def leaving_out(record: Record, doubt: IntArray) -> Record:
    """Return a record without the outputs that are in doubt."""
    measured = np.asarray(doubt == Doubt.NONE)
    if measured.all():
        return replace(record, measured=None)
    return replace(record, y=filled(record.y, measured), measured=measured)
