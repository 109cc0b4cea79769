"""Background: one thread for what waits for a disk, so that the session does not."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable

from replant.live.outputs.notices import Notices

MOST_WAITING = 16


class Background:
    """Run jobs one after the other in a thread of their own; what fails is said, and the next goes on.

    Parameters
    ----------
    notices : Notices
    """

    def __init__(self, notices: Notices) -> None:
        self._notices = notices
        self._jobs: queue.Queue[tuple[str, Callable[[], None]] | None] = queue.Queue(MOST_WAITING)
        self._thread = threading.Thread(target=self._work, name="replant-disk", daemon=True)
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
        while (entry := self._jobs.get()) is not None:
            subject, job = entry
            try:
                job()
            except Exception as error:  # a full disk, a folder gone: identification goes on
                self._notices.say(subject, f"replant: {subject}: {one_line(error)}; going on")
            finally:
                self._jobs.task_done()


def one_line(error: BaseException) -> str:
    """Return an error's message in one line.

    Examples
    --------
    >>> one_line(OSError(28, "No space left on device", "a/b"))
    "No space left on device: 'a/b'"
    """
    if isinstance(error, OSError) and error.strerror:
        return error.strerror + (f": {error.filename!r}" if error.filename else "")
    return " ".join(str(error).split()) or type(error).__name__
