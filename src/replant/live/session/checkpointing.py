"""Keeper: a checkpoint every few seconds, written behind the session's back, and the way back from it."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

from replant.checkpoint.encoding import encode
from replant.checkpoint.files import write
from replant.errors import InvalidArgumentError, MissingCheckpointError
from replant.live.outputs.disk_writer import Background
from replant.online.identifier import Identifier
from replant.online.saving import Loaded, load
from replant.settings import Request

Kept = Mapping[str, int | float | str]


class Keeper:
    """Keep an identifier in a file.

    Parameters
    ----------
    path : path
    every : float
        Seconds between two checkpoints.
    background : Background
        Writes them: a disk may take its time.
    """

    def __init__(self, path: Path, every: float, background: Background) -> None:
        self._path, self._every, self._background = path, every, background
        self._due = time.monotonic() + every
        self._idle = threading.Event()
        self._idle.set()

    def is_due(self, now: float) -> bool:
        """Whether it is time for the next checkpoint, and the one before has been written."""
        return now >= self._due and self._idle.is_set()

    def keep(self, identifier: Identifier, progress: Kept) -> None:
        """Have a checkpoint of this very state written."""
        self._due = time.monotonic() + self._every
        data = encode(vars(identifier), progress)
        self._idle.clear()
        taken = False
        try:
            taken = self._background.submit("checkpoint", lambda: self._write(data))
        finally:
            if not taken:
                self._idle.set()

    def finish(self, identifier: Identifier, progress: Kept) -> None:
        """Write the last checkpoint, at once.

        Raises
        ------
        CheckpointError
            If it cannot be written; the file is as it was.
        """
        write(self._path, encode(vars(identifier), progress))

    def _write(self, data: bytes) -> None:
        try:
            write(self._path, data)
        finally:
            self._idle.set()


def resume(path: Path, request: Request) -> Loaded | None:
    """Return what a checkpoint holds; None where there is none yet.

    Raises
    ------
    InvalidArgumentError
        If it is of an identifier that was asked for otherwise.
    CheckpointError
        If it cannot be used, and there is no previous one.
    """
    try:
        loaded = load(path)
    except MissingCheckpointError:
        return None
    kept = loaded.identifier.request
    for entry in fields(Request):
        before, now = getattr(kept, entry.name), getattr(request, entry.name)
        if before != now:
            raise InvalidArgumentError(
                f"{path}: the checkpoint is of {entry.name} {before}, and {now} is asked for now; "
                f"give the same options, or move {path} away to begin anew"
            )
    return loaded
