"""Search for the structure: poles, zeros and dead time of a grid, judged by their evidence on all samples."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Any, overload

import numpy as np

from replant.errors import InvalidArgumentError
from replant.estimation.engine.record import Record
from replant.estimation.filters import RefinedFilter
from replant.estimation.solver.solve import at_first, leaving_out, solve
from replant.fitting.fit import fit_samples
from replant.fitting.miso_fit import RowFit, fit_row, is_row
from replant.fitting.miso_search import Options, search_rows
from replant.fitting.samples import Samples
from replant.fitting.search_result import ALPHA, Candidate, MatrixSearch, SearchResult, likeliest_between
from replant.fitting.several_outputs import are_rows, in_columns, own_of, samples_of_outputs
from replant.fitting.structure_evidence import Evidence, Trial, least_known
from replant.model.interop import in_our_words
from replant.model.preprocess import Preprocess
from replant.model.structure import Structure
from replant.numerics.arguments import whole
from replant.numerics.limits import MOST_TRIED, dead_time, duration, several
from replant.numerics.linear_algebra import chi2_quantile
from replant.verdict.evidence import CONSTANT, is_constant


@overload
def search(
    u: Any, y: Any = None, dt: float | None = None, *, poles: Any = ..., zeros: Any = None, delays: Any = (0.0,),
    bias: bool = False, preprocess: Preprocess | None = None, reference: Any = None, t: Any = None,
    input: str | Sequence[str] | None = None, output: str | None = None,
    progress: Callable[[int, int], None] = ...,
) -> SearchResult: ...  # fmt: skip


@overload
def search(
    u: Any, y: None = None, dt: float | None = None, *, poles: Any = ..., zeros: Any = None, delays: Any = (0.0,),
    bias: bool = False, preprocess: Preprocess | None = None, reference: Any = None, t: Any = None,
    input: str | Sequence[str] | None = None, output: list[str] | tuple[str, ...],
    progress: Callable[[int, int], None] = ...,
) -> MatrixSearch: ...  # fmt: skip


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
    input: str | Sequence[str] | None = None,  # noqa: A002 - the field's word
    output: str | Sequence[str] | None = None,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> SearchResult | MatrixSearch:
    """Fit the structures of a grid by refined instrumental variables, and choose one.

    A structure is judged by its evidence: the log-likelihood of all samples, one step ahead, minus ln(K) / 2 for every
    fitted number, see `replant.fitting.structure_evidence`.  The numbers of poles and zeros are compared with the dead
    time found between the points of the grid.  A dead time of the grid is kept unless another one gains more than
    ln(K) / 2.  Structures that cannot win are left early.

    With several inputs not all structures are tried.  From the smallest one of each input, one input is changed at a
    time: its dead time along the grid, a pole or a zero more or fewer, as long as the evidence rises.

    Parameters
    ----------
    u, y, dt : as of `fit`
        A record, ``u`` (K,) or (K, q) of q inputs, a log, several logs of one rig, or columns of a table.  With several
        outputs, ``y`` (K, p), each has its own search in the same grid.
    poles : int or iterable of int
        Numbers of poles to try; with several inputs for each, or a tuple with a range for each; so are the following.
    zeros : int or iterable of int, optional
        Numbers of zeros to try; by default all below the number of poles.
    delays : float or iterable of float
        Dead times to try, in s.
    bias : bool
        Whether a bias is identified.
    preprocess, reference, t, input, output : as of `fit`
        Working point, set-point, time stamps, columns of the table.
    progress : callable
        Called before each structure with the numbers of structures tried and in all.

    Returns
    -------
    SearchResult or MatrixSearch
        Every structure of the grid, and the one chosen; with several outputs those of each.

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
    outputs = samples_of_outputs(u, y, dt, t, reference, input, output)
    are_rows(outputs, {"bias": bias, "preprocess": preprocess is not None})
    # an iterator is read once, but each input and each output needs its values
    n, m, times = (
        tuple(islice(each, MOST_TRIED + 1)) if isinstance(each, Iterator) else each for each in (poles, zeros, delays)
    )
    if len(outputs) == 1:
        return _searched(outputs[0], n, m, times, bias, preprocess, progress)

    def of_one(given: Samples, number: int) -> SearchResult:
        def say(done: int, of: int) -> None:
            progress(number * of + done, len(outputs) * of)

        return as_row(_searched(given, n, m, times, bias, preprocess, say), given)

    return MatrixSearch(tuple(of_one(given, number) for number, given in enumerate(outputs)))


def as_row(found: SearchResult, given: Samples) -> SearchResult:
    """Return the result of a search with its best as a row, as in a matrix of several outputs."""
    if isinstance(found.best, RowFit):
        return found
    each = found.best.structure
    return replace(found, best=fit_row(in_columns(given), (each.poles,), (each.zeros,), (each.delay,)))


def _searched(
    given: Samples,
    poles: Any,
    zeros: Any,
    delays: Any,
    bias: bool,
    preprocess: Preprocess | None,
    progress: Callable[[int, int], None],
) -> SearchResult:
    if is_row(given):
        return search_rows(given, _options(given, poles, zeros, delays), progress)
    preprocess = given.preprocess if preprocess is None else preprocess
    dt, times = duration("dt", given.dt), _times(delays)
    grid = _grid(poles, zeros, times, bias)
    hold = RefinedFilter(given.input_hold)
    raw, r, _ = given.checked(replace(grid[0], delay=times[-1]), dt, given.input_hold, preprocess)
    ready = raw.made_ready(r)
    # without outputs that are bad by the smallest structure, or without a model: a fast pole with an initial state of a
    # larger structure would fit a bad first output
    solution = solve(min(grid, key=_size), ready)
    used = at_first(ready) if solution is None else leaving_out(ready, solution.doubt)
    for _ in range(2):
        sweep = _Sweep(used, grid, times, progress)
        chosen = sweep.chosen
        best = fit_samples(given, chosen.structure, "srivc", hold, preprocess)
        made = best.record
        if made is None or made.u.size != used.u.size or (made.is_measured == used.is_measured).all():
            break
        used = replace(used, y=made.y, measured=made.measured)  # and again, without outputs that are bad by this model
    progress(len(grid), len(grid))
    shown = list(dict.fromkeys([*grid, chosen.structure]))
    candidates = tuple(sweep.candidate(structure) for structure in shown)
    return SearchResult(best, candidates[shown.index(chosen.structure)], candidates, chosen.structure not in grid)


class _Sweep:
    """Walks over the grid, from small structures to large ones and from the most likely dead time to its neighbours."""

    def __init__(
        self, ready: Record, grid: list[Structure], delays: list[float], progress: Callable[[int, int], None]
    ) -> None:
        self._evidence, self._grid, self._delays = Evidence(ready, at_rest=True), grid, delays
        self._progress, self._seen = progress, 0
        self._tried: dict[Structure, Trial | None] = {}
        self._between: dict[tuple[int, int], Trial] = {}
        # a trial cannot win if it is behind by more than all its parameters gain by chance
        self._reach = chi2_quantile(1.0 - ALPHA, max(structure.size for structure in grid) + 1)
        if ready.u.size and float(np.ptp(ready.u)) > 0.0:
            self._walk()

    @property
    def chosen(self) -> Trial:
        """The trial with the most evidence; its dead time is of the grid, unless another is worth its price."""
        top = self._top
        if top is None:
            why = f" No, {CONSTANT}" if is_constant(self._evidence.record.u) else ""
            asked = "does the input move the output?"
            raise InvalidArgumentError(f"no structure of the grid explains this record: {asked}{why}")
        on_grid = max(self._of(_size(top.structure)), key=lambda trial: trial.evidence)
        paid = top.likelihood - on_grid.likelihood > 0.5 * math.log(self._evidence.record.u.size)
        return top if paid else on_grid

    def candidate(self, structure: Structure) -> Candidate:
        """Return the candidate of a structure of the grid, or of the one chosen."""
        trial = self._tried.get(structure, self._between.get(_size(structure)))
        if trial is None or trial.structure != structure:
            return Candidate(structure)
        found, span = trial.found, self._evidence.record.span
        uncertainty = least_known(structure, found.theta, found.covariance, span)
        return Candidate(structure, trial.fit, trial.likelihood, -2.0 * trial.evidence, uncertainty)

    @property
    def _top(self) -> Trial | None:
        trials = [*(trial for trial in self._tried.values() if trial is not None), *self._between.values()]
        return max(trials, key=lambda trial: trial.evidence, default=None)

    def _of(self, size: tuple[int, int]) -> list[Trial]:
        return [trial for trial in self._tried.values() if trial is not None and _size(trial.structure) == size]

    def _walk(self) -> None:
        """Try all structures that can win."""
        for size in sorted({_size(structure) for structure in self._grid}):
            self._along_delays(size)
            if self._begins_in_motion():
                self._evidence = Evidence(self._evidence.record, at_rest=False)
                self._tried, self._between = {}, {}
                self._walk()
                return
            if trials := self._of(size):
                self._refine_delay(max(trials, key=lambda trial: trial.evidence))

    def _begins_in_motion(self) -> bool:
        """Return whether unknown inputs before the record make it likelier than by chance."""
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

    def _try(self, size: tuple[int, int], k: int, beside: Trial | None) -> Trial | None:
        """Try a structure, from the dead time beside it, or from a smaller structure and fast poles, or afresh."""
        self._seen = max(self._seen, len(self._tried))
        self._progress(self._seen, len(self._grid))
        structure, dt = Structure(*size, self._delays[k], self._grid[0].bias), self._evidence.record.dt
        smaller = [
            trial
            for each, trial in self._tried.items()
            if trial is not None and each.delay == structure.delay and each.poles <= size[0] and each.zeros <= size[1]
        ]
        inner = max(smaller, key=lambda trial: trial.likelihood, default=None)
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
        alike = self._of(_size(best.structure))
        found = {trial.structure.delay: trial for trial in alike if low <= trial.structure.delay <= high}

        def tried(delay: float, beside: Trial) -> Trial | None:
            return self._evidence.of(replace(best.structure, delay=delay), [beside.found.theta])

        self._between[_size(best.structure)] = likeliest_between(found, low, high, self._evidence.record.dt, tried)


def _options(given: Samples, poles: Any, zeros: Any, delays: Any) -> list[Options]:
    """Return the options of each of several inputs: the same for all, or a range for each."""
    count = np.shape(given.inputs)[1]
    asked, found = {"poles": poles, "zeros": zeros, "delays": delays}, []
    for i in range(count):
        n, m, times = (own_of(name, each, i, count, "ranges and u {} inputs") for name, each in asked.items())
        grid = _grid(n, m, (0.0,), bias=False)
        found.append(Options(sorted({_size(structure) for structure in grid}), _times(times)))
    return found


def _times(delays: Any) -> list[float]:
    return sorted(set(several("delays", delays, dead_time)))


def _size(structure: Structure) -> tuple[int, int]:
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
