"""The state of an identification of several inputs, and its changes by samples.

Each time that the record, or the number of moves of an input, has grown by `AGAIN`, the record is solved again as a
whole, from the present estimate.  Other models that may be as likely are also kept: in a short record a fast branch can
replace a slow one.  Each time that the moves of an input have doubled since the last solution from new initial models,
the record is solved from new ones again if the noise had a colour then, which may be a slow branch, or if there are
findings against the solution from the estimate or against that earlier one.

A recursion follows the samples in between.  The record is tested for a change each time that it has grown by `LOOK`,
and at growing counts after its innovations have grown.  A load gives new offsets and initial states; after a change of
the plant the record begins anew.

Nothing is changed in place: each sample makes a new state, so that an interrupt leaves the state before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np

from replant.estimation.engine.dimensions import RECENT
from replant.estimation.engine.record import GAP
from replant.estimation.simulation.miso import Row, RowRecord, evaluate
from replant.estimation.solver.miso_change import Judge, find_change, plant_change
from replant.estimation.solver.record_changes import may_have_loads
from replant.estimation.solver.solve import leaving_out, suspected
from replant.estimation.solver.srivc_steps import SOONEST
from replant.fitting.miso_solve import Begins, RowEstimate, RowSolution, solve_with
from replant.fitting.parted_record import solve_parted_row
from replant.kernels.schema import Supposition
from replant.numerics.arguments import FloatArray
from replant.numerics.linear_algebra import quiet
from replant.numerics.robust import last_known
from replant.online.change_response import AGAIN
from replant.online.miso_recursion import RowRecursion
from replant.online.miso_samples import (
    REASONS,
    RowClock,
    RowHistory,
    RowSamples,
    RowSettings,
    Screened,
)
from replant.verdict.miso_certainty import unsure, untold
from replant.verdict.miso_tests import lacking
from replant.verdict.verdict import Finding

# at each solution, and once in between
LOOK = math.sqrt(AGAIN)  # growth of the record, as far as it is used, after which it is tested for a change [ratio]

# the oldest of them is from half of the record
JUDGES = math.ceil(math.log(2.0) / math.log(AGAIN))  # newest solutions that are used to test for a change [count]


@dataclass(frozen=True, eq=False)
class RowState:
    """The whole state of an identification."""

    settings: RowSettings
    kept: RowHistory
    solve_at: int  # samples (before the first model: outputs) at which the record is solved again; 0: never
    samples: int = 0  # accepted so far
    solved_at: int = 0  # length of the record when it was last solved
    started_at: int = 0  # length of the record when it was last solved from new initial models
    is_sure: bool = False  # whether that solution had white noise and no findings
    look_at: int = 0  # samples at which the record is tested for a change; 0: never
    record_began: int = 0  # samples before the record, which is of one plant
    loads: tuple[int, ...] = ()  # samples before each load, which begins with new offset and initial states
    rejected: dict[str, int] = field(default_factory=lambda: dict.fromkeys(REASONS, 0))
    stamped: bool | None = None  # whether samples come with a time stamp; None before the first
    clock: RowClock = field(default_factory=RowClock)
    adapts: bool = True
    recursion: RowRecursion | None = None  # None before the first model
    rivals: tuple[FloatArray, ...] = ()  # other models (P,) that may be as likely as the last solution
    judges: tuple[Judge, ...] = ()  # the last solutions of the record, the newest last
    findings: tuple[Finding, ...] = ()  # of the last solution
    of_references: tuple[Finding, ...] = ()  # findings on references of the last solution

    @classmethod
    def of(cls, settings: RowSettings) -> RowState:
        """Return the state before the first sample."""
        rows = np.empty((0, len(settings.structures) + 2))
        return cls(settings, RowHistory(rows, settings.history), settings.startup)

    @property
    def taken(self) -> int:
        """Number of samples given so far, with rejected ones."""
        return self.samples + sum(self.rejected.values()) - self.rejected["no output"]

    @property
    def unit(self) -> float:
        """The unit in s of the times that are kept, see `Screened`."""
        return 1.0 if self.stamped else self.settings.dt

    @property
    def last_time(self) -> float:
        """The newest time kept, -inf before the first."""
        return float(self.kept.values[-1, -1]) if self.samples else -math.inf

    @property
    def references(self) -> int:
        """Number of references with each sample; 0 before the first sample."""
        return int(self.kept.rows.shape[1]) - len(self.settings.structures) - 2

    @property
    def parameters(self) -> FloatArray:
        """The estimate (P,); zero before the first one."""
        return np.zeros(self.settings.size) if self.recursion is None else self.recursion.parameters

    @property
    def was_frozen(self) -> bool:
        """Whether the estimate is or was frozen, after which there are no tests for a change."""
        return self.recursion is not None and not self.look_at

    @cached_property
    def closest(self) -> float:
        """The shortest interval in s, see `RowSettings`."""
        return self.settings.closest

    @property
    def due(self) -> int:
        """Samples (before the first model: outputs) of the next solution or test for a change; 0: never."""
        return min((each for each in (self.solve_at, self.look_at) if each), default=0)

    @property
    def length(self) -> int:
        """Length of the record in samples."""
        return self.samples - self.record_began

    @property
    def newest_rows(self) -> FloatArray:
        """The newest samples (K, q + p + 2) of the record, as many as the verdict uses."""
        return self.kept.values[-min(self.length, RECENT) :]

    @property
    def newest_intervals(self) -> FloatArray:
        """The intervals (K,) in s before each of them."""
        clock = self.newest_rows[:, -1]
        return np.diff(clock, prepend=clock[:1] - self.settings.dt / self.unit) * self.unit

    @quiet
    def take(self, given: RowSamples, errors: FloatArray, estimates: FloatArray) -> tuple[RowState, int]:
        """Take samples up to the next solution, test or alarm; return the state after them and their number."""
        # errors (K,), which are NaN, and estimates (K, P) are written
        if self.clock.held:
            return self._with_held(given, errors, estimates)
        given = given._replace(y=np.where(np.isfinite(given.r).all(axis=1), given.y, np.nan))
        if given.t is None:
            given = given.each_in_time(self.taken, self.kept.values[-math.ceil(GAP) :])
        u, y, t, r = given
        dt, is_first, is_alarm = self.settings.dt, self.recursion is None, False
        last = self.last_time
        done = Screened.of(self.clock, given, self.taken, last, dt, self.closest)
        counted = done.is_taken & np.isfinite(y) if is_first else done.is_taken
        is_now = done.is_taken & ~done.is_believed  # one held back is taken with its successor
        before, due = self.kept.measured if is_first else self.samples, self.due
        reached = np.flatnonzero((np.cumsum(counted) >= due - before) & is_now) if due else np.zeros(0, int)
        end = int(reached[0]) + 1 if reached.size else y.size
        if end < y.size:  # screened again, as the clock must be that after these samples
            return self.take(given.part(slice(end)), errors, estimates)
        rejected = {name: self.rejected[name] + int(each.sum()) for name, each in done.turned_away.items()}
        rows = np.flatnonzero(done.is_taken)
        r = self._held(r[rows])
        kept = self.kept if self.samples else RowHistory(np.empty((0, u.shape[1] + r.shape[1] + 2)), self.kept.most)
        kept = kept.with_more(np.column_stack([u[rows], r, y[rows], done.times[rows]]))
        stamped = t is not None if rows.size else self.stamped
        new = replace(
            self, kept=kept, samples=self.samples + rows.size, rejected=rejected, stamped=stamped, clock=done.clock
        )
        estimates[:end] = self.parameters
        if self.recursion is not None and rows.size:
            intervals = np.diff(done.times[rows], prepend=last) * new.unit
            recursion, errors[rows], after, alarm = self.recursion.take(
                u[rows], y[rows], r, intervals, learns=self.adapts
            )
            is_alarm = alarm < rows.size and self.look_at > 0
            if is_alarm and (stop := int(rows[alarm] + np.argmax(is_now[rows[alarm] :])) + 1) < end:
                errors[:] = np.nan
                return self.take(given.part(slice(stop)), errors, estimates)
            errors[:end][done.is_believed] = np.nan  # nothing was predicted while it waited
            newest = np.maximum.accumulate(np.where(is_now, np.cumsum(done.is_taken) - 1, -1))  # taken by then
            estimates[:end][newest >= 0] = after[newest[newest >= 0]]
            new = replace(new, recursion=recursion)
            if is_alarm:
                new = replace(new, look_at=min(new.look_at, new.samples + max(SOONEST - recursion.surprising, 0)))
        if reached.size or is_alarm:
            new = new._attended()
            estimates[end - 1] = new.parameters
        return new, end

    def _with_held(self, given: RowSamples, errors: FloatArray, estimates: FloatArray) -> tuple[RowState, int]:
        """Take the sample held back again, with the others after it."""
        u, y, t, r = given
        assert t is not None, "a sample waits for the next stamp"
        inputs, row = u.shape[1], np.array(self.clock.held)
        given = RowSamples(
            np.vstack([row[:inputs], u]), np.append(row[-2], y), np.append(row[-1], t), np.vstack([row[inputs:-2], r])
        )
        all_errors, all_estimates = np.full(1 + y.size, np.nan), np.empty((1 + y.size, self.settings.size))
        rejected = self.rejected | {"time leap": self.rejected["time leap"] - 1}
        before = replace(self, clock=self.clock._replace(held=()), rejected=rejected)
        state, end = before.take(given, all_errors, all_estimates)
        errors[: end - 1], estimates[: end - 1] = all_errors[1:end], all_estimates[1:end]
        return state, end - 1

    def take_all(self, rows: list[tuple[float, ...]]) -> RowState:
        """Return the state after rows of inputs, output and time, with no solution or test due at any of them."""
        columns = np.array(rows, np.float64)
        errors, estimates = np.full(len(rows), np.nan), np.empty((len(rows), self.settings.size))
        u, y, t = np.ascontiguousarray(columns[:, :-2]), columns[:, -2].copy(), columns[:, -1].copy()
        given = RowSamples(u, y, t if self.stamped else None, np.empty((len(rows), 0)))
        return self.take(given, errors, estimates)[0]

    def _held(self, r: FloatArray) -> FloatArray:
        """Return references (K, p) with values that are not finite replaced by the last finite one, at first by 0."""
        if not r.size:
            return r
        before = self.kept.values[-1, len(self.settings.structures) : -2] if self.samples else np.zeros(r.shape[1])
        return np.column_stack([last_known(each, value) for each, value in zip(r.T, before, strict=True)])

    def _attended(self) -> RowState:
        """Return the state after the work due: a test for a change, a solution of the record."""
        looks = 0 < self.look_at <= self.samples
        new = self._looked() if looks else self
        tells_more = looks and new.solve_at > 0 and new._has_told(AGAIN, new.solved_at)
        return new.solved() if new.recursion is None or tells_more or 0 < new.solve_at <= new.samples else new

    def _has_told(self, times: float, length: int) -> bool:
        """Return whether the moves of an input are at least ``times`` those in the first ``length`` samples."""
        moves = np.diff(self.kept.values[-self.length :, : len(self.settings.structures)], axis=0) != 0.0
        before, now = (np.count_nonzero(part, axis=0) for part in (moves[: max(length - 1, 0)], moves))
        return bool(np.any((now > 0) & (now >= times * before)))

    def _looked(self) -> RowState:
        """Return the state after a test for a change, and after a solution with the change if there is one."""
        new = replace(self, look_at=self._next_look)
        known = self.recursion
        if known is None or not (self.adapts and np.isfinite(self.newest_rows[:, -2]).any()):
            return new
        if self.references:  # in feedback the joint update may have gone astray
            return new.solved() if known.surprising else new
        ready, row, _ = self.record(RECENT)
        doubt = suspected(ready.record, ready.inputs)
        if doubt.any():
            row = Row(row.structures, leaving_out(row.record, doubt), row.inputs, row.names)
        change = find_change(row, known.parameters_in(row), self.judges)
        if change is None:
            return new._used_to(row)
        at = self.samples - ready.used.size + int(np.flatnonzero(ready.used)[change.begin])
        if change.supposition is Supposition.LOAD:
            began = max(self.record_began, self.samples - len(self.kept.values))  # only kept samples are solved
            loads = (*(each for each in self.loads if each > began), at)
            changed = replace(new, record_began=began, loads=loads).solved()
        else:
            changed = new._begun_at(at).solved()
        if changed.recursion is self.recursion:  # no model was found with the change
            return new
        return replace(changed, look_at=changed._next_look)

    def _begun_at(self, at: int) -> RowState:
        """Return the state with a record that begins after ``at`` samples, where the plant has changed."""
        return replace(
            self, record_began=at, loads=(), solved_at=0, started_at=0, is_sure=False, rivals=(), judges=()
        )  # fmt: skip

    def _used_to(self, row: Row) -> RowState:
        """Return the state with a larger usual variance of innovations if no change explains them for long enough."""
        known = self.recursion
        if known is None or known.surprising < self.settings.startup or not row.stretches:
            return self
        point = evaluate(row, known.parameters_in(row), known.noise)
        used = known.used_to(point, row.stretches[-1], known.surprising)
        return replace(self, recursion=used, look_at=replace(self, recursion=used)._next_look)

    @property
    def _next_look(self) -> int:
        surprising = 0 if self.recursion is None else self.recursion.surprising
        length = surprising or min(self.length, RECENT)
        return self.samples + max(math.ceil((LOOK - 1.0) * length), SOONEST)

    @quiet
    def solved(self, *, afresh: bool = False) -> RowState:
        """Return the state after a solution of the record, if possible, with the time of the next one."""
        whole, starting = self.length <= len(self.kept.values), self.recursion is None
        later = math.ceil(AGAIN * (self.kept.measured if starting else self.length))
        solve_at = self.record_began + later if later <= RECENT or starting else 0
        new = replace(self, solve_at=solve_at, solved_at=self.length)
        if not (self.adapts and whole):
            return new
        ready, row, references = self.record()
        if row.count <= row.nuisances + self.settings.size:
            return new
        known, settings = self.recursion, self.settings
        present = None if known is None else known.parameters_in(row)
        present = present if present is not None and row.is_stable(present) else None
        solve = partial(solve_with, settings.structures, ready, references, settings.input_names)
        begins = Begins() if known is None or present is None else Begins(known.noise, (present, *self.rivals))
        afresh = afresh or present is None
        done = solve(partial(begins.afresh, also_white=True) if afresh else begins.there)
        is_asked = not afresh and self._has_told(2.0, self.started_at)
        settled = is_asked and _is_settled(done[1]) and not self.rivals
        if is_asked and not (self.is_sure and settled):
            if done[1] is not None:
                found = done[1].found
                begins = Begins(found.noise, (found.point.theta, *found.rivals))
            newest = settings.startup if settled and not _is_white(done[1]) else None
            done, afresh = solve(partial(begins.afresh, newest=newest)), True
        if afresh:
            new = replace(new, started_at=self.length, is_sure=_is_white(done[1]) and _is_settled(done[1]))
        if RECENT < later <= settings.history and not _is_known(done[1]):  # e.g. an input has not moved yet
            new = replace(new, solve_at=self.record_began + later)
        return new._with(*done)

    def _with(self, ready: RowRecord, solution: RowSolution | None, of_references: tuple[Finding, ...]) -> RowState:
        """Return the state with a solution of its record; unchanged if there is none."""
        if solution is None:
            return self
        return replace(
            self, recursion=self._behind(ready, solution.row, solution.found), findings=solution.found.findings,
            of_references=of_references, look_at=self.look_at or self._next_look, rivals=solution.found.rivals,
            judges=(*self.judges, Judge(solution.found.point.theta, solution.found.noise))[-JUDGES:],
        )  # fmt: skip

    @quiet
    def finished(self) -> RowState:
        """Return the state after all samples kept are solved as `fit` does."""
        done = self.solved(afresh=True)
        # later samples may refute a change, and a record that one model does not explain may contain one
        is_asked = self.record_began or self.loads
        if not is_asked and done.recursion is not None:
            is_asked = may_have_loads(done.record()[1], done.parameters, of_plant=True)
        return self._parted() or done if is_asked else done

    def _parted(self) -> RowState | None:
        """Return the state by all samples kept, divided at loads, or since a new plant; None if nothing is gained."""
        if self.references or not self.adapts or self.length > len(self.kept.values):
            return None
        whole = replace(self, record_began=self.samples - len(self.kept.values), loads=())
        ready, row, _ = whole.record()
        began = int(np.count_nonzero(ready.used[: self.record_began - whole.record_began]))
        if began:
            record = leaving_out(replace(ready.record, begins=(began,)), suspected(ready.record, ready.inputs))
            if plant_change(Row(row.structures, record, row.inputs, row.names), began, self.parameters, self.judges):
                return None
        loads = tuple(int(np.count_nonzero(ready.used[: at - whole.record_began])) for at in self.loads)
        found = solve_parted_row(row.structures, ready, None, row.names, loads)
        places = whole.record_began + np.flatnonzero(ready.used)
        if found.plant is not None:
            return self._begun_at(int(places[found.plant.begin])).solved(afresh=True)
        if found.solution is None:
            return None
        loads = tuple(places[list(found.loads)].tolist())
        return replace(whole, solved_at=whole.length, loads=loads)._with(ready, found.solution, ())

    def _behind(self, ready: RowRecord, row: Row, found: RowEstimate) -> RowRecursion:
        """Return the recursion after a solution, with the samples after its last stretch taken."""
        recursion = RowRecursion.of(row, found, ready.level, self.settings.startup)
        end = int(np.flatnonzero(ready.used)[row.stretches[-1].rows.stop - 1]) + 1
        kept = self.kept.values[-ready.used.size :]
        rest = kept[end:]
        if not len(rest):
            return recursion
        intervals = np.diff(kept[end - 1 :, -1]) * self.unit
        inputs = len(self.settings.structures)
        return recursion.take(rest[:, :inputs], rest[:, -2], rest[:, inputs:-2], intervals)[0]

    def record(self, most: int | None = None) -> tuple[RowRecord, Row, FloatArray | None]:
        """Return the kept samples of the record, or the newest ``most``, prepared, with row and references."""
        values, settings = self.kept.values, self.settings
        values = values[-min(self.length, len(values) if most is None else most) :]
        first = self.samples - len(values)
        begins = tuple(at - first for at in self.loads if at > first)
        inputs = len(settings.structures)
        u, y, times = values[:, :inputs].copy(), values[:, -2].copy(), values[:, -1]
        is_regular = not self.stamped and times[-1] - times[0] == len(times) - 1  # no sample among them was rejected
        stamps = None if is_regular else times * self.unit
        ready = RowRecord.of(u, y, settings.dt, stamps, settings.input_hold, begins)
        references = values[ready.used, inputs:-2] if self.references else None
        return ready, Row(settings.structures, ready.record, ready.inputs, settings.input_names), references


def _is_settled(solution: RowSolution | None) -> bool:
    """Return whether there is no finding against a solution that other initial models may remove."""
    if solution is None:
        return False
    row, found, _ = solution
    findings = [*found.findings, *untold(row, found.point, found.covariance)]
    return not (findings or any(lacking(row, found.point, found.noise)))


def _is_known(solution: RowSolution | None) -> bool:
    """Return whether a solution is settled, and each transfer function known well."""
    if solution is None or not _is_settled(solution):
        return False
    row, found, _ = solution
    return all(each.status == "trusted" for each in unsure(row, found.point, found.covariance))


def _is_white(solution: RowSolution | None) -> bool:
    """Return whether the noise is white; the autoregression of coloured noise may contain a slow branch."""
    return solution is not None and solution.found.noise.order == 0
