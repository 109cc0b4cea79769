"""Run a session from its settings to its end."""

from __future__ import annotations

import contextlib
import ctypes
import shlex
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from replant.errors import DamagedCheckpointError, InvalidArgumentError
from replant.estimation.settings import Request
from replant.live.observer.client import Observer
from replant.live.observer.make_view import EstimateHistory, make_view
from replant.live.observer.process import DashboardAddress, ObserverOptions
from replant.live.observer.terminal import print_summary
from replant.live.observer.view import UNNAMED, SignalNames
from replant.live.outputs.message import DiskWriter, Notices, ParquetRecorder, time_to_live
from replant.live.outputs.sinks import Sink, open_sink
from replant.live.session.progress import CheckpointWriter, Limits, Progress, resume
from replant.live.session.session import Session
from replant.live.streams import Source, open_source
from replant.model.transfer_function import TransferFunction
from replant.online.identifier import Identifier

M_MMAP_THRESHOLD = -3  # name of the setting in malloc.h [number]

THRESHOLD = 1 << 17  # size of blocks that the system gets back at once: glibc's initial value [bytes]


def limit_heap_growth() -> None:
    """Have the C library map blocks of 128 KiB and more one by one, and return them when they are freed.

    Otherwise blocks of lines and samples, whose sizes vary, leave holes in the heap: at hundreds of thousands of
    samples a second it grows by some megabytes a minute until it has found its size.  Without glibc this has no effect.
    """
    with contextlib.suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, THRESHOLD)


@dataclass(frozen=True)
class Plan:
    """The source, settings and outputs of a live run."""

    source: str  # URL of the samples
    request: Request
    limits: Limits
    sinks: Sequence[str] = ()  # addresses that estimates are sent to
    record: Path | None = None  # folder in which samples and estimates are recorded
    checkpoint: Path | None = None  # file of the checkpoint
    every: float = 10.0  # seconds between two checkpoints
    dashboard: tuple[str, int] | None = None  # (host, port)
    token: str | None = None  # the token that a browser must present
    truth: TransferFunction | None = None  # the true plant of a simulated rig
    signals: SignalNames = UNNAMED  # names of input and output
    # seconds for which "trusted" may stand without an accepted sample; None: see `time_to_live`
    ttl: float | None = None
    background: bool = False  # whether a second process solves the record again


def run(plan: Plan) -> bool:
    """Identify until the stream, a limit or the user ends the session, and print the result."""
    limit_heap_growth()
    progress, identifier, messages = _load_checkpoint(plan)
    address = None if plan.dashboard is None else DashboardAddress(*plan.dashboard, plan.token)
    ttl = time_to_live(plan.request.dt) if plan.ttl is None else plan.ttl
    with ExitStack() as opened:
        source = open_source(plan.source)
        opened.callback(source.close)
        sinks: list[Sink] = []
        for to in plan.sinks:
            sinks.append(open_sink(to, ttl))
            opened.callback(sinks[-1].close)
        observer = Observer(ObserverOptions(address, terminal=True, truth=plan.truth, signals=plan.signals))
        opened.callback(observer.close)
        watched = [f"replant: watch it at {observer.url}"] if observer.url else []
        for line in messages + watched:
            observer.show(line)
        session = _session(plan, source, sinks, observer, progress, identifier)
        if plan.record is not None:
            observer.show(f"replant: cut and fit it meanwhile: {_open_command(plan.record)}")
        reached = session.run()
        if session.identifier.forced_waits:
            waited = f"{session.identifier.forced_waits:,} times a sample waited for the second process"
            observer.show(f"replant: {waited}: the record is solved again more slowly than samples come")
    view = observer.last or make_view(session.identifier, session.info, EstimateHistory(plan.request.structure.size))
    print_summary(view, plan.truth, to_stderr="-" in plan.sinks)
    return reached


def _open_command(record: Path) -> str:
    """Return the command that opens a record in the workbench."""
    return shlex.join(["replant", "open", str(record)])


def _session(
    plan: Plan,
    source: Source,
    sinks: Sequence[Sink],
    observer: Observer,
    progress: Progress,
    identifier: Identifier | None,
) -> Session:
    """Return a session that continues with ``identifier``, or starts with a new one."""
    notices = Notices(observer.show)
    disk_writer = DiskWriter(notices)
    resumed = identifier is not None
    return Session(
        source,
        identifier or Identifier(**vars(plan.request), background=plan.background),
        disk_writer=disk_writer,
        notices=notices,
        observer=observer,
        sinks=sinks,
        recorder=None if plan.record is None else ParquetRecorder(plan.record, disk_writer, go_on=resumed),
        checkpoints=None if plan.checkpoint is None else CheckpointWriter(plan.checkpoint, plan.every, disk_writer),
        limits=plan.limits,
        progress=progress,
        ttl=plan.ttl,
    )


def _load_checkpoint(plan: Plan) -> tuple[Progress, Identifier | None, list[str]]:
    """Return progress and identifier of the checkpoint, if there is one, and messages about it for the user."""
    path = plan.checkpoint
    if path is None:
        return Progress(), None, []
    if not path.absolute().parent.is_dir():
        raise InvalidArgumentError(f"--checkpoint {path}: there is no folder {path.parent}; make it first")
    loaded = resume(path, plan.request)
    if loaded is None:
        return Progress(), None, []
    try:
        progress = Progress.of(loaded.progress)
    except DamagedCheckpointError as error:
        raise DamagedCheckpointError(f"{path}: {error}") from error
    if plan.background and not loaded.identifier.background:
        raise InvalidArgumentError(
            f"--background: {path} goes on without a second process; leave it out, or begin anew"
        )
    messages = [f"replant: {path}: continuing after {progress.taken:,} samples"]
    if loaded.used_previous:
        messages.insert(0, f"replant: {loaded.used_previous}; the previous checkpoint is used instead")
    return progress, loaded.identifier, messages
