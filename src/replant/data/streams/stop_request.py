"""Stop request: ends a thread that waits for bytes; a signal handler may make it, so it takes no lock."""

from __future__ import annotations

import contextlib
import select
import socket
from types import TracebackType
from typing import Protocol


class HasFile(Protocol):
    """A socket, or any other object that `select` can wait for."""

    def fileno(self) -> int:
        """Return the file descriptor."""
        ...


class StopRequest:
    """A request to stop, made once and never withdrawn.  Within a ``with`` block it also wakes the waiting thread.

    Attributes
    ----------
    requested : bool

    Examples
    --------
    >>> stop = StopRequest()
    >>> with stop:
    ...     stop.request()
    ...     stop.wait(60.0)
    True
    """

    def __init__(self) -> None:
        self.requested = False
        self._sockets: tuple[socket.socket, socket.socket] | None = None

    def __enter__(self) -> StopRequest:
        receiver, sender = socket.socketpair()
        sender.setblocking(False)
        self._sockets = receiver, sender
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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

    def wait_readable(self, file: HasFile | int | None, timeout: float) -> bool:
        """Wait until ``file`` can be read, at most ``timeout`` s."""
        if self.requested or self._sockets is None:
            return False
        files = [self._sockets[0]] if file is None else [self._sockets[0], file]
        readable, _, _ = select.select(files, [], [], timeout)
        return bool(readable) and not self.requested
