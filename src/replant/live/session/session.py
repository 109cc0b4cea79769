"""Session: source -> identifier -> sinks, in one loop that waits for nothing but samples."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from replant.arguments import FloatArray
from replant.data.streams import Batch, Source
from replant.errors import CheckpointError, InvalidArgumentError, SystemRefusedError
from replant.live.observer.client import Observer
from replant.live.observer.view import Pulse
from replant.live.outputs.disk_writer import Background
from replant.live.outputs.message import UNKNOWN, Estimate, time_to_live
from replant.live.outputs.notices import Notices
from replant.live.outputs.outlets import Outlets
from replant.live.outputs.parquet_recorder import Recorder
from replant.live.outputs.sinks import Sink
from replant.live.session.checkpointing import Keeper
from replant.live.session.progress import Progress
from replant.online.identifier import Identifier
from replant.system.refusals import refusal


@dataclass(frozen=True)
class Limits:
    """When a session ends by itself.

    Attributes
    ----------
    seconds : float or None
        After so much real time.
    samples : int or None
        When so many samples have been taken, those before a resumption and rejected ones included.
    until_trusted : bool
        When the verdict is "trusted".
    """

    seconds: float | None = None
    samples: int | None = None
    until_trusted: bool = False


class Session:
    """Learn the samples of a source while they come, and hand the estimates on.

    Parameters
    ----------
    source : Source
    identifier : Identifier
    background : Background
        Writes what the recorder and the keeper hand it; closed in the end.
    notices : Notices
    observer : Observer
    sinks : sequence of Sink
    recorder : Recorder or None
    keeper : Keeper or None
        Keeps checkpoints.
    limits : Limits
    progress : Progress
        Of the session that this one resumes.
    ttl : float or None
        Seconds for which "trusted" may stand without an accepted sample; None: see `time_to_live`.
    """

    def __init__(
        self,
        source: Source,
        identifier: Identifier,
        *,
        background: Background,
        notices: Notices,
        observer: Observer,
        sinks: Sequence[Sink] = (),
        recorder: Recorder | None = None,
        keeper: Keeper | None = None,
        limits: Limits = Limits(),
        progress: Progress | None = None,
        ttl: float | None = None,
    ) -> None:
        self.identifier, self.source = identifier, source
        self.progress = progress or Progress()
        self._background, self._notices, self._observer = background, notices, observer
        self._recorder, self._keeper = recorder, keeper
        ttl = time_to_live(identifier.dt) if ttl is None else ttl
        self._outlets = Outlets(sinks, recorder, ttl, notices=notices, gone=self.stop)
        self._limits = limits
        self._meter = _Meter()
        self._clock = self.progress.clock(identifier.dt)
        self._learned = self._trusted = False
        self._torn = False  # whether samples were taken by the identifier alone, or by a part of it
        self._verdict = UNKNOWN

    def run(self) -> bool:
        """Run until the stream ends, a limit is reached, or SIGINT or SIGTERM asks for the end.

        Returns
        -------
        bool
            Whether the verdict was "trusted" in the end, where that was to end the session; else True.

        Raises
        ------
        ReplantError
            If the source fails for good, or the system refuses what learning needs; what was learned has been kept and
            handed on before.
        """
        begun = time.monotonic()
        if self.progress.sequence is not None:
            self.source.seek(self.progress.sequence)
        self._outlets.begin(self._estimate())
        try:
            with self._stopped_by_signals():
                try:
                    self._learn(begun)
                except Exception as error:  # it cannot go on: what was learned is kept
                    self._finish()
                    reason = refusal(error)
                    if reason is None:
                        raise
                    raise SystemRefusedError(
                        f"the session ended after {self.progress.taken:,} samples: {reason}"
                    ) from error
                self._finish()
        finally:  # whatever happened, nobody is left with an estimate that nobody answers for
            self._outlets.end()
        return self._trusted or not self._limits.until_trusted

    def _learn(self, begun: float) -> None:
        for batch in self.source.batches():
            self._take(batch)
            self._go_on(time.monotonic())
            if self._is_enough(time.monotonic() - begun):
                break
        self.source.close()

    def stop(self) -> None:
        """End soon, when what has come in already is learned; from any thread, or from a signal handler."""
        self.source.close()

    @property
    def pulse(self) -> Pulse:
        """What the session knows and its identifier does not."""
        rate, lag = self._meter.read()
        counters = self.progress.counted(self.source.counters)
        silence = self._outlets.silence
        return Pulse(self.progress.at, self.source.name, self.source.state, counters, rate, lag, silence)

    def _take(self, batch: Batch) -> None:
        """Learn the samples of a batch that are still wanted."""
        batch = self._cut(batch)
        if not batch.u.size:
            return
        t = self._stamps(batch)
        before = self._measured
        self._torn = True
        self.identifier.update_many(batch.u, batch.y, t)
        if self._measured > before:
            self._outlets.accepted()
        clock = self.progress.advance(batch, t, self.identifier.dt)
        self._torn = False
        if self._recorder is not None:
            self._recorder.take(batch.sequence, clock, batch.u, batch.y)
        self._learned = True
        self._meter.count(batch.u.size, batch.arrived)
        self._outlets.mark()

    @property
    def _measured(self) -> int:
        """How many samples were accepted with their output: without one nothing says that the model still holds."""
        return self.identifier.samples - self.identifier.rejected["no output"]

    def _stamps(self, batch: Batch) -> FloatArray | None:
        """Return the time stamps to learn with: the device's, or those that its numbers give on a regular clock."""
        stamps = batch.t
        if stamps is None:
            if batch.sequence is None:
                return None
            stamps = np.asarray(batch.sequence * self.identifier.dt)
        t = self._clock.follow(stamps)
        if self._clock.offset != self.progress.offset:
            self._observer.show("replant: the device's clock went back: its filters begin anew, the estimate goes on")
        self.progress.follow(self._clock)
        return t

    def _cut(self, batch: Batch) -> Batch:
        """Return as much of a batch as the limit on samples leaves."""
        if self._limits.samples is None:
            return batch
        return _part(batch, slice(0, max(self._limits.samples - self.progress.taken, 0)))

    def _go_on(self, now: float) -> None:
        """Do what is due besides learning."""
        for name in self._observer.poll():
            self._obey(name)
        if self.source.trouble:
            self._notices.say("source", f"replant: {self.source.name}: {self.source.trouble}; trying again")
        self._hear()
        with self._spared("estimates"):
            self._outlets.send(self._estimate)
        with self._spared("observer"):
            if self._observer.hand(self.identifier, self.pulse, learned=self._learned):
                self._learned = False
                self._meter.forget_lag()
        if self._keeper is not None and self._keeper.is_due(now):
            with self._spared("checkpoint"):
                self._keep(self._keeper)

    @contextmanager
    def _spared(self, subject: str) -> Iterator[None]:
        """Do what is no part of learning: where the system refuses it, say so and go on."""
        try:
            yield
        except Exception as error:
            reason = refusal(error)
            if reason is None:
                raise
            self._notices.say(subject, f"replant: {subject}: {reason}; going on")

    def _hear(self) -> None:
        """Take the newest verdict; a new one is worth an estimate even if no sample comes."""
        view = self._observer.view
        verdict = UNKNOWN if view is None else view.verdict
        if verdict != self._verdict and self.progress.taken:
            self._outlets.mark()
        self._verdict, self._trusted = verdict, verdict == "trusted"

    def _keep(self, keeper: Keeper) -> None:
        """Keep a checkpoint; what was recorded until then is on the disk before it."""
        if self._recorder is not None:
            self._recorder.flush()
        keeper.keep(self.identifier, self.progress.with_counters(self.source.counters))

    def _estimate(self) -> Estimate:
        view, identifier = self._observer.view, self.identifier
        unknown = np.full(identifier.structure.size, np.nan)
        return Estimate(
            self.progress.at,
            self.progress.sequence,
            identifier.samples,
            identifier.names,
            identifier.parameters if identifier.settings is not None else unknown,
            unknown if view is None else view.std,
            identifier.status,
            self._verdict,
        )

    def _obey(self, name: str) -> None:
        """Do what a user of the dashboard asks for."""
        try:
            {"freeze": self.identifier.freeze, "adapt": self.identifier.resume, "reset": self.identifier.reset}[name]()
        except InvalidArgumentError as mistake:
            self._observer.show(f"replant: {mistake}")
            return
        self._learned = True
        self._observer.show(f"replant: {name}, asked for at the dashboard")

    def _is_enough(self, seconds: float) -> bool:
        limits = self._limits
        return (
            (limits.seconds is not None and seconds >= limits.seconds)
            or (limits.samples is not None and self.progress.taken >= limits.samples)
            or (limits.until_trusted and self._trusted)
        )

    def _finish(self) -> None:
        """Keep what was learned first of all, then hand on the last estimate with its verdict."""
        with self._spared("record"):
            if self._recorder is not None:
                self._recorder.flush()
        self._background.wait()
        with self._spared("last checkpoint"):
            self._keep_last()
        # the last verdict is one on all samples: that none comes any more is said by the end itself
        with self._spared("last view"):
            self._observer.look_again(self.identifier, replace(self.pulse, silence=0.0))
        self._hear()
        with self._spared("last estimate"):
            self._outlets.send(self._estimate, at_any_rate=True)
        self._outlets.end()
        with self._spared("record"):
            if self._recorder is not None:
                self._recorder.close()
        self._background.close()

    def _keep_last(self) -> None:
        """Keep the last checkpoint, unless the identifier has taken samples that the progress knows nothing of."""
        if self._keeper is None:
            return
        if self._torn:
            self._observer.show("replant: the checkpoint stays as it was last written")
            return
        try:
            self._keeper.finish(self.identifier, self.progress.with_counters(self.source.counters))
        except CheckpointError as error:
            self._observer.show(f"replant: {error}")

    @contextmanager
    def _stopped_by_signals(self) -> Iterator[None]:
        """Stop on the first SIGINT or SIGTERM; the second one finds Python's own handling."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

        def stop(*_: object) -> None:
            for number, handler in before.items():
                signal.signal(number, handler)
            self.stop()

        for number in before:
            signal.signal(number, stop)
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


class _Meter:
    """Samples a second, and how long they took from the wire into the estimate."""

    def __init__(self) -> None:
        self._since: float | None = None  # nothing has come yet
        self._samples, self._rate, self._lag = 0, 0.0, 0.0

    def count(self, samples: int, arrived: float) -> None:
        """Count samples that were just learned, the newest of which had arrived then."""
        now = time.monotonic()
        self._since = now if self._since is None else self._since
        self._samples += samples
        self._lag = max(self._lag, now - arrived)

    def read(self) -> tuple[float, float]:
        """Return the rate over about a second, and the longest lag since it was forgotten."""
        now = time.monotonic()
        if self._since is not None and now - self._since >= 1.0:
            self._rate, self._samples, self._since = self._samples / (now - self._since), 0, now
        return self._rate, self._lag

    def forget_lag(self) -> None:
        """Begin a new longest lag."""
        self._lag = 0.0


def _part(batch: Batch, part: slice) -> Batch:
    t, sequence = batch.t, batch.sequence
    return replace(
        batch,
        u=batch.u[part],
        y=batch.y[part],
        t=None if t is None else t[part],
        sequence=None if sequence is None else sequence[part],
    )
