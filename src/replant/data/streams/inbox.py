"""Inbox: the bounded queue between the thread that reads samples and the session that learns them."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np

from replant.data.streams.source import Batch

CAPACITY = 1 << 17  # samples that wait at the most: 0.6 s at 200,000 samples/s, 4 MB [samples]
LARGEST_BATCH = 1 << 14  # samples handed over at once at the most [samples]

EMPTY = np.empty(0)


class Inbox:
    """A ring buffer of samples.  Its memory never grows; samples that arrived one by one are returned together.

    >>> inbox = Inbox(2, drop=True)
    >>> inbox.put(Batch(np.array([1.0, 2.0, 3.0]), np.zeros(3), None, None, arrived=0.0))
    1
    >>> inbox.get(0.1).u
    array([2., 3.])
    """

    def __init__(self, capacity: int = CAPACITY, *, drop: bool) -> None:
        self._capacity = capacity
        self._drop = drop
        self._ring: dict[str, np.ndarray[Any, Any]] = {}
        self._head = 0
        self._size = 0
        self._changed = threading.Condition()
        self._abandoned = False
        self._failure: BaseException | None = None
        self.ended = False  # no sample follows; those in the buffer can still be read

    def put(self, batch: Batch) -> int:
        """Append samples; return how many samples were dropped.  All batches have the fields of the first one."""
        samples, done, dropped = len(batch), 0, 0
        if not samples:
            return 0
        with self._changed:
            if not self._ring:
                self._ring = {name: np.empty(self._capacity, kind) for name, kind in fields(batch).items()}
            if self._drop:
                done = max(samples - self._capacity, 0)
                over = max(self._size + samples - done - self._capacity, 0)
                self._remove(over)
                dropped = done + over
            while done < samples and not self._abandoned:
                part = min(self._capacity - self._size, samples - done)
                self._append(batch, done, part)
                done += part
                self._changed.notify_all()
                if done < samples:
                    self._changed.wait()
        return dropped

    def get(self, timeout: float) -> Batch:
        """Return the samples in the buffer, the oldest first; an empty batch if none came within ``timeout`` s."""
        with self._changed:
            if not self._size and not self.ended:
                self._changed.wait(timeout)
            if self.ended and not self._size and self._failure is not None:
                raise self._failure
            count = min(self._size, self._capacity - self._head, LARGEST_BATCH)
            if not count:
                return Batch(EMPTY, EMPTY, None, None, time.monotonic())
            taken = {name: column[self._head : self._head + count].copy() for name, column in self._ring.items()}
            self._remove(count)
            self._changed.notify_all()
        arrived = float(taken["arrived"][-1])
        return Batch(taken["u"], taken["y"], taken.get("t"), taken.get("sequence"), arrived, taken.get("r"))

    def end(self, failure: BaseException | None = None) -> None:
        """Mark the end of the stream; `get` raises ``failure`` once the buffer is empty."""
        with self._changed:
            self.ended, self._failure = True, failure
            self._changed.notify_all()

    def abandon(self) -> None:
        """Mark that `get` is not called any more: from now on `put` does not wait."""
        with self._changed:
            self._abandoned = True
            self._changed.notify_all()

    def __len__(self) -> int:
        return self._size

    def _append(self, batch: Batch, done: int, count: int) -> None:
        start = (self._head + self._size) % self._capacity
        first = min(count, self._capacity - start)
        for name, ring in self._ring.items():
            if name == "arrived":
                ring[start : start + first] = ring[: count - first] = batch.arrived
            else:
                column = getattr(batch, name)
                ring[start : start + first] = column[done : done + first]
                if first < count:
                    ring[: count - first] = column[done + first : done + count]
        self._size += count

    def _remove(self, count: int) -> None:
        self._size -= count
        self._head = (self._head + count) % self._capacity if self._size else 0


def fields(batch: Batch) -> dict[str, type]:
    """Return the fields that a batch has, with the type of each.

    Examples
    --------
    >>> list(fields(Batch(EMPTY, EMPTY, None, None, arrived=0.0)))
    ['u', 'y', 'arrived']
    """
    given = {"u": float, "y": float, "t": float, "r": float, "sequence": np.int64, "arrived": float}
    return {name: kind for name, kind in given.items() if getattr(batch, name) is not None}
