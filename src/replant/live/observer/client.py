"""Observer: the session's end of the process that makes views, so that the session never waits for one."""

from __future__ import annotations

import atexit
import contextlib
import multiprocessing
import queue
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection

from replant.errors import InvalidArgumentError
from replant.live.observer.process import (
    ENDING,
    Command,
    Failed,
    Handover,
    Notice,
    NoView,
    Orders,
    Serving,
    observe,
)
from replant.live.observer.view import Pulse, View
from replant.live.outputs.disk_writer import one_line
from replant.live.outputs.notices import Notices
from replant.online.identifier import Identifier
from replant.system.refusals import refusal
from replant.system.worker import Worker

INTERVAL = 0.2
"""Time between two handovers at the least [s]."""
SHARE = 0.02
"""Part of the session's time that handing over may take [share]."""
GOODBYE = 5.0
"""Time that the process gets to end by itself [s]."""
PATIENCE = 20.0
"""Time that the last view may take: the process may just have begun to compile [s]."""
STARTING = 120.0
"""Time that the process may take to serve the dashboard: it imports everything anew [s]."""
TOO_OLD = 5.0
"""Age beyond which a view says nothing of the present any more [s]."""
PAUSES = 0.5, 30.0
"""First and longest pause before the process is started again [s]."""
LONG_LIFE = 60.0
"""Life of a process after which its death is none of a row [s]."""
RESTARTS = "observer restarts"  # as it is counted


class Observer:
    """Hand an identifier's state to a process of its own whenever that is idle, and take the views it makes.

    Should the process die it is started again, each time after a longer pause; the session goes on without it in any
    case.

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
        self._notices = Notices(self.show)
        self._restarts, self._pause = 0, PAUSES[0]
        self._commands: list[str] = []
        self.url = ""
        self._alive = self._busy = self._knows_state = False
        self._handed = self._due = 0.0
        self._starting: Worker | None = None
        self._life: _Life | None = None
        self._revived: _Life | None = None
        self._take_over(_Life(orders))
        if orders.dashboard is not None:
            try:
                self._await_dashboard()
            except BaseException:
                self.close()
                raise

    def _take_over(self, life: _Life) -> None:
        self._life, self._alive = life, True
        self._busy = self._knows_state = False
        self._handed = self._due = 0.0

    def _await_dashboard(self) -> None:
        """Wait for the process to say that the dashboard answers."""
        given_up = time.monotonic() + STARTING
        while self._alive and not self.url and time.monotonic() < given_up:
            assert self._life is not None
            self._life.connection.poll(0.1)
            self._hear(first=True)
        if not self.url:
            raise InvalidArgumentError("the dashboard's process does not answer: see the lines above")

    @property
    def view(self) -> View | None:
        """The newest view; None before the first, and when it is too old or nobody makes one any more."""
        return self._view if self._alive and time.monotonic() - self._viewed < TOO_OLD else None

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
        if self._alive:
            self._hear()
        elif self._starting is None and time.monotonic() >= self._due:
            # in a thread of its own: until the process takes its orders the start of it may block
            reviver = Worker(self._revive)
            try:
                reviver.start()
                self._starting = reviver
            except RuntimeError as error:
                self._not_yet(error)
        elif self._starting is not None and not self._starting.is_alive():
            self._starting = None
            if self._revived is None:
                self._due = time.monotonic() + self._longer_pause()
            else:
                self._take_over(self._revived)
        commands, self._commands = self._commands, []
        return commands

    def _hear(self, *, first: bool = False) -> None:
        assert self._life is not None
        try:
            while self._life.connection.poll(0):
                self._take(self._life.connection.recv(), first=first)
            if not self._life.sends:  # what it could not send is waited for in vain
                raise EOFError
        except (EOFError, OSError, MemoryError):  # half a message may have been taken: there is no going on with it
            self._died()

    def _take(self, message: object, *, first: bool) -> None:
        match message:
            case View() | NoView():
                now = time.monotonic()
                self._busy = False
                self._due = max(self._due, now + (now - self._handed))  # no more than half of its time
                if isinstance(message, View):
                    self._view, self._viewed = message, now
            case Command(name):
                self._commands.append(name)
            case Serving(url):
                self.url = url
            case Notice(line):
                self.show(line)
            case Failed(reason):
                if first:
                    raise InvalidArgumentError(reason)
                self._notices.say("dashboard", f"replant: {reason}; trying again")

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
        assert self._life is not None
        if self._restarts:
            pulse = replace(pulse, counters={**pulse.counters, RESTARTS: self._restarts})
        begun = time.thread_time()
        state = identifier.to_bytes() if learned or not self._knows_state else None
        cost = time.thread_time() - begun
        self._life.outbox.put(Handover(pulse, tuple(self._lines), state))
        self._lines.clear()
        self._busy = self._knows_state = True
        self._handed = now
        self._due = now + max(INTERVAL, cost / SHARE)
        return True

    def look_again(self, identifier: Identifier, pulse: Pulse) -> None:
        """Wait for the view of this very state, as long as a session that ends may take."""
        given_up, handed = time.monotonic() + PATIENCE, False
        while self._alive and time.monotonic() < given_up and (self._busy or not handed):
            assert self._life is not None
            self._life.connection.poll(0.02)
            self._hear()
            if not handed:
                self._due = 0.0
                handed = self.hand(identifier, pulse, learned=True)

    def _died(self) -> None:
        assert self._life is not None
        self._alive = False
        self._life.bury()
        lost, self._lines = self._lines, []
        for line in lost:
            self.show(line)
        if time.monotonic() - self._life.begun > LONG_LIFE:
            self._pause = PAUSES[0]
        pause = self._longer_pause()
        self._due = time.monotonic() + pause
        self._restarts += 1
        self._notices.say(
            "observer",
            f"replant: the process that makes verdict, status and dashboard ended ({self._life.end}); "
            f"it is started again in {pause:.1f} s, and nothing is trusted until then",
        )
        if self._view is not None:
            self._orders = replace(self._orders, history=self._view.history)

    def _longer_pause(self) -> float:
        pause, self._pause = self._pause, min(2.0 * self._pause, PAUSES[1])
        return pause

    def _revive(self) -> None:
        """Start a new process; runs in a thread of its own."""
        self._revived = None
        try:
            self._revived = _Life(self._orders)
        except Exception as error:  # no memory, no descriptors, no processes left: perhaps there are later
            self._not_yet(error)

    def _not_yet(self, error: Exception) -> None:
        reason = refusal(error) or one_line(error)
        self._due = time.monotonic() + self._pause
        self._notices.say("start", f"replant: the observer cannot be started: {reason}; trying again")

    def close(self) -> None:
        """Let the process end; lines not shown yet go to standard error."""
        if self._starting is not None:
            self._starting.join(GOODBYE)
            if self._revived is not None:
                self._revived.end_now(wait=0.0)
        if self._alive and self._life is not None:
            self._life.end_now(wait=GOODBYE)
            self._alive = False
        for line in self._lines:
            _print(line)
        self._lines.clear()


class _Life:
    """One process, with what leads to it.

    Attributes
    ----------
    connection : Connection
    outbox : Queue
        What is put there is sent, by a thread: a pipe is too small for a state, and the session must not wait.
    begun : float
    """

    def __init__(self, orders: Orders) -> None:
        context = multiprocessing.get_context("spawn")
        self.outbox: queue.Queue[Handover | None] = queue.Queue()
        self.connection, theirs = context.Pipe()
        with contextlib.ExitStack() as undo:  # what the system refuses half-way leaves nothing behind
            undo.callback(self.connection.close)
            with theirs:
                self._process = context.Process(
                    target=observe, args=(theirs, orders), name="replant observer", daemon=True
                )  # fmt: skip
                with _out_of_reach_of_signals():
                    self._process.start()
            undo.callback(self._kill)
            atexit.register(self._process.kill)  # else an exit without `close` would ask it to end, and wait for ever
            self._sender = Worker(partial(_send_all, self.connection, self.outbox))
            self._sender.start()
            self.begun = time.monotonic()
            undo.pop_all()

    @property
    def sends(self) -> bool:
        """Whether what is put into the outbox is still sent."""
        return self._sender.is_alive()

    @property
    def pid(self) -> int | None:
        """The process's number."""
        return self._process.pid

    @property
    def end(self) -> str:
        """How it ended, in words."""
        code = self._process.exitcode
        if code is None:
            return "it hung up"
        return f"signal {-code}" if code < 0 else f"exit code {code}"

    def bury(self) -> None:
        """Let go of a process that has hung up; one that goes on all the same is killed."""
        self.connection.close()
        self.outbox.put(None)
        self._process.join(0.2)
        self._kill()

    def _kill(self) -> None:
        """End the process at once, if it has not ended."""
        if self._process.is_alive():
            self._process.kill()
            self._process.join(GOODBYE)
        atexit.unregister(self._process.kill)

    def end_now(self, *, wait: float) -> None:
        """Ask it to end, and kill it if it has not within ``wait`` s."""
        self.outbox.put(None)
        self._process.join(wait)
        self.bury()


def _print(line: str) -> None:
    with contextlib.suppress(OSError):  # nobody reads any more, as after `| head`: no reason to stop
        print(line, file=sys.stderr, flush=True)


def _send_all(connection: Connection, outbox: queue.Queue[Handover | None]) -> None:
    """Send what comes, the last None included; a pipe is too small for a state, and the session must not wait."""
    while True:
        message = outbox.get()
        try:
            connection.send(message)
        except (OSError, MemoryError):  # `Observer.poll` finds this thread at its end
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
