"""The run of a model on an irregular clock, its state fitted to the output anew behind each gap.

What the input did while no sample came is not known, and so the state behind a gap is not, as at the beginning of the
record.  The offset is that of the whole record.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import gaps_of
from replant.model.transfer_function import TransferFunction
from replant.simulation.free_run import FreeRun
from replant.statistics.linear_algebra import least_norm, quiet
from replant.statistics.projections import without

RANK_TOLERANCE = 1e-12
"""Singular value of the scaled free responses below which it counts as zero [part of the largest].
Derivation: as RANK_TOLERANCE of the offset's fit.
"""

FEWEST = 4
"""Outputs for each unknown of its state that a part needs, else it is left out [count].
Derivation: with fewer, the state that is fitted takes up most of what the model does not explain.
"""


class Part(NamedTuple):
    """A stretch between two gaps, or what there is of it in a batch.

    Attributes
    ----------
    rows : slice
        Of the batch.
    forced : (K,) array
        Output by the inputs alone, from rest.
    free : (K, n) array
        Responses to a unit of each state at the beginning of the stretch.
    begins : bool
        Whether the stretch begins here; else it goes on from the last batch.
    unknown : int
        How many of its first outputs answer to inputs from before it, because of a dead time.
    """

    rows: slice
    forced: FloatArray
    free: FloatArray
    begins: bool
    unknown: int


class PartedRun:
    """Runs a model over a record on an irregular clock that comes batch by batch.

    Parameters
    ----------
    model : TransferFunction
    dt : float
        Usual interval in s.
    input_hold : {"zoh", "foh"}

    Examples
    --------
    >>> run = PartedRun(TransferFunction([1.0], [1.0, 1.0]), dt=1.0)
    >>> [part.rows for part in run.take(np.ones(5), np.array([0.0, 1.0, 2.0, 30.0, 31.0]))]
    [slice(0, 3, None), slice(3, 5, None)]
    """

    def __init__(self, model: TransferFunction, dt: float, input_hold: str = "zoh") -> None:
        self._model, self._dt, self._hold = model, dt, input_hold
        self._run: FreeRun | None = None
        self._last = np.nan

    def take(self, u: FloatArray, t: FloatArray) -> list[Part]:
        """Take the next inputs (K,) and their time stamps (K,) in s."""
        first = self._run is None
        before = np.array([t[0] - self._dt if first else self._last])
        intervals = np.diff(t, prepend=before)
        # the interval of the first sample is looked at, too, where the batch goes on
        gaps = (gaps_of(np.append(self._dt, intervals), self._dt) - 1).tolist()
        begins = sorted({0, *gaps})
        self._last = float(t[-1])
        found = []
        for begin, end in zip(begins, [*begins[1:], u.size], strict=True):
            anew = begin in gaps or first
            if anew or self._run is None:
                self._run = FreeRun(self._model, self._dt, self._hold)
            first = False
            rows = slice(begin, end)
            forced, free, unknown = self._run.take(u[rows], intervals[rows])
            found.append(Part(rows, forced, free, anew, unknown))
        return found


@quiet
def offset_of(parts: list[Part], y: FloatArray) -> float:
    """Return the offset that fits the outputs (K,) best together with a state of each part; NaN where none does."""
    power = product = 0.0
    for part in parts:
        measured = known_outputs(part, y)
        kept = np.isfinite(measured) & np.isfinite(part.forced)
        if not kept.any() or not np.isfinite(part.free).all():
            continue
        signals = np.column_stack([np.ones(int(kept.sum())), measured[kept] - part.forced[kept]])
        ones, error = without(signals, part.free[kept]).T
        power, product = power + float(ones @ ones), product + float(ones @ error)
    return product / power if power > 0.0 else np.nan


@quiet
def state_of(part: Part, y: FloatArray, offset: float) -> FloatArray:
    """Return the state (n,) of a part that fits the outputs (K,) of the batch best."""
    measured = known_outputs(part, y)
    kept = np.isfinite(measured) & np.isfinite(part.forced)
    usable = np.isfinite(part.free).all(axis=0)
    weights = np.zeros(usable.size)
    if not kept.any():
        return weights
    basis = part.free[kept][:, usable]
    lengths = np.linalg.norm(basis, axis=0)
    lengths[lengths == 0.0] = 1.0
    found, rank, _ = least_norm(basis / lengths, measured[kept] - part.forced[kept] - offset, RANK_TOLERANCE)
    if rank:
        weights[usable] = found / lengths
    return weights


def known_outputs(part: Part, y: FloatArray) -> FloatArray:
    """Return the outputs (K,) of a part that say something; NaN where they do not.

    Those that answer to inputs from before the part do not, and none of a part that begins with too few.
    """
    measured = y[part.rows].copy()
    measured[: part.unknown] = np.nan
    if part.begins and int(np.isfinite(measured).sum()) < FEWEST * max(part.free.shape[1], 1):
        measured[:] = np.nan
    return measured
