"""Search for the structure: poles, zeros and dead time of a grid, judged by their evidence on all samples."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError
from replant.estimation.engine.record import Record
from replant.estimation.filters import RefinedFilter
from replant.estimation.solver.solve import at_first
from replant.fitting.fit import check_delay, check_length, fit_samples
from replant.fitting.fit_result import FitResult
from replant.fitting.samples import RawRecord, Samples
from replant.fitting.structure_evidence import Evidence, Trial
from replant.model.interop import in_our_words
from replant.model.preprocess import Preprocess, screen
from replant.model.structure import Structure
from replant.numerics.arguments import record, vector, whole
from replant.numerics.limits import MOST_TRIED, dead_time, duration, increasing, several
from replant.numerics.linear_algebra import chi2_quantile

ALPHA = 1e-2
"""Chance that a better likelihood is no more than chance [probability].
Level: 1 %.
"""

# a dead time that lies a seventh of its standard deviation from the likeliest costs as much
WORTH = 0.01  # gain that a dead time between two points of the grid must promise to be tried [log-likelihood]
# halving as often would find it to a 256th of a sample; tops of parabolas come as near in fewer steps
BETWEEN = 8  # dead times tried between two points of the grid, at the most [count]
SHOWN = 6  # candidates within chance of the best that are shown, at the most [count]


@dataclass(frozen=True, eq=False, repr=False)
class Candidate:
    """One structure of the grid.

    Attributes
    ----------
    structure : Structure
    fit : float
        Fit in percent of the simulated output over all samples, with offset and initial state estimated; of an unstable
        model, which would run away, of the output predicted one step ahead.  Minus infinity where there is no model,
        or where the structure was left early: beside a smaller one, or a dead time next to it, it could not win.
    likelihood : float
        Logarithm of the likelihood of all samples.
    criterion : float
        Bayesian information criterion: N ln(K) less twice the log-likelihood, N numbers fitted to K samples.  Smaller
        is better.
    uncertainty : float
        Largest standard deviation of a coefficient, as a part of its size.
    """

    structure: Structure
    fit: float = -math.inf
    likelihood: float = -math.inf
    criterion: float = math.inf
    uncertainty: float = math.inf

    def __repr__(self) -> str:
        size = f"{self.structure.poles} poles, {self.structure.zeros} zeros, {self.structure.delay:g} s"
        return f"{size}: fit {self.fit:.1f} %" if self.was_tried else f"{size}: left early"

    @property
    def was_tried(self) -> bool:
        """Whether there is a model of this structure."""
        return math.isfinite(self.fit)


@dataclass(frozen=True, eq=False, repr=False)
class SearchResult:
    """The result of a search.

    Attributes
    ----------
    best : FitResult
        The fit of the chosen structure to the whole record, its dead time found between the points of the grid.
    chosen : Candidate
    candidates : tuple of Candidate
        All of the grid, in its order.
    """

    best: FitResult
    chosen: Candidate
    candidates: tuple[Candidate, ...]

    @property
    def likely(self) -> tuple[Candidate, ...]:
        """Those worth reading, that of most evidence first: those within chance of it, and the best of each order."""
        tried = sorted((each for each in self.candidates if each.was_tried), key=lambda each: each.criterion)
        best = {each.structure.poles: each for each in reversed(tried)}
        chance = [each for each in tried[:SHOWN] if each.criterion <= tried[0].criterion - 2.0 * math.log(ALPHA)]
        worth = {id(each) for each in (*chance, *best.values(), self.chosen)}
        return tuple(each for each in tried if id(each) in worth)

    @property
    def rest(self) -> str:
        """What is to be said of the others, in one line; empty where there are none."""
        more = len(self.candidates) - len(self.likely)
        early = sum(not each.was_tried for each in self.candidates)
        if not more:
            return ""
        return f"{more} more explain{'s' if more == 1 else ''} less" + (
            f", {early} of them left early" if early else ""
        )

    def __repr__(self) -> str:
        rows = [f"{each!r}, {0.5 * (self.chosen.criterion - each.criterion):+.1f} evidence" for each in self.likely]
        of = f"<SearchResult of {len(self.candidates)} structures: {self.best.model!r}"
        return "\n  ".join([of, *rows, *([self.rest] if self.rest else [])]) + ">"

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(repr(self))}</pre>{self.best._repr_html_()}"


@in_our_words
def search(
    u: Any,
    y: Any = None,
    dt: float | None = None,
    *,
    poles: int | Iterable[int] = range(1, 5),
    zeros: int | Iterable[int] | None = None,
    delays: float | Iterable[float] = (0.0,),
    bias: bool = False,
    preprocess: Preprocess | None = None,
    reference: Any = None,
    t: Any = None,
    input: str | None = None,  # noqa: A002 - the field's word
    output: str | None = None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> SearchResult:
    """Fit the structures of a grid by refined instrumental variables, and choose one.

    A structure is judged by its evidence: the log-likelihood of all samples, one step ahead, less ln(K) / 2 for every
    number that was fitted, see `replant.fitting.structure_evidence`.  The numbers of poles and zeros are compared with
    the dead time found between the points of the grid.  The grid's own dead time stays unless another brings more than
    ln(K) / 2.  Structures that cannot win are left early.

    Parameters
    ----------
    u, y, dt : as of `fit`
        A record of one input, a log, several logs of one rig, or columns of a table.
    poles : int or iterable of int
        Numbers of poles to try.
    zeros : int or iterable of int, optional
        Numbers of zeros to try; by default all below the number of poles.
    delays : float or iterable of float
        Dead times to try, in s.
    bias : bool
        Whether a bias is identified.
    preprocess, reference, t, input, output : as of `fit`
        Working point, set-point, time stamps, columns of the table.
    progress : callable
        Called before each structure with how many were tried, of how many.

    Returns
    -------
    SearchResult
        Every structure of the grid, and the one chosen.

    Raises
    ------
    InvalidArgumentError
        If no structure of the grid is possible, or none gives a model.

    References
    ----------
    Schwarz (1978), "Estimating the dimension of a model", Annals of Statistics 6; Ljung (1999), "System Identification:
    Theory for the User", section 16.4.

    Examples
    --------
    >>> from replant.signals import prbs, white_noise
    >>> u = prbs(2000, hold=8)
    >>> y = Structure(poles=2).transfer_function([4.0, 3.0, 2.0]).simulate(u, 0.05) + white_noise(2000, 0.05)
    >>> found = search(u, y, 0.05, poles=(1, 2, 3))
    >>> found.best.structure.poles
    2
    """
    given = Samples.of(u, y, dt, t, reference, input, output)
    preprocess = given.preprocess if preprocess is None else preprocess
    u, y = record(given.u, given.y)
    dt, times = duration("dt", given.dt), sorted(set(several("delays", delays, dead_time)))
    grid = _grid(poles, zeros, times, bias)
    r = None if given.reference is None else vector("reference", given.reference)
    stamps = None if given.t is None else increasing(given.t, u.size)
    hold = RefinedFilter(given.input_hold)
    told = y if r is None or r.size != y.size else np.where(np.isfinite(r), y, np.nan)
    check_length(int(screen(preprocess.map_input(u), told)[0].sum()), grid[0])
    check_delay(times[-1], dt, u.size, stamps)
    resolved = preprocess.resolve(u, told)
    ready = RawRecord(grid[0], dt, resolved, u, told, stamps, given.input_hold, given.begins).made_ready(told, r)
    used = at_first(ready)
    for _ in range(2):
        sweep = _Sweep(used, grid, times, progress)
        chosen = sweep.chosen
        best = fit_samples(given, chosen.structure, "srivc", hold, preprocess)
        made = best.record
        if made is None or made.u.size != used.u.size or (made.is_measured == used.is_measured).all():
            break
        used = replace(used, y=made.y, measured=made.measured)  # and again, without what this model finds bad
    progress(len(grid), len(grid))
    candidates = tuple(sweep.candidate(structure) for structure in grid)
    nearest = min(
        (each for each in candidates if _size(each.structure) == _size(chosen.structure)),
        key=lambda each: abs(each.structure.delay - chosen.structure.delay),
    )
    return SearchResult(given.named(best), nearest, candidates)


class _Sweep:
    """Walks over the grid, from small structures to large ones and from the most likely dead time to its neighbours."""

    def __init__(
        self, ready: Record, grid: list[Structure], delays: list[float], progress: Callable[[int, int], None]
    ) -> None:
        self._evidence, self._grid, self._delays = Evidence(ready, at_rest=True), grid, delays
        self._progress, self._seen = progress, 0
        self._tried: dict[Structure, Trial | None] = {}
        self._between: dict[tuple[int, int], Trial] = {}
        # a trial behind by more than chance makes of all its parameters cannot win
        self._reach = chi2_quantile(1.0 - ALPHA, max(structure.size for structure in grid) + 1)
        if ready.u.size and float(np.ptp(ready.u)) > 0.0:
            self._walk()

    @property
    def chosen(self) -> Trial:
        """The trial with the most evidence; its dead time that of the grid, unless another is paid for."""
        top = self._top
        if top is None:
            raise InvalidArgumentError("no structure of the grid explains this record: does the input move the output?")
        on_grid = max(self._of(_size(top.structure)), key=lambda trial: trial.evidence)
        paid = top.likelihood - on_grid.likelihood > 0.5 * math.log(self._evidence.record.u.size)
        return top if paid else on_grid

    def candidate(self, structure: Structure) -> Candidate:
        """Return what came of a structure of the grid."""
        trial = self._tried.get(structure)
        if trial is None:
            return Candidate(structure)
        uncertainty = trial.uncertainty(self._evidence.record.span)
        return Candidate(structure, trial.fit, trial.likelihood, -2.0 * trial.evidence, uncertainty)

    @property
    def _top(self) -> Trial | None:
        trials = [*(trial for trial in self._tried.values() if trial is not None), *self._between.values()]
        return max(trials, key=lambda trial: trial.evidence, default=None)

    def _of(self, size: tuple[int, int]) -> list[Trial]:
        return [trial for trial in self._tried.values() if trial is not None and _size(trial.structure) == size]

    def _walk(self) -> None:
        """Try what can win."""
        for size in sorted({_size(structure) for structure in self._grid}):
            self._along_delays(size)
            if self._begins_in_motion():
                self._evidence = Evidence(self._evidence.record, at_rest=False)
                self._tried, self._between = {}, {}
                return self._walk()
            trials = self._of(size)
            if trials:
                self._refine_delay(max(trials, key=lambda trial: trial.evidence))
        return None

    def _begins_in_motion(self) -> bool:
        """Return whether unknown inputs before the record make it likelier, by more than chance makes of so many."""
        top, record = self._top, self._evidence.record
        if top is None or not self._evidence.at_rest or not top.structure.delay:
            return False
        moving = Evidence(record, at_rest=False).of(top.structure, [top.found.theta])
        unknown = record.unknown(top.structure.delay) * len(record.parts)
        return moving is not None and moving.evidence - top.evidence > 0.5 * chi2_quantile(1.0 - ALPHA, unknown)

    def _along_delays(self, size: tuple[int, int]) -> None:
        """Try one number of poles and zeros with the dead times around the best one so far; at first with all."""
        top = self._top
        best = self._delays[0] if top is None else top.structure.delay
        begin = int(np.argmin(np.abs(np.array(self._delays) - best)))
        start = self._try(size, begin, None)
        for steps in (range(begin - 1, -1, -1), range(begin + 1, len(self._delays))):
            last = start
            for k in steps:
                trial = self._try(size, k, last)
                falls = trial is None or last is None or trial.evidence < last.evidence
                if top is not None and falls and self._is_out(trial):
                    break
                last = trial or last

    def _is_out(self, trial: Trial | None) -> bool:
        top = self._top
        return trial is None or (top is not None and trial.evidence < top.evidence - self._reach)

    def _smaller(self, size: tuple[int, int], k: int) -> list[Trial | None]:
        """Return the trials with this dead time, and no more poles and zeros."""
        return [
            trial
            for structure, trial in self._tried.items()
            if structure.delay == self._delays[k] and structure.poles <= size[0] and structure.zeros <= size[1]
        ]

    def _try(self, size: tuple[int, int], k: int, beside: Trial | None) -> Trial | None:
        """Try a structure, from the dead time beside it, or from a smaller structure and fast poles, or afresh."""
        self._seen = max(self._seen, len(self._tried))
        self._progress(self._seen, len(self._grid))
        structure, dt = Structure(*size, self._delays[k], self._grid[0].bias), self._evidence.record.dt
        inner = max(filter(None, self._smaller(size, k)), key=lambda trial: trial.likelihood, default=None)
        if beside is not None:
            trial = self._evidence.of(structure, [beside.found.theta])
            worse = inner is not None and (trial is None or trial.likelihood < inner.likelihood)
            if inner is not None and worse and not self._is_out(inner):  # it has not converged
                again = self._evidence.of(structure, [inner.grown(structure, dt)])
                trial = max(filter(None, (trial, again)), key=lambda each: each.likelihood, default=None)
        else:
            known = [] if inner is None else [inner.grown(structure, dt)]
            afresh = inner is None or inner.structure.poles < structure.poles
            trial = self._evidence.of(structure, known, afresh=afresh)
        self._tried[structure] = trial
        return trial

    def _refine_delay(self, best: Trial) -> None:
        """Find the likeliest dead time between the neighbours of the best one of the grid."""
        k, top = self._delays.index(best.structure.delay), self._top
        low, high = self._delays[max(k - 1, 0)], self._delays[min(k + 1, len(self._delays) - 1)]
        if not high > low or (top is not None and best.evidence < top.evidence - 3.0 * self._reach):
            return
        found = {trial.structure.delay: trial for trial in self._of(_size(best.structure))}
        for _ in range(BETWEEN):
            delay, gain = _top_of_parabola({each: trial.likelihood for each, trial in found.items()}, low, high)
            if gain < WORTH or delay in found:
                break
            beside = found[min(found, key=lambda each: abs(each - delay))]
            trial = self._evidence.of(replace(best.structure, delay=delay), [beside.found.theta])
            if trial is None:
                break
            found[delay] = trial
        self._between[_size(best.structure)] = max(found.values(), key=lambda trial: trial.evidence)


def _top_of_parabola(values: Mapping[float, float], low: float, high: float) -> tuple[float, float]:
    """Return where the parabola through the best of some values and its neighbours is highest, and by how much."""
    best = max(values, key=lambda place: values[place])
    near = sorted((place for place in values if place != best), key=lambda place: abs(place - best))
    if len(near) < 2:
        return (0.5 * (best + (near[0] if near else low + high - best)), math.inf)
    across = [place for place in near if (place < best) != (near[0] < best)]  # on the other side
    others = near[0], across[0] if across else near[1]
    slopes = [(values[place] - values[best]) / (place - best) for place in others]
    bend = (slopes[1] - slopes[0]) / (others[1] - others[0])
    if not -math.inf < bend < 0.0:
        return best, 0.0
    tilt = slopes[0] - bend * (others[0] - best)
    top = min(max(-0.5 * tilt / bend, low - best), high - best)
    return best + top, top * (tilt + bend * top)


def _size(structure: Structure) -> tuple[int, int]:
    """Return the numbers of poles and zeros."""
    return structure.poles, structure.zeros


def _grid(poles: Any, zeros: Any, delays: Sequence[float], bias: bool) -> list[Structure]:
    numbers = several("poles", poles, partial(whole, least=1))
    allowed = None if zeros is None else several("zeros", zeros, partial(whole, least=0))
    orders = [Structure(n).poles for n in numbers]  # raises for too many
    if len(orders) * (len(allowed) if allowed else 1) * len(delays) > MOST_TRIED:
        raise InvalidArgumentError(f"the grid of poles, zeros and delays must have at most {MOST_TRIED} structures")
    grid = [
        Structure(n, m, delay, bias)
        for n in orders
        for m in (range(n) if allowed is None else allowed)
        if m < n
        for delay in delays
    ]
    if not grid:
        raise InvalidArgumentError("the grid holds no possible structure: zeros must be fewer than poles")
    return grid
