"""A record of any length through an identifier: with progress, a thinned history, and the result at the end."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from replant.arguments import BoolArray, FloatArray
from replant.assessment import Simulation, Verdict, assess_record
from replant.engine.record import ready_record
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.offline.fit import FitResult
from replant.online.defaults import settle
from replant.online.identifier import Identifier
from replant.online.trace import Trace
from replant.regressor.filters import Filter, StateVariableFilter
from replant.regressor.preprocess import screen
from replant.runs.batches import Arrays, Source, batched
from replant.runs.overview import Overview, Recorder
from replant.settings import LONGEST_STARTUP, Request, Settings
from replant.simulation.score import FITTED, Score
from replant.simulation.stretches import (
    NONE,
    IntArray,
    flags_of,
    joined,
    stretches_of,
)
from replant.statistics.linear_algebra import quiet

CHUNK = 1 << 13
"""Samples between two reports of progress: fewer than an identifier keeps [samples]."""
PIECE = 1 << 15
"""Samples of the second pass that are looked at together [samples]."""
MOST_ROWS = 10_000
"""Rows of history kept: more than a plot can show [rows]."""
SETTLED = 1_000_000
"""Samples looked at where choices are made from the record beforehand [samples]."""
IDENTIFYING, TESTING = "identifying", "testing"  # the stages of a run
MOST_SHADES = 1000
"""Stretches left out that a plot tells apart [count]."""
BANDS = 200
"""Times that standard deviations are taken along the way [count]."""


@dataclass(frozen=True, eq=False)
class History:
    """The estimate over time, thinned.

    Attributes
    ----------
    samples : (H,) array of int
        After how many samples each row was taken.
    parameters : (H, P) array
    std : (H, P) array or None
        Standard deviation of each estimate, where the estimator tells it.
    """

    samples: np.ndarray[tuple[int], np.dtype[np.int64]]
    parameters: FloatArray
    std: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Result:
    """An identified model with what is needed to trust or distrust it.

    Attributes
    ----------
    structure : Structure
    parameters : (P,) array
    transfer_function : TransferFunction
    one_step, simulated : float
        Fit in percent: from past outputs, and from the input alone.
    simulation : Simulation
    samples : int
        Accepted samples.
    rejected : dict
        Rejected samples by reason.
    verdict : Verdict
    elapsed : float
        Time taken in s.
    settings : Settings or None
        Of an online run.
    history : History or None
        Of an online run.
    covariance : (P, P) array or None
        Of the parameters, in their units squared, where the estimator tells it.
    overview : Overview or None
        Of a record too long to be held; the simulation then holds its newest samples alone.
    left_out : (R, 2) array of int
        Samples that take no part in the fits, as rows [begin, end) of the record: bridged, rejected, or without an
        output.
    """

    structure: Structure
    parameters: FloatArray
    transfer_function: TransferFunction
    one_step: float
    simulation: Simulation
    samples: int
    rejected: dict[str, int]
    verdict: Verdict
    elapsed: float
    settings: Settings | None = None
    history: History | None = None
    covariance: FloatArray | None = None
    overview: Overview | None = None
    left_out: IntArray = field(default_factory=NONE.copy)

    def left_out_over_time(self, dt: float) -> FloatArray:
        """Return from when to when samples take no part (L, 2), in s; those that no plot could part are joined."""
        samples = self.overview.samples if self.overview else self.simulation.output.size
        rows = joined(self.left_out, max(1, samples // MOST_SHADES)) - np.array([1.0, 0.0])
        return np.asarray(dt * np.maximum(rows, 0.0))

    def residual(self, y: FloatArray) -> FloatArray:
        """Return measured output (K,), the newest of the record, less the simulated one; NaN where it takes no part."""
        first = (self.overview.samples if self.overview else y.size) - y.size
        with np.errstate(over="ignore", invalid="ignore"):
            return np.where(flags_of(self.left_out, first, y.size), np.nan, y - self.simulation.output)

    @property
    def uncertainty(self) -> Uncertainty | None:
        """Standard deviations of parameters, poles, gain and response, where the estimator tells them."""
        return None if self.covariance is None else Uncertainty(self.structure, self.parameters, self.covariance)

    @property
    def fixed_filter(self) -> StateVariableFilter | None:
        """The filter of an online run; 1/A of the result where it was the refined one."""
        if self.settings is None:
            return None
        return self.settings.filter.fixed_at(self.transfer_function.den, self.settings.dt)


def run_online(
    request: Request,
    u: FloatArray,
    y: FloatArray,
    progress: Callable[[int], None] = lambda samples: None,
    *,
    startup: int | None = None,
) -> Result:
    """Identify in one pass over a record in memory; see `run_source`.

    Parameters
    ----------
    request : Request
    u, y : (K,) arrays
        Raw input and output.
    progress : callable
        Called with the number of samples done, every few thousand.
    startup : int, optional
        See `run_source`.
    """

    def report(stage: str, samples: int) -> None:
        if stage == IDENTIFYING:
            progress(samples)

    return run_source(request, Arrays(u, y), report, startup=startup)


def run_source(
    request: Request,
    source: Source,
    progress: Callable[[str, int], None] = lambda stage, samples: None,
    sink: Callable[[Trace], None] = lambda trace: None,
    newest: int | None = None,
    startup: int | None = None,
) -> Result:
    """Identify in one pass over a record of any length; a second pass runs the model beside it.

    Where instruments are wanted, a tenth of the record is the start-up, 20000 samples at the most; else what is left
    to "auto" is chosen from the first million samples beforehand.

    Parameters
    ----------
    request : Request
    source : Source
    progress : callable
        Called with the stage, "identifying" or "testing", and how many of its samples are done.
    sink : callable
        Called with the trace of every few thousand samples.
    newest : int, optional
        How many samples of the simulation are kept, where the record is too long for all of them.
    startup : int, optional
        Samples held back for the start-up; the run is then, to the bit, what it would have been live.
    """
    begun = time.perf_counter()
    identifier = _identifier(request, source, startup)
    history, bridged = _History(source.samples, request.structure.size), _Bridged(identifier)
    chunk = min(CHUNK, max(1, source.samples // BANDS))
    done, stamped = 0, _needs_stamps(request, source)
    for u, y in batched(source.batches(), FITTED):
        for start in range(0, u.size, chunk):
            piece = slice(start, start + chunk)
            t = identifier.dt * np.arange(done, done + u[piece].size) if stamped else None
            trace = identifier.update_many(u[piece], y[piece], t)
            bridged.take(u[piece], y[piece])
            history.take(trace, identifier.uncertainty.std)
            sink(trace)
            done += len(trace)
            progress(IDENTIFYING, done)
    identifier.finish_startup()
    bridged.note()
    return _result(identifier, request, history.history, source, begun, progress, newest, bridged.stretches)


def _needs_stamps(request: Request, source: Source) -> bool:
    """Return whether samples are missing: without stamps a rejected one would take no time.

    The article's filters know a regular clock only.
    """
    regular_only = isinstance(request.filter, Filter) and request.filter.regular_only
    return not source.complete and not regular_only


def _identifier(request: Request, source: Source, startup: int | None) -> Identifier:
    if startup is not None:
        return Identifier(**vars(dataclasses.replace(request, startup=startup)))
    if request.wants_instruments:
        startup = min(max(source.samples // 10, 1), LONGEST_STARTUP)
        return Identifier(**vars(dataclasses.replace(request, startup=startup)))
    u, y = next(batched(source.batches(), SETTLED), (np.empty(0), np.empty(0)))
    return Identifier(**vars(settle(request, u, y, source.samples)))


class _History:
    """Every so many rows of the traces that come, so that `MOST_ROWS` or up to twice as many are kept."""

    def __init__(self, samples: int, size: int) -> None:
        self._stride, self._seen = max(1, samples // MOST_ROWS), 0
        self._rows, self._bands = [np.empty((0, size))], [np.empty((0, size))]

    def take(self, trace: Trace, std: FloatArray) -> None:
        self._rows.append(trace.parameters[(-1 - self._seen) % self._stride :: self._stride].copy())
        self._bands.append(np.broadcast_to(std, self._rows[-1].shape))
        self._seen += len(trace)

    @property
    def history(self) -> History:
        parameters = np.concatenate(self._rows)
        samples = self._stride * np.arange(1, parameters.shape[0] + 1)
        return History(samples, parameters, np.concatenate(self._bands))


class _Bridged:
    """Which samples of the record an identifier bridged, told from those that it keeps after each chunk."""

    def __init__(self, identifier: Identifier) -> None:
        self._identifier = identifier
        self._samples = 0  # of the record, up to the last note
        self._accepted: list[BoolArray] = []  # since then: the identifier may hold samples back
        self._found = [NONE]

    def take(self, u: FloatArray, y: FloatArray) -> None:
        """Take the samples (K,) that the identifier has just been given."""
        self._accepted.append(screen(self._identifier.request.preprocess.map_input(u), y)[0])
        if self._identifier.settings is not None:
            self.note()

    def note(self) -> None:
        """Note which of the samples since the last note were bridged; of a long start-up, the newest that are kept."""
        accepted = np.concatenate([np.empty(0, bool), *self._accepted])
        places, doubted = np.flatnonzero(accepted), self._identifier.bridged
        count = min(places.size, doubted.size)
        flags = np.zeros(accepted.size, bool)
        flags[places[places.size - count :]] = doubted[doubted.size - count :]
        self._found.append(stretches_of(flags, self._samples))
        self._samples += accepted.size
        self._accepted = []

    @property
    def stretches(self) -> IntArray:
        """Of the whole record, (R, 2)."""
        return np.concatenate(self._found)


@quiet
def _result(
    identifier: Identifier,
    request: Request,
    history: History,
    source: Source,
    begun: float,
    progress: Callable[[str, int], None],
    newest: int | None,
    bridged: IntArray,
) -> Result:
    """Return the result of an online run over a record; ``begun`` is the clock at its start."""
    settings = identifier.settings
    hold = settings.filter.input_hold if settings else "zoh"
    score = Score(identifier.transfer_function, identifier.dt, hold)
    preprocess = settings.preprocess if settings else None
    kept, left_out = Recorder(source.samples, newest), [NONE]
    for u, y in _pieces(source):
        if preprocess is None:  # not one sample could be used
            preprocess = request.preprocess.resolve(u, y)
        mapped = preprocess.map_input(u)
        accepted, _ = screen(mapped, y)
        used = accepted & ~flags_of(bridged, kept.samples, u.size)
        left_out.append(stretches_of(~used, kept.samples))
        measured = np.where(used, y, np.nan)
        modelled = score.take(np.where(accepted, mapped - float(preprocess.input_offset), np.nan), measured)
        kept.take(u, y, modelled, used)
        progress(TESTING, kept.samples)
    covariance = identifier.covariance
    return Result(
        identifier.structure,
        identifier.parameters,
        identifier.transfer_function,
        score.one_step,
        Simulation(kept.output(score.shift), score.offset, score.simulated),
        identifier.samples,
        identifier.rejected,
        identifier.assess(),
        time.perf_counter() - begun,
        settings,
        history,
        covariance if np.isfinite(covariance).all() else None,
        kept.overview(score.shift),
        np.concatenate(left_out),
    )


def _pieces(source: Source) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Go through a record: first what the initial state is fitted over, then pieces that a processor's cache holds."""
    first = True
    for u, y in batched(source.batches(), FITTED):
        size = FITTED if first else PIECE
        first = False
        yield from ((u[start : start + size], y[start : start + size]) for start in range(0, max(u.size, 1), size))


@quiet
def result_of_fit(fitted: FitResult, u: FloatArray, y: FloatArray, begun: float) -> Result:
    """Return the result of an offline fit to the record u, y; ``begun`` is the clock at its start."""
    hold = fitted.filter.input_hold
    record = ready_record(fitted.structure, fitted.dt, fitted.preprocess, u, y, input_hold=hold)
    return Result(
        fitted.structure,
        fitted.parameters,
        fitted.transfer_function,
        fitted.one_step,
        fitted.simulation,
        fitted.samples,
        fitted.rejected,
        assess_record(
            fitted.structure,
            fitted.parameters,
            record,
            fitted.dt,
            fitted.covariance,
            instruments=fitted.method != "least_squares",
        ),
        time.perf_counter() - begun,
        covariance=fitted.covariance,
        left_out=stretches_of(~screen(fitted.preprocess.map_input(u), y)[0]),
    )
