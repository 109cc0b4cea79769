"""Search for the structure: poles, zeros and dead time of a grid, judged by their evidence on all samples."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Any, overload

import numpy as np

from replant.errors import InvalidArgumentError
from replant.estimation.filters import RefinedFilter
from replant.estimation.solver.solve import leaving_out, suspected
from replant.fitting.fit import fit_samples
from replant.fitting.miso_fit import RowFit, fit_row, is_row, ready_row
from replant.fitting.miso_solve import with_outside
from replant.fitting.samples import Samples
from replant.fitting.search_result import Candidate, MatrixSearch, SearchResult
from replant.fitting.search_walk import Options, Walk
from replant.fitting.several_outputs import are_rows, in_columns, own_of, samples_of_outputs
from replant.fitting.structure_evidence import Evidence, RowEvidence, Structures, Trial
from replant.kernels.schema import Doubt
from replant.model.interop import in_our_words
from replant.model.preprocess import Preprocess
from replant.model.structure import Structure
from replant.numerics.arguments import whole
from replant.numerics.limits import MOST_TRIED, dead_time, duration, several


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
    is_one = not isinstance(found.best, RowFit)
    return replace(found, best=fit_row(in_columns(given), *_orders(found.chosen.structures))) if is_one else found


def _searched(
    given: Samples,
    poles: Any,
    zeros: Any,
    delays: Any,
    bias: bool,
    preprocess: Preprocess | None,
    progress: Callable[[int, int], None],
) -> SearchResult:
    options = _options(np.shape(given.inputs)[1] if is_row(given) else 1, poles, zeros, delays, bias)
    longest = tuple(Structure(*each.sizes[0], each.delays[-1], bias) for each in options)
    record, inputs, rows, evidence_of, fitted = _prepared(given, longest, preprocess)
    grid: list[Structures] = [] if options[1:] else [(each,) for each in options[0].structures]
    count, seen = len(grid) or sum(len(each.sizes) + len(each.delays) for each in options), 0

    def say(done: int) -> None:
        nonlocal seen
        seen = max(seen, min(done, count - 1))
        progress(seen, count)

    used = leaving_out(record, suspected(record, inputs))
    for _ in range(2):
        walk = Walk(evidence_of(used), options, say)
        chosen = walk.chosen()
        best = fitted(chosen.structures)
        bad = np.zeros(rows.size, bool)
        bad[best.outliers] = bad[best.stuck] = True
        again = leaving_out(record, np.where(record.is_measured & ~bad[rows], Doubt.NONE, Doubt.MISSING))
        if (again.is_measured == used.is_measured).all():
            break
        used = again  # and again, without outputs that are bad by this model
    progress(count, count)
    tried, places = walk.tried, [each.delays for each in options]
    grid = grid or [key for key in tried if all(one.delay in of for one, of in zip(key, places, strict=True))]
    shown = {key: _candidate(key, tried.get(key), used.span) for key in dict.fromkeys([*grid, chosen.structures])}
    return SearchResult(best, shown[chosen.structures], tuple(shown.values()), chosen.structures not in grid)


def _candidate(structures: Structures, trial: Trial | None, span: float) -> Candidate:
    structure = structures if structures[1:] else structures[0]
    if trial is None:
        return Candidate(structure)
    return Candidate(structure, trial.fit, trial.likelihood, -2.0 * trial.evidence, trial.uncertainty(span))


def _prepared(given: Samples, longest: Structures, preprocess: Preprocess | None) -> tuple[Any, ...]:
    """Return the record (J,), several inputs of it, which samples (K,) these are, how to judge it and how to fit."""
    if is_row(given):
        ready, _, references, _ = ready_row(given, *_orders(longest))
        ready, _ = with_outside(ready, references, ["u"] * len(longest))
        judge = partial(RowEvidence, inputs=ready.inputs if ready.outside is None else ready.outside.inputs)
        return ready.record, ready.inputs, ready.used, judge, lambda chosen: fit_row(given, *_orders(chosen))
    preprocess = given.preprocess if preprocess is None else preprocess
    raw, r, _ = given.checked(longest[0], duration("dt", given.dt), given.input_hold, preprocess)
    how: Any = "srivc", RefinedFilter(given.input_hold), preprocess
    at_rest = partial(Evidence, at_rest=True)
    return raw.made_ready(r), None, raw.made_use_of, at_rest, lambda chosen: fit_samples(given, chosen[0], *how)


def _orders(structures: Structures) -> list[tuple[Any, ...]]:
    return [tuple(getattr(each, name) for each in structures) for name in ("poles", "zeros", "delay")]


def _options(inputs: int, poles: Any, zeros: Any, delays: Any, bias: bool) -> list[Options]:
    """Return the options of each input: the same for all, or a range for each."""
    asked, found = {"poles": poles, "zeros": zeros, "delays": delays}, []
    for i in range(inputs):
        each = (own_of(name, given, i, inputs, "ranges and u {} inputs") for name, given in asked.items())
        found.append(Options(*_checked(*each), bias))
    if inputs == 1 and len(found[0].structures) > MOST_TRIED:
        raise InvalidArgumentError(f"the grid of poles, zeros and delays must have at most {MOST_TRIED} structures")
    return found


def _checked(poles: Any, zeros: Any, delays: Any) -> tuple[list[tuple[int, int]], list[float]]:
    """Return the numbers of poles and zeros, and the dead times, ascending."""
    times = sorted(set(several("delays", delays, dead_time)))
    numbers = several("poles", poles, partial(whole, least=1))
    allowed = None if zeros is None else several("zeros", zeros, partial(whole, least=0))
    orders = [Structure(n).poles for n in numbers]  # raises for too many
    sizes = {(n, m) for n in orders for m in (range(n) if allowed is None else allowed) if m < n}
    if not sizes:
        raise InvalidArgumentError("the grid holds no possible structure: zeros must be fewer than poles")
    return sorted(sizes), times
