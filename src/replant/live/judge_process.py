"""The observer's process: makes views for terminal, dashboard and session without delaying the session."""

from __future__ import annotations

import contextlib
import dataclasses
import signal
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING

from replant.errors import ReplantError, needs
from replant.live.make_view import EstimateHistory, make_view
from replant.live.outputs.message import Notices
from replant.live.progress import Identification
from replant.live.streams import Signals
from replant.live.view import UNNAMED, Rows, SessionInfo, View
from replant.model.transfer_function import TransferFunction
from replant.numerics.operating_system import one_line, refusal
from replant.online.identifier import Identifier

if TYPE_CHECKING:
    from replant.live.dashboard.app import Hub
    from replant.live.dashboard.server import Dashboard

#: Signals that end a session; the observer ignores them, as the session ends it.
ENDING = (signal.SIGINT, signal.SIGTERM)
UNHEARD = 5.0  # time without a handover after which the session does not respond; usually several come a second [s]
AGAIN = 5.0  # pause before the next attempt to serve the dashboard [s]


@dataclass(frozen=True)
class DashboardAddress:
    """The address at which the dashboard listens, and its token."""

    host: str
    port: int
    token: str | None = None


@dataclass(frozen=True, eq=False)
class ObserverOptions:
    """The tasks of an observer."""

    dashboard: DashboardAddress | None = None
    terminal: bool = False  # whether to write the status to standard error
    truth: TransferFunction | None = None  # the true plant of a simulated rig, shown beside the estimate
    signals: Signals = UNNAMED  # names of input and output


@dataclass(frozen=True)
class Handover:
    """A message of the session: info, lines to show, and the identifier if it has learned since the last handover."""

    info: SessionInfo
    lines: tuple[str, ...] = ()
    identifier: bytes | None = None
    history: Rows | None = None  # history of the previous process, sent with the first identifier


@dataclass(frozen=True)
class ObserverMessage:
    """A message to the session other than a view."""

    # "no view"; "serving": the dashboard's URL; "failed": why it is not served; "notice": a line to show; "command"
    kind: str
    text: str = ""


def observe(connection: Connection, options: ObserverOptions) -> None:
    """Run the observer until the session closes the connection."""
    for number in ENDING:  # for systems on which the session cannot block them before it starts this process
        signal.signal(number, signal.SIG_IGN)
    try:
        with contextlib.suppress(EOFError, OSError):  # the session has ended
            _Observing(connection, options).run()
    except (MemoryError, RuntimeError) as error:
        reason = refusal(error)
        if reason is None:
            raise
        with contextlib.suppress(OSError):
            print(f"replant: the observer: {reason}", file=sys.stderr)


class _Observing:
    """The state of the running observer: its newest identifier and view, its terminal and dashboard."""

    def __init__(self, connection: Connection, options: ObserverOptions) -> None:
        from replant.live.terminal_status import TerminalStatus

        self._connection, self._sending = connection, threading.Lock()
        self._options = options
        self._notices = Notices(lambda line: self._send(ObserverMessage("notice", line)))
        self._history: EstimateHistory | None = None
        self._identifier: Identification | None = None
        self._view: View | None = None
        self._hub: Hub | None = None
        self._dashboard: Dashboard | None = None
        self._serve_again = 0.0
        self._serve()
        self._status = TerminalStatus(options.truth) if options.terminal else None

    def run(self) -> None:
        """Answer each handover with a view, until the session closes the connection."""
        try:
            while (handover := self._await_handover()) is not None:
                view = self._judge(handover)
                self._send(ObserverMessage("no view") if view is None else view)
                self._show(view, handover.lines)
                self._serve()
            if self._dashboard is not None:
                self._dashboard.announce_end()
        finally:
            if self._status is not None:
                self._status.close()
            if self._dashboard is not None:
                self._dashboard.stop()

    def _await_handover(self) -> Handover | None:
        """Return the next handover; while none comes, show that the session does not respond."""
        while not self._connection.poll(UNHEARD):
            if self._view is not None:
                reason = f"the session has not answered for more than {UNHEARD:.0f} s"
                self._show(self._view.unjudged(reason), ())
        handover: Handover | None = self._connection.recv()
        return handover

    def _judge(self, handover: Handover) -> View | None:
        """Return a view of the handover; if that fails, return the last view with the verdict "unknown", or None."""
        try:
            self._update_view(handover)
        except Exception as error:  # this state cannot be judged; perhaps the next one can
            reason = f"the estimate could not be judged: {type(error).__name__}: {one_line(error)}"
            self._notices.say("view", f"replant: {reason}; identification continues")
            if self._view is not None:
                self._view = dataclasses.replace(self._view, **vars(handover.info)).unjudged(reason)
        view = self._view
        if view is not None and view.silence:
            view = view.unjudged(f"no sample has been accepted for {view.silence:.0f} s")
        return view

    def _update_view(self, handover: Handover) -> None:
        """Make a view of the identifier; if the handover has none, only replace the info in the last view."""
        if handover.identifier is None:
            if self._view is not None:
                self._view = dataclasses.replace(self._view, **vars(handover.info))
            return
        if handover.history is not None:
            self._history = EstimateHistory.of(handover.history)
        identifier: Identification = Identifier.from_bytes(handover.identifier)
        if self._history is None:
            self._history = EstimateHistory(len(identifier.names))
        elif self._view is not None and identifier.samples < self._view.samples:  # the identifier was reset
            self._history.clear()
        self._view = make_view(
            identifier, handover.info, self._history, truth=self._options.truth, signals=self._options.signals
        )
        self._identifier = identifier

    def _show(self, view: View | None, lines: Sequence[str]) -> None:
        """Show lines at the terminal, and a view, if there is one, at the terminal and on the page."""
        try:
            if self._status is not None:
                self._status.show(view, lines)
            if self._hub is not None and view is not None:
                self._hub.publish(view.to_json())
        except Exception as error:
            self._notices.say(
                "show", f"replant: the estimate could not be shown: {one_line(error)}; identification continues"
            )

    def _send(self, message: object) -> None:
        with self._sending:
            self._connection.send(message)

    def _serve(self) -> None:
        """Serve the dashboard if it is requested and not served; send the session its URL or the reason of failure."""
        address, served = self._options.dashboard, self._dashboard is not None and self._dashboard.alive
        if address is None or served or time.monotonic() < self._serve_again:
            return
        self._serve_again = time.monotonic() + AGAIN
        from replant.live.dashboard.server import PAGES_NEED, InUseError, serve

        try:
            with needs(PAGES_NEED, "live"):
                from replant.live.dashboard.app import Hub
            self._hub = self._hub or Hub(
                command=lambda name: self._send(ObserverMessage("command", name)),
                report=self._report,
                notice=lambda text: self._notices.say("dashboard", f"replant: the dashboard: {text}"),
            )
            self._dashboard = serve(self._hub, address.host, address.port, address.token)
        except InUseError as mistake:
            remedy = f"choose another port, as in --dashboard {address.host}:{address.port % 65535 + 1}, or off"
            self._send(ObserverMessage("failed", f"{one_line(mistake)}; {remedy}"))
            return
        except (ReplantError, OSError, RuntimeError) as mistake:
            self._send(ObserverMessage("failed", one_line(mistake)))
            return
        self._send(ObserverMessage("serving", self._dashboard.url))

    def _report(self) -> bytes:
        """Return the report on the newest estimate and the samples that the identifier keeps."""
        from replant.live.terminal_status import report_of

        identifier, view = self._identifier, self._view
        if identifier is None or view is None:
            raise ReplantError("there is no model to report on yet")
        return report_of(identifier, view)
