"""Run an identifier over a record of any length, with progress and a thinned history, and return the result."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from replant.estimation.filters import Filter
from replant.estimation.settings import LONGEST_STARTUP, STORED, Request
from replant.estimation.simulation.fitted_run import FITTED
from replant.estimation.simulation.model_run import Score, runs_away
from replant.kernels.monitoring.interruptions import INPUT_LEAP
from replant.model.preprocess import screen
from replant.model.structure import Structure
from replant.numerics.arguments import BoolArray, FloatArray, IntArray
from replant.numerics.linear_algebra import quiet
from replant.numerics.robust import NONE, flags_of, stretches_of
from replant.online.bank import Bank
from replant.online.bank_members import asked_for
from replant.online.identifier import Identifier
from replant.online.running_model import model_of
from replant.online.runs.result import KNOTS, ClockRecorder, History, Recorder, Result
from replant.online.startup import settle
from replant.online.trace import Trace
from replant.verdict import Simulation

if TYPE_CHECKING:
    from replant.logs.recording import Recording

CHUNK = 1 << 13  # samples between two reports of progress, fewer than an identifier keeps [samples]
PIECE = 1 << 15  # samples of a batch in the second pass [samples]
MOST_ROWS = 10_000  # rows of history kept, more than a plot can show [rows]
SETTLED = 1_000_000  # first samples used for choices made before the run [samples]
IDENTIFYING, TESTING = "identifying", "testing"  # the stages of a run
BANDS = 200  # times at which standard deviations are recorded during a run [count]


Batch = tuple[FloatArray, ...]  # (K,) each: input, output, the reference if any, the stamps if any
Block = tuple[FloatArray, FloatArray, FloatArray | None, FloatArray | None]  # the same, None for what there is not


@dataclass(frozen=True, eq=False)
class Arrays:
    """A record in memory: input and output (K,); optional reference and stamps in s of an irregular clock."""

    input: FloatArray
    output: FloatArray
    reference: FloatArray | None = None
    stamps: FloatArray | None = None

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.input.size

    @property
    def complete(self) -> bool:
        """Whether every sample is finite."""
        return all(bool(np.isfinite(signal).all()) for batch in self.batches() for signal in batch)

    def batches(self) -> Iterator[Batch]:
        """Yield the record as one batch."""
        every = self.input, self.output, self.reference, self.stamps
        yield tuple(signal for signal in every if signal is not None)


def batched(batches: Iterable[Batch], size: int) -> Iterator[Batch]:
    """Yield a record in batches of ``size``, the last one shorter; an empty record as one empty batch."""
    held: list[Batch] = []
    some = False
    for batch in batches:
        held.append(batch)
        while sum(part[0].size for part in held) >= size:
            whole = _joined(held)
            yield tuple(signal[:size] for signal in whole)
            held, some = [tuple(signal[size:] for signal in whole)], True
    rest = _joined(held)
    if rest[0].size or not some:
        yield rest


def _joined(parts: list[Batch]) -> Batch:
    if not parts:
        return np.empty(0), np.empty(0)
    return parts[0] if len(parts) == 1 else tuple(np.concatenate(signals) for signals in zip(*parts, strict=True))


def run_online(
    request: Request,
    u: FloatArray,
    y: FloatArray,
    progress: Callable[[int], None] = lambda samples: None,
    *,
    startup: int | None = None,
    reference: FloatArray | None = None,
    t: FloatArray | None = None,
    structures: Sequence[Structure] = (),
) -> Result:
    """Identify a record in memory in one pass; see `run_source`."""

    def report(stage: str, samples: int) -> None:
        if stage == IDENTIFYING:
            progress(samples)

    source = Arrays(u, y, reference, t)
    return run_source(request, source, report, startup=startup, irregular=t is not None, structures=structures)


@quiet
def run_source(
    request: Request,
    source: Arrays | Recording,
    progress: Callable[[str, int], None] = lambda stage, samples: None,
    sink: Callable[[Trace], None] = lambda trace: None,
    newest: int | None = None,
    startup: int | None = None,
    irregular: bool = False,
    with_history: bool = True,
    structures: Sequence[Structure] = (),  # instead of the request's: they learn side by side, the lead is the result
) -> Result:
    """Identify a record of any length in one pass; a second pass simulates the model and computes its fits."""
    begun = time.perf_counter()
    given = asked_for(structures, {}) if structures else [{"structure": request.structure}]
    requests = [replace(request, **each) for each in given]
    members = [_identifier(each, source, startup, irregular=irregular) for each in requests]
    bank = Bank(members) if structures else None
    histories = [_History(source.samples, each.structure.size) for each in members] if with_history else []
    all_bridged = [_Bridged(each) for each in members]
    dt = members[0].dt
    chunk = min(CHUNK, max(1, source.samples // BANDS))
    # on a regular clock stamps let missing samples take their time; the article's filters take none
    regular_only = isinstance(request.filter, Filter) and request.filter.regular_only
    done, stamped = 0, not source.complete and not regular_only
    ends: list[float] = []  # the first and the last stamp
    for u, y, r, t in _blocks(source, FITTED, irregular=irregular):
        if t is not None and t.size:
            ends = [ends[0] if ends else float(t[0]), float(t[-1])]
        for start in range(0, u.size, chunk):
            piece = slice(start, start + chunk)
            regular = np.asarray(dt * np.arange(done, done + u[piece].size)) if stamped else None
            stamps = regular if t is None else t[piece]
            samples = u[piece], y[piece], stamps, None if r is None else r[piece]
            traces = (members[0].update_many(*samples),) if bank is None else bank.update_many(*samples).members
            for each in all_bridged:
                each.take(u[piece], y[piece])
            for member, trace, history in zip(members, traces, histories, strict=False):
                history.take(trace, member.uncertainty.std)
            sink(traces[0])
            done += len(traces[0])
            progress(IDENTIFYING, done)
    finished = startup is None or all(each.settings is None for each in members)
    if finished:
        (members[0] if bank is None else bank).finish()
    lead = 0 if bank is None else bank.lead
    identifier, bridged, kept = members[lead], all_bridged[lead], histories[lead] if histories else None
    if finished and kept is not None:
        kept.end(identifier.parameters, identifier.uncertainty.std)
    bridged.note()
    bridged.note_again()
    settings, verdict = identifier.settings, identifier.assess()
    span = ends[1] - ends[0] if ends else dt * (done - 1)
    tested = _Tested(identifier, source.samples, newest, span, bridged.loads.tolist())
    size = FITTED  # the first samples fit the initial state; later pieces fit into the cache
    for u, y, _, t in _blocks(source, FITTED, irregular=irregular):
        for start in range(0, max(u.size, 1), size):
            piece = slice(start, start + size)
            tested.take(u[piece], y[piece], None if t is None else t[piece], bridged.stretches)
            progress(TESTING, tested.record.samples)
        size = PIECE
    simulation = tested.simulation
    return Result(
        model_of(identifier, simulation, tested.score.one_step, verdict), tested.score.one_step, simulation,
        identifier.samples, identifier.rejected, verdict, time.perf_counter() - begun, settings,
        None if kept is None else kept.history, tested.record.overview(tested.score.shift),
        np.concatenate(tested.left_out), bridged.loads, finished, tested.clock.clock,
        () if bank is None else tuple(zip(bank.structures, bank.weights.tolist(), strict=True)),
        () if bank is None else bank.leads,
    )  # fmt: skip


def _blocks(source: Arrays | Recording, size: int, *, irregular: bool) -> Iterator[Block]:
    """Yield a record as `Block`, of ``size`` samples each, the last one shorter."""
    for u, y, *others in batched(source.batches(), size):
        t = others.pop() if irregular and others else None
        yield u, y, others[0] if others else None, t


def _identifier(request: Request, source: Arrays | Recording, startup: int | None, *, irregular: bool) -> Identifier:
    if startup is None and request.wants_instruments:
        startup = min(max(source.samples // 10, 1), LONGEST_STARTUP)
    if startup is not None:
        return Identifier(**vars(replace(request, startup=startup)))
    u, y, _, t = next(_blocks(source, SETTLED, irregular=irregular))
    return Identifier(**settle(request, u, y, source.samples, t=t).arguments)


class _History:
    """Keeps evenly spaced rows of the traces: of a long record at least `MOST_ROWS`, and fewer than twice as many."""

    def __init__(self, samples: int, size: int) -> None:
        self._stride, self._seen = max(1, samples // MOST_ROWS), 0
        self._rows, self._bands = [np.empty((0, size))], [np.empty((0, size))]

    def take(self, trace: Trace, std: FloatArray) -> None:
        self._rows.append(trace.parameters[(-1 - self._seen) % self._stride :: self._stride].copy())
        self._bands.append(np.broadcast_to(std, self._rows[-1].shape))
        self._seen += len(trace)

    def end(self, parameters: FloatArray, std: FloatArray) -> None:
        """Replace the newest row by the final estimate from the whole record."""
        if len(self._rows) > 1 and len(self._rows[-1]):
            self._rows[-1][-1] = parameters
            self._bands[-1] = self._bands[-1].copy()
            self._bands[-1][-1] = std

    @property
    def history(self) -> History:
        parameters = np.concatenate(self._rows)
        samples = self._stride * np.arange(1, parameters.shape[0] + 1)
        return History(samples, parameters, np.concatenate(self._bands))


class _Bridged:
    """Collects the samples of the record that an identifier has bridged, read from its raw samples after each chunk."""

    def __init__(self, identifier: Identifier) -> None:
        self._identifier = identifier
        self._samples = 0  # samples of the record noted so far
        self._accepted: list[BoolArray] = []  # which of the later samples are accepted, as a start-up collects them
        self._found = [NONE]
        self._all: list[BoolArray] = []  # which of all samples are accepted, while the record is short enough to solve
        self._seen = 0
        self.loads = np.zeros(0, np.int64)  # samples at which a new load begins to act

    def take(self, u: FloatArray, y: FloatArray) -> None:
        """Take the samples (K,) that the identifier has just been given."""
        # a sample without an output is kept as well
        mapped = self._identifier.request.preprocess.map_input(u)
        self._accepted.append(screen(mapped, np.where(np.isfinite(y), y, 0.0))[0])
        self._seen += u.size
        if self._seen <= 2 * STORED:
            self._all.append(self._accepted[-1])
        else:
            self._all = []
        if self._identifier.settings is not None:
            self.note()

    def note(self) -> None:
        """Note which samples since the last note were bridged; a long start-up keeps only the newest ones."""
        accepted = np.concatenate([np.empty(0, bool), *self._accepted])
        self._found.append(_stretches_among(accepted, self._identifier.bridged, self._samples))
        self._samples += accepted.size
        self._accepted = []

    def note_again(self) -> None:
        """Replace the bridged samples by those that the solution of the whole record leaves out."""
        left_out = self._identifier.left_out
        if left_out.size and self._all:
            accepted = np.concatenate(self._all)
            self._found = [_stretches_among(accepted, left_out)]
            self.loads = np.flatnonzero(accepted)[list(self._identifier.loads)]

    @property
    def stretches(self) -> IntArray:
        """The stretches of bridged samples in the whole record, (R, 2)."""
        return np.concatenate(self._found)


def _stretches_among(accepted: BoolArray, doubted: BoolArray, first: int = 0) -> IntArray:
    """Return the stretches (R, 2) of doubted samples; ``doubted`` has a flag for each of the newest accepted ones."""
    places, flags = np.flatnonzero(accepted), np.zeros(accepted.size, bool)
    count = min(places.size, doubted.size)
    flags[places[places.size - count :]] = doubted[doubted.size - count :]
    return stretches_of(flags, first)


class _Tested:
    """The second pass: simulation of the model over the record, its fits, and the samples they leave out."""

    def __init__(
        self, identifier: Identifier, samples: int, newest: int | None, span: float, loads: Sequence[int]
    ) -> None:
        settings, request = identifier.settings, identifier.request
        hold = settings.filter.input_hold if settings else "zoh"
        model, dt = identifier.transfer_function, identifier.dt
        self._predicts = runs_away(model.den, span)
        self.score = Score(model, dt, hold, loads, predicts=self._predicts)
        self.record, self.left_out = Recorder(samples, newest), [NONE]
        self.clock = ClockRecorder(identifier.dt, samples, samples if newest is None else KNOTS)
        self._preprocess, self._chosen = request.preprocess, settings.preprocess if settings else None
        state = identifier._state
        # an input farther than ``_misread`` from ``_usual`` was rejected by the identifier as misread
        self._misread, self._usual = math.inf, 0.0
        if settings is not None and identifier.rejected["input leap"]:
            self._misread, self._usual = INPUT_LEAP * math.sqrt(state.largest_power), state.input_mean

    def take(self, u: FloatArray, y: FloatArray, t: FloatArray | None, bridged: IntArray) -> None:
        """Take the next samples (K,)."""
        if self._chosen is None:  # every sample was rejected
            self._chosen = self._preprocess.resolve(u, y)
        mapped = self._chosen.map_input(u)
        if math.isfinite(self._misread):
            far = np.abs(mapped - float(self._chosen.input_offset) - self._usual) > self._misread
            mapped = np.where(far, np.nan, mapped)
        accepted, _ = screen(mapped, y)
        used = accepted & ~flags_of(bridged, self.record.samples, u.size)
        self.left_out.append(stretches_of(~used, self.record.samples))
        known = screen(mapped, np.zeros(u.size))[0]  # the input of a sample without an output still acts
        driven = np.where(known, mapped - float(self._chosen.input_offset), np.nan)
        modelled = self.score.take(driven, np.where(used, y, np.nan), t)
        self.record.take(u, y, modelled, used, t)
        if t is not None:
            self.clock.take(t)

    @property
    def simulation(self) -> Simulation:
        """The simulation of the newest samples that are kept."""
        score = self.score
        return Simulation(self.record.output(score.shift), score.offset, score.simulated, is_prediction=self._predicts)
