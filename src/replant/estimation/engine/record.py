"""Record: samples prepared for an estimator: mapped, usable, working point subtracted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from replant.kernels.schema import LAGS
from replant.model.preprocess import Preprocess, centre, screen
from replant.model.state_space import unknown_outputs
from replant.model.structure import Structure
from replant.numerics.arguments import BoolArray, FloatArray, IntArray
from replant.numerics.autoregression import Autoregression, in_a_row, since_break
from replant.numerics.linear_algebra import quiet, sum_of_squares

# some million times the precision of float64
SAME = 1e-9  # part of an interval up to which a difference is rounding [ratio]

GAP = 3.5
"""Interval, relative to the usual one and its neighbours, above which it is a gap, after which the state is unknown
[ratio].
Origin: a resonant plant with 5 % of noise, its binary input held for five samples. The largest error of a coefficient
is 0.3 % without lost samples. Once in a hundred samples, three lost in a row make it 1.7 %, five make it 8.5 %, and
0.4 % if the state after the gap is estimated. A tenth of all samples lost at random: 2.7 % either way.
Sensitivity: halved, no verdict changes, and no error by a quarter; doubled, nothing changes on these records.
"""

MOST_GAPS = 500  # gaps that divide a record, the longest ones: each costs a pass over its part [count]


def gaps_of(intervals: FloatArray, usual: float) -> IntArray:
    """Return the samples (G,) that follow a gap: the input during the gap is unknown, and so is the state."""
    if intervals.size < 2:
        return np.zeros(0, np.int64)
    steps = np.concatenate([[usual] * 2, intervals[1:], [usual] * 2])
    # three slow samples in a row have a rate of their own; two gaps may have a single sample between them
    pairs = np.minimum(steps[:-1], steps[1:])
    beside = np.maximum.reduce(
        [pairs[:-3], np.minimum(steps[1:-3], steps[3:-1]), pairs[3:], np.full(steps.size - 4, usual)]
    )
    found = np.flatnonzero(intervals[1:] > GAP * beside) + 1
    if found.size > MOST_GAPS:
        found = np.sort(found[np.argsort(-intervals[found], kind="stable")[:MOST_GAPS]])
    return np.asarray(found, np.int64)


@dataclass(frozen=True, eq=False)
class Record:
    """A prepared record: mapped input and output, working point subtracted, unusable samples dropped."""

    u: FloatArray  # (K,)
    y: FloatArray  # (K,)
    intervals: FloatArray  # (1,) or (K,): time since the previous sample, in s: one for all, or one each
    input_hold: str = "zoh"
    r: FloatArray | None = None  # (K,): the reference, if there is one
    before: Record | None = None  # the samples before it, whose inputs still act because of a dead time
    # usual interval in s of a record divided by its gaps, see `gaps_of`; infinite if it is not divided
    usual: float = math.inf
    # (K,): which outputs were measured, None for all; for the others ``y`` is a guess: the model's own output drives
    # the filters, and nothing is learned from them
    measured: BoolArray | None = None
    begins: tuple[int, ...] = ()  # samples at which another record begins, with its own offset and initial state
    rest: int = 0  # samples at rest that were put before the log's first sample

    @property
    def count(self) -> int:
        """Number of measured outputs."""
        return self.u.size if self.measured is None else int(self.measured.sum())

    @property
    def is_measured(self) -> BoolArray:
        """Which outputs (K,) were measured."""
        return np.ones(self.u.size, bool) if self.measured is None else self.measured

    @cached_property
    def spread(self) -> float:
        """Standard deviation of the output."""
        return math.sqrt(sum_of_squares(self.y - self.y.mean()) / self.y.size) if self.y.size else 0.0

    @cached_property
    def predecessors(self) -> IntArray:
        """Number of outputs measured before each (K,), one sampling time apart, up to LAGS; jitter is ignored."""
        if self.measured is None:
            return self._unbroken
        return np.minimum(in_a_row(self.measured, self._breaks), LAGS)

    @cached_property
    def _unbroken(self) -> IntArray:
        """Number of samples before each (K,) that are one sampling time apart, measured or not, up to LAGS."""
        if self.intervals.size == 1 and not self.begins:
            return _predecessors(self.u.size)
        since = since_break(self._breaks)
        return np.minimum(since, LAGS, out=since)

    def whitened(self, noise: Autoregression, signals: FloatArray) -> FloatArray:
        """Return D(q) x of ``signals`` (K, ...) along the first axis, weighted if the past is incomplete."""
        white = noise.whiten_known(signals, self._unbroken)
        missing = np.flatnonzero(~self.is_measured)
        # missing outputs take the values that minimise the result, which gives the exact likelihood
        return noise.without_unknown(white, self._unbroken, missing) if noise.order and missing.size else white

    @property
    def inputs_before(self) -> IntArray:
        """Number of inputs before each (K,) that are one sampling time apart; jitter is ignored."""
        return since_break(self._breaks)

    @property
    def _breaks(self) -> BoolArray:
        """Which samples (K,) begin a record, or come after an unusual interval, beyond jitter."""
        from replant.kernels.filters.autoregressions import JITTER

        broken = np.zeros(self.u.size, bool)
        broken[:1] = True
        broken[list(self.begins)] = True
        if self.intervals.size > 1:
            nominal = float(np.median(self.intervals[1:]))
            broken |= np.abs(self.intervals - nominal) > JITTER * nominal
        return broken

    @cached_property
    def parts(self) -> list[slice]:
        """The stretches between gaps and records; each begins with an unknown state."""
        gaps = gaps_of(self.intervals, self.usual).tolist() if math.isfinite(self.usual) else []
        return _slices(sorted({*gaps, *self.begins}), self.u.size)

    def nuisances_beside(self, poles: int, *, bias: bool) -> int:
        """Return the number of unknown initial states and offsets, without those of the first part."""
        others = self.parts[1:]
        return sum(min(rows.stop - rows.start, poles + (rows.start in self.begins and not bias)) for rows in others)

    def answers(self, delay: float) -> BoolArray:
        """Return which outputs (K,) respond to inputs of their own part, with a dead time in s."""
        answers = np.ones(self.u.size, bool)
        for rows in self.parts:
            answers[rows.start : rows.start + self.part(rows).unknown(delay)] = False
        return answers

    @property
    def records(self) -> list[slice]:
        """The records that were joined."""
        return _slices(self.begins, self.u.size)

    def part(self, rows: slice) -> Record:
        """Return a stretch without a gap."""
        return self._cut(rows, math.inf)

    def first(self, samples: int) -> Record:
        """Return the record's beginning."""
        return self._cut(slice(0, samples), self.usual)

    def last(self, samples: int) -> Record:
        """Return the record's end."""
        return self._cut(slice(max(self.u.size - samples, 0), None), self.usual)

    def _cut(self, rows: slice, usual: float) -> Record:
        intervals = self.intervals if self.intervals.size == 1 else self.intervals[rows]
        r = None if self.r is None else self.r[rows]
        measured = None if self.measured is None else self.measured[rows]
        first, end, _ = rows.indices(self.u.size)
        begins = tuple(begin - first for begin in self.begins if first < begin < end)
        rest = max(min(self.rest, end) - first, 0)
        return Record(self.u[rows], self.y[rows], intervals, self.input_hold, r, None, usual, measured, begins, rest)

    def answering(self, delay: float) -> Record:
        """Return the samples that respond to inputs of the record, at least the newest; the others become `before`."""
        unknown = min(self.unknown(delay), self.u.size - 1)
        if unknown <= 0:
            return self
        return replace(self.last(self.u.size - unknown), before=self.first(unknown))

    @property
    def restored(self) -> tuple[Record, IntArray]:
        """The record with lost samples restored, signals interpolated, and the places of its samples (K,) in it."""
        if self.intervals.size == 1:
            return self, np.arange(self.u.size)
        steps = self.intervals / float(np.median(self.intervals[1:]))
        steps[[0, *(rows.start for rows in self.parts)]] = 0.0
        # samples lost in a gap are not restored
        lost = np.where(steps <= GAP, np.maximum(np.rint(steps) - 1.0, 0.0), 0.0).astype(int)
        places = np.arange(self.u.size) + np.cumsum(lost)
        each, along = np.arange(places[-1] + 1), np.cumsum(self.intervals)
        at = np.interp(each, places, along)
        u, y = np.interp(at, along, self.u), np.interp(at, along, self.y)
        r = None if self.r is None else np.interp(at, along, self.r)
        measured = np.zeros(each.size, bool)
        measured[places] = self.is_measured
        intervals = np.repeat(self.intervals / (lost + 1.0), lost + 1)
        begins = tuple(int(places[begin]) for begin in self.begins)
        before = None if self.before is None else self.before.restored[0]
        return Record(u, y, intervals, self.input_hold, r, before, self.usual, measured, begins), places

    @property
    def levelled(self) -> Record:
        """The record with the means of each joined record subtracted from input and output."""
        u, y, measured = self.u.copy(), self.y.copy(), self.is_measured
        for rows in self.records:
            u[rows] -= u[rows].mean()
            if measured[rows].any():
                y[rows] = np.where(measured[rows], y[rows] - y[rows][measured[rows]].mean(), y[rows])
        return replace(self, u=u, y=y)

    @property
    def joined(self) -> Record:
        """The record with the samples before it."""
        if self.before is None:
            return self
        parts = self.before, self
        u, y = (np.concatenate([getattr(part, name) for part in parts]) for name in ("u", "y"))
        regular = self.intervals.size == 1 and self.u.size > 1
        intervals = self.intervals if regular else np.concatenate([part.intervals for part in parts])
        r = None if self.r is None or self.before.r is None else np.concatenate([self.before.r, self.r])
        measured = None
        if self.measured is not None or self.before.measured is not None:
            measured = np.concatenate([part.is_measured for part in parts])
        begins = (*self.before.begins, *(self.before.u.size + begin for begin in self.begins))
        return Record(u, y, intervals, self.input_hold, r, None, self.usual, measured, begins)

    def unknown(self, delay: float) -> int:
        """Return how many first samples respond to inputs before the record, with a dead time in s."""
        if self.intervals.size == 1:
            return min(unknown_outputs(delay, float(self.intervals[0])), self.u.size)
        since = np.cumsum(self.intervals) - self.intervals[0]
        return int(np.count_nonzero(delay - since > SAME * self.intervals))

    def since_first(self, sample: int) -> float:
        """Return the time from the first sample of the log to another one, in s."""
        return self.first(sample + 1).last(max(sample + 1 - self.rest, 1)).span

    def clock(self, rows: slice) -> tuple[float, FloatArray | None]:
        """Return the usual interval in s of a stretch, and its time stamps in s; None for a regular clock."""
        if self.intervals.size == 1:
            return float(self.intervals[0]), None
        return self.usual if math.isfinite(self.usual) else self.dt, np.cumsum(self.intervals[rows])

    @property
    def span(self) -> float:
        """Time from first to last sample, in s."""
        if self.intervals.size == 1:
            return float(self.intervals[0]) * (self.u.size - 1)
        return float(self.intervals[1:].sum())

    @cached_property
    def dt(self) -> float:
        """Mean interval in s, without gaps."""
        if not math.isfinite(self.usual) or len(self.parts) == 1:
            return self.span / (self.u.size - 1)
        within = [self.intervals[rows][1:] for rows in self.parts]
        return float(np.concatenate(within).mean()) if any(each.size for each in within) else self.usual


@lru_cache(maxsize=2)
def _predecessors(samples: int) -> IntArray:
    """Return the number of samples before each one (K,), up to LAGS; cached, as a search needs it often."""
    found = np.minimum(np.arange(samples), LAGS)
    found.flags.writeable = False
    return found


def _slices(begins: Sequence[int], end: int) -> list[slice]:
    return [slice(*rows) for rows in zip([0, *begins], [*begins, end], strict=True)]


@quiet
def ready_record(
    structure: Structure, dt: float, preprocess: Preprocess, u: FloatArray, y: FloatArray,
    stamps: FloatArray | None = None, input_hold: str = "zoh", r: FloatArray | None = None,
) -> Record:  # fmt: skip
    """Return a prepared record: mapped, samples without an input dropped, working point subtracted."""
    mapped = preprocess.map_input(u)
    accepted, measured = screen(mapped, np.zeros(y.size))[0], screen(mapped, y)[0]
    # samples before the first output and after the last one carry no information
    accepted &= np.logical_or.accumulate(measured) & np.logical_or.accumulate(measured[::-1])[::-1]
    if not structure.bias:  # the constant estimated with G(s) corrects an error of the mean
        preprocess = centre(preprocess, u, y)
    regular = stamps is None and bool(accepted.all())
    clock = np.arange(u.size) * dt if stamps is None else stamps
    # dropped samples lengthen the intervals: the filters are exact for the elapsed time
    intervals = np.array([dt]) if regular else np.diff(clock[accepted], prepend=clock[accepted][:1] - dt)
    u, y = mapped[accepted] - float(preprocess.input_offset), y[accepted] - float(preprocess.output_offset)
    measured = measured[accepted]
    if r is not None:
        r = r[accepted]
        known = np.isfinite(r)
        measured = measured & known
        r = np.interp(np.arange(r.size), np.flatnonzero(known), r[known]) if known.any() else r
    return Record(
        u, np.where(measured, y, 0.0), intervals, input_hold, r,
        usual=math.inf if regular else dt, measured=None if measured.all() else measured,
    )  # fmt: skip
