"""Reader: what all sources share, a thread that reads into an inbox from which `batches` hands over."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator

from replant.data.streams.alarm import Alarm
from replant.data.streams.batch import Batch
from replant.data.streams.inbox import CAPACITY, Inbox
from replant.data.streams.numbering import Numbering
from replant.system.worker import Worker

TICK = 0.1
"""Time without samples after which an empty batch comes [s]."""
PATIENCE = 1.0
"""Time that a closed source may still take to let go of what it reads from [s]."""
BACKOFF = 0.1, 5.0
"""First and longest pause before connecting again [s]."""


class Reader(ABC):
    """A `Source` that is read by a thread of its own.

    Parameters
    ----------
    name : str
        The URL for people.
    waits : bool
        Whether the other side can wait: a full queue then stops the reading; else it drops its oldest samples.
    replays : bool
        See `Numbering`.
    capacity : int
        Samples that may wait for the session.
    """

    def __init__(self, name: str, *, waits: bool, replays: bool = True, capacity: int = CAPACITY) -> None:
        self.name = name
        self.trouble = ""  # why it is not connected, for people
        self._counts: Counter[str] = Counter()
        self._numbering = Numbering(self._counts, replays=replays)
        self._inbox = Inbox(capacity, drop=not waits)
        self._alarm = Alarm()
        self._state = "connecting"
        self._backoff = BACKOFF[0]

    @abstractmethod
    def _read(self) -> None:
        """Read and `_deliver` until the end of the stream or until the alarm is rung."""

    def batches(self) -> Iterator[Batch]:
        """Yield samples as they come, see `Source.batches`."""
        thread = Worker(self._run)
        with self._alarm:
            thread.start()
            try:
                yield from self._handed_over()
            finally:
                self.close()
                self._inbox.abandon()
                thread.join(PATIENCE)
                self._state = "ended"

    def seek(self, sequence: int) -> None:
        """Go on after this sequence number, see `Source.seek`."""
        self._numbering.last = sequence

    def close(self) -> None:
        """Stop reading, see `Source.close`."""
        self._alarm.ring()

    @property
    def counters(self) -> dict[str, int]:
        """What went wrong how often, see `Source.counters`."""
        return {reason: count for reason, count in dict(self._counts).items() if count}

    @property
    def state(self) -> str:
        """One of "connecting", "connected", "waiting" and "ended"."""
        return self._state

    def _handed_over(self) -> Iterator[Batch]:
        deadline = float("inf")
        while True:
            batch = self._inbox.take(TICK)
            if len(batch):
                yield batch
            elif self._inbox.ended or time.monotonic() > deadline:
                return
            elif self._alarm.rung:
                deadline = min(deadline, time.monotonic() + PATIENCE)
            else:
                yield batch

    def _run(self) -> None:
        failure: BaseException | None = None
        try:
            self._read()
        except BaseException as error:
            failure = error  # raised where the batches are taken: a thread's own error would go unseen
        self._inbox.end(failure)

    def refuse(self, reason: str, samples: int) -> None:
        """Count samples that were left out before the reading began."""
        self._counts[reason] += samples

    def _deliver(self, batch: Batch | None) -> None:
        """Hand samples over, those aside that came before."""
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
        """Pause before connecting again, twice as long as the last time."""
        self._state, self.trouble = "waiting" if again else "connecting", trouble
        self._alarm.wait(self._backoff)
        self._backoff = min(2.0 * self._backoff, BACKOFF[1])
