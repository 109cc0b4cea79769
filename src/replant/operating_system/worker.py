"""Worker: a thread whose start either succeeds or raises an error."""

from __future__ import annotations

import _thread
import threading
from collections.abc import Callable

START_TIMEOUT = 60.0  # time within which a thread that was started must have begun: it needs microseconds [s]


class Worker:
    """A thread that does not keep the process alive.

    `threading.Thread.start` waits until the thread has begun: without end, if a lack of memory ends the thread before.

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
        """Start the thread."""
        _thread.start_new_thread(self._run, ())
        if not self._begun.wait(START_TIMEOUT):
            self._ended.set()
            raise RuntimeError("can't start new thread")

    def is_alive(self) -> bool:
        """Return whether the thread has begun and not ended."""
        return self._begun.is_set() and not self._ended.is_set()

    def join(self, timeout: float | None = None) -> None:
        """Wait until the thread has ended, at most ``timeout`` s."""
        self._ended.wait(timeout)

    def _run(self) -> None:
        self._begun.set()
        try:
            self._job()
        finally:
            self._ended.set()
