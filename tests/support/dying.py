"""A function whose first callers kill their process, for tests of executors."""

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
