r"""The run of a model over a record, from the input alone, offset and initial state fitted; its fit, batch by batch.

After a gap of an irregular clock the run begins anew: the input during the gap, and so the state, is unknown, as at the
beginning of the record; the offset is that of the whole record.  The fit needs only a small triangle of the samples, R
of the QR decomposition of nuisances and residual.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from replant.estimation.engine.record import GAP, gaps_of
from replant.model.state_space import Response, Stretch
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import BoolArray, FloatArray, record
from replant.numerics.linear_algebra import combined, quiet, sum_of_squares
from replant.numerics.projections import amounts_of, lengths_of
from replant.numerics.robust import last_known

FEWEST = 4  # outputs per unknown state that a part after a gap needs, else the state would fit them all [count]
RANK_TOLERANCE = 1e-12  # singular value of scaled nuisances that counts as zero: rounding [part of the largest]
ROWS = 1 << 10  # samples taken into a triangle together: few enough for a cache and for one thread [samples]
FITTED = 1 << 18  # samples of the first batch of a record, over which the initial state is fitted [samples]


@dataclass(frozen=True)
class Simulation:
    """The free run of a model, with offset and initial state fitted to a measured output."""

    output: FloatArray  # (K,): with the estimated offset and initial state
    offset: float  # estimated constant between measured and simulated output, in the unit of y
    fit: float  # in percent over the finite samples
    is_prediction: bool = False  # whether it is predicted one step ahead, as an unstable model would run away

    @property
    def how(self) -> str:
        """How the output was made, in words."""
        return "predicted from input and past output" if self.is_prediction else "simulated from the input alone"


def fit_percent(measured: FloatArray, modelled: FloatArray) -> float:
    r"""Return the fit in percent, :math:`100 (1 - \|y - \hat y\| / \|y - \bar y\|)`; samples with a NaN are left out.

    A perfect model has 100, the mean of the output 0, a worse model less than 0.  A constant output has no fit: NaN.

    Parameters
    ----------
    measured, modelled : (K,) arrays

    Raises
    ------
    InvalidArgumentError
        If the two differ in length, or one is not a vector of real numbers.

    Examples
    --------
    >>> fit_percent(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0]))
    100.0
    """
    measured, modelled = record(measured, modelled, ("measured", "modelled"))
    kept = np.isfinite(measured) & ~np.isnan(modelled)
    y, model = measured[kept], modelled[kept]
    if y.size == 0 or y.min() == y.max():
        return math.nan
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # the squares of tiny numbers are zero
        return float(100.0 * (1.0 - np.sqrt(np.divide(sum_of_squares(y - model), sum_of_squares(y - y.mean())))))


def simulate(
    model: TransferFunction, u: FloatArray, y: FloatArray, dt: float, *, input_hold: str = "zoh",
    t: FloatArray | None = None, begins: Sequence[int] = (),
) -> Simulation:  # fmt: skip
    """Run a model from the input alone, offset and initial state fitted to ``y``, new ones at ``begins``."""
    run = FittedRun(model, dt, input_hold, begins)
    output, known = run.take(u, y, t)
    if not (np.isfinite(output).all() and np.isfinite(known).any()):
        return Simulation(np.full(u.size, np.nan), 0.0, -math.inf)
    return Simulation(output, run.offset, fit_percent(known, output))


class Part(NamedTuple):
    """A stretch between two gaps, or the part of it in a batch."""

    stretch: Stretch  # the response of the model from rest, and to its states
    known: FloatArray  # (K,): the measured output; NaN where it is not used
    begins: bool  # whether the stretch begins here; else it continues from the last batch

    @property
    def triangle(self) -> FloatArray:
        """The triangle of responses to unit states, ones, and the residual of the run from rest; see `triangle_of`."""
        free, left = self.stretch.free, self.known - self.stretch.output
        alive = len(free)
        free = np.where(np.isfinite(free).all(axis=0), free, 0.0)  # one that is not finite gets the weight zero
        triangle = triangle_of(free, np.ones(alive), left[:alive])
        rest = left[alive:][np.isfinite(left[alive:])]
        if not rest.size:
            return triangle
        root = math.sqrt(rest.size)
        row = np.zeros(free.shape[1] + 2)  # for samples without effect of a state the mean suffices
        row[-2:] = root, float(rest.sum()) / root
        return np.vstack([triangle, row])

    def output(self, offset: float, state: FloatArray) -> FloatArray:
        """Return the model's output (K,) with an offset and a state (n,) at the beginning of the stretch."""
        used, free = state != 0.0, self.stretch.free
        output = self.stretch.output + offset
        output[: len(free)] += combined(free[:, used], state[used])
        unknown = self.stretch.unknown
        output[:unknown] = output[min(unknown, output.size - 1)]  # constant where it depends on unknown inputs
        return output


class FittedRun:
    """Runs a model over a record batch by batch; the offset is fitted to the first batch, a state to each new part.

    At ``begins``, samples of the first batch, the run begins anew: with another load, or another record.
    """

    def __init__(self, model: TransferFunction, dt: float, input_hold: str = "zoh", begins: Sequence[int] = ()) -> None:
        self._model, self._dt, self._hold, self._begins = model, dt, input_hold, begins
        self._begin()

    def _begin(self) -> None:
        self._response: Response | None = None
        self._input, self._last, self._told = 0.0, math.nan, math.nan  # times of the last sample and the last input
        self._state = np.zeros(self._model.den.size - 1)
        self.offset = 0.0

    @quiet
    def take(self, u: FloatArray, y: FloatArray, t: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Take the next samples (K,); return the model's output (K,), and the measured one (K,)."""
        if u.size == 0:
            return u.copy(), y.copy()
        if self._begins:
            return self._take_parts(u, y, t)
        first, told = self._response is None, np.isfinite(u)
        intervals = None if t is None else np.diff(t, prepend=t[0] - self._dt if first else self._last)
        gaps, is_blind = self._gaps(told, t)
        u = last_known(u, self._input)
        self._input = float(u[-1])
        begins = sorted({0, *gaps})
        parts = [
            self._part(slice(*ends), u, np.where(is_blind, np.nan, y), intervals, behind_gap=ends[0] in gaps)
            for ends in zip(begins, [*begins[1:], u.size], strict=True)
        ]
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

    def _take_parts(self, u: FloatArray, y: FloatArray, t: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        ends, self._begins, parts = [0, *self._begins, u.size], (), []
        for begin, end in pairwise(ends):
            self._begin()
            parts.append(self.take(u[begin:end], y[begin:end], None if t is None else t[begin:end]))
        outputs, known = zip(*parts, strict=True)
        return np.concatenate(outputs), np.concatenate(known)

    def _gaps(self, told: BoolArray, t: FloatArray | None) -> tuple[list[int], BoolArray]:
        """Return the samples after gaps of the clock, or of inputs (K,) not ``told``; and which lie within gaps."""
        begun = t[0] - self._dt if t is not None else 0.0 if math.isnan(self._last) else self._last
        clock = begun + self._dt * np.arange(1, told.size + 1) if t is None else t
        rows, before = np.flatnonzero(told), begun if math.isnan(self._told) else self._told
        newest = np.maximum.accumulate(np.where(told, clock, before))  # time of the last input
        self._last, self._told = float(clock[-1]), float(newest[-1])
        intervals = np.diff(clock[rows], prepend=before)
        # also the interval of the first sample
        gaps = rows[gaps_of(np.append(self._dt, intervals), self._dt) - 1]
        return gaps.tolist(), clock - newest > (GAP - 1.0) * self._dt

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


@quiet
def triangle_of(*columns: FloatArray) -> FloatArray:
    """Return R (at most C, C) of joined columns, each (K,) or (K, c), C in all, without rows with a NaN."""
    triangle = np.zeros((0, sum(each.shape[1] if each.ndim > 1 else 1 for each in columns)))
    for begin in range(0, len(columns[0]), ROWS):
        block = np.column_stack([each[begin : begin + ROWS] for each in columns])
        known = np.isfinite(block).all(axis=1)
        stacked = np.vstack([triangle, block if known.all() else block[known]])
        triangle = np.asarray(np.linalg.qr(stacked, mode="r"))
    return triangle


@quiet
def weights_of(triangle: FloatArray) -> FloatArray:
    """Return the least-norm weights (C - 1,) of a triangle's columns that fit its last one; zeros if none do."""
    # the columns are scaled: the sizes of a decaying and of a growing response differ by many decades
    return amounts_of(triangle[:, :-1], triangle[:, -1], RANK_TOLERANCE)


@quiet
def common_offset(triangles: Sequence[FloatArray]) -> float:
    """Return the offset fitted together with a state of each part; 0 if the states explain it."""
    size = power = product = 0.0
    for triangle in triangles:
        own, rest = triangle[:, :-2], triangle[:, -2:]
        if not np.isfinite(triangle).all():
            continue
        left, values, _ = np.linalg.svd(own / lengths_of(own), full_matrices=False)
        basis = left[:, values > RANK_TOLERANCE * values.max(initial=0.0)]
        for _ in range(2):  # twice, to remove rounding
            rest = rest - basis @ (basis.T @ rest)
        size += float(triangle[:, -2] @ triangle[:, -2])
        power, product = power + float(rest[:, 0] @ rest[:, 0]), product + float(rest[:, 0] @ rest[:, 1])
    return product / power if power > RANK_TOLERANCE**2 * size else 0.0
