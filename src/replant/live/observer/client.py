"""Observer: the session's end of the process that makes views, so that the session never waits for one."""

from __future__ import annotations

import atexit
import contextlib
import multiprocessing
import queue
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection

from replant.errors import InvalidArgumentError
from replant.live.observer.process import (
    ENDING,
    Command,
    Failed,
    Handover,
    Orders,
    Serving,
    observe,
)
from replant.live.observer.view import Pulse, View
from replant.online.identifier import Identifier

INTERVAL = 0.2  # s between two handovers at the least
SHARE = 0.02  # of the session's time that handing over may take
GOODBYE = 5.0  # s that the process gets to end by itself
PATIENCE = 20.0  # s that the last view may take: the process may just have begun to compile
TOO_OLD = 5.0  # s after which a view says nothing of the present any more


class Observer:
    """Hand an identifier's state to a process of its own whenever that is idle, and take the views it makes.

    Should the process die it is started again, once; the session goes on without it in any case.

    Parameters
    ----------
    orders : Orders

    Raises
    ------
    InvalidArgumentError
        If the dashboard that the orders ask for cannot be served.
    """

    def __init__(self, orders: Orders) -> None:
        self._orders = orders
        self._view: View | None = None
        self._viewed = 0.0
        self._lines: list[str] = []
        self._restarts = 0
        self._commands: list[str] = []
        self.url = ""
        self._start()
        if orders.dashboard is not None:
            try:
                self._await_dashboard()
            except InvalidArgumentError:
                self.close()
                raise

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(
            target=observe, args=(theirs, self._orders), name="replant observer", daemon=True
        )  # fmt: skip
        with _out_of_reach_of_signals():
            self._process.start()
        atexit.register(self._process.kill)  # else an exit without `close` would ask it to end, and wait for ever
        theirs.close()
        self._outbox: queue.Queue[Handover | None] = queue.Queue()
        self._sender = threading.Thread(
            target=_send_all, args=(self._connection, self._outbox), name="replant-observer", daemon=True
        )
        self._sender.start()
        self._alive, self._busy, self._knows_state = True, False, False
        self._handed = self._due = 0.0

    def _await_dashboard(self) -> None:
        """Wait for the process to say that the dashboard answers."""
        while self._alive and not self.url:
            self._connection.poll(0.1)
            self.poll()
        if not self.url:
            raise InvalidArgumentError("the dashboard's process ended: see the lines above")

    @property
    def view(self) -> View | None:
        """The newest view; None before the first, and when it is too old to say anything of the present."""
        return self._view if time.monotonic() - self._viewed < TOO_OLD else None

    @property
    def last(self) -> View | None:
        """The newest view however old; None before the first."""
        return self._view

    def show(self, line: str) -> None:
        """Have a line shown at the terminal, above the status once there is one: the first handover draws it."""
        if self._alive and self._orders.terminal and self._knows_state:
            self._lines.append(line)
        else:
            _print(line)

    def poll(self) -> list[str]:
        """Take what has come from the process; return what the dashboard's users ask for."""
        try:
            while self._alive and self._connection.poll(0):
                self._take(self._connection.recv())
        except (EOFError, OSError):
            self._died()
        commands, self._commands = self._commands, []
        return commands

    def _take(self, message: object) -> None:
        match message:
            case View():
                now = time.monotonic()
                self._view, self._viewed, self._busy = message, now, False
                self._due = max(self._due, now + (now - self._handed))  # no more than half of its time
            case Command(name):
                self._commands.append(name)
            case Serving(url):
                self.url = url
            case Failed(reason):
                raise InvalidArgumentError(reason)

    def hand(self, identifier: Identifier, pulse: Pulse, *, learned: bool) -> bool:
        """Hand over the pulse, and the identifier's state if it has learned since, unless the process is at work.

        Returns
        -------
        bool
            Whether it was handed over.
        """
        now = time.monotonic()
        if not self._alive or self._busy or now < self._due:
            return False
        begun = time.thread_time()
        state = identifier.to_bytes() if learned or not self._knows_state else None
        cost = time.thread_time() - begun
        self._outbox.put(Handover(pulse, tuple(self._lines), state))
        self._lines.clear()
        self._busy = self._knows_state = True
        self._handed = now
        self._due = now + max(INTERVAL, cost / SHARE)
        return True

    def look_again(self, identifier: Identifier, pulse: Pulse) -> None:
        """Wait for the view of this very state, as long as a session that ends may take."""
        given_up, handed = time.monotonic() + PATIENCE, False
        while self._alive and time.monotonic() < given_up and (self._busy or not handed):
            self._connection.poll(0.02)
            self.poll()
            if not handed:
                self._due = 0.0
                handed = self.hand(identifier, pulse, learned=True)

    def _died(self) -> None:
        self._alive = False
        self._connection.close()
        self._process.join(GOODBYE)
        lost, self._lines = self._lines, []
        for line in lost:
            self.show(line)
        if self._restarts:
            self.show("replant: the observer ended again: no verdict, status and dashboard from here on")
            return
        self._restarts += 1
        self.show("replant: the observer ended unexpectedly; it is started again")
        if self._view is not None:
            self._orders = Orders(**{**vars(self._orders), "history": self._view.history})
        self._start()

    def close(self) -> None:
        """Let the process end; lines not shown yet go to standard error."""
        if self._alive:
            self._outbox.put(None)
            self._process.join(GOODBYE)
            if self._process.is_alive():
                self._process.kill()
                self._process.join()
            self._alive = False
            self._connection.close()
        atexit.unregister(self._process.kill)
        for line in self._lines:
            _print(line)
        self._lines.clear()


def _print(line: str) -> None:
    with contextlib.suppress(OSError):  # nobody reads any more, as after `| head`: no reason to stop
        print(line, file=sys.stderr, flush=True)


def _send_all(connection: Connection, outbox: queue.Queue[Handover | None]) -> None:
    """Send what comes, the last None included; a pipe is too small for a state, and the session must not wait."""
    while True:
        message = outbox.get()
        try:
            connection.send(message)
        except OSError:  # the process has died: the reader of the pipe sees it
            return
        if message is None:
            return


@contextmanager
def _out_of_reach_of_signals() -> Iterator[None]:
    """Start processes that no signal ends which asks for the end of a session.

    Ctrl-C, `timeout` and service managers send theirs to every process of a group: the session ends on it, and takes
    its last view from the observer after that.  Blocked, a signal meant for this process meanwhile only waits.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # begun later, by the start of a process, it would let signals through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
