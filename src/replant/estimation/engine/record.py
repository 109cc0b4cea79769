"""Record: samples made ready for an estimator, mapped, usable, working point taken off."""

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
SAME = 1e-9  # part of an interval that is rounding [ratio]

GAP = 3.5
"""Interval without a sample, beside the usual one and its neighbours, after which the state is unknown [ratio].
Origin: of a resonant plant under 5 % of noise, its binary input held for five samples, three lost in a row once in a
hundred samples made the largest error of a coefficient 1.7 %, five 8.5 %, and 0.4 % where the state behind them is
estimated; without lost samples it is 0.3 %.  Single samples lost at random, a tenth of all: 2.7 % either way.
Sensitivity: halved, no verdict changes, and no error by a quarter; doubled, nothing changes on these records.
"""

MOST_GAPS = 500  # gaps that part a record, the longest ones of them: each costs a pass over its part [count]


def gaps_of(intervals: FloatArray, usual: float) -> IntArray:
    """Return the samples (G,) that follow a gap: the input of the meantime is not known, and so is the state."""
    if intervals.size < 2:
        return np.zeros(0, np.int64)
    steps = np.concatenate([[usual] * 2, intervals[1:], [usual] * 2])
    # three samples that come more slowly have a rate of their own; two gaps may have one sample between them
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
    """A record made ready: mapped input and output, working point taken off, unusable samples dropped."""

    u: FloatArray  # (K,)
    y: FloatArray  # (K,)
    intervals: FloatArray  # (1,) or (K,): time since the sample before, in s: one for all, or one each
    input_hold: str = "zoh"
    r: FloatArray | None = None  # (K,): the reference, where there is one
    before: Record | None = None  # the samples before it, whose inputs still act on it because of a dead time
    # usual interval in s of a record whose gaps part it, see `gaps_of`; infinite where none does
    usual: float = math.inf
    # (K,): which outputs were measured, None for all; in place of others, ``y`` a guess, the model's own output drives
    # the filters, and nothing is learned from them
    measured: BoolArray | None = None
    begins: tuple[int, ...] = ()  # samples at which another record begins: its offset and initial state are its own
    rest: int = 0  # samples at the beginning that are none of the log's: the rest that was put before it

    @property
    def count(self) -> int:
        """How many outputs were measured."""
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
        """How many outputs before each (K,) were measured a sampling time apart, up to LAGS; jitter counts as none."""
        if self.measured is None:
            return self._unbroken
        return np.minimum(in_a_row(self.measured, self._breaks), LAGS)

    @cached_property
    def _unbroken(self) -> IntArray:
        """How many outputs before each (K,) came a sampling time apart, measured or not, up to LAGS."""
        if self.intervals.size == 1 and not self.begins:
            return _predecessors(self.u.size)
        since = since_break(self._breaks)
        return np.minimum(since, LAGS, out=since)

    def whitened(self, noise: Autoregression, signals: FloatArray) -> FloatArray:
        """Return D(q) x of ``signals`` (K, ...) along the first axis, weighted where the past is not known."""
        white = noise.whiten_known(signals, self._unbroken)
        missing = np.flatnonzero(~self.is_measured)
        # an output not measured is whatever makes the result least: the likelihood is exact
        return noise.without_unknown(white, self._unbroken, missing) if noise.order and missing.size else white

    @property
    def inputs_before(self) -> IntArray:
        """How many inputs before each (K,) came a sampling time apart; jitter counts as none."""
        return since_break(self._breaks)

    @property
    def _breaks(self) -> BoolArray:
        """Which samples (K,) begin a record, or come at another interval than usual, by more than jitter."""
        from replant.kernels.filters.whitening import JITTER

        broken = np.zeros(self.u.size, bool)
        broken[:1] = True
        broken[list(self.begins)] = True
        if self.intervals.size > 1:
            nominal = float(np.median(self.intervals[1:]))
            broken |= np.abs(self.intervals - nominal) > JITTER * nominal
        return broken

    @cached_property
    def parts(self) -> list[slice]:
        """The stretches between gaps and records; at the beginning of each the state is unknown."""
        gaps = gaps_of(self.intervals, self.usual).tolist() if math.isfinite(self.usual) else []
        return _slices(sorted({*gaps, *self.begins}), self.u.size)

    def nuisances_beside(self, poles: int, *, bias: bool) -> int:
        """Return how many initial states and offsets are unknown beside those that the record begins with."""
        others = self.parts[1:]
        return sum(min(rows.stop - rows.start, poles + (rows.start in self.begins and not bias)) for rows in others)

    def answers(self, delay: float) -> BoolArray:
        """Return which outputs (K,) answer to inputs of their own part, with a dead time in s."""
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
        """Return the samples that answer to inputs of the record, those before as `before`; at least the newest."""
        unknown = min(self.unknown(delay), self.u.size - 1)
        if unknown <= 0:
            return self
        return replace(self.last(self.u.size - unknown), before=self.first(unknown))

    @property
    def restored(self) -> tuple[Record, IntArray]:
        """The record with rows that were lost, the input on a straight line, and where its samples (K,) are in that."""
        if self.intervals.size == 1:
            return self, np.arange(self.u.size)
        steps = self.intervals / float(np.median(self.intervals[1:]))
        steps[[0, *(rows.start for rows in self.parts)]] = 0.0
        # what lies in a gap stays lost
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
        """The record, where several were joined, with the means of each taken off input and output."""
        u, y, told = self.u.copy(), self.y.copy(), self.is_measured
        for rows in self.records:
            u[rows] -= u[rows].mean()
            if told[rows].any():
                y[rows] = np.where(told[rows], y[rows] - y[rows][told[rows]].mean(), y[rows])
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
        """Return how many samples at the beginning answer to inputs before the record, with a dead time in s."""
        if self.intervals.size == 1:
            return min(unknown_outputs(delay, float(self.intervals[0])), self.u.size)
        since = np.cumsum(self.intervals) - self.intervals[0]
        return int(np.count_nonzero(delay - since > SAME * self.intervals))

    def since_first(self, sample: int) -> float:
        """Return how long after the first sample of the log another one came, in s."""
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
        """Mean interval in s, gaps left out."""
        if not math.isfinite(self.usual) or len(self.parts) == 1:
            return self.span / (self.u.size - 1)
        within = [self.intervals[rows][1:] for rows in self.parts]
        return float(np.concatenate(within).mean()) if any(each.size for each in within) else self.usual


@lru_cache(maxsize=2)
def _predecessors(samples: int) -> IntArray:
    """Return how many samples came before each one (K,), up to LAGS; of a search it is asked again and again."""
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
    """Return a raw record made ready: mapped, samples without an input dropped, working point taken off."""
    mapped = preprocess.map_input(u)
    accepted, measured = screen(mapped, np.zeros(y.size))[0], screen(mapped, y)[0]
    # before the first output and behind the last nothing is told
    accepted &= np.logical_or.accumulate(measured) & np.logical_or.accumulate(measured[::-1])[::-1]
    if not structure.bias:  # the constant beside G(s) takes up what the mean leaves
        preprocess = centre(preprocess, u, y)
    regular = stamps is None and bool(accepted.all())
    clock = np.arange(u.size) * dt if stamps is None else stamps
    # where samples are dropped the intervals grow: the filters are exact for the time that passed
    intervals = np.array([dt]) if regular else np.diff(clock[accepted], prepend=clock[accepted][:1] - dt)
    u, y = mapped[accepted] - float(preprocess.input_offset), y[accepted] - float(preprocess.output_offset)
    measured = measured[accepted]
    if r is not None:
        r = r[accepted]
        told = np.isfinite(r)
        measured = measured & told
        r = np.interp(np.arange(r.size), np.flatnonzero(told), r[told]) if told.any() else r
    return Record(
        u, np.where(measured, y, 0.0), intervals, input_hold, r,
        usual=math.inf if regular else dt, measured=None if measured.all() else measured,
    )  # fmt: skip
