"""The run of a model over a record, from the input alone, batch by batch: offset and initial state are fitted.

Behind a gap of an irregular clock the run begins anew.  What the input did meanwhile is not known, and so the state is
not, as at the beginning of the record; the offset is that of the whole record.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import gaps_of
from replant.model.response import Response, Stretch
from replant.model.transfer_function import TransferFunction
from replant.simulation.nuisances import common_offset, triangle_of, weights_of
from replant.statistics.linear_algebra import quiet

FEWEST = 4
"""Outputs for each unknown of its state that a part behind a gap needs, else it is left out [count].
Derivation: with fewer, the state that is fitted takes up most of what the model does not explain.
"""


class Part(NamedTuple):
    """A stretch between two gaps, or what there is of it in a batch.

    Attributes
    ----------
    stretch : Stretch
        What the model gives from rest, and by its state.
    known : (K,) array
        The measured output; NaN where it says nothing.
    begins : bool
        Whether the stretch begins here; else it goes on from the last batch.
    """

    stretch: Stretch
    known: FloatArray
    begins: bool

    @property
    def triangle(self) -> FloatArray:
        """Of the responses to a unit of each state, ones, and what the run from rest leaves; see `triangle_of`."""
        free, left = self.stretch.free, self.known - self.stretch.output
        alive = len(free)
        free = np.where(np.isfinite(free).all(axis=0), free, 0.0)  # the weight of one that leaves float64 is zero
        triangle = triangle_of(free, np.ones(alive), left[:alive])
        rest = left[alive:][np.isfinite(left[alive:])]
        if not rest.size:
            return triangle
        root = math.sqrt(rest.size)
        row = np.zeros(free.shape[1] + 2)  # of samples where no state is felt the mean says all
        row[-2:] = root, float(rest.sum()) / root
        return np.vstack([triangle, row])

    def output(self, offset: float, state: FloatArray) -> FloatArray:
        """Return the model's output (K,) with an offset and a state (n,) at the beginning of the stretch."""
        used, free = state != 0.0, self.stretch.free
        output = self.stretch.output + offset
        output[: len(free)] += free[:, used] @ state[used]
        unknown = self.stretch.unknown
        output[:unknown] = output[min(unknown, output.size - 1)]  # what answers to unknown inputs stands still
        return output


class FittedRun:
    """Runs a model over a record that comes batch by batch.

    The offset is fitted to the first batch, the state to the rest of the batch in which its stretch begins.

    >>> g = TransferFunction([2.0], [1.0, 1.0])
    >>> u = np.repeat([0.0, 1.0, -1.0, 1.0], 10)
    >>> run = FittedRun(g, dt=0.1)
    >>> output, known = run.take(u, g.simulate(u, 0.1) + 5.0)
    >>> round(run.offset, 6), bool(np.abs(output - known).max() < 1e-9)
    (5.0, True)
    """

    def __init__(self, model: TransferFunction, dt: float, input_hold: str = "zoh") -> None:
        self._model, self._dt, self._hold = model, dt, input_hold
        self._response: Response | None = None
        self._input, self._last = 0.0, math.nan
        self._state = np.zeros(model.den.size - 1)
        self.offset = 0.0

    @quiet
    def take(self, u: FloatArray, y: FloatArray, t: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Take the next samples (K,); return the model's output (K,), and the measured one (K,)."""
        if u.size == 0:
            return u.copy(), y.copy()
        first = self._response is None
        u, self._input = bridged(u, self._input)
        parts = self._parts(u, y, t)
        triangles = [part.triangle if part.begins else None for part in parts]
        if first:
            self.offset = common_offset([each for each in triangles if each is not None])
        modelled = []
        for part, triangle in zip(parts, triangles, strict=True):
            if triangle is not None:
                self._state = weights_of(
                    np.column_stack([triangle[:, :-2], triangle[:, -1] - self.offset * triangle[:, -2]])
                )
            modelled.append(part.output(self.offset, self._state))
        return np.concatenate(modelled), np.concatenate([part.known for part in parts])

    def _parts(self, u: FloatArray, y: FloatArray, t: FloatArray | None) -> list[Part]:
        """Return the parts of a batch, which a model has been run over."""
        gaps: list[int] = []
        intervals = None
        if t is not None:
            intervals = np.diff(t, prepend=t[0] - self._dt if self._response is None else self._last)
            self._last = float(t[-1])
            # the interval of the first sample is looked at, too, where the batch goes on
            gaps = (gaps_of(np.append(self._dt, intervals), self._dt) - 1).tolist()
        begins = sorted({0, *gaps})
        return [
            self._part(slice(*ends), u, y, intervals, behind_gap=ends[0] in gaps)
            for ends in zip(begins, [*begins[1:], u.size], strict=True)
        ]

    def _part(
        self, rows: slice, u: FloatArray, y: FloatArray, intervals: FloatArray | None, *, behind_gap: bool
    ) -> Part:
        begins = self._response is None or behind_gap
        if self._response is None or behind_gap:
            self._response = Response(self._model, self._dt, self._hold, at_rest=False)
        stretch = self._response.take(u[rows], None if intervals is None else intervals[rows])
        known = np.where(np.isfinite(y[rows]), y[rows], np.nan)
        known[: stretch.unknown] = np.nan
        if behind_gap and int(np.isfinite(known).sum()) < FEWEST * max(self._state.size, 1):
            known[:] = np.nan
        return Part(stretch, known, begins)


def bridged(u: FloatArray, before: float = 0.0) -> tuple[FloatArray, float]:
    """Return ``u`` (K,) with each entry that is not finite replaced by the last finite one, and its last entry.

    ``before`` is the entry before the first one.
    """
    finite = np.isfinite(u)
    if not finite.all():
        last = np.maximum.accumulate(np.where(finite, np.arange(u.size), -1))
        u = np.where(last >= 0, u[np.maximum(last, 0)], before)
    return u, float(u[-1]) if u.size else before
