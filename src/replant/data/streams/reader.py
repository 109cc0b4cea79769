"""Reader: base class of the sources; a thread reads samples into an inbox, from which `batches` yields them."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator

from replant.data.streams.inbox import CAPACITY, Inbox
from replant.data.streams.sequence_numbers import Numbering
from replant.data.streams.source import Batch
from replant.data.streams.stop_request import StopRequest
from replant.operating_system.worker import Worker

TICK = 0.1  # time without samples after which an empty batch comes [s]
CLOSE_TIMEOUT = 1.0  # time that a closed source may still take to let go of what it reads from [s]
BACKOFF = 0.1, 5.0  # first and longest pause before connecting again [s]


class Reader(ABC):
    """A `Source` that is read by its own thread."""

    def __init__(self, name: str, *, waits: bool, replays: bool = True, capacity: int = CAPACITY) -> None:
        self.name = name
        self.trouble = ""  # why the source is not connected, for messages
        self._counts: Counter[str] = Counter()
        self._numbering = Numbering(self._counts, replays=replays)
        self._inbox = Inbox(capacity, drop=not waits)
        self._stop = StopRequest()
        self._state = "connecting"
        self._backoff = BACKOFF[0]

    @abstractmethod
    def _read(self) -> None:
        """Read and `_deliver` samples until the stream ends or a stop is requested."""

    def batches(self) -> Iterator[Batch]:
        """Yield samples as they arrive, see `Source.batches`."""
        thread = Worker(self._run)
        with self._stop:
            thread.start()
            try:
                yield from self._batches_until_end()
            finally:
                self.close()
                self._inbox.abandon()
                thread.join(CLOSE_TIMEOUT)
                self._state = "ended"

    def seek(self, sequence: int) -> None:
        """Continue after this sequence number, see `Source.seek`."""
        self._numbering.last = sequence

    def close(self) -> None:
        """Stop reading, see `Source.close`."""
        self._stop.request()

    @property
    def counters(self) -> dict[str, int]:
        """How often each fault has occurred, see `Source.counters`."""
        return {reason: count for reason, count in dict(self._counts).items() if count}

    @property
    def state(self) -> str:
        """One of "connecting", "connected", "waiting" and "ended"."""
        return self._state

    def _batches_until_end(self) -> Iterator[Batch]:
        deadline = float("inf")
        while True:
            batch = self._inbox.get(TICK)
            if len(batch):
                yield batch
            elif self._inbox.ended or time.monotonic() > deadline:
                return
            elif self._stop.requested:
                deadline = min(deadline, time.monotonic() + CLOSE_TIMEOUT)
            else:
                yield batch

    def _run(self) -> None:
        failure: BaseException | None = None
        try:
            self._read()
        except BaseException as error:
            failure = error  # `Inbox.get` raises it in the session's thread; here nobody would see it
        self._inbox.end(failure)

    def count_refused(self, reason: str, samples: int) -> None:
        """Count samples that were refused before the reading began."""
        self._counts[reason] += samples

    def _deliver(self, batch: Batch | None) -> None:
        """Put the samples that `Numbering` accepts into the inbox."""
        if batch is not None:
            dropped = self._inbox.put(self._numbering.screen(batch))
            if dropped:
                self._counts["dropped"] += dropped

    def _connected(self, *, again: bool) -> None:
        self._numbering.connect()
        self._state, self.trouble, self._backoff = "connected", "", BACKOFF[0]
        if again:
            self._counts["reconnects"] += 1

    def _wait_to_connect(self, trouble: str, *, again: bool) -> None:
        """Pause before the next attempt to connect; each pause is twice as long as the one before."""
        self._state, self.trouble = "waiting" if again else "connecting", trouble
        self._stop.wait(self._backoff)
        self._backoff = min(2.0 * self._backoff, BACKOFF[1])
