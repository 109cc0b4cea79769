"""The progress of a session: its samples, the rig's clock, the checkpoints that keep them, and its end."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from replant.errors import DamagedCheckpointError, InvalidArgumentError, MissingCheckpointError
from replant.estimation.engine.state import GAP
from replant.estimation.settings import Request
from replant.kernels.schema import FARTHEST, LEAP
from replant.live.outputs.message import DiskWriter
from replant.live.streams import Batch
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.limits import typed_path
from replant.online.checkpoint_file import previous, write
from replant.online.identifier import Identifier
from replant.online.miso_identifier import RowIdentifier
from replant.online.miso_samples import RowSettings
from replant.online.saving import load

#: An identification of one input or of several, and its request.
Identification = Identifier | RowIdentifier
AnyRequest = Request | RowSettings

BACK = 1.0  # largest step back of late samples, which the identifier rejects one by one; a larger one is a reset [s]


@dataclass
class RigClock:
    """Converts time stamps to rig time, the stamp plus an offset, by the rules of the identifier of one input.

    If two consecutive stamps are close together and more than a second back, the clock was set back or the device was
    reset: rig time then continues after a gap, at which the filters restart.  A stamp that leaps by more than `LEAP`
    sampling times, and the very first stamp, advance rig time only when the next stamp confirms them; ``leaps`` marks
    the stamps (K,) of the last call that are not confirmed.
    """

    last: float = -np.inf  # rig time of the newest confirmed stamp [s]
    offset: float = 0.0  # rig time minus stamp [s]
    candidate: float | None = None  # a stamp that the next one may confirm
    alone: bool = False  # whether `last` is the very first stamp and not confirmed yet
    leaps: BoolArray = field(default_factory=lambda: np.zeros(0, bool), compare=False)

    def follow(self, t: FloatArray, dt: float) -> FloatArray:
        """Return rig time (K,) of the stamps of K samples, whose sampling time is ``dt`` s."""
        shifted = t + self.offset if self.offset else t
        is_first = self.last == -np.inf
        if not self.alone and (not is_first or (t.size > 1 and np.abs(shifted).max() <= FARTHEST * dt)):
            steps = np.diff(shifted) if is_first else np.diff(shifted, prepend=self.last)
            if (steps > 0.0).all() and (steps <= LEAP * dt).all():
                self._advance(float(shifted[-1]))
                self.leaps = np.zeros(t.size, bool)
                return shifted
        followed, last = np.array([(self._one(stamp, dt), self.last) for stamp in t.tolist()]).T
        self.leaps = ~(followed <= last)
        return followed if self.offset else t

    def _one(self, stamp: float, dt: float) -> float:
        shifted = stamp + self.offset if self.offset else stamp
        if not abs(shifted) <= FARTHEST * dt:
            return shifted
        if self.last == -np.inf:
            self.last, self.alone = shifted, True
        elif 0.0 < shifted - self.last <= LEAP * dt:
            self._advance(shifted)
        elif self.alone or not self.last - BACK <= shifted <= self.last:
            candidate, self.candidate = self.candidate, stamp
            if candidate is not None and candidate < stamp:
                return self._confirm(candidate, stamp, dt)
        return shifted

    def _advance(self, shifted: float) -> None:
        self.last, self.candidate, self.alone = shifted, None, False

    def _confirm(self, candidate: float, stamp: float, dt: float) -> float:
        """Return the rig time of a stamp; if it confirms the candidate, which leapt or was set back, follow both."""
        shifted, step = stamp + self.offset if self.offset else stamp, stamp - candidate
        leapt = candidate + self.offset - self.last
        if self.alone or shifted > self.last:
            if (self.alone or leapt > 0.0) and step <= LEAP * dt:
                self._advance(shifted)
            elif (self.alone or leapt > 0.0) and step <= 2.0 * leapt:  # a slow rig: each of its stamps leaps
                self.last, self.alone = candidate + self.offset, False
        elif leapt <= 0.0 and step <= LEAP * dt:  # the clock was set back
            self.offset = self.last + 2.0 * GAP * dt - stamp
            self._advance(stamp + self.offset)
            return self.last
        return shifted


COUNTER = "counter "  # prefix of a counter's name in a checkpoint
LATEST = 1e300  # bound of every time in a checkpoint [s]
ProgressEntries = Mapping[str, int | float | str]


@dataclass
class Progress:
    """The number of samples that a session has taken, and the clock of its rig."""

    taken: int = 0  # samples taken, rejected ones included
    sequence: int | None = None  # number of the newest sample, if the device numbers them
    clock: RigClock = field(default_factory=RigClock)
    earlier: dict[str, int] = field(default_factory=dict)  # counters of the sources before this resumption

    @property
    def at(self) -> float:
        """Rig time of the newest sample in s: its stamp, or taken times dt."""
        return self.clock.last if np.isfinite(self.clock.last) else 0.0

    def advance(self, batch: Batch, t: FloatArray | None, dt: float) -> FloatArray:
        """Count the samples of a batch and return their rig time (K,) in s."""
        clock = np.asarray((self.taken + 1 + np.arange(len(batch))) * dt) if t is None else t
        self.taken += len(batch)
        if t is None:
            self.clock.last = float(clock[-1])
        if batch.sequence is not None:
            self.sequence = int(batch.sequence[-1])
        return clock

    def counted(self, counters: Mapping[str, int]) -> dict[str, int]:
        """Return all counters: those of earlier sources plus ``counters`` of the present one."""
        every = {**self.earlier, **counters}
        return {name: self.earlier.get(name, 0) + counters.get(name, 0) for name in every}

    def with_counters(self, counters: Mapping[str, int]) -> dict[str, int | float | str]:
        """Return the entries that a checkpoint stores besides the identifier."""
        clock = self.clock
        state = {"taken": self.taken, "at": self.at, "offset": clock.offset, "sequence": self.sequence}
        state |= {"candidate": clock.candidate, "alone": 1 if clock.alone else None}
        entries: dict[str, int | float | str] = {name: value for name, value in state.items() if value is not None}
        return entries | {COUNTER + name: count for name, count in self.counted(counters).items()}

    @classmethod
    def of(cls, entries: ProgressEntries) -> Progress:
        """Return the progress with the entries of a checkpoint, see `with_counters`."""
        taken, at, offset = _whole(entries, "taken"), _number(entries, "at"), _number(entries, "offset")
        sequence = _whole(entries, "sequence", -(2**63)) if "sequence" in entries else None
        candidate = _number(entries, "candidate") if "candidate" in entries else None
        clock = RigClock(at if taken else -np.inf, offset, candidate, bool(_whole(entries, "alone")))
        earlier = {name.removeprefix(COUNTER): _whole(entries, name) for name in entries if name.startswith(COUNTER)}
        return cls(taken, sequence, clock, earlier)


def _whole(entries: ProgressEntries, name: str, least: int = 0) -> int:
    value = entries.get(name, 0)
    if not isinstance(value, int) or not least <= value < 2**63:
        raise DamagedCheckpointError(f"its {name!r} is not a count: {value!r:.30}")
    return value


def _number(entries: ProgressEntries, name: str) -> float:
    value = entries.get(name, 0.0)
    if isinstance(value, str) or not -LATEST <= value <= LATEST:
        raise DamagedCheckpointError(f"its {name!r} is not a time: {value!r:.30}")
    return float(value)


class Throughput:
    """Measures rate and lag of the samples that a session learns."""

    def __init__(self) -> None:
        self._since: float | None = None  # beginning of the current second; None before the first sample
        self._samples, self._rate, self.lag = 0, 0.0, 0.0

    def count(self, samples: int, arrived: float) -> None:
        """Count samples that were learned just now; ``arrived`` is the time at which the newest arrived."""
        now = time.monotonic()
        self._since = now if self._since is None else self._since
        self._samples += samples
        self.lag = max(self.lag, now - arrived)

    def read(self) -> tuple[float, float]:
        """Return samples a second, over about one second, and the longest lag in s since it was set to 0."""
        now = time.monotonic()
        if self._since is not None and now - self._since >= 1.0:
            self._rate, self._samples, self._since = self._samples / (now - self._since), 0, now
        return self._rate, self.lag


class CheckpointWriter:
    """Writes checkpoints of an identifier into a file."""

    def __init__(self, path: Path, every: float, disk_writer: DiskWriter) -> None:
        self._path, self._every, self._disk_writer = path, every, disk_writer
        self._due = time.monotonic() + every
        self._idle = threading.Event()
        self._idle.set()

    @property
    def there_are(self) -> bool:
        """Whether there is a checkpoint from which a session can go on."""
        return self._path.exists() or previous(self._path).exists()

    def is_due(self, now: float) -> bool:
        """Return whether the time for the next checkpoint has come and the one before has been written."""
        return now >= self._due and self._idle.is_set()

    def submit(self, identifier: Identification, progress: ProgressEntries) -> None:
        """Have a checkpoint of the present state written in the background."""
        self._due = time.monotonic() + self._every
        data = identifier.to_bytes(progress)
        self._idle.clear()
        accepted = False
        try:
            accepted = self._disk_writer.submit("checkpoint", lambda: self._write(data))
        finally:
            if not accepted:
                self._idle.set()

    def write_now(self, identifier: Identification, progress: ProgressEntries) -> None:
        """Write a checkpoint and wait for it."""
        write(self._path, identifier.to_bytes(progress))

    def _write(self, data: bytes) -> None:
        try:
            write(self._path, data)
        finally:
            self._idle.set()


def new_identification(request: AnyRequest, *, background: bool = False) -> Identification:
    """Return an identification without samples."""
    if isinstance(request, RowSettings):
        return RowIdentifier.of(request)
    return Identifier(**vars(request), background=background)


class Resumed(NamedTuple):
    """What a checkpoint keeps of a session, and messages about it for the user."""

    progress: Progress
    identifier: Identification
    messages: list[str]


def resume(path: Path, request: AnyRequest, *, background: bool = False) -> Resumed | None:
    """Load a checkpoint and check that it fits the request; return None if there is no checkpoint yet."""
    if not path.absolute().parent.is_dir():
        raise InvalidArgumentError(f"--checkpoint {path}: there is no folder {path.parent}; make it first")
    try:
        loaded = load(path)
        progress = Progress.of(loaded.progress)
    except MissingCheckpointError:
        return None
    except DamagedCheckpointError as error:
        away = typed_path(path) if not previous(path).exists() else f"{typed_path(path)} and its .previous"
        reason = str(error).removeprefix(f"{path}: ")
        raise DamagedCheckpointError(f"{path}: {reason}; move {away} away to start anew") from error
    _check_request(path, loaded.identifier, request)
    if background and not loaded.identifier.background:
        raise InvalidArgumentError(
            f"--background: {path} was made without a second process; leave the option out, or begin anew"
        )
    before = f"replant: {loaded.used_previous}; the previous checkpoint is used instead" if loaded.used_previous else ""
    messages = [before, f"replant: {path}: continuing after {progress.taken:,} samples"]
    return Resumed(progress, loaded.identifier, [message for message in messages if message])


def _check_request(path: Path, identifier: Identification, request: AnyRequest) -> None:
    """Check that the identifier of a checkpoint was made for a request."""
    stored = getattr(identifier, "request", None)  # an identifier of several structures has none
    if type(stored) is not type(request):
        kinds = {Request: "one input", RowSettings: "several inputs"}
        made, asked = (kinds.get(type(each), "several structures") for each in (stored, request))
        raise InvalidArgumentError(
            f"{path}: the checkpoint is of {made}, not of {asked}; give the same options, or move {path} away to "
            "start anew"
        )
    for name, now in (request._asdict() if isinstance(request, RowSettings) else vars(request)).items():
        before = getattr(stored, name)
        if before != now:
            was, is_now = ("; ".join(map(str, each)) if isinstance(each, tuple) else each for each in (before, now))
            raise InvalidArgumentError(
                f"{path}: the checkpoint was made with {name} {was}, and {is_now} is requested now; give the same "
                f"options, or move {path} away to start anew"
            )


@dataclass(frozen=True)
class Limits:
    """The conditions under which a session ends by itself."""

    seconds: float | None = None  # the session ends after this real time
    # the session ends after this number of samples, including rejected ones and those before a resumption
    samples: int | None = None
    until_trusted: bool = False  # the session ends when the verdict is "trusted"

    def left(self, samples: int) -> int | None:
        """Return how many more samples may be taken after ``samples``; None without a limit."""
        return None if self.samples is None else max(self.samples - samples, 0)

    def reached(self, *, seconds: float, samples: int, trusted: bool) -> bool:
        """Return whether the session has to end."""
        return (
            (self.seconds is not None and seconds >= self.seconds)
            or (self.samples is not None and samples >= self.samples)
            or (self.until_trusted and trusted)
        )


@contextmanager
def stop_on_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Call ``stop`` on the first SIGINT or SIGTERM in the block; a second one acts as usual; main thread only."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def restore_handlers() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def stop_once(*_: object) -> None:
        restore_handlers()
        stop()

    for number in before:
        signal.signal(number, stop_once)
    try:
        yield
    finally:
        restore_handlers()
