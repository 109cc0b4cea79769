"""Checkpointing: a checkpoint every few seconds, written by a background thread, and resuming from it."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

from replant.checkpoint.encoding import encode
from replant.checkpoint.files import write
from replant.errors import InvalidArgumentError, MissingCheckpointError
from replant.live.outputs.disk_writer import DiskWriter
from replant.online.identifier import Identifier
from replant.online.saving import Loaded, load
from replant.settings import Request

ProgressEntries = Mapping[str, int | float | str]


class CheckpointWriter:
    """Writes checkpoints of an identifier into a file."""

    def __init__(self, path: Path, every: float, disk_writer: DiskWriter) -> None:
        self._path, self._every, self._disk_writer = path, every, disk_writer
        self._due = time.monotonic() + every
        self._idle = threading.Event()
        self._idle.set()

    def is_due(self, now: float) -> bool:
        """Return whether the time for the next checkpoint has come and the one before has been written."""
        return now >= self._due and self._idle.is_set()

    def submit(self, identifier: Identifier, progress: ProgressEntries) -> None:
        """Have a checkpoint of the present state written in the background."""
        self._due = time.monotonic() + self._every
        data = encode(vars(identifier), progress)
        self._idle.clear()
        accepted = False
        try:
            accepted = self._disk_writer.submit("checkpoint", lambda: self._write(data))
        finally:
            if not accepted:
                self._idle.set()

    def write_now(self, identifier: Identifier, progress: ProgressEntries) -> None:
        """Write a checkpoint and wait for it."""
        write(self._path, encode(vars(identifier), progress))

    def _write(self, data: bytes) -> None:
        try:
            write(self._path, data)
        finally:
            self._idle.set()


def resume(path: Path, request: Request) -> Loaded | None:
    """Return what a checkpoint holds; None if there is no checkpoint yet.

    >>> from replant.model.structure import Structure
    >>> resume(Path("no-such-file.replant"), Request(Structure(1), dt=0.1)) is None
    True
    """
    try:
        loaded = load(path)
    except MissingCheckpointError:
        return None
    stored = loaded.identifier.request
    for entry in fields(Request):
        before, now = getattr(stored, entry.name), getattr(request, entry.name)
        if before != now:
            raise InvalidArgumentError(
                f"{path}: the checkpoint was made with {entry.name} {before}, and {now} is requested now; "
                f"give the same options, or move {path} away to start anew"
            )
    return loaded
