"""solve: the estimate of a record, and the samples that it uses, the same for every caller.

`fit`, the start-up, the record solved again, the end of a run and the search all solve records here.  Missing outputs,
outliers, and outputs of a stuck sensor are left out, but not their inputs: the filters use the model's output instead.
Bad outputs are found with a model, so that both are found in turn.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

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
ROUNDS = 5  # most times that a record is solved and its outputs are judged [count]


S = TypeVar("S")


@dataclass(frozen=True, eq=False)
class Solution:
    """A model and the samples that it was made from."""

    found: Refined
    record: Record  # with the model's outputs in place of those left out
    doubt: IntArray  # (K,), the `Doubt` in each output
    bridged: FloatArray  # (K,), these outputs, possibly relative to another working point

    @property
    def is_bad(self) -> BoolArray:
        """Which outputs (K,) were left out."""
        return np.asarray(self.doubt != Doubt.NONE)


def at_first(record: Record) -> Record:
    """Return a record without the outputs that seem bad without a model."""
    return leaving_out(record, suspected(record))


def solve(
    structure: Structure, record: Record, given: Sequence[FloatArray] = (), *, afresh: bool = False,
    nested: bool = False,
) -> Solution | None:  # fmt: skip
    """Solve a record, see `refine`; None if no start leads to a model."""
    solution = _solved(structure, record, given, afresh=afresh, nested=nested)
    first = first_jump(record)
    if solution is None or not first or record.r is not None:
        return solution
    # a fast pole with an initial state fits any first output, so that it is judged by a solution without it
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
    """Return how many outputs precede the largest jump of a record; 0 unless it is near the begin and stands out."""
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
    """Solve a record and judge its outputs by the model, in turn."""
    answers = record.answers(structure.delay)

    def solved(doubt: IntArray, before: Refined | None) -> Refined | None:
        used = leaving_out(record, doubt)
        if before is not None:
            return refine(structure, used, [before.theta])
        # None without samples, or with a constant input or reference
        return refine(structure, used, given, afresh=afresh, nested=nested) if given or _moves(used) else None

    def modelled(found: Refined, doubt: IntArray) -> FloatArray:
        return Problem(structure, leaving_out(record, doubt)).run_whole(found.theta).output

    def told(found: Refined, doubt: IntArray) -> IntArray:
        return doubted(record, np.where(answers, modelled(found, doubt), np.nan), found.noise_model.coefficients)

    ends = in_turn(record.is_measured, suspected(record), solved, told)
    if ends is None:
        return None
    used = leaving_out(record, ends[1])
    bridged = np.where(used.is_measured, used.y, modelled(*ends))
    return Solution(with_untold(structure, used, ends[0]), replace(used, y=bridged), ends[1], bridged)


def in_turn(
    known: BoolArray, doubt: IntArray, solved: Callable[[IntArray, S | None], S | None],
    told: Callable[[S, IntArray], IntArray],
) -> tuple[S, IntArray] | None:  # fmt: skip
    """Return the solution without the outputs in ``doubt``, which are judged again by it, and the `Doubt` it used."""
    # known: which outputs (K,) exist; if there is no solution without the doubtful ones, all are used
    found, as_they_came = solved(doubt, None), np.where(known, Doubt.NONE, Doubt.MISSING)
    if found is None and (doubt != as_they_came).any():
        doubt = as_they_came
        found = solved(doubt, None)
    if found is None:
        return None
    for _ in range(ROUNDS - 1):
        again = told(found, doubt)
        other = None if (again == doubt).all() else solved(again, found)
        if other is None:
            break
        found, doubt = other, again
    return found, doubt


def _moves(record: Record) -> bool:
    """Return whether input and reference move."""
    signals = (record.u,) if record.r is None else (record.u, record.r)
    return record.u.size > 0 and all(float(np.ptp(signal)) > 0.0 for signal in signals)


def suspected(record: Record, inputs: FloatArray | None = None) -> IntArray:
    """Return the `Doubt` in each output (K,) without a model; ``inputs`` (K, q) if there are several."""
    u, y = record.u if inputs is None else inputs, np.where(record.is_measured, record.y, np.nan)
    return np.concatenate([suspicious(u[rows], y[rows]) for rows in record.records])


def doubted(record: Record, modelled: FloatArray, noise: FloatArray, inputs: FloatArray | None = None) -> IntArray:
    """Return the `Doubt` in each output (K,) by a modelled one (K,), NaN where unknown, and its noise model."""
    u, y = record.u if inputs is None else inputs, np.where(record.is_measured, record.y, np.nan)
    return np.concatenate([doubts(u[rows], y[rows], modelled[rows], noise) for rows in record.records])


def leaving_out(record: Record, doubt: IntArray) -> Record:
    """Return a record without the outputs that are in doubt."""
    measured = np.asarray(doubt == Doubt.NONE)
    if measured.all():
        return replace(record, measured=None)
    return replace(record, y=filled(record.y, measured), measured=measured)
