"""`rp.run`, one online pass over a log or arrays, and the comparison of several methods on one record."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np

from replant.errors import InvalidArgumentError, ReplantError
from replant.estimation.engine.dimensions import RECENT
from replant.estimation.optimizers import OPTIMIZERS, Optimizer
from replant.estimation.settings import AUTO, Request, filter_for
from replant.estimation.simulation.miso import RowRecord
from replant.fitting.fit import fit
from replant.fitting.fit_result import FitResult
from replant.fitting.miso_fit import RowFit, check_numbers, columns_of, structures_of
from replant.fitting.miso_model import evaluated
from replant.fitting.miso_solve import references_of
from replant.fitting.model import reference_of
from replant.fitting.other_causes import judged_further
from replant.fitting.samples import RawRecord, Samples
from replant.fitting.several_outputs import MatrixFit, are_rows, samples_of_outputs, solved_rows
from replant.logs.log import Log, without_added
from replant.model.interop import in_our_words
from replant.model.preprocess import Preprocess
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray, one_of, record, vector
from replant.numerics.limits import increasing
from replant.numerics.robust import flags_of
from replant.online.bank_members import asked_for
from replant.online.miso_identifier import RowIdentifier
from replant.online.miso_samples import RowClock, RowSamples, Screened
from replant.online.runs.result import Result, result_of_fit
from replant.online.runs.run import CHUNK, run_online
from replant.verdict.other_columns import other_columns
from replant.verdict.verdict import Verdict

AT_REST = Preprocess("identity", "mean", "mean")


@overload
def run(
    u: Any, y: Any = None, dt: float | None = None, structure: None = None, *, poles: tuple[int, ...],
    zeros: int | tuple[int, ...] = 0, delay: float | tuple[float, ...] = 0.0, t: Any = None, reference: Any = None,
) -> RowFit: ...  # fmt: skip


@overload
def run(
    u: Any, y: Any = None, dt: float | None = None, structure: Structure | Sequence[Structure] | None = None, *,
    poles: int | None = None, zeros: int = 0, delay: float = 0.0, optimizer: Optimizer | str = AUTO,
    preprocess: Preprocess = AT_REST, t: Any = None, reference: Any = None, input: str | None = None,
    output: str | None = None,
) -> Result: ...  # fmt: skip


@in_our_words
def run(
    u: Any,
    y: Any = None,
    dt: float | None = None,
    structure: Structure | Sequence[Structure] | None = None,
    *,
    poles: Any = None,
    zeros: Any = 0,
    delay: Any = 0.0,
    optimizer: Optimizer | str = AUTO,
    preprocess: Preprocess = AT_REST,
    t: Any = None,
    reference: Any = None,
    input: str | Sequence[str] | None = None,  # noqa: A002 - the field's word
    output: str | Sequence[str] | None = None,
) -> Result | RowFit | MatrixFit:
    """Identify a record online, in one pass as `Identifier` does, and return the result as ``replant run`` does.

    Parameters
    ----------
    u : (K,) or (K, q) array, Log, list of Log, or table
        Raw input, or a column for each of q inputs; or a log with input, output and sampling time; or several logs of
        one rig, which give one model.
    y : (K,) array
        Output, or (K, p) for p outputs, each identified separately.
    dt : float
        Sampling time in s; without it, the usual interval of ``t``.
    structure : Structure or list of Structure
        Alternatively give ``poles``, ``zeros`` and ``delay``.  Two to ten structures learn side by side; the result is
        that of the most probable trusted one, see `Identifier`.
    poles, zeros : int or tuple of int
        Numbers of poles and zeros; with several inputs an entry for each.  With several outputs these hold for all, or
        there is a tuple for each output.
    delay : float or tuple of float
        Dead time in s.
    optimizer : Optimizer or str
        See `Identifier`.  With several inputs it must be "auto", and ``preprocess`` the default.
    preprocess : Preprocess
        Input map and working point, by default the record's mean.
    t : (K,) array, optional
        Time stamps of an irregular clock in s, or dates, strictly increasing.
    reference : (K,) array, optional
        Reference of a controller that makes the input, see `fit`.
    input, output : str, optional
        Column names (several as a list) if ``u`` is a table of pandas or polars; ``t`` and ``reference`` may name
        columns, too.  Without ``t`` and ``dt`` the clock is the column t, time or timestamp, or the index.

    Returns
    -------
    Result, RowFit or MatrixFit
        A RowFit for several inputs, a MatrixFit for several outputs.

    Raises
    ------
    InvalidArgumentError, ArgumentTypeError
        For an argument that cannot be used; the message names it.

    Examples
    --------
    >>> import numpy as np
    >>> from replant import TransferFunction
    >>> u = np.where(np.arange(4000) // 125 % 2 == 0, 1.0, -1.0)
    >>> result = run(u, TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.01), 0.01, poles=1)
    >>> result.model
    <Model 2 / (s + 0.5): u -> y, fit 100.0 %, trusted>
    """
    outputs = samples_of_outputs(u, y, dt, t, reference, input, output)
    orders = {"poles": poles, "zeros": zeros, "delay": delay}
    not_yet = {"structure": structure is not None, "optimizer": optimizer != AUTO, "preprocess": preprocess != AT_REST}
    if are_rows(outputs, not_yet, *orders.values()):
        return solved_rows(outputs, orders, run_row)
    given, structures = outputs[0], structure if isinstance(structure, list | tuple) else []
    first: Any = structures[0] if structures else structure
    first = Structure.wanted(first, **orders)
    if structures:
        asked_for(structures, {} if optimizer == AUTO else {"optimizer": optimizer})
    request = Request(first, given.dt, filter=filter_for(given.input_hold), optimizer=optimizer, preprocess=preprocess)
    u, y = record(given.u, given.y)
    stamps = None if given.t is None else increasing(given.t, u.size)
    r = None if given.reference is None else reference_of(given.reference, u.size)
    result = run_online(request, u, y, reference=r, t=stamps, structures=structures)
    result = result.without_added(given.added)
    return replace(result, model=result.model.of_log(given.input_name, given.output_name, given.source, given.sha256))


def first_model(samples: int) -> int:
    """Return the default number of samples for the first model: a tenth, at most `RECENT`."""
    return min(max(samples // 10, 1), RECENT)


def run_row(
    given: Samples,
    orders: dict[str, Any],
    startup: int | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> RowFit:
    """Identify a record of several inputs by a `RowIdentifier`; ``orders``: poles, zeros and delay of each input."""
    if given.begins:
        raise InvalidArgumentError("a pass over several inputs takes one log: give one, or use fit for several")
    u, y = columns_of(given.inputs), vector("y", given.y)
    structures_of(u.shape[1], **orders)
    for name, signal in (("u", u), ("t", given.t), ("reference", given.references)):
        if signal is not None and len(signal) != y.size:
            raise InvalidArgumentError(f"{name} has {len(signal)} rows and y {y.size} samples: give one row for each")
    check_numbers(given, u, y, references_of(given.references, y.size))
    t = None if given.t is None else increasing(given.t, y.size)
    first = first_model(y.size) if startup is None else startup
    ident = RowIdentifier(
        dt=given.dt, startup=first, input_hold=given.input_hold, input_names=given.input_names, **orders
    )  # fmt: skip
    samples = RowSamples(u, y, t, np.empty((y.size, 0)))
    screened = Screened.of(RowClock(), samples, 0, -np.inf, given.dt, ident.request.closest)
    if t is None and not screened.is_taken.all():
        t = given.dt * np.arange(y.size, dtype=np.float64)  # a sample that is left out still takes its time
    for begin in range(0, y.size, CHUNK):
        rows = slice(begin, begin + CHUNK)
        stamps, references = (None if each is None else each[rows] for each in (t, given.references))
        ident.update_many(u[rows], y[rows], stamps, references)
        progress(min(begin + CHUNK, y.size))
    if startup is None or not ident.has_model:
        ident.finish()
    names, taken = ident.request.input_names, np.flatnonzero(screened.is_taken)
    of_newest = taken[taken.size - len(ident.recent[1]) :]
    others = {name: each[of_newest] for name, each in given.unused.items()}
    found = ident.fit_of_newest(others)
    newest = ident.model if found is None else found.model
    model = newest.of_log(names, given.output_name, given.source, given.sha256)
    rejected = without_added(dict(model.rejected), "no output", given.added)
    made = replace(model.provenance, samples=model.provenance.samples - given.added)
    model = replace(model, rejected=tuple(rejected.items()), provenance=made)
    none, missing = np.zeros(0, np.int64), np.flatnonzero(~np.isfinite(y))
    began, *loads = (int(taken[each]) for each in ident.begins)
    ready = RowRecord.of(u, y, given.dt, t, given.input_hold, (began, *loads))
    output = ready.simulated(*evaluated(model, ready))
    output[:began] = np.nan  # before the record that the estimate is made from
    return RowFit(model, output, none, none, missing)


def judged_by_log(result: Result, log: Log) -> Result:
    """Return the result with a verdict from the whole log, as that of `fit`."""
    settings = result.settings
    if settings is None or not result.parameters.any() or log.earlier:
        return result
    y = np.where(flags_of(result.left_out, 0, log.output.size), np.nan, log.output)
    hold, loads = settings.filter.input_hold, tuple(result.loads.tolist())
    raw = RawRecord(result.structure, log.dt, settings.preprocess, log.input, y, log.stamps, hold, loads=loads)
    if not raw.usable.any():
        return result
    record = raw.made_ready(log.reference)
    others = {name: signal[raw.made_use_of] for name, signal in log.others.items()}
    found = other_columns(result.structure, result.parameters, record, log.dt, others)
    known = result.covariance if settings.instruments else None
    verdict = judged_further(
        result.verdict, result.structure, result.parameters, known, record, raw.input_level(record), found
    )
    kept = Verdict(verdict.status, verdict.reasons, verdict.excited)
    return replace(result, verdict=verdict, model=replace(result.model, verdict=kept))


DEFAULT = "default"
OFFLINE = ("srivc", "least_squares")
#: The methods that can be compared: replant's default, every optimizer, and the fits of the whole record.
METHODS = (DEFAULT, *OPTIMIZERS, *OFFLINE)
#: The methods compared by default: replant's default, two of the article's optimizers, fits of the whole record.
USUAL = (DEFAULT, "amsgrad", "gradient", *OFFLINE)
TRIAL = 500  # samples of a trial run [samples]


@dataclass(frozen=True, eq=False)
class Contender:
    """The result of one method."""

    name: str  # name of the method
    result: Result | None  # None if the method found no model
    fitted: FitResult | None = None  # the fit, for an offline method
    problem: str = ""  # why there is no result


def compare(
    request: Request,
    u: FloatArray,
    y: FloatArray,
    methods: Sequence[str] = USUAL,
    progress: Callable[[str, float], None] = lambda name, part: None,
    reference: FloatArray | None = None,
    t: FloatArray | None = None,
) -> list[Contender]:
    """Identify the same record by each of ``methods``; a method that fails is reported and does not stop the others."""
    contenders = []
    for name in methods:
        name = one_of("method", name, METHODS)
        asked = request
        if name not in OFFLINE:
            asked = replace(request, optimizer=AUTO if name == DEFAULT else name)
        r = reference if (name == "srivc" if name in OFFLINE else asked.takes_reference) else None
        with contextlib.suppress(ReplantError):  # a trial run first, so that loading the kernels is not timed
            first_r, first_t = (None if signal is None else signal[:TRIAL] for signal in (r, t))
            _identify(name, asked, u[:TRIAL], y[:TRIAL], first_r, first_t, progress)
        try:
            contenders.append(_identify(name, asked, u, y, r, t, progress))
        except ReplantError as problem:
            contenders.append(Contender(name, None, problem=str(problem)))
        progress(name, 1.0)
    return contenders


def _identify(
    name: str, request: Request, u: FloatArray, y: FloatArray, r: FloatArray | None, t: FloatArray | None,
    progress: Callable[[str, float], None],
) -> Contender:  # fmt: skip
    if name not in OFFLINE:
        return Contender(name, run_online(request, u, y, lambda done: progress(name, done / u.size), reference=r, t=t))
    begun = time.perf_counter()
    how: dict[str, Any] = {"method": name, "preprocess": request.preprocess, "filter": request.filter, "t": t}
    how |= {} if r is None else {"reference": r}
    fitted = fit(u, y, request.dt, request.structure, **how)
    return Contender(name, result_of_fit(fitted, u, y, begun, t), fitted)


def best(contenders: Sequence[Contender]) -> Contender | None:
    """Return the contender with the best simulated fit; None if no contender has a model."""
    known = [(entry.result.simulation.fit, entry) for entry in contenders if entry.result is not None]
    usable = [(fit, entry) for fit, entry in known if fit > float("-inf")]
    return max(usable, key=lambda pair: pair[0])[1] if usable else None
