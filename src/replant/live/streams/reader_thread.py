"""The thread that reads samples, the lines of its stream, the queue from it to the session, and the request to stop."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Iterator

import numpy as np

from replant.live.streams.source import Batch, Numbering, joined
from replant.numerics.operating_system import Worker


class StopRequest:
    """A request to stop, which is never withdrawn; within a ``with`` block it also wakes the waiting thread."""

    def __init__(self) -> None:
        self.requested = False
        self._sockets: tuple[socket.socket, socket.socket] | None = None

    def __enter__(self) -> StopRequest:
        receiver, sender = socket.socketpair()
        sender.setblocking(False)
        self._sockets = receiver, sender
        return self

    def __exit__(self, *_: object) -> None:
        if self._sockets is not None:
            for end in self._sockets:
                end.close()

    def request(self) -> None:
        """Request the stop, and wake the waiting thread."""
        self.requested = True
        if self._sockets is not None:
            # the buffer is full after many requests; the sockets are closed after the ``with`` block
            with contextlib.suppress(OSError):
                self._sockets[1].send(b"\0")

    def wait(self, timeout: float) -> bool:
        """Wait for the request, at most ``timeout`` s; return whether it was made."""
        self.wait_readable(None, timeout)
        return self.requested

    def wait_readable(self, file: socket.socket | int | None, timeout: float) -> bool:
        """Wait until ``file`` can be read, at most ``timeout`` s."""
        if self.requested or self._sockets is None:
            return False
        files = [self._sockets[0]] if file is None else [self._sockets[0], file]
        readable, _, _ = select.select(files, [], [], timeout)
        return bool(readable) and not self.requested


LONGEST = 1 << 16  # longest line; a longer one is skipped [bytes]


class LineSplitter:
    """Splits one stream into lines."""

    def __init__(self, counters: Counter[str], longest: int = LONGEST) -> None:
        self._counters = counters
        self._longest = longest
        self._tail = b""
        self._skipping = False  # whether bytes are skipped until the next line begins
        self._midway = False  # whether the skipped line has not been counted yet

    def split(self, data: bytes) -> bytes:
        """Return the lines that ``data`` completes, each with its line end."""
        if self._skipping:
            skipped, end, data = data.partition(b"\n")
            counted = self._midway and bool(skipped.strip())
            if counted:
                self._counters["cut off"] += 1
            self._skipping = not end
            self._midway = self._midway and not end and not counted
        complete, end, tail = (self._tail + data).rpartition(b"\n")
        if len(tail) > self._longest:
            self._counters["too long"] += 1
            self._skipping, tail = True, b""
        self._tail = tail
        return self._without_long(complete + end)

    def _without_long(self, block: bytes) -> bytes:
        if len(block) <= self._longest + 1:
            return block
        ends = np.flatnonzero(np.frombuffer(block, np.uint8) == ord("\n"))
        if np.diff(ends, prepend=-1).max() <= self._longest + 1:
            return block
        lines = [line + b"\n" for line in block[:-1].split(b"\n")]
        kept = [line for line in lines if len(line) <= self._longest + 1]
        self._counters["too long"] += len(lines) - len(kept)
        return b"".join(kept)

    def rest(self) -> bytes:
        """Return the last line, which the end of the stream completes."""
        tail, self._tail = self._tail, b""
        return tail + b"\n" if tail.strip() else b""

    def restart(self) -> None:
        """Start again at the beginning of a line; an unfinished line is dropped and counted as "cut off"."""
        if self._tail.strip():
            self._counters["cut off"] += 1
        self._tail, self._skipping, self._midway = b"", False, False

    def restart_midway(self) -> None:
        """Start again in the middle of a line; the rest of that line is skipped."""
        self.restart()
        self._skipping = self._midway = True


CAPACITY = 1 << 17  # capacity of the queue: 0.6 s at 200,000 samples/s, 4 MB [samples]
LARGEST_BATCH = 1 << 14  # most samples handed over at once [samples]
MOST_PARTS = 256  # batches held before they are joined [count]
EMPTY = np.empty(0)


class Inbox:
    """A queue of samples of bounded size; samples that arrived one by one are joined."""

    def __init__(self, capacity: int = CAPACITY, *, drop: bool) -> None:
        self._capacity = capacity
        self._drop = drop
        self._parts: deque[Batch] = deque()  # the oldest first
        self._size = 0
        self._changed = threading.Condition()
        self._abandoned = False
        self._failure: BaseException | None = None
        self.ended = False  # no sample follows; those in the queue can still be read

    def put(self, batch: Batch) -> int:
        """Append samples; return the number of dropped samples.  All batches must have the same fields."""
        dropped = 0
        with self._changed:
            while not self._abandoned:
                room = len(batch) if self._drop else self._capacity - self._size
                part = batch if len(batch) <= room else batch.select(slice(0, room))
                if len(part):
                    self._parts.append(part)
                    self._size += len(part)
                    if len(self._parts) == MOST_PARTS:  # samples that come one by one would need much memory
                        self._parts = deque([joined(self._parts)])
                    self._changed.notify_all()
                if part is batch:
                    break
                batch = batch.select(slice(room, None))
                self._changed.wait()
            if self._drop:
                dropped = max(self._size - self._capacity, 0)
                self._take(dropped)
        return dropped

    def get(self, timeout: float) -> Batch:
        """Return the samples in the queue, the oldest first; an empty batch if none came within ``timeout`` s."""
        with self._changed:
            if not self._size and not self.ended:
                self._changed.wait(timeout)
            if self.ended and not self._size and self._failure is not None:
                raise self._failure
            taken = self._take(LARGEST_BATCH)
            self._changed.notify_all()
        return joined(taken) if taken else Batch(EMPTY, EMPTY, arrived=time.monotonic())

    def end(self, failure: BaseException | None = None) -> None:
        """Mark the end of the stream; `get` raises ``failure`` once the queue is empty."""
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

    def _take(self, count: int) -> list[Batch]:
        """Remove the ``count`` oldest samples, or all of them."""
        taken: list[Batch] = []
        while count and self._parts:
            part = self._parts.popleft()
            if len(part) > count:
                self._parts.appendleft(part.select(slice(count, None)))
                part = part.select(slice(0, count))
            taken.append(part)
            count -= len(part)
            self._size -= len(part)
        return taken


TICK = 0.1  # time without samples after which an empty batch is returned [s]
CLOSE_TIMEOUT = 1.0  # timeout for a closed source to release its connection or file [s]
BACKOFF = 0.1, 5.0  # first and longest pause before reconnecting [s]


class Source(ABC):
    """A stream of live samples, read by its own thread."""

    waits = False  # whether reading waits while the queue is full; else the oldest samples are dropped
    replays = True  # whether samples may be sent again, with the same numbers
    capacity = CAPACITY

    def __init__(self, name: str) -> None:
        self.name = name  # the URL without password, for messages
        self.trouble = ""  # why the source is not connected, for messages; empty while it is
        self.state = "connecting"  # or "connected", "waiting" (before reconnecting), "ended"
        self._counts: Counter[str] = Counter()
        self._numbering = Numbering(self._counts, replays=self.replays)
        self._inbox = Inbox(self.capacity, drop=not self.waits)
        self._stop = StopRequest()
        self._backoff = BACKOFF[0]
        self._again = False  # whether it has been connected before

    @abstractmethod
    def _read(self) -> None:
        """Read and `_deliver` samples until the stream ends or a stop is requested."""

    def batches(self) -> Iterator[Batch]:
        """Yield samples as they arrive, an empty batch at least every 0.1 s, until the stream ends or is closed."""
        thread, deadline = Worker(self._run), float("inf")
        with self._stop:
            thread.start()
            try:
                while True:
                    batch = self._inbox.get(TICK)
                    if not len(batch) and (self._inbox.ended or time.monotonic() > deadline):
                        return
                    if len(batch) or not self._stop.requested:
                        yield batch
                    else:
                        deadline = min(deadline, time.monotonic() + CLOSE_TIMEOUT)
            finally:
                self.close()
                self._inbox.abandon()
                thread.join(CLOSE_TIMEOUT)
                self.state = "ended"

    def seek(self, sequence: int) -> None:
        """Continue after this number; call it before `batches`.  A TCP peer is requested to, a log skips rows."""
        self._numbering.last = sequence

    def close(self) -> None:
        """Stop reading; may be called from any thread and from a signal handler."""
        self._stop.request()

    @property
    def counters(self) -> dict[str, int]:
        """Number of occurrences of each fault, without zeros."""
        return {reason: count for reason, count in dict(self._counts).items() if count}

    @property
    def refused(self) -> str:
        """The first line that is not a sample, and what is expected; empty if there is none."""
        return ""

    @property
    def remark(self) -> str:
        """How the samples were read, if a user should check that; else empty."""
        return ""

    def _run(self) -> None:
        failure: BaseException | None = None
        try:
            self._read()
        except BaseException as error:
            failure = error  # `Inbox.get` raises it in the session's thread
        self._inbox.end(failure)

    def _deliver(self, batch: Batch | None) -> None:
        """Put the samples that `Numbering` accepts into the inbox."""
        if batch is not None:
            dropped = self._inbox.put(self._numbering.screen(batch))
            if dropped:
                self._counts["dropped"] += dropped

    def _connected(self) -> None:
        self._numbering.connect()
        self.state, self.trouble, self._backoff = "connected", "", BACKOFF[0]
        self._counts["reconnects"] += self._again
        self._again = True
