"""Spawn: starts and ends the observer's process, and sends it messages from a thread."""

from __future__ import annotations

import atexit
import contextlib
import multiprocessing
import queue
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection

from replant.live.observer.process import ENDING, Handover, ObserverOptions, observe
from replant.operating_system import Worker

GOODBYE = 5.0  # time that the process gets to end by itself [s]


class ObserverProcess:
    """One process of the observer, with its connection and the thread that sends to it.

    Attributes
    ----------
    connection : Connection
    outbox : Queue
        Messages put there are sent by a thread: a pipe is too small for a state, and the session must not wait.
    start : float
        `time.monotonic()` when the process was started.
    """

    def __init__(self, options: ObserverOptions) -> None:
        context = multiprocessing.get_context("spawn")
        self.outbox: queue.Queue[Handover | None] = queue.Queue()
        self.connection, theirs = context.Pipe()
        with contextlib.ExitStack() as undo:  # a start that the system refuses half-way leaves nothing behind
            undo.callback(self.connection.close)
            with theirs:
                self._process = context.Process(
                    target=observe, args=(theirs, options), name="replant observer", daemon=True
                )  # fmt: skip
                with _signals_blocked():
                    self._process.start()
            undo.callback(self._kill)
            # at an exit without `end`, multiprocessing would ask the process to end and wait for it without limit
            atexit.register(self._process.kill)
            self._sender = Worker(partial(_send_all, self.connection, self.outbox))
            self._sender.start()
            self.start = time.monotonic()
            undo.pop_all()

    @property
    def sends(self) -> bool:
        """Whether messages in the outbox are still sent."""
        return self._sender.is_alive()

    @property
    def pid(self) -> int | None:
        """The process's number."""
        return self._process.pid

    @property
    def exit_reason(self) -> str:
        """Why the process ended, in words."""
        code = self._process.exitcode
        if code is None:
            return "its connection was closed"
        return f"signal {-code}" if code < 0 else f"exit code {code}"

    def clean_up(self) -> None:
        """Close the connection to a process that has closed its own; if the process still runs, kill it."""
        self.connection.close()
        self.outbox.put(None)
        self._process.join(0.2)
        self._kill()

    def end(self, *, wait: float) -> None:
        """Ask the process to end, and kill it if it has not ended after ``wait`` s."""
        self.outbox.put(None)
        self._process.join(wait)
        self.clean_up()

    def _kill(self) -> None:
        if self._process.is_alive():
            self._process.kill()
            self._process.join(GOODBYE)
        atexit.unregister(self._process.kill)


def _send_all(connection: Connection, outbox: queue.Queue[Handover | None]) -> None:
    """Send the messages in the outbox, up to and including the None that ends the process."""
    while True:
        message = outbox.get()
        try:
            connection.send(message)
        except (OSError, MemoryError):  # `Observer.poll` notices that this thread has ended
            return
        if message is None:
            return


@contextmanager
def _signals_blocked() -> Iterator[None]:
    """Start processes that ignore the signals which end a session.

    Ctrl-C, `timeout` and service managers send signals to every process of a group.  The session ends on the signal,
    and needs the observer after that for its last view.  A signal to this process waits until the block ends.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # started later, by the start of a process, it would unblock the signals
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
