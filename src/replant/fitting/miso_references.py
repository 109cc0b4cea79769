"""The references of a row: which inputs they move, and what of these comes from outside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError, shown
from replant.estimation.simulation.miso import RowRecord
from replant.estimation.simulation.miso_exogenous import Outside
from replant.model.preprocess import accepted
from replant.numerics.arguments import BoolArray, FloatArray, array_of_reals
from replant.verdict.loop_tests import COPIED, STILL, Reference, fault_of
from replant.verdict.verdict import Finding

IDLE = "the reference explains nothing of any input: give the column that does, move it more, or leave it out"
SERVED = "input {} is moved by the reference: the estimate is made from what that explains of it"

OPEN = "no input answers to disturbances: the reference is not needed"


def references_of(given: Any, samples: int) -> FloatArray | None:
    """Return references as columns (K, p), checked; None where there are none."""
    if given is None:
        return None
    columns, _ = accepted(np.asarray(array_of_reals("reference", given), np.float64))
    columns = columns[:, None] if columns.ndim == 1 else columns
    if columns.ndim != 2 or not columns.shape[1] or len(columns) != samples:
        raise InvalidArgumentError(
            f"reference must have one value for each of {samples} samples, or a column of them for each reference, got "
            f"shape {shown(columns.shape)}"
        )
    return columns


def held(references: FloatArray) -> FloatArray:
    """Return references (K, p) on straight lines where they are not known."""
    columns, index = references.copy(), np.arange(len(references))
    for column in columns.T:
        known = np.flatnonzero(np.isfinite(column))
        column[:] = np.interp(index, known, column[known]) if known.size else 0.0
    return columns


def with_outside(
    ready: RowRecord, references: FloatArray | None, names: Sequence[str], is_moved: BoolArray | None = None
) -> tuple[RowRecord, tuple[Finding, ...]]:
    """Return a record (J,) with what references (J, p) explain of its inputs, and what there is to say about them."""
    if references is None:
        return ready, ()
    each_of = [np.ascontiguousarray(each) for each in references.T]
    if all(fault_of(each, ready.inputs[:, 0]) == STILL for each in each_of):
        return ready, (Finding("not excited", f"{STILL}: move it, or leave it out"),)
    inputs, told = [np.ascontiguousarray(each) for each in ready.inputs.T], is_moved is not None
    if is_moved is None:
        is_moved = np.array([any(_moves(r, u, ready.record.y) for r in each_of) for u in inputs])
    if not is_moved.any() and told:
        return replace(ready, outside=None), (Finding("trusted", OPEN),)
    if not is_moved.any():
        if any(fault_of(r, u) == COPIED for r in each_of for u in inputs):
            return ready, (Finding("trusted", f"{COPIED}, and says no more than the input does"),)
        return ready, (Finding("not excited", IDLE),)
    outside = Outside.of(ready.inputs, references, is_moved)
    served = (Finding("trusted", SERVED.format(name)) for name, moves in zip(names, is_moved, strict=True) if moves)
    return replace(ready, outside=outside), tuple(served)


def _moves(r: FloatArray, u: FloatArray, y: FloatArray) -> bool:
    """Return whether a reference moves an input, of which it is no copy."""
    return bool(np.ptp(u) > 0.0 and not fault_of(r, u) and Reference.projected(r, u, y).strength > 1.0)
