"""Worker: a thread that either begins or is refused."""

from __future__ import annotations

import _thread
import threading
from collections.abc import Callable

PATIENCE = 60.0
"""Time within which a thread that was started must have begun: it needs microseconds [s]."""


class Worker:
    """A thread that ends with the process at the latest.

    `threading.Thread.start` waits for the thread to begin, and for ever if that dies before for want of memory.

    Parameters
    ----------
    job : callable
        What it does.

    Examples
    --------
    >>> done = []
    >>> worker = Worker(lambda: done.append(True))
    >>> worker.start()
    >>> worker.join()
    >>> done
    [True]
    """

    def __init__(self, job: Callable[[], None]) -> None:
        self._job = job
        self._begun, self._ended = threading.Event(), threading.Event()

    def start(self) -> None:
        """Begin.

        Raises
        ------
        RuntimeError
            If the system lets no thread begin.
        """
        _thread.start_new_thread(self._run, ())
        if not self._begun.wait(PATIENCE):
            self._ended.set()
            raise RuntimeError("can't start new thread")

    def is_alive(self) -> bool:
        """Whether it has begun and not ended."""
        return self._begun.is_set() and not self._ended.is_set()

    def join(self, timeout: float | None = None) -> None:
        """Wait for its end, at most ``timeout`` s."""
        self._ended.wait(timeout)

    def _run(self) -> None:
        self._begun.set()
        try:
            self._job()
        finally:
            self._ended.set()
