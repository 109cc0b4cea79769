"""Disk writer: one thread for everything that waits for a disk, so that the session does not wait."""

from __future__ import annotations

import contextlib
import queue
from collections.abc import Callable

from replant.live.outputs.notices import Notices
from replant.operating_system import Worker, one_line

MOST_WAITING = 16  # pieces of work that wait for the disk at the most [count]


class DiskWriter:
    """Runs jobs one after the other in its own thread; a job that fails is reported, and the next one is run."""

    def __init__(self, notices: Notices) -> None:
        self._notices = notices
        self._jobs: queue.Queue[tuple[str, Callable[[], None]] | None] = queue.Queue(MOST_WAITING)
        self._thread = Worker(self._work)
        self._thread.start()

    def submit(self, subject: str, job: Callable[[], None]) -> bool:
        """Queue a job; return False if too many jobs wait.  ``subject`` begins the message if the job fails."""
        try:
            self._jobs.put_nowait((subject, job))
        except queue.Full:
            self._notices.say(subject + " late", f"replant: {subject}: the disk is too slow; a part is left out")
            return False
        return True

    def wait(self) -> None:
        """Wait until every job has been done."""
        self._jobs.join()

    def close(self) -> None:
        """Finish the queued jobs, and end the thread."""
        self._jobs.put(None)
        self._thread.join()

    def _work(self) -> None:
        running = True
        while running:
            # without memory even taking a job from the queue or reporting a failure may fail; the thread must survive
            # that, because `wait` and `close` would otherwise never return
            with contextlib.suppress(Exception):
                running = self._do_next()

    def _do_next(self) -> bool:
        """Wait for a job and do it; return False at the end of the queue."""
        entry = self._jobs.get()
        if entry is None:
            return False
        subject, job = entry
        try:
            job()
        except Exception as error:  # such as a full disk or a missing folder: identification continues
            self._notices.say(subject, f"replant: {subject}: {one_line(error)}; identification continues")
        finally:
            self._jobs.task_done()
        return True
