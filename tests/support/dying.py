"""Functions that fail as workers do: some kill their process, some raise what cannot be sent."""

from __future__ import annotations

import os
import signal
from pathlib import Path


def die_first(task: tuple[str, int, int]) -> int:
    """Return the number of a task; the process dies as long as fewer than so many have died in ``folder``."""
    folder, number, deaths = task
    died = len(list(Path(folder).iterdir()))
    if died < deaths:
        Path(folder, f"{os.getpid()}").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


class UnsendableError(Exception):
    """An error that pickle cannot build again: it is built from other arguments than its text."""

    def __init__(self, what: str, record: object) -> None:
        super().__init__(f"{what} {record}")


def refuse(record: object) -> None:
    raise UnsendableError("bad record", record)
