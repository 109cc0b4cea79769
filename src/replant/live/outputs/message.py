"""What goes out: an estimate as a message, notices, and the thread that waits for disks."""

from __future__ import annotations

import contextlib
import json
import math
import queue
import time
from collections.abc import Callable
from dataclasses import dataclass

from replant.arguments import FloatArray
from replant.operating_system import Worker, one_line

AGAIN = 60.0  # time until the next message about the same subject [s]


class Notices:
    """Passes messages on to ``show``, at most one a minute about each subject.

    >>> notices = Notices(print)
    >>> notices.say("checkpoint", "no room on the disk")
    no room on the disk
    >>> notices.say("checkpoint", "no room on the disk")
    """

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._said: dict[str, float] = {}

    def say(self, subject: str, message: str) -> None:
        """Show a message, unless one about the same subject was shown within the last minute."""
        now = time.monotonic()
        if now - self._said.get(subject, -AGAIN) >= AGAIN:
            self._said[subject] = now
            self._show(message)


VERSION = 1
"""Version of the layout, `schema/message-1.json`; raised where an entry changes its meaning or goes away [count]."""
UNKNOWN = "unknown"  # the verdict while none is known
LEAST_TTL = 5.0
"""Least time for which "trusted" may stand without an accepted sample: a network takes time to send again [s]."""
INTERVALS = 10  # the same in sampling times: a slow plant's samples may come ten in a message [sampling times]
#: `Estimate.status` while no sample is accepted, and when the session is over.
WAITING, ENDED = "waiting", "ended"


def time_to_live(dt: float) -> float:
    """Return the default time to live: how long "trusted" may stand without an accepted sample, in s.

    Examples
    --------
    >>> time_to_live(0.001), time_to_live(2.0)
    (5.0, 20.0)
    """
    return max(LEAST_TTL, INTERVALS * dt)


@dataclass(frozen=True, eq=False)
class EstimateMessage:
    """The estimate after a sample, with the newest verdict and the newest standard deviations.

    Examples
    --------
    >>> import numpy as np
    >>> known = np.array([2.128]), np.array([0.056])
    >>> EstimateMessage(0.5, None, 25, ("a0",), *known, "running", "trusted", True, ttl=5.0).as_json()
    b'{"schema_version":1,"timestamp":0.5,"samples":25,"a0":2.128,"std_a0":0.056,"trusted":1,"excited":1,"ttl":5.0,...'
    """

    timestamp: float  # rig time of the sample in s
    sequence: int | None  # number of the sample, where the device gives one
    samples: int  # accepted samples so far
    names: tuple[str, ...]  # names of the P parameters
    # (P,): NaN until there is a first model
    parameters: FloatArray
    # (P,): standard deviations.  They and the verdict may be tenths of a second older than the sample; NaN and
    # "unknown" where the estimate has moved since by more than they allow
    std: FloatArray
    # {"starting", "running", "diverged", "waiting", "ended"}: "waiting" while no sample is accepted, "ended" when the
    # session is over
    status: str
    verdict: str
    excited: bool = False  # see `Assessment`; False while the verdict is not known
    ttl: float = 0.0  # seconds from the receipt of the message for which a controller may use the model; 0: it may not
    sent: float | None = None  # Unix time in s at which the message was sent; None before that

    @property
    def trusted(self) -> bool:
        """Whether a controller may use the model, for `ttl` seconds."""
        return self.verdict == "trusted" and self.ttl > 0.0

    def as_json(self) -> bytes:
        """Return one line of JSON, without the line end: a flat object, in which unknown numbers are null."""
        fields: dict[str, float | int | str | None] = {"schema_version": VERSION, "timestamp": self.timestamp}
        if self.sequence is not None:
            fields["sequence"] = self.sequence
        fields["samples"] = self.samples
        for prefix, values in (("", self.parameters), ("std_", self.std)):
            for name, value in zip(self.names, values.tolist(), strict=True):
                fields[prefix + name] = value if math.isfinite(value) else None
        fields["trusted"] = int(self.trusted)
        fields["excited"] = int(self.excited)
        fields["ttl"] = self.ttl
        fields["status"] = self.status
        fields["verdict"] = self.verdict
        fields["sent"] = self.sent
        return json.dumps(fields, separators=(",", ":"), allow_nan=False).encode()


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
