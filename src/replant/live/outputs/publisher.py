"""Publisher: sends estimates to the sinks; a watchdog withdraws trust when no sample is accepted.

No receiver holds ``trusted: 1`` for longer than the time to live without an accepted sample.  Each message carries the
rest of that time, for receivers that get no further message.  When the time is over while the session's thread waits
for samples, for a disk or for a solution, the watchdog's thread sends ``trusted: 0`` instead.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from replant.live.outputs.message import (
    ENDED,
    UNKNOWN,
    WAITING,
    EstimateMessage,
)
from replant.live.outputs.notices import Notices
from replant.live.outputs.sinks import Sink
from replant.operating_system import Worker, one_line

TICK = 0.05  # time between two looks of the watchdog, at the most [s]
GOODBYE = 2.0  # time that the sinks get to take the news of the end [s]


@dataclass
class _Receiver:
    """A sink and its state: whether an estimate is pending, when it is due, whether it may hold trust, has ended."""

    sink: Sink
    pending: bool = False
    due: float = 0.0
    trusted: bool = False
    ended: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock)


class Publisher:
    """Sends estimates to sinks, each at its own rate."""

    def __init__(
        self,
        sinks: Sequence[Sink],
        archive: Sink | None,
        ttl: float,
        *,
        notices: Notices,
        on_reader_gone: Callable[[], None],
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._watched = [_Receiver(sink) for sink in sinks]
        self._all = [*self._watched, *([_Receiver(archive)] if archive is not None else [])]
        self._ttl, self._notices, self._on_reader_gone, self._now = ttl, notices, on_reader_gone, now
        self._accepted = -math.inf  # time of the last accepted sample
        self._newest: EstimateMessage | None = None
        self._ended = threading.Event()
        self._thread: Worker | None = None

    def start(self, estimate: EstimateMessage) -> None:
        """Start the watchdog; ``estimate`` is sent to receivers that connect before the first sample."""
        self._newest = estimate
        if self._watched:
            self._thread = Worker(self._watch)
            self._thread.start()

    def accepted(self) -> None:
        """Record that a sample has been accepted just now."""
        self._accepted = self._now()

    @property
    def silence(self) -> float:
        """Seconds since a sample was accepted, once trust has expired for want of one; else 0."""
        since = self._now() - self._accepted
        return since if self._ttl <= since < math.inf else 0.0

    def mark(self) -> None:
        """Mark that there is a new estimate to send."""
        for receiver in self._all:
            receiver.pending = True

    def send(self, estimate: Callable[[], EstimateMessage], *, immediately: bool = False) -> None:
        """Send the newest estimate to each receiver that is due; with ``immediately`` to each that lacks it."""
        now = self._now()
        due = [receiver for receiver in self._all if receiver.pending and (immediately or now >= receiver.due)]
        if not due:
            return
        self._newest = estimate()
        for receiver in due:
            receiver.pending, receiver.due = False, now + receiver.sink.interval
            with receiver.lock:
                self._transmit(receiver)

    def check(self) -> None:
        """Do the watchdog's work once: withdraw expired trust, and send again what did not arrive."""
        expired = self._remaining() <= 0.0
        for receiver in self._watched:
            wanted = receiver.sink.behind or (expired and receiver.trusted)
            if wanted and receiver.lock.acquire(blocking=False):  # else the other thread is sending right now
                try:
                    self._transmit(receiver)
                finally:
                    receiver.lock.release()

    def end(self) -> None:
        """Send ``status: ended`` on every sink, and close them; a second call has no effect."""
        if self._ended.is_set():
            return
        self._ended.set()
        if self._thread is not None:
            self._thread.join(GOODBYE)
        for receiver in self._watched:
            if receiver.lock.acquire(timeout=GOODBYE):  # else its connection blocks the watchdog
                if not receiver.ended:  # the watchdog may have been about to send, and said it
                    self._transmit(receiver)
                receiver.lock.release()
        deadline = time.monotonic() + GOODBYE
        while any(receiver.sink.behind for receiver in self._watched) and time.monotonic() < deadline:
            time.sleep(0.2 * TICK)
            self.check()
        for receiver in self._watched:
            with contextlib.suppress(OSError):
                receiver.sink.close()

    def _watch(self) -> None:
        pause = TICK
        while not self._ended.wait(pause):
            self.check()
            left = self._remaining()
            pause = min(left, TICK) if left > 0.0 else TICK

    def _remaining(self) -> float:
        """Return how long a controller may still use the estimate, in s."""
        return 0.0 if self._ended.is_set() else max(self._accepted + self._ttl - self._now(), 0.0)

    def _transmit(self, receiver: _Receiver) -> None:
        """Send the newest estimate with the present time to live; the caller holds the receiver's lock."""
        if self._newest is None:
            return
        estimate = self._stamped(self._newest)
        receiver.trusted |= estimate.trusted
        try:
            receiver.sink.send(estimate)
            if not receiver.sink.behind:
                receiver.trusted, receiver.ended = estimate.trusted, estimate.status == ENDED
        except BrokenPipeError:  # the reader has closed the pipe, as `| head` does
            receiver.trusted = False
            self._on_reader_gone()
        except Exception as error:  # a fault of one sink; the others, and the watchdog, continue
            name = receiver.sink.name
            self._notices.say(name, f"replant: {name}: {one_line(error)}; identification continues")

    def _stamped(self, estimate: EstimateMessage) -> EstimateMessage:
        """Return the estimate as it is sent now: with time to live, time of sending and the status that follows."""
        ttl = math.floor(1e3 * self._remaining()) / 1e3
        sent = round(time.time(), 3)
        if ttl > 0.0:
            return replace(estimate, ttl=ttl, sent=sent)
        estimate = replace(estimate, ttl=0.0, sent=sent, excited=False)  # without samples nothing can be learned
        if self._ended.is_set():  # the last verdict stays
            return replace(estimate, status=ENDED)
        return replace(estimate, status=WAITING, verdict=UNKNOWN)
