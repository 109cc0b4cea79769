"""Search over the structures of several inputs, one input at a time, judged by the same evidence as for one input.

All numbers of poles, zeros and dead times of q inputs are too many to try.  The search begins at the smallest structure
of each input.  In turn it changes one input alone: its dead time along the grid, a pole or a zero more or fewer, each
with the neighbouring dead times.  It ends when no change of one input raises the evidence.

If a structure is wrong, an autoregression explains its error as noise: with little noise in the record it predicts a
smooth error almost as well as a right structure does, and the evidence does not discriminate.  As long as this holds
for all trials (`differs`), they are judged by their errors without a noise model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError
from replant.estimation.engine.record import Record
from replant.estimation.simulation.miso import Point, Row, evaluate
from replant.estimation.solver.miso_steps import start
from replant.estimation.solver.solve import leaving_out, suspected
from replant.estimation.solver.undetermined_poles import grown
from replant.fitting.miso_fit import fit_row, ready_row
from replant.fitting.miso_solve import covariance_of, differs, likeliest, with_outside
from replant.fitting.samples import Samples
from replant.fitting.search_result import ALPHA, Candidate, SearchResult, likeliest_between
from replant.fitting.structure_evidence import Evidence, Judged, least_known
from replant.kernels.schema import Doubt
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.linear_algebra import chi2_quantile, quiet

Structures = tuple[Structure, ...]


@dataclass(frozen=True, eq=False)
class Options:
    """The sizes and dead times that may be tried for one input, ascending."""

    sizes: list[tuple[int, int]]  # numbers of poles and zeros
    delays: list[float]

    def beside(self, size: tuple[int, int]) -> list[tuple[int, int]]:
        """Return the sizes with a pole, a zero or both more or fewer."""
        n, m = size
        poles = sorted({k for k, _ in self.sizes})
        place = poles.index(n)
        larger = [(k, zeros) for zeros in (m, m + 1) for k in poles[place + 1 : place + 2]]
        smaller = [(k, min(m, k - 1)) for k in poles[max(place - 1, 0) : place]]
        return [each for each in (*larger, (n, m + 1), (n, m - 1), *smaller) if each in self.sizes]

    def nearest(self, delay: float) -> int:
        """Return the index of the dead time nearest to another one."""
        return int(np.argmin(np.abs(np.array(self.delays) - delay)))


@dataclass(frozen=True, eq=False)
class Trial(Judged):
    """Structures fitted to a record."""

    structures: Structures
    row: Row
    point: Point

    def candidate(self, span: float) -> Candidate:
        """Return the trial as a `Candidate`."""
        theta, covariance = self.point.theta, covariance_of(self.row, self.point)
        each = zip(self.structures, self.row.places, strict=True)
        uncertainty = max(least_known(one, theta[rows], covariance[rows, rows], span) for one, rows in each)
        return Candidate(self.structures, self.fit, self.likelihood, -2.0 * self.evidence, uncertainty)


class _Search:
    """Tries structures on one record, and keeps the trials."""

    def __init__(
        self, record: Record, inputs: FloatArray, options: Sequence[Options], say: Callable[[int], None]
    ) -> None:
        self.record, self.inputs, self.options, self._say = record, inputs, options, say
        self._found: dict[Structures, tuple[Trial, Trial] | None] = {}  # without a noise model, and with one
        self._is_told = False  # whether the noise model of some trial explains nothing but noise
        self._evidence = Evidence(record, at_rest=False)
        # a trial cannot win if it is behind by more than all its parameters gain by chance
        self._reach = chi2_quantile(1.0 - ALPHA, sum(max(each.sizes)[0] * 2 + 1 for each in options))

    def found(self) -> Trial:
        """Return the chosen trial; its dead times may lie between points of the grid."""
        first = tuple(Structure(*each.sizes[0], each.delays[0]) for each in self.options)
        best = self._try(first)
        if best is None:
            raise InvalidArgumentError("no structure of the grid explains this record: do the inputs move the output?")
        while True:
            best = before = max(self.tried.values(), key=lambda trial: trial.evidence)
            for i in range(len(self.options)):
                best = self._along_delays(best, i)
                for size in self.options[i].beside((best.structures[i].poles, best.structures[i].zeros)):
                    best = max(best, self._of_size(best, i, size), key=lambda trial: trial.evidence)
            if best is before:
                return self._on_grid(best)

    @property
    def tried(self) -> dict[Structures, Trial]:
        """The trials that led to a model."""
        return {structures: each[self._is_told] for structures, each in self._found.items() if each is not None}

    def _of_size(self, best: Trial, i: int, size: tuple[int, int]) -> Trial:
        """Return the best trial with another number of poles and zeros of an input, or the given one."""
        trial = self._try(_with(best.structures, i, Structure(*size, best.structures[i].delay)), best)
        if trial is None or trial.evidence < best.evidence - self._reach:
            return best
        return self._along_delays(trial, i)

    def _along_delays(self, trial: Trial, i: int) -> Trial:
        """Return the best trial of the dead times of an input: along the grid, then between its points."""
        delays, begin = self.options[i].delays, self.options[i].nearest(trial.structures[i].delay)
        best = self._at(trial, i, delays[begin]) or trial
        for steps in (range(begin - 1, -1, -1), range(begin + 1, len(delays))):
            last = trial
            for k in steps:
                other = self._at(last, i, delays[k])
                if other is None or (other.evidence < last.evidence and other.evidence < best.evidence - self._reach):
                    break
                best, last = max(best, other, key=lambda each: each.evidence), other
        return max(trial, best, self._between(best, i), key=lambda each: each.evidence)

    def _between(self, best: Trial, i: int) -> Trial:
        """Return the likeliest trial between the neighbours of a point of the grid."""
        delays, k = self.options[i].delays, self.options[i].nearest(best.structures[i].delay)
        low, high = delays[max(k - 1, 0)], delays[min(k + 1, len(delays) - 1)]
        found = {delay: self._at(best, i, delay) for delay in {low, delays[k], high}}
        trials = {delay: trial for delay, trial in found.items() if trial is not None}
        if not high > low:
            return trials[low]
        return likeliest_between(trials, low, high, self.record.dt, lambda delay, beside: self._at(beside, i, delay))

    def _on_grid(self, best: Trial) -> Trial:
        """Return the best trial with the grid's dead times, except those between that are worth their price."""
        for i, each in enumerate(self.options):
            stays = self._at(best, i, each.delays[each.nearest(best.structures[i].delay)]) or best
            paid = best.likelihood - stays.likelihood > 0.5 * math.log(self.record.u.size)
            best = best if paid else stays
        return best

    def _at(self, trial: Trial, i: int, delay: float) -> Trial | None:
        return self._try(_with(trial.structures, i, replace(trial.structures[i], delay=delay)), trial)

    def _try(self, structures: Structures, beside: Trial | None = None) -> Trial | None:
        if structures not in self._found:
            self._found[structures] = found = self._fitted(structures, beside)
            self._is_told |= found is not None and found[0] is found[1]
            self._say(len(self._found))
        return self.tried.get(structures)

    @quiet
    def _fitted(self, structures: Structures, beside: Trial | None) -> tuple[Trial, Trial] | None:
        """Return the trials without and with noise model, from another trial, or new starts if its poles differ."""
        row = Row(structures, self.record, self.inputs)
        size = sum(each.size for each in structures)
        if row.count <= size + row.nuisances:
            return None
        white, begins = Autoregression.white(1.0, row.count), []
        if beside is None or any(a.poles != b.poles for a, b in zip(structures, beside.structures, strict=True)):
            begins = start(structures, self.record, self.inputs)
        if beside is not None and all(a.poles <= b.poles for a, b in zip(beside.structures, structures, strict=True)):
            parts = zip(beside.structures, beside.row.branches(beside.point.theta), structures, strict=True)
            theta = np.concatenate([grown(less, theta, more, row.dt) for less, theta, more in parts])
            begins = [*begins, evaluate(row, theta, white)] if row.is_stable(theta) else begins
        if not begins:
            return None
        free, point, noise, *_ = likeliest(row, begins, lambda noise: [])
        found = self._judged(row, point, whitened=True)
        if found is None or not noise.order or not differs(row, free, point):
            return None if found is None else (found, found)  # the noise model explains nothing but noise
        plain = self._judged(row, free, whitened=False)
        return None if plain is None else (plain, found)

    def _judged(self, row: Row, point: Point, *, whitened: bool) -> Trial | None:
        error, explained = np.zeros(self.record.u.size), np.zeros(self.record.u.size, bool)
        for stretch, residual in zip(row.stretches, point.residual, strict=True):
            error[stretch.rows], explained[stretch.rows] = residual, stretch.measured
        if not (np.isfinite(error).all() and explained.any()):
            return None
        numbers = sum(each.size + each.poles + bool(each.delay) for each in row.structures)
        judged = self._evidence.judged(error, explained, numbers, whitened=whitened)
        return Trial(*judged, row.structures, row, point)


def _with(structures: Structures, i: int, other: Structure) -> Structures:
    return (*structures[:i], other, *structures[i + 1 :])


def _orders(structures: Structures) -> list[tuple[Any, ...]]:
    return [tuple(getattr(each, name) for each in structures) for name in ("poles", "zeros", "delay")]


def search_rows(given: Samples, options: Sequence[Options], progress: Callable[[int, int], None]) -> SearchResult:
    """Return the result of a search that changes the structure of one input at a time."""
    smallest = tuple(Structure(*each.sizes[0], max(each.delays)) for each in options)
    ready, _, references, _ = ready_row(given, *_orders(smallest))
    ready, _ = with_outside(ready, references, ["u"] * len(options))
    inputs = ready.inputs if ready.outside is None else ready.outside.inputs
    count = sum(len(each.sizes) + len(each.delays) for each in options)

    def say(done: int) -> None:
        progress(min(done, count - 1), count)

    record = leaving_out(ready.record, suspected(ready.record, ready.inputs))
    for _ in range(2):
        sweep = _Search(record, inputs, options, say)
        chosen = sweep.found()
        best = fit_row(given, *_orders(chosen.structures))
        bad = np.zeros(ready.used.size, bool)
        bad[best.outliers] = bad[best.stuck] = True
        measured = ready.record.is_measured & ~bad[ready.used]
        again = leaving_out(ready.record, np.where(measured, Doubt.NONE, Doubt.MISSING))
        if (again.is_measured == record.is_measured).all():
            break
        record = again  # and again, without outputs that are bad by this model
    progress(count, count)
    candidates = {
        key: trial.candidate(record.span)
        for key, trial in sweep.tried.items()
        if all(each.delay in of.delays for each, of in zip(key, options, strict=True))
    }
    between = chosen.structures not in candidates
    candidates.setdefault(chosen.structures, chosen.candidate(record.span))
    return SearchResult(best, candidates[chosen.structures], tuple(candidates.values()), between)
