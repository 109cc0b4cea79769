"""Alarm: wakes a thread that waits for bytes; it may be rung from a signal handler, which may take no lock."""

from __future__ import annotations

import contextlib
import select
import socket
from types import TracebackType
from typing import Protocol


class HasFile(Protocol):
    """A socket, or whatever else `select` can wait for."""

    def fileno(self) -> int:
        """Return the file descriptor."""
        ...


class Alarm:
    """Rung once, for good.  While entered it also wakes whoever waits.

    Examples
    --------
    >>> alarm = Alarm()
    >>> with alarm:
    ...     alarm.ring()
    ...     alarm.wait(60.0)
    True
    """

    def __init__(self) -> None:
        self.rung = False
        self._ends: tuple[socket.socket, socket.socket] | None = None

    def __enter__(self) -> Alarm:
        receiver, sender = socket.socketpair()
        sender.setblocking(False)
        self._ends = receiver, sender
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._ends is not None:
            for end in self._ends:
                end.close()

    def ring(self) -> None:
        """Wake the waiting thread."""
        self.rung = True
        if self._ends is not None:
            with contextlib.suppress(OSError):  # rung often enough already, or nobody is left to wake
                self._ends[1].send(b"\0")

    def wait(self, timeout: float) -> bool:
        """Wait ``timeout`` s or until rung; tell whether it was."""
        self.ready(None, timeout)
        return self.rung

    def ready(self, other: HasFile | int | None, timeout: float) -> bool:
        """Wait until ``other`` can be read, at most ``timeout`` s; tell whether it can, and the alarm is silent."""
        if self.rung or self._ends is None:
            return False
        files = [self._ends[0]] if other is None else [self._ends[0], other]
        readable, _, _ = select.select(files, [], [], timeout)
        return bool(readable) and not self.rung
