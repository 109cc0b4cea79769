"""Session: the loop from source to identifier to outputs, which waits only for samples; and `run`, a whole session."""

from __future__ import annotations

import contextlib
import ctypes
import shlex
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from replant.errors import CheckpointError, InvalidArgumentError, LogError, SystemRefusedError
from replant.live.judge_client import Observer
from replant.live.judge_process import DashboardAddress, ObserverOptions
from replant.live.make_view import EstimateHistory, make_view
from replant.live.outputs.message import (
    UNKNOWN,
    DiskWriter,
    EstimateMessage,
    Notices,
    ParquetRecorder,
    Sink,
    time_to_live,
)
from replant.live.outputs.sinks import Publisher, open_sink
from replant.live.progress import (
    AnyRequest,
    CheckpointWriter,
    Identification,
    Limits,
    Progress,
    Throughput,
    new_identification,
    resume,
    stop_on_signals,
)
from replant.live.streams import UY, Batch, Signals, Source, open_source
from replant.live.streams.source import REFERENCE
from replant.live.terminal_status import render
from replant.live.view import UNNAMED, SessionInfo, View
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import FloatArray
from replant.numerics.limits import typed_path
from replant.numerics.operating_system import alone, refusal
from replant.online.identifier import Identifier
from replant.verdict.estimate_tests import MOVED_SIGMAS

PATIENCE = 1.0  # time without a sample after which the first refused line is shown [s]


@dataclass(eq=False, kw_only=True)
class Session:
    """Learns the samples of a source as they arrive, and sends the estimates to the outputs."""

    source: Source
    identifier: Identification
    disk_writer: DiskWriter
    notices: Notices
    observer: Observer
    sinks: Sequence[Sink] = ()
    recorder: ParquetRecorder | None = None
    checkpoints: CheckpointWriter | None = None
    limits: Limits = field(default_factory=Limits)
    progress: Progress = field(default_factory=Progress)
    ttl: float | None = None  # time to live of the estimates in s; None: see `time_to_live`

    def __post_init__(self) -> None:
        ttl = time_to_live(self.identifier.dt) if self.ttl is None else self.ttl
        self._publisher = Publisher(self.sinks, self.recorder, ttl, notices=self.notices, on_reader_gone=self.stop)
        self._throughput = Throughput()
        self._begun = self.progress.taken  # samples of a session before, whose checkpoint this one continues
        self._learned = False  # whether samples were learned since the last handover to the observer
        self._stopped = False  # whether a user or the reader of the outputs has ended the session
        self._remarked = False  # whether the remark of the source has been shown
        self.has_reference = False  # whether samples with a reference came
        self._inconsistent = False  # whether the identifier may hold samples that the progress does not count
        self._judged = UNKNOWN, False, False  # verdict, excited and coefficients of the newest view

    def run(self) -> bool:
        """Run until the stream ends, a limit is reached, or SIGINT or SIGTERM asks for the end."""
        start = time.monotonic()
        if self.progress.sequence is not None:
            self.source.seek(self.progress.sequence)
        self._publisher.start(self._estimate())
        try:
            with stop_on_signals(self.stop):
                if self.checkpoints is not None and not self.checkpoints.there_are:
                    self._write_checkpoint("first")  # after a power cut no record may lack one to go on with
                try:
                    self._learn(start)
                except Exception as error:  # learning cannot continue: save what was learned
                    self._finish()
                    reason = refusal(error)
                    if reason is None:
                        raise
                    raise SystemRefusedError(
                        f"the session ended after {self.progress.taken:,} samples: {reason}"
                    ) from error
                self._finish()
                if self._refused:
                    raise LogError(f"{self.source.name}: no sample could be read; the first line is {self._refused}")
        finally:  # every receiver must learn that no estimate follows, however the session ends
            self._publisher.end()
        return self._judged[0] == "trusted" or not self.limits.until_trusted

    def stop(self) -> None:
        """End the session once the samples that have arrived are learned; from any thread or a signal handler."""
        self._stopped = True
        self.source.close()

    @property
    def info(self) -> SessionInfo:
        """The part of a view that the identifier does not have: source, counters, rate, lag."""
        rate, lag = self._throughput.read()
        counters = self.progress.counted(self.source.counters)
        silence = self._publisher.silence
        return SessionInfo(self.progress.at, self.source.name, self.source.state, counters, rate, lag, silence)

    # --- learning

    def _learn(self, start: float) -> None:
        """Learn the batches of the source until it ends or a limit is reached."""
        for batch in self.source.batches():
            self._learn_batch(batch)
            self._serve_outputs(time.monotonic())
            if self.source.remark and not self._remarked:
                self._remarked = True
                self.observer.show(f"replant: {self.source.name}: {self.source.remark}")
            seconds = time.monotonic() - start
            if seconds > PATIENCE and self._refused:
                self.notices.say(
                    "line", f"replant: {self.source.name}: no sample yet; the first line is {self._refused}"
                )
            trusted = self._judged[0] == "trusted"
            if self.limits.reached(seconds=seconds, samples=self.progress.taken, trusted=trusted):
                break
        self.source.close()

    @property
    def _refused(self) -> str:
        """The first line that the source refused, while this session has read no sample; else empty."""
        return "" if self.progress.taken > self._begun else self.source.refused

    @property
    def missed(self) -> str:
        """Why no sample came to a session that nobody has stopped; else empty."""
        trouble = self.source.trouble
        # a log or a pipe at its end has no sample more for a session that continues an earlier one
        if self.progress.taken > self._begun or self._stopped or (self._begun and not trouble):
            return ""
        return f"no sample came{f': {trouble}' if trouble else '; check that the source sends any'}"

    def _learn_batch(self, batch: Batch) -> None:
        """Learn the samples of a batch, up to the limit on samples."""
        left = self.limits.left(self.progress.taken)
        batch = batch if left is None else batch.select(slice(0, left))
        if not len(batch):
            return
        t = self._stamps(batch)
        before = self._accepted_outputs
        self.has_reference |= batch.r is not None
        self._inconsistent = True
        confirmed = t  # NaN where a stamp leaps and the identifier would follow it
        if t is not None and not isinstance(self.identifier, Identifier):
            confirmed = np.where(self.progress.clock.leaps, np.nan, t)
        self.identifier.update_many(batch.u, batch.y, confirmed, batch.r)
        if self._accepted_outputs > before:
            self._publisher.accepted()
        rig_time = self.progress.advance(batch, t, self.identifier.dt)
        self._inconsistent = False
        if self.recorder is not None:
            self.recorder.add_samples(batch, rig_time)
        self._learned = True
        self._throughput.count(len(batch), batch.arrived)
        self._publisher.mark()

    @property
    def _accepted_outputs(self) -> int:
        """Number of samples accepted with their output: a sample without output adds no information on the model."""
        return self.identifier.samples - self.identifier.rejected["no output"]

    def _stamps(self, batch: Batch) -> FloatArray | None:
        """Return the time stamps to learn with: the device's, else sequence numbers times dt, else None."""
        stamps = batch.t
        if stamps is None:
            if batch.sequence is None:
                return None
            stamps = np.asarray(batch.sequence * self.identifier.dt)
        before = self.progress.clock.offset
        t = self.progress.clock.follow(stamps, self.identifier.dt)
        if self.progress.clock.offset != before:
            self.observer.show("replant: the device's clock was set back: the filters restart, the estimate is kept")
        return t

    # --- everything besides learning

    def _serve_outputs(self, now: float) -> None:
        """Obey commands, send the estimate, hand the state to the observer, and write a checkpoint if one is due."""
        for name in self.observer.poll():
            self._obey(name)
        if self.source.trouble:
            self.notices.say("source", f"replant: {self.source.name}: {self.source.trouble}; trying again")
        self._update_verdict()
        with self._refusals_reported("estimates"):
            self._publisher.send(self._estimate)
        with self._refusals_reported("observer"):
            if self.observer.hand_over(self.identifier, self.info, learned=self._learned):
                self._learned = False
                self._throughput.lag = 0.0
        if self.checkpoints is not None and self.checkpoints.is_due(now):
            with self._refusals_reported("checkpoint"):
                self._flush_record()  # the record on the disk must reach as far as the checkpoint
                self.checkpoints.submit(self.identifier, self.progress.with_counters(self.source.counters))

    @contextmanager
    def _refusals_reported(self, subject: str) -> Iterator[None]:
        """Do a task other than learning; if the system refuses something, report it and continue."""
        try:
            yield
        except Exception as error:
            reason = refusal(error)
            if reason is None:
                raise
            self.notices.say(subject, f"replant: {subject}: {reason}; identification continues")

    def _update_verdict(self) -> None:
        """Take the newest verdict on the present model; a changed verdict is sent even if no sample arrives."""
        view, before = self._view, self._judged
        self._judged = (UNKNOWN, False, False) if view is None else (view.verdict, view.excited, view.coefficients)
        if self._judged != before and self.progress.taken:
            self._publisher.mark()

    @property
    def _view(self) -> View | None:
        """The newest view; None if the parameters have changed significantly since, as it then judges another model."""
        view = self.observer.view
        if view is None:
            return None
        with np.errstate(invalid="ignore"):  # infinite if the model has overflowed float64
            moved = np.abs(self.identifier.parameters - view.parameters) > MOVED_SIGMAS * view.std
        return None if moved.any() else view

    def _flush_record(self) -> None:
        if self.recorder is not None:
            self.recorder.flush()

    def _estimate(self) -> EstimateMessage:
        view, identifier = self._view, self.identifier
        unknown = np.full(len(identifier.names), np.nan)
        return EstimateMessage(
            self.progress.at,
            self.progress.sequence,
            identifier.samples,
            identifier.names,
            identifier.parameters if identifier.has_model else unknown,
            unknown if view is None else view.std,
            identifier.status,
            *self._judged,
        )

    def _obey(self, name: str) -> None:
        """Execute a command that a user gave at the dashboard."""
        try:
            {"freeze": self.identifier.freeze, "adapt": self.identifier.resume, "reset": self.identifier.reset}[name]()
        except InvalidArgumentError as mistake:
            self.observer.show(f"replant: {mistake}")
            return
        self._learned = True
        self.observer.show(f"replant: {name}, requested at the dashboard")

    # --- the end

    def _finish(self) -> None:
        """Save what was learned, then send the last estimate with its verdict."""
        with self._refusals_reported("record"):
            self._flush_record()
        self.disk_writer.wait()
        self._write_checkpoint("last")
        # the last verdict covers all samples; the status "ended", not silence, shows that no sample follows
        with self._refusals_reported("last view"):
            self.observer.wait_for_view(self.identifier, replace(self.info, silence=0.0))
        self._update_verdict()
        with self._refusals_reported("last estimate"):
            self._publisher.send(self._estimate, immediately=True)
        self._publisher.end()
        with self._refusals_reported("record"):
            self._flush_record()
        self.disk_writer.close()

    def _write_checkpoint(self, which: str) -> None:
        """Write a checkpoint now, unless the identifier holds samples that the progress does not count."""
        if self.checkpoints is None:
            return
        if self._inconsistent:
            self.observer.show(f"replant: no {which} checkpoint: learning was interrupted; the one before is kept")
            return
        with self._refusals_reported(f"{which} checkpoint"):
            try:
                self.checkpoints.write_now(self.identifier, self.progress.with_counters(self.source.counters))
            except CheckpointError as error:
                self.observer.show(f"replant: {error}")


M_MMAP_THRESHOLD = -3  # name of the setting in malloc.h [number]
THRESHOLD = 1 << 17  # size from which freed blocks return to the system at once: glibc's initial value [bytes]


def limit_heap_growth() -> None:
    """Have glibc map blocks of 128 KiB and more one by one, and return them when they are freed."""
    with contextlib.suppress(OSError, AttributeError, TypeError):
        # otherwise blocks of varying size fragment the heap: at first it grows by megabytes a minute
        ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, THRESHOLD)


def run(
    source: str,
    request: AnyRequest,
    limits: Limits,
    *,
    sinks: Sequence[str] = (),
    record: Path | None = None,
    checkpoint: Path | None = None,
    every: float = 10.0,  # time between two checkpoints [s]
    dashboard: DashboardAddress | None = None,
    truth: TransferFunction | None = None,
    columns: Signals = UY,
    signals: Signals = UNNAMED,
    ttl: float | None = None,
    background: bool = False,
    to_fit: Sequence[str] = (),
) -> bool:
    """Identify until the stream, a limit or the user ends the session, and print the result.

    Samples have the columns ``columns``, and are shown under the names ``signals``, beside the ``truth`` of a simulated
    rig.  ``to_fit`` are the options with which `replant fit` identifies the same model from the record.
    """
    from rich.console import Console

    limit_heap_growth()
    with ExitStack() as opened:
        for path in filter(None, (checkpoint, record)):
            opened.enter_context(alone(path))
        resumed = None if checkpoint is None else resume(checkpoint, request, background=background)
        progress, identifier, messages = resumed or (Progress(), new_identification(request, background=background), [])
        stream = open_source(source, columns)
        opened.callback(stream.close)
        receivers: list[Sink] = []
        for to in sinks:
            receivers.append(open_sink(to, time_to_live(request.dt) if ttl is None else ttl))
            opened.callback(receivers[-1].close)
        observer = Observer(ObserverOptions(dashboard, terminal=True, truth=truth, signals=signals))
        opened.callback(observer.close)
        for line in [*messages, *([f"replant: watch it at {observer.url}"] if observer.url else [])]:
            observer.show(line)
        notices = Notices(observer.show)
        disk_writer = DiskWriter(notices)
        session = Session(
            source=stream,
            identifier=identifier,
            disk_writer=disk_writer,
            notices=notices,
            observer=observer,
            sinks=receivers,
            recorder=None
            if record is None
            else ParquetRecorder(record, disk_writer, columns, go_on=resumed is not None),
            checkpoints=None if checkpoint is None else CheckpointWriter(checkpoint, every, disk_writer),
            limits=limits,
            progress=progress,
            ttl=ttl,
        )
        if record is not None:
            name = typed_path(record)
            command = shlex.join(["replant", "fit", name, *to_fit])
            observer.show(f"replant: to look at the record while it grows: {shlex.join(['replant', 'open', name])}")
            observer.show(f"replant: to fit it: {command}")
        reached = session.run()
        if record is not None and session.has_reference and "--reference" not in to_fit:  # a header named it
            observer.show(f"replant: to fit it with its reference: {command} --reference {REFERENCE}")
        if session.missed:
            raise LogError(f"{stream.name}: {session.missed}")
        waits = session.identifier.forced_waits if isinstance(session.identifier, Identifier) else 0
        if waits:
            waited = f"{waits:,} times a sample waited for the second process"
            observer.show(f"replant: {waited}: it solves the record more slowly than samples arrive")
    view = observer.last or make_view(session.identifier, session.info, EstimateHistory(len(session.identifier.names)))
    Console(stderr="-" in sinks).print(render(view, truth, running=False))
    return reached
