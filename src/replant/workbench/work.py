"""Work: a process that computes what the page asks for, and is made anew when it dies."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

from replant.errors import ReplantError


class Work:
    """One worker process, started at the first request."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._lock = threading.Lock()

    def do(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return what a function of `replant.workbench.tasks` gives; waits for it."""
        pool = self._ready()
        try:
            return pool.submit(function, *arguments).result()
        except BrokenExecutor:
            with self._lock:
                if self._pool is pool:
                    self._pool = None
            raise ReplantError(
                "the process that computes this has died: the memory may be too small; try again"
            ) from None

    def close(self) -> None:
        """End the process, whatever it is computing."""
        with self._lock:
            pool, self._pool = self._pool, None
        if pool is None:
            return
        processes = list((pool._processes or {}).values())
        pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.kill()

    def _ready(self) -> ProcessPoolExecutor:
        with self._lock:
            if self._pool is None:
                self._pool = ProcessPoolExecutor(1, get_context("spawn"), _deaf)
            return self._pool


def _deaf() -> None:
    """Leave Ctrl-C to the server."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
