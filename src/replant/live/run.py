"""Run: from what is asked for to a session at work, and its result in words."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from replant.data.streams import Source, open_source
from replant.errors import DamagedCheckpointError, InvalidArgumentError
from replant.live.observer.client import Observer
from replant.live.observer.history import History
from replant.live.observer.make_view import look
from replant.live.observer.process import Address, Orders
from replant.live.observer.terminal import print_summary
from replant.live.outputs.disk_writer import Background
from replant.live.outputs.message import time_to_live
from replant.live.outputs.notices import Notices
from replant.live.outputs.parquet_recorder import Recorder
from replant.live.outputs.sinks import Sink, open_sink
from replant.live.session.checkpointing import Keeper, resume
from replant.live.session.malloc import hold_flat
from replant.live.session.progress import Progress
from replant.live.session.session import Limits, Session
from replant.live.session.warm_up import warm
from replant.model.transfer_function import TransferFunction
from replant.online.identifier import Identifier
from replant.settings import Request


@dataclass(frozen=True)
class Plan:
    """What a live run is to do.

    Attributes
    ----------
    source : str
        URL of the samples.
    request : Request
    limits : Limits
    sinks : sequence of str
        Addresses of estimates.
    record, checkpoint : Path or None
    every : float
        Seconds between two checkpoints.
    dashboard : (host, port) or None
    token : str or None
    truth : TransferFunction or None
        The true plant, of a simulated rig.
    ttl : float or None
        Seconds for which "trusted" may stand without an accepted sample; None: see `time_to_live`.
    """

    source: str
    request: Request
    limits: Limits
    sinks: Sequence[str] = ()
    record: Path | None = None
    checkpoint: Path | None = None
    every: float = 10.0
    dashboard: tuple[str, int] | None = None
    token: str | None = None
    truth: TransferFunction | None = None
    ttl: float | None = None


def run(plan: Plan) -> bool:
    """Identify until the stream, a limit or the user ends it, and print what was found.

    Returns
    -------
    bool
        False if the verdict was to become "trusted", and did not.

    Raises
    ------
    ReplantError
        For whatever of the plan cannot be done; nothing has been learned or written then.
    """
    hold_flat()
    progress, identifier, said = _begin(plan)
    address = None if plan.dashboard is None else Address(*plan.dashboard, plan.token)
    ttl = time_to_live(plan.request.dt) if plan.ttl is None else plan.ttl
    with ExitStack() as opened:
        source = open_source(plan.source)
        opened.callback(source.close)
        sinks: list[Sink] = []
        for to in plan.sinks:
            sinks.append(open_sink(to, ttl))
            opened.callback(sinks[-1].close)
        observer = Observer(Orders(address, terminal=True, truth=plan.truth))
        opened.callback(observer.close)
        for line in said + ([f"replant: watch it at {observer.url}"] if observer.url else []):
            observer.show(line)
        session = _session(plan, source, sinks, observer, progress, identifier)
        warm(plan.request, observer.show)
        reached = session.run()
    view = observer.last or look(session.identifier, session.pulse, History(plan.request.structure.size))
    print_summary(view, plan.truth, to_stderr="-" in plan.sinks)
    return reached


def _session(
    plan: Plan,
    source: Source,
    sinks: Sequence[Sink],
    observer: Observer,
    progress: Progress,
    identifier: Identifier | None,
) -> Session:
    """Return the session, going on with ``identifier`` if there is one."""
    notices = Notices(observer.show)
    background = Background(notices)
    resumed = identifier is not None
    return Session(
        source,
        identifier or Identifier(**vars(plan.request)),
        background=background,
        notices=notices,
        observer=observer,
        sinks=sinks,
        recorder=None if plan.record is None else Recorder(plan.record, background, go_on=resumed),
        keeper=None if plan.checkpoint is None else Keeper(plan.checkpoint, plan.every, background),
        limits=plan.limits,
        progress=progress,
        ttl=plan.ttl,
    )


def _begin(plan: Plan) -> tuple[Progress, Identifier | None, list[str]]:
    """Return where to go on from, the identifier if there is a checkpoint, and what is to be said of it."""
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
    said = [f"replant: {path}: going on after {progress.taken:,} samples"]
    if loaded.used_previous:
        said.insert(0, f"replant: {loaded.used_previous}; the previous checkpoint is used instead")
    return progress, loaded.identifier, said
