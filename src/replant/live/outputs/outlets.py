"""Outlets: estimates on their way to the sinks, and the watchdog that takes trust back when no sample is accepted.

What holds on every sink: nobody is left with ``trusted: 1`` for longer than the time to live without an accepted
sample.  Each message carries the rest of that time, for whoever hears nothing more; where the time is over and the
session's thread waits for samples, a disk or a solution, the watchdog's thread says so in its place.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from replant.live.outputs.disk_writer import one_line
from replant.live.outputs.message import (
    ENDED,
    UNKNOWN,
    WAITING,
    Estimate,
)
from replant.live.outputs.notices import Notices
from replant.live.outputs.sinks import Sink
from replant.system.worker import Worker

TICK = 0.05
"""Time between two looks of the watchdog, at the most [s]."""
GOODBYE = 2.0
"""Time that the sinks get to take the news of the end [s]."""


@dataclass
class _Outlet:
    """A sink with what it has not been sent yet, when its turn comes, and what its other side may believe."""

    sink: Sink
    pending: bool = False
    due: float = 0.0
    trusted: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock)


class Outlets:
    """Hand estimates to sinks, each in its own time.

    Parameters
    ----------
    sinks : sequence of Sink
    archive : Sink or None
        Gets the session's estimates as well, but no word of the watchdog: nobody acts on a record.
    ttl : float
        Seconds for which "trusted" may stand without an accepted sample.
    notices : Notices
    gone : callable
        Called when a reader has gone for good.
    now : callable
        A clock in s.
    """

    def __init__(
        self,
        sinks: Sequence[Sink],
        archive: Sink | None,
        ttl: float,
        *,
        notices: Notices,
        gone: Callable[[], None],
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._watched = [_Outlet(sink) for sink in sinks]
        self._all = [*self._watched, *([_Outlet(archive)] if archive is not None else [])]
        self._ttl, self._notices, self._gone, self._now = ttl, notices, gone, now
        self._accepted = -math.inf  # when a sample was last
        self._newest: Estimate | None = None
        self._ended = threading.Event()
        self._thread: Worker | None = None

    def begin(self, estimate: Estimate) -> None:
        """Take what is known before the first sample, for whoever asks, and set the watchdog to work."""
        self._newest = estimate
        if self._watched:
            self._thread = Worker(self._watch)
            self._thread.start()

    def accepted(self) -> None:
        """Note that a sample has been accepted just now."""
        self._accepted = self._now()

    @property
    def silence(self) -> float:
        """Seconds since a sample was accepted, once trust has expired for want of one; else 0."""
        since = self._now() - self._accepted
        return since if self._ttl <= since < math.inf else 0.0

    def mark(self) -> None:
        """Note that there is something new to send."""
        for outlet in self._all:
            outlet.pending = True

    def send(self, estimate: Callable[[], Estimate], *, at_any_rate: bool = False) -> None:
        """Send the newest estimate to each outlet whose turn it is."""
        now = self._now()
        due = [outlet for outlet in self._all if outlet.pending and (at_any_rate or now >= outlet.due)]
        if not due:
            return
        self._newest = estimate()
        for outlet in due:
            outlet.pending, outlet.due = False, now + outlet.sink.interval
            with outlet.lock:
                self._transmit(outlet)

    def look(self) -> None:
        """Do the watchdog's work once: take expired trust back, and send again what did not arrive."""
        expired = self._remaining() <= 0.0
        for outlet in self._watched:
            wanted = outlet.sink.behind or (expired and outlet.trusted)
            if wanted and outlet.lock.acquire(blocking=False):  # else somebody is sending right now
                try:
                    self._transmit(outlet)
                finally:
                    outlet.lock.release()

    def end(self) -> None:
        """Say on every sink that the session is over, and let go of them; without effect the second time."""
        if self._ended.is_set():
            return
        self._ended.set()
        if self._thread is not None:
            self._thread.join(GOODBYE)
        for outlet in self._watched:
            if outlet.lock.acquire(timeout=GOODBYE):  # else its wire holds the watchdog up
                self._transmit(outlet)
                outlet.lock.release()
        deadline = time.monotonic() + GOODBYE
        while any(outlet.sink.behind for outlet in self._watched) and time.monotonic() < deadline:
            time.sleep(0.2 * TICK)
            self.look()
        for outlet in self._watched:
            with contextlib.suppress(OSError):
                outlet.sink.close()

    def _watch(self) -> None:
        pause = TICK
        while not self._ended.wait(pause):
            self.look()
            left = self._remaining()
            pause = min(left, TICK) if left > 0.0 else TICK

    def _remaining(self) -> float:
        """Return for how long the estimate may still be acted upon, in s."""
        return 0.0 if self._ended.is_set() else max(self._accepted + self._ttl - self._now(), 0.0)

    def _transmit(self, outlet: _Outlet) -> None:
        """Send the newest estimate as it is worth now; the outlet's lock is held."""
        if self._newest is None:
            return
        estimate = self._stamped(self._newest)
        outlet.trusted |= estimate.trusted
        try:
            outlet.sink.send(estimate)
            if not outlet.sink.behind:
                outlet.trusted = estimate.trusted
        except BrokenPipeError:  # as `| head` does: nobody wants to know any more
            outlet.trusted = False
            self._gone()
        except Exception as error:  # of one wire alone: the others, and the watchdog, go on
            self._notices.say(outlet.sink.name, f"replant: {outlet.sink.name}: {one_line(error)}; going on")

    def _stamped(self, estimate: Estimate) -> Estimate:
        ttl = math.floor(1e3 * self._remaining()) / 1e3
        sent = round(time.time(), 3)
        if ttl > 0.0:
            return replace(estimate, ttl=ttl, sent=sent)
        if self._ended.is_set():  # with the verdict that was the last one
            return replace(estimate, ttl=0.0, sent=sent, status=ENDED)
        return replace(estimate, ttl=0.0, sent=sent, status=WAITING, verdict=UNKNOWN)
