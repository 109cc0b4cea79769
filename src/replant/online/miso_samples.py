"""Samples of several inputs: settings, acceptance by the same rules as for one input, and the samples kept."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from replant.estimation.engine import record
from replant.estimation.engine.dimensions import ring_of
from replant.estimation.engine.state import GAP
from replant.kernels.schema import FARTHEST, LARGEST, LEAP, MOST_EARLIER
from replant.model.structure import Structure
from replant.numerics.arguments import BoolArray, FloatArray, IntArray
from replant.numerics.robust import last_known

LEAST = 4  # least outputs for the first model [count for each unknown]
ROOM = 256  # rows that are allocated at first [samples]
# fate of a sample; one that leaps is accepted as BELIEVED when its successor is taken
TAKEN, BELIEVED, UNUSABLE, NOT_LATER, LEAPS, TOO_COARSE, TOO_DENSE = range(7)
REASONS = "not finite", "too large", "not later", "time leap", "time too coarse", "too dense", "no output"


class RowSettings(NamedTuple):
    """The settings of an identification: sampling time in s; outputs for the first model; raw samples kept; names."""

    structures: tuple[Structure, ...]
    dt: float
    startup: int
    history: int
    input_hold: str
    input_names: tuple[str, ...]

    @property
    def size(self) -> int:
        """Number of parameters, P."""
        return sum(each.size for each in self.structures)

    @property
    def closest(self) -> float:
        """The shortest interval in s with which the past inputs kept cover every dead time."""
        return max(each.delay / (ring_of(each, self.dt) - 2) for each in self.structures)


def fewest(structures: tuple[Structure, ...]) -> int:
    """Return the fewest outputs for a first model: `LEAST` for each coefficient, initial state and offset."""
    return LEAST * sum(each.size + each.poles + 1 for each in structures)


class RowClock(NamedTuple):
    """The state of the check of time stamps."""

    shift: float = 0.0  # added to a stamp to give the time that is kept, since the clock was set [s]
    earlier: int = 0  # stamps in a row that advance, but not beyond the newest one accepted [count]
    earlier_time: float = 0.0  # the last of these [s]
    held: tuple[float, ...] = ()  # the sample whose stamp leaps ahead, until its successor confirms or refutes it

    def judged(
        self, t: FloatArray, usable: BoolArray, last: float, dt: float, closest: float
    ) -> tuple[RowClock, FloatArray, IntArray, int | None]:
        """Return the clock after stamps (K,), the times kept, the fate of each, and the row of one held back."""
        # last: the newest time kept, -inf before the first; a sample held back comes again, before its successor
        times = t + self.shift
        steps = np.diff(times[usable], prepend=last)
        if last > -np.inf and bool(((steps > 0.0) & (steps >= closest) & (steps <= LEAP * dt)).all()):
            clock = self._replace(earlier=0, held=()) if usable.any() else self
            return clock, times, np.where(usable, TAKEN, UNUSABLE), None
        return self._one_by_one(t, usable, last, dt, closest)

    def _one_by_one(
        self, t: FloatArray, usable: BoolArray, last: float, dt: float, closest: float
    ) -> tuple[RowClock, FloatArray, IntArray, int | None]:
        shift, earlier, earlier_time, _ = self
        times, fate, held = t + shift, np.full(t.size, UNUSABLE), None
        for k in np.flatnonzero(usable).tolist():
            now = times[k] = t[k] + shift
            is_later, leaps = now > last, now - last > LEAP * dt
            if (leaps or not is_later) and abs(t[k]) > FARTHEST * dt:
                fate[k] = TOO_COARSE
                continue
            if not is_later:
                earlier = earlier + 1 if earlier > 0 and t[k] > earlier_time else 1
                earlier_time, fate[k] = float(t[k]), NOT_LATER
                if earlier <= MOST_EARLIER:
                    continue
                shift = float(last + 2.0 * GAP * dt - t[k])  # the true interval is unknown: it counts as a gap
                now = times[k] = t[k] + shift
            elif now - last < closest:
                fate[k] = TOO_DENSE
                continue
            elif leaps and last > -np.inf:
                # all stamps of a slow rig may leap by as much
                if held is None or not 0.0 < now - times[held] <= max(LEAP * dt, 2.0 * (times[held] - last)):
                    held, fate[k] = k, LEAPS
                    continue
                fate[held] = BELIEVED
            earlier, held, last, fate[k] = 0, None, now, TAKEN
        return RowClock(shift, earlier, earlier_time), times, fate, held


class RowSamples(NamedTuple):
    """Samples of several inputs."""

    u: FloatArray  # (K, q)
    y: FloatArray  # (K,)
    t: FloatArray | None  # (K,): time stamps in s; None without
    r: FloatArray  # (K, p): p = 0 without references

    def part(self, rows: slice) -> RowSamples:
        """Return some of the samples."""
        return RowSamples(self.u[rows], self.y[rows], None if self.t is None else self.t[rows], self.r[rows])

    def each_in_time(self, taken: int, before: FloatArray) -> RowSamples:
        """Return samples without stamps, of which each takes its time; ``before``: the rows kept, after ``taken``.

        If one lacks an input, the one before lasts, up to a gap after the newest output; from then on the input is
        unknown, so that the sample will be rejected.
        """
        u, y, _, _ = self
        is_known, y = np.abs(u) <= LARGEST, np.where(np.abs(y) <= LARGEST, y, np.nan)
        is_whole = is_known.all(axis=1)
        if is_whole.all():
            return self._replace(y=y)
        y = np.where(is_whole, y, np.nan)
        places, outputs = np.arange(taken, taken + y.size), before[np.isfinite(before[:, -2])]
        newest = np.where(np.isfinite(y), places, outputs[-1, -1] if len(outputs) else -np.inf)
        lasts = places - np.maximum.accumulate(newest) <= record.GAP
        begin = before[-1] if len(before) else np.full(u.shape[1], np.nan)
        known = np.where(is_known, u, np.nan)
        held = np.column_stack(
            [last_known(each, value) for each, value in zip(known.T, begin[: u.shape[1]], strict=True)]
        )
        return self._replace(u=np.where(lasts[:, None], held, known), y=y)


class Screened(NamedTuple):
    """The fate of samples (K,)."""

    clock: RowClock  # after them
    times: FloatArray  # (K,): as they are kept: in s; without stamps, the number of samples given before
    is_taken: BoolArray  # (K,)
    is_believed: BoolArray  # (K,): whether the sample was taken after waiting for its successor
    turned_away: dict[str, BoolArray]  # samples (K,) counted as rejected, by reason

    @classmethod
    def of(cls, clock: RowClock, given: RowSamples, taken: int, last: float, dt: float, closest: float) -> Screened:
        """Screen samples after ``taken`` others and the time ``last``, -inf before the first.

        ``closest``: see `RowSettings`.
        """
        u, y, t, r = given
        signals = np.column_stack([u, np.where(np.isnan(y), 0.0, y)])
        finite, small = np.isfinite(signals).all(axis=1), (np.abs(signals) <= LARGEST).all(axis=1)
        finite = finite if t is None else finite & np.isfinite(t)
        usable = finite & small
        # without stamps a rejected sample takes its time as well
        times, fate = np.arange(taken, taken + y.size, dtype=np.float64), np.where(usable, TAKEN, UNUSABLE)
        if t is not None:
            clock, times, fate, held = clock.judged(t, usable, last, dt, closest)
            if held is not None:
                clock = clock._replace(held=tuple(np.concatenate([u[held], r[held], [y[held], t[held]]]).tolist()))
        is_taken = fate <= BELIEVED
        turned = ~finite, finite & ~small, *(fate == each for each in (NOT_LATER, LEAPS, TOO_COARSE, TOO_DENSE))
        turned_away = dict(zip(REASONS, (*turned, is_taken & np.isnan(y)), strict=True))
        return cls(clock, times, is_taken, fate == BELIEVED, turned_away)


@dataclass(frozen=True, eq=False)
class RowHistory:
    """The newest samples, at most ``most``; rows from ``end`` on are free, or belong to a later history."""

    rows: FloatArray  # (R, q + p + 2): inputs, references, output, time: see `Screened`
    most: int
    begin: int = 0
    end: int = 0

    @property
    def values(self) -> FloatArray:
        """The rows (K, q + p + 2)."""
        return self.rows[self.begin : self.end]

    @property
    def measured(self) -> int:
        """Number of samples with an output."""
        return int(np.isfinite(self.values[:, -2]).sum())

    def with_more(self, rows: FloatArray) -> RowHistory:
        """Return the history with further rows (K, q + p + 2)."""
        room, begin, end = self.rows, self.begin, self.end
        if end + len(rows) > len(room):
            room = np.empty((max(ROOM, 2 * (end - begin + len(rows))), room.shape[1]))
            room[: end - begin] = self.values
            begin, end = 0, end - begin
        room[end : end + len(rows)] = rows
        end += len(rows)
        return RowHistory(room, self.most, max(begin, end - self.most), end)

    def copy(self) -> RowHistory:
        """Return an independent copy."""
        return RowHistory(self.values.copy(), self.most, 0, self.end - self.begin)
