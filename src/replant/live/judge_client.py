"""The session's interface to the observer, the process that judges and shows the estimate; starts and ends it."""

from __future__ import annotations

import atexit
import contextlib
import multiprocessing
import queue
import sys
import time
from dataclasses import replace

from replant.errors import InvalidArgumentError
from replant.live.judge_process import ENDING, Handover, ObserverMessage, ObserverOptions, observe
from replant.live.outputs.message import Notices
from replant.live.progress import Identification
from replant.live.view import SessionInfo, View
from replant.numerics.operating_system import Worker, one_line, refusal, signals_blocked

GOODBYE = 5.0  # timeout for the process to end by itself [s]


class ObserverProcess:
    """One process of the observer, with its connection and the thread that sends to it."""

    def __init__(self, options: ObserverOptions) -> None:
        context = multiprocessing.get_context("spawn")
        self.outbox: queue.Queue[Handover | None] = queue.Queue()
        self.connection, theirs = context.Pipe()
        with contextlib.ExitStack() as undo:  # a start that the system refuses half-way leaves nothing behind
            undo.callback(self.connection.close)
            with theirs:
                self.process = context.Process(
                    target=observe, args=(theirs, options), name="replant observer", daemon=True
                )  # fmt: skip
                with signals_blocked(*ENDING):  # the observer must survive them to make the last view
                    self.process.start()
            undo.callback(self._kill)
            # at an exit without `end`, multiprocessing would ask the process to end and wait for it without limit
            atexit.register(self.process.kill)
            # this thread ends with the process, and then leaves the rest of the outbox unsent
            self.sender = Worker(self._send_all)
            self.sender.start()
            self.start = time.monotonic()
            undo.pop_all()
        self.busy = False  # whether it has not answered the last handover yet
        self.knows_state = self.answered = False  # whether it has received an identifier; whether it has ever answered
        self.handed = 0.0  # time of the last handover

    def end(self, wait: float) -> None:
        """Ask the process to end, kill it if it has not ended after ``wait`` s, and close the connection."""
        self.outbox.put(None)
        self.process.join(wait)
        self._kill()
        self.connection.close()

    def _kill(self) -> None:
        if self.process.is_alive():
            self.process.kill()
            self.process.join(GOODBYE)
        atexit.unregister(self.process.kill)

    def _send_all(self) -> None:
        """Send the messages in the outbox, up to and including the None that ends the process."""
        with contextlib.suppress(OSError, MemoryError):  # `Observer.poll` notices that this thread has ended
            for handover in iter(self.outbox.get, None):
                self.connection.send(handover)
            self.connection.send(None)


INTERVAL = 0.2  # least time between two handovers [s]
SHARE = 0.02  # largest part of the session's time for handovers [share]
LAST_VIEW_TIMEOUT = 20.0  # timeout of the last view: the process may just have started [s]
STARTING = 120.0  # timeout for serving the dashboard: the new process imports everything [s]
TOO_OLD = 5.0  # age at which a view is outdated [s]
PAUSES = 0.5, 30.0  # first and longest pause before the process is restarted [s]
LONG_LIFE = 60.0  # a process that ran this long was healthy: after it, the pauses start from the first [s]
RESTARTS = "observer restarts"  # name of the counter


class Observer:
    """Sends the state to the observer's process when it is idle, receives views, and restarts a dead process."""

    def __init__(self, options: ObserverOptions) -> None:
        self._options = options
        self.last: View | None = None  # the newest view, however old
        self._viewed = 0.0  # when the view came
        self._lines: list[str] = []  # lines to send with the next handover
        self._notices = Notices(self.show)
        self._restarts, self._pause = 0, PAUSES[0]
        self._commands: list[str] = []
        self.url = ""
        self._due = 0.0  # earliest time of the next handover or restart
        self._process = ObserverProcess(options)
        self._alive = True
        if options.dashboard is not None:
            deadline = time.monotonic() + STARTING
            try:
                while self._alive and not self.url and time.monotonic() < deadline:
                    self._process.connection.poll(0.1)
                    self._receive_all()
                if not self.url:
                    raise InvalidArgumentError("the dashboard's process does not respond: see the lines above")
            except BaseException:
                self.close()
                raise

    @property
    def view(self) -> View | None:
        """The newest view; None before the first one, if it is outdated, and while no process runs."""
        return self.last if self._alive and time.monotonic() - self._viewed < TOO_OLD else None

    def show(self, line: str) -> None:
        """Show a line at the terminal, above the status; before the first handover there is no status."""
        if self._alive and self._options.terminal and self._process.knows_state:
            self._lines.append(line)
        else:
            _print(line)

    def poll(self) -> list[str]:
        """Receive the process's messages, restart it if it has ended; return the commands from the dashboard."""
        if self._alive:
            self._receive_all()
        elif time.monotonic() >= self._due:
            self._restart()
        commands, self._commands = self._commands, []
        return commands

    def _receive_all(self) -> None:
        """Receive all waiting messages; raise the dashboard's error if it was never served."""
        try:
            while self._process.connection.poll(0):
                self._receive(self._process.connection.recv())
            if not self._process.sender.is_alive():  # a message was not sent, so no answer follows
                raise EOFError
        except (EOFError, OSError, MemoryError):  # a message may have been read in part: the connection is unusable
            self._handle_exit()

    def _receive(self, message: object) -> None:
        match message:
            case View() | ObserverMessage("no view"):
                now, process = time.monotonic(), self._process
                if process.answered:  # the first answer includes the start of the process
                    self._due = max(self._due, now + (now - process.handed))  # it is busy at most half of the time
                process.busy, process.answered = False, True
                if isinstance(message, View):
                    self.last, self._viewed = message, now
            case ObserverMessage("command", name):
                self._commands.append(name)
            case ObserverMessage("serving", url):
                self.url = url
            case ObserverMessage("notice", line):
                self.show(line)
            case ObserverMessage("failed", reason):
                if not self.url:
                    raise InvalidArgumentError(reason)
                self._notices.say("dashboard", f"replant: {reason}; trying again")

    def hand_over(self, identifier: Identification, info: SessionInfo, *, learned: bool) -> bool:
        """Send the state to the process, unless the process is busy or the last handover was too recent."""
        now, process = time.monotonic(), self._process
        if not self._alive or process.busy or now < self._due:
            return False
        if self._restarts:
            info = replace(info, counters={**info.counters, RESTARTS: self._restarts})
        start = time.thread_time()
        state = identifier.to_bytes() if learned or not process.knows_state else None
        cost = time.thread_time() - start
        history = self.last.history if self.last is not None and not process.knows_state else None
        process.outbox.put(Handover(info, tuple(self._lines), state, history))
        self._lines.clear()
        process.busy = process.knows_state = True
        process.handed, self._due = now, now + max(INTERVAL, cost / SHARE)
        return True

    def wait_for_view(self, identifier: Identification, info: SessionInfo) -> None:
        """Send the state and wait for its view, at most `LAST_VIEW_TIMEOUT`; for the end of a session."""
        deadline, handed = time.monotonic() + LAST_VIEW_TIMEOUT, False
        while self._alive and time.monotonic() < deadline and (self._process.busy or not handed):
            self._process.connection.poll(0.02)
            self._receive_all()
            if not handed:
                self._due = 0.0
                handed = self.hand_over(identifier, info, learned=True)

    def _handle_exit(self) -> None:
        """Clean up after a process that has ended, and schedule the next one."""
        self._alive = False
        self._process.connection.close()  # a process that still reads from it ends
        self._process.end(wait=0.2)
        lost, self._lines = self._lines, []
        for line in lost:
            self.show(line)
        if time.monotonic() - self._process.start > LONG_LIFE:
            self._pause = PAUSES[0]
        pause, code = self._next_pause(), self._process.process.exitcode
        reason = "its connection was closed" if code is None else f"signal {-code}" if code < 0 else f"exit code {code}"
        self._due = time.monotonic() + pause
        self._restarts += 1
        self._notices.say(
            "observer",
            f"replant: the process that makes verdict, status and dashboard ended ({reason}); "
            f"it restarts in {pause:.1f} s, and no model is trusted until then",
        )

    def _next_pause(self) -> float:
        """Return the pause before the next start, and double the one after it."""
        pause, self._pause = self._pause, min(2.0 * self._pause, PAUSES[1])
        return pause

    def _restart(self) -> None:
        try:
            self._process, self._alive, self._due = ObserverProcess(self._options), True, 0.0
        except Exception as error:  # no memory, file descriptors or processes left; there may be some later
            reason = refusal(error) or one_line(error)
            self._due = time.monotonic() + self._next_pause()
            self._notices.say("start", f"replant: the observer cannot be started: {reason}; trying again")

    def close(self) -> None:
        """End the process, and print lines that were not shown yet to standard error."""
        if self._alive:
            self._process.end(wait=GOODBYE)
            self._alive = False
        for line in self._lines:
            _print(line)
        self._lines.clear()


def _print(line: str) -> None:
    with contextlib.suppress(OSError):  # standard error is closed, as after `| head`: continue
        print(line, file=sys.stderr, flush=True)
