"""Glitches of the input: values that its recording has and the plant has not seen.

A few values far from all others, as of a bad cable or an error code, leave a model that explains little, and tests that
name other causes.  Whether the plant has seen them is asked of the record: without these rows another model has more
evidence from the other ones, each of them paid for as a number that was fitted, and is trusted.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.solver.refined_estimate import without_nuisances
from replant.fitting.structure_evidence import Evidence
from replant.model.structure import Structure
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.levels import ALPHA
from replant.numerics.robust import far_out
from replant.verdict.assess import MOST_SAMPLES, assess_record
from replant.verdict.verdict import Assessment


def with_input_glitches(
    verdict: Assessment, structure: Structure, parameters: FloatArray, record: Record, zero: float
) -> Assessment:
    """Return the verdict on a model (P,): where the input has glitches, they alone; its record has it less ``zero``."""
    record = record.last(MOST_SAMPLES)
    glitches, low, high = far_out(record.u)
    if verdict.status == "trusted" or not glitches.any() or len(record.parts) > 1:
        return verdict
    beside, emptied = replace(record, measured=record.is_measured & ~glitches), _without(record, glitches)
    at_rest = not structure.delay
    given = Evidence(beside, at_rest=at_rest).of(structure, [without_nuisances(structure, parameters)])
    found = Evidence(emptied, at_rest=at_rest).of(structure, (), afresh=True)
    price = -math.log(ALPHA) + 0.5 * int(glitches.sum()) * math.log(record.u.size)
    if found is None or (given is not None and not found.evidence > given.evidence + price):
        return verdict
    size = structure.size
    theta, covariance = found.found.theta[:size], found.found.covariance[:size, :size]
    if assess_record(structure, theta, emptied, emptied.usual, covariance).status != "trusted":
        return verdict  # of a wrong structure none tells what the plant has seen
    count = int(glitches.sum())
    values = "a value of the input lies" if count == 1 else f"{count:,} values of the input lie"
    reason = (
        f"{values} far from its others, {low + zero:.3g} to {high + zero:.3g}, and the output does not answer: without "
        f"{'it' if count == 1 else 'them'} a model explains {found.fit:.1f} %: make the cells empty"
    )
    return replace(verdict, status="inconsistent", reasons=(reason,))  # others are of a model that they have made


def _without(record: Record, glitches: BoolArray) -> Record:
    """Return a record of one part without some rows (K,), as if these had no input."""
    kept = ~glitches
    t = np.cumsum(np.broadcast_to(record.intervals, kept.shape))[kept]
    usual = float(np.median(record.intervals))
    return replace(
        record, u=record.u[kept], y=record.y[kept], intervals=np.diff(t, prepend=t[:1] - usual), usual=usual,
        r=None if record.r is None else record.r[kept],
        measured=None if record.measured is None else record.measured[kept],
    )  # fmt: skip
