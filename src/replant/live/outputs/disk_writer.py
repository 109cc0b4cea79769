"""Background: one thread for what waits for a disk, so that the session does not."""

from __future__ import annotations

import contextlib
import queue
from collections.abc import Callable

from replant.live.outputs.notices import Notices
from replant.system.worker import Worker

MOST_WAITING = 16
"""Pieces of work that wait for the disk at the most [count]."""


class Background:
    """Run jobs one after the other in a thread of their own; what fails is said, and the next goes on.

    Parameters
    ----------
    notices : Notices
    """

    def __init__(self, notices: Notices) -> None:
        self._notices = notices
        self._jobs: queue.Queue[tuple[str, Callable[[], None]] | None] = queue.Queue(MOST_WAITING)
        self._thread = Worker(self._work)
        self._thread.start()

    def submit(self, subject: str, job: Callable[[], None]) -> bool:
        """Take a job, unless too many wait; ``subject`` begins the message when it fails."""
        try:
            self._jobs.put_nowait((subject, job))
        except queue.Full:
            self._notices.say(subject + " late", f"replant: {subject}: the disk is too slow, some of it is left out")
            return False
        return True

    def wait(self) -> None:
        """Return when every job has been done."""
        self._jobs.join()

    def close(self) -> None:
        """Finish what waits, and end the thread."""
        self._jobs.put(None)
        self._thread.join()

    def _work(self) -> None:
        going = True
        while going:
            # not even a job that cannot be taken, or a failure that cannot be said, for want of memory, ends the
            # thread: `wait` and `close` would never return
            with contextlib.suppress(Exception):
                going = self._do_next()

    def _do_next(self) -> bool:
        """Wait for a job and do it; tell whether another may come."""
        entry = self._jobs.get()
        if entry is None:
            return False
        subject, job = entry
        try:
            job()
        except Exception as error:  # a full disk, a folder gone: identification goes on
            self._notices.say(subject, f"replant: {subject}: {one_line(error)}; going on")
        finally:
            self._jobs.task_done()
        return True


def one_line(error: BaseException) -> str:
    """Return an error's message in one line.

    Examples
    --------
    >>> one_line(OSError(28, "No space left on device", "a/b"))
    "No space left on device: 'a/b'"
    """
    if isinstance(error, OSError) and error.strerror:
        return error.strerror + (f": {error.filename!r}" if error.filename else "")
    if isinstance(error, MemoryError) and not str(error):
        return "out of memory"
    return " ".join(str(error).split()) or type(error).__name__
