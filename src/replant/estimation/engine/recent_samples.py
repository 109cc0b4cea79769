"""Recent samples: the newest raw samples that a state keeps, oldest first."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from replant.estimation.engine.dimensions import RECENT
from replant.estimation.engine.record import Record, gaps_of
from replant.estimation.engine.state import GAP, State
from replant.kernels.schema import BRIDGED, DOUBTED, INPUT, LOAD, OUTPUT, REFERENCE, STEP, Doubt
from replant.numerics.arguments import BoolArray, FloatArray

# a longer run may be a change of the plant; a solution of the record distinguishes runs of this length
IN_A_ROW = 5  # most outliers in a row that are bridged [samples]

# a gap of any length begins a new part; choices by the duration of the record must not depend on its length
LONGEST_GAP = 1000.0  # longest interval that a gap between parts counts as [usual intervals]


@dataclass(frozen=True, eq=False)
class RecentSamples:
    """Raw samples, oldest first: input mapped, working point subtracted (except in a start-up)."""

    # (K, 3): input, output, interval; (K, 5) if outputs are examined; (K, 6) with a reference
    values: FloatArray

    @classmethod
    def of(cls, state: State, most: int = RECENT) -> RecentSamples:
        """Return the newest samples that a state keeps, at most ``most``."""
        ring, rows, end = state.recent, *_newest(state, most)
        if rows <= end:
            return cls(ring[end - rows : end])
        return cls(np.concatenate([ring[len(ring) - (rows - end) :], ring[:end]]))

    @classmethod
    def since(cls, state: State, sample: int) -> RecentSamples:
        """Return a copy of the samples after the given number of accepted ones, with short runs of outliers bridged."""
        kept = cls.of(state).cleaned()
        return kept[max(len(kept) - (state.samples - sample), 0) :]

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, rows: Any) -> RecentSamples:
        return RecentSamples(self.values[rows])

    @property
    def input(self) -> FloatArray:
        """View of the input."""
        return self.values[:, INPUT]

    @property
    def output(self) -> FloatArray:
        """View of the output as it was measured."""
        return self.values[:, OUTPUT]

    @property
    def interval(self) -> FloatArray:
        """View of the time since the sample before, in s."""
        return self.values[:, STEP]

    @property
    def bridged(self) -> FloatArray:
        """View of the output as the filters saw it."""
        return self.values[:, BRIDGED if self.are_examined else OUTPUT]

    @property
    def doubt(self) -> FloatArray:
        """View of the `Doubt`; `Doubt.NONE` if outputs are not examined."""
        return self.values[:, DOUBTED] if self.are_examined else np.full(len(self), float(Doubt.NONE))

    @property
    def reference(self) -> FloatArray:
        """View of the reference; NaN without one."""
        return self.values[:, REFERENCE] if self.have_reference else np.full(len(self), np.nan)

    @property
    def have_reference(self) -> bool:
        """Whether the samples came with a reference."""
        return bool(self.values.shape[1] > REFERENCE)

    @property
    def are_examined(self) -> bool:
        """Whether the state examines its outputs."""
        return bool(self.values.shape[1] > DOUBTED)

    @property
    def is_bridged(self) -> BoolArray:
        """Whether the output of each sample was bridged."""
        return np.asarray(self.doubt > Doubt.NONE)

    @property
    def is_measured(self) -> BoolArray:
        """Whether each sample came with an output."""
        return np.asarray(self.doubt != Doubt.MISSING)

    @property
    def is_stuck(self) -> BoolArray:
        """Whether the output of each sample is that of a stuck sensor, also before this was noticed."""
        stuck = np.asarray(self.doubt == Doubt.STUCK)
        if not stuck.any():
            return stuck
        tied = np.append(False, self.output[1:] == self.output[:-1])
        begins = np.maximum.accumulate(np.where(tied, 0, np.arange(len(self))))  # begin of the run of equal outputs
        return stuck | np.isin(begins, begins[stuck])

    @property
    def is_replaced(self) -> BoolArray:
        """Whether the output of each sample carries no information: it is the model's, or that of a stuck sensor."""
        return np.asarray(self.is_stuck | (self.is_bridged & (self.output == self.bridged)))

    @property
    def loads(self) -> tuple[int, ...]:
        """Samples at which a solution of the record has found a new load."""
        return tuple(np.flatnonzero(self.doubt == LOAD).tolist())

    def cleaned(self) -> RecentSamples:
        """Return a copy with short runs of outliers bridged, as the filters saw them."""
        copy = RecentSamples(self.values.copy())
        rows = np.flatnonzero((self.doubt == Doubt.OUTLIER) & ~self.is_stuck)
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            if run.size <= IN_A_ROW:
                copy.output[run] = self.bridged[run]
        return copy

    def changed(self, **columns: FloatArray) -> RecentSamples:
        """Return a copy with other values (K,) in the columns of these names."""
        copy = RecentSamples(self.values.copy())
        for name, values in columns.items():
            getattr(copy, name)[:] = values
        return copy

    def select(self, rows: BoolArray) -> RecentSamples:
        """Return a copy of some samples (K,); their intervals include those of the samples left out."""
        copy, ends = RecentSamples(self.values[rows]), np.cumsum(self.interval)
        if not rows.all():
            copy.interval[1:] = np.diff(ends[rows])
        return copy

    def since_last_gap(self, dt: float) -> RecentSamples:
        """Return the samples since the last interruption."""
        gaps = np.flatnonzero(self.interval[1:] > GAP * dt)
        return self[gaps[-1] + 1 :] if gaps.size else self

    def is_regular(self, dt: float) -> bool:
        """Return whether every interval is ``dt``."""
        return bool((self.interval[1:] == dt).all())

    @classmethod
    def record_of(cls, state: State, most: int, dt: float, input_hold: str) -> Record:
        """Return the newest samples that a state keeps, at most ``most``, as a record divided by its gaps."""
        from replant.kernels.step import stages

        rows, end = _newest(state, most)
        if rows and state.recent.shape[1] <= REFERENCE:  # one pass; signal by signal would take a tenth of a search
            u, y = np.empty((2, rows))
            if not stages.unroll(state.recent, end, dt, u, y):
                return Record(u, y, np.array([dt]), input_hold)
        return cls.of(state, most).record(dt, input_hold, parted=True)

    def record(self, dt: float, input_hold: str, *, parted: bool = False) -> Record:
        """Return the samples as a record, regular if every interval is ``dt``; ``parted``: divided by its gaps."""
        u, y = self.input.copy(), self.output.copy()
        r = self.reference.copy() if self.have_reference else None
        intervals, usual = np.array([dt]), math.inf
        if not self.is_regular(dt):
            intervals = self.interval.copy()
            if parted:
                usual, gaps = dt, gaps_of(intervals, dt)
                intervals[gaps] = np.minimum(intervals[gaps], LONGEST_GAP * float(np.median(intervals[1:])))
        measured = self.is_measured & np.isfinite(y)
        if measured.all():
            return Record(u, y, intervals, input_hold, r, usual=usual)
        y = np.where(measured, y, np.nan_to_num(self.bridged))  # as the filters saw it
        return Record(u, y, intervals, input_hold, r, usual=usual, measured=measured)


def variance_of_input(state: State, samples: int) -> float:
    """Return the variance of the newest inputs that a state keeps, at most ``samples``; there must be one."""
    from replant.kernels.step import stages

    rows, end = _newest(state, samples)
    return float(stages.variance(state.recent, end, rows, INPUT))


def _newest(state: State, most: int) -> tuple[int, int]:
    """Return how many samples a state keeps, at most ``most``, and the place in its ring where they end."""
    ring = len(state.recent)
    return min(state.samples, most, ring), state.samples if state.samples < ring else state.recent_head
