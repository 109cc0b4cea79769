"""The walk over structures: one input is changed at a time, its size and its dead time, judged by the evidence.

All numbers of poles, zeros and dead times of q inputs are too many to try.  The walk begins at the smallest structure
of each input.  In turn it changes one input alone: its dead time along the grid, a pole or a zero more or fewer, each
with the neighbouring dead times.  It ends when no change of one input raises the evidence.  Of one input alone all
numbers of poles and zeros are tried, from small structures to large ones.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np

from replant.errors import InvalidArgumentError
from replant.fitting.search_result import likeliest_between
from replant.fitting.structure_evidence import ALPHA, Evidence, RowEvidence, Structures, Trial, sizes_of
from replant.model.structure import Structure
from replant.numerics.linear_algebra import chi2_quantile
from replant.verdict.evidence import CONSTANT, is_constant


@dataclass(frozen=True, eq=False)
class Options:
    """The sizes and dead times that may be tried for one input, ascending."""

    sizes: list[tuple[int, int]]  # numbers of poles and zeros
    delays: list[float]
    bias: bool = False

    @property
    def structures(self) -> list[Structure]:
        """All of them."""
        return [Structure(*size, delay, self.bias) for size in self.sizes for delay in self.delays]

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


class Walk:
    """Tries structures on one record, and keeps the trials."""

    def __init__(
        self, evidence: Evidence | RowEvidence, options: Sequence[Options], say: Callable[[int], None]
    ) -> None:
        self._evidence, self._options, self._say = evidence, options, say
        self._found: dict[Structures, tuple[Trial, Trial] | None] = {}  # without a noise model, and with one
        self._is_told = False  # whether the noise model of some trial explains nothing but noise
        self._walked: set[int] = set()  # inputs of which all dead times were tried
        # a trial cannot win if it is behind by more than all its parameters gain by chance
        self._reach = chi2_quantile(1.0 - ALPHA, sum(max(each.sizes)[0] * 2 + 1 for each in options))

    @property
    def tried(self) -> dict[Structures, Trial]:
        """The trials that led to a model."""
        return {structures: each[self._is_told] for structures, each in self._found.items() if each is not None}

    def chosen(self) -> Trial:
        """Return the chosen trial, whose dead times may lie between points of the grid."""
        starts = zip_longest(*(each.structures for each in self._options))
        smallest = [each.structures[0] for each in self._options]
        if not any(
            self._try(tuple(one or first for one, first in zip(start, smallest, strict=True))) for start in starts
        ):
            u = self._evidence.record.u
            asked, why = "do the inputs" if smallest[1:] else "does the input", f" No, {CONSTANT}" * is_constant(u)
            raise InvalidArgumentError(f"no structure of the grid explains this record: {asked} move the output?{why}")
        while True:
            best = before = self._best
            for i, options in enumerate(self._options):
                own = sizes_of(best.structures)[i]
                for size in options.sizes if not self._options[1:] else [own, *options.beside(own)]:
                    best = _likelier(best, self._of_size(best, i, size))
                    moving = self._evidence.in_motion(best)
                    if moving is not None:  # begin again
                        self._evidence, self._found, self._walked = moving, {}, set()
                        return self.chosen()
            if best is before or not self._options[1:]:
                return self._on_grid(best)

    @property
    def _best(self) -> Trial:
        return max(self.tried.values(), key=lambda trial: trial.evidence)

    def _of_size(self, best: Trial, i: int, size: tuple[int, int]) -> Trial:
        """Return the best trial with another number of poles and zeros of an input, or the given one."""
        structure = replace(best.structures[i], poles=size[0], zeros=size[1])
        trial = self._try(_with(best.structures, i, structure), best)
        return best if trial is None else self._along_delays(trial, i)

    def _along_delays(self, trial: Trial, i: int) -> Trial:
        """Return the best trial of the dead times of an input: of the grid, at first of all of it, then between."""
        delays, begin = self._options[i].delays, self._options[i].nearest(trial.structures[i].delay)
        start = self._at(trial, i, delays[begin]) or trial
        best = _likelier(trial, start)
        for steps in (range(begin - 1, -1, -1), range(begin + 1, len(delays))):
            last = start
            for k in steps:
                other = self._at(last, i, delays[k])
                if i in self._walked and (other is None or (other.evidence < last.evidence and self._is_out(other))):
                    break
                last = other or last
                best = _likelier(best, last)
        self._walked.add(i)
        return best if self._is_out(best) else _likelier(best, self._between(best, i))

    def _between(self, best: Trial, i: int) -> Trial:
        """Return the likeliest trial between the neighbours of a point of the grid."""
        delays, k = self._options[i].delays, self._options[i].nearest(best.structures[i].delay)
        low, high = delays[max(k - 1, 0)], delays[min(k + 1, len(delays) - 1)]
        if not high > low:
            return best
        found = {delay: self._at(best, i, delay) for delay in {low, delays[k], high}}
        trials = {best.structures[i].delay: best, **{at: trial for at, trial in found.items() if trial is not None}}
        dt = self._evidence.record.dt
        return likeliest_between(trials, low, high, dt, lambda delay, beside: self._at(beside, i, delay))

    def _on_grid(self, best: Trial) -> Trial:
        """Return the best trial with the grid's dead times, except those between that are worth their price."""
        for i, each in enumerate(self._options):
            stays = self._at(best, i, each.delays[each.nearest(best.structures[i].delay)]) or best
            paid = best.likelihood - stays.likelihood > 0.5 * math.log(self._evidence.record.u.size)
            best = best if paid else stays
        return best

    def _at(self, trial: Trial, i: int, delay: float) -> Trial | None:
        return self._try(_with(trial.structures, i, replace(trial.structures[i], delay=delay)), trial)

    def _is_out(self, trial: Trial) -> bool:
        return trial.evidence < self._best.evidence - self._reach

    def _try(self, structures: Structures, beside: Trial | None = None) -> Trial | None:
        if structures not in self._found:
            self._say(len(self._found))
            self._found[structures] = found = self._fitted(structures, beside)
            self._is_told |= found is not None and found[0] is found[1]
        return self.tried.get(structures)

    def _fitted(self, structures: Structures, beside: Trial | None) -> tuple[Trial, Trial] | None:
        """Return the trials of structures, from other dead times beside them, or from smaller ones, or afresh."""
        smaller = [trial for trial in self.tried.values() if trial.is_within(structures)]
        inner = max(smaller, key=lambda trial: trial.likelihood, default=None)
        if beside is None or sizes_of(beside.structures) != sizes_of(structures):
            poles = [each.poles for each in structures]
            known = [[each.poles for each in trial.structures] for trial in (inner, beside) if trial is not None]
            return self._evidence.trials(
                structures, inner, afresh=inner is None or any(each != poles for each in known)
            )
        found = self._evidence.trials(structures, beside, afresh=False)
        is_worse = inner is not None and (found is None or found[self._is_told].likelihood < inner.likelihood)
        if inner is None or not is_worse or self._is_out(inner):
            return found
        again = self._evidence.trials(structures, inner, afresh=False)  # it has not converged
        each = [pair for pair in (found, again) if pair is not None]
        return max(each, key=lambda pair: pair[self._is_told].likelihood, default=None)


def _with(structures: Structures, i: int, other: Structure) -> Structures:
    return (*structures[:i], other, *structures[i + 1 :])


def _likelier(one: Trial, other: Trial) -> Trial:
    return max(one, other, key=lambda trial: trial.evidence)
