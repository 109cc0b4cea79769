"""The observer's own process: views for the terminal, the page and the session, at nobody's cost."""

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

from replant.errors import ReplantError
from replant.live.observer.history import History
from replant.live.observer.make_view import look
from replant.live.observer.view import Pulse, Rows, View
from replant.live.outputs.disk_writer import one_line
from replant.live.outputs.message import UNKNOWN
from replant.live.outputs.notices import Notices
from replant.model.transfer_function import TransferFunction
from replant.online.identifier import Identifier
from replant.system.refusals import refusal

if TYPE_CHECKING:
    from replant.live.dashboard.hub import Hub
    from replant.live.dashboard.server import Dashboard

#: Signals that end a session, and the observer by it alone.
ENDING = (signal.SIGINT, signal.SIGTERM)
UNHEARD = 5.0
"""Time without a handover, of which several come a second, after which the session is not heard any more [s]."""
AGAIN = 5.0
"""Time until a dashboard that could not be served is tried again [s]."""


@dataclass(frozen=True)
class Address:
    """Where the dashboard listens."""

    host: str
    port: int
    token: str | None = None


@dataclass(frozen=True, eq=False)
class Orders:
    """What an observer is to do.

    Attributes
    ----------
    dashboard : Address or None
    terminal : bool
        Whether to write the status to standard error.
    truth : TransferFunction or None
        The true plant, shown beside the estimate: of a simulated rig.
    history : Rows or None
        Of the observer that this one replaces.
    """

    dashboard: Address | None = None
    terminal: bool = False
    truth: TransferFunction | None = None
    history: Rows | None = None


@dataclass(frozen=True)
class Handover:
    """What the session hands over: its pulse, lines to show, and the identifier if it has learned since."""

    pulse: Pulse
    lines: tuple[str, ...] = ()
    identifier: bytes | None = None


@dataclass(frozen=True)
class Serving:
    """The dashboard answers at this URL."""

    url: str


@dataclass(frozen=True)
class Failed:
    """The dashboard cannot be served, and why."""

    reason: str


@dataclass(frozen=True)
class Notice:
    """Something to be said at the terminal."""

    line: str


@dataclass(frozen=True)
class NoView:
    """A handover of which no view could be made."""


@dataclass(frozen=True)
class Command:
    """What somebody at the dashboard asked for."""

    name: str


def observe(connection: Connection, orders: Orders) -> None:
    """Run the observer until the session hangs up."""
    for number in ENDING:  # where they could not be blocked before this process began
        signal.signal(number, signal.SIG_IGN)
    try:
        with contextlib.suppress(EOFError, OSError):  # the session has gone, whatever the reason
            _Observing(connection, orders).run()
    except (MemoryError, RuntimeError) as error:
        reason = refusal(error)
        if reason is None:
            raise
        with contextlib.suppress(OSError):
            print(f"replant: the observer: {reason}", file=sys.stderr)


class _Observing:
    """The observer at work: its newest identifier and view."""

    def __init__(self, connection: Connection, orders: Orders) -> None:
        from replant.live.observer.terminal import Status

        self._connection, self._sending = connection, threading.Lock()
        self._orders = orders
        self._notices = Notices(lambda line: self._send(Notice(line)))
        self._history: History | None = None
        self._identifier: Identifier | None = None
        self._view: View | None = None
        self._hub: Hub | None = None
        self._dashboard: Dashboard | None = None
        self._serve_again = 0.0
        self._serve()
        self._status = Status(orders.truth) if orders.terminal else None

    def run(self) -> None:
        """Take handovers, one view for each, until the session hangs up."""
        try:
            while (handover := self._await_handover()) is not None:
                view = self._look(handover)
                self._send(NoView() if view is None else view)
                self._show(view, handover.lines)
                if self._orders.dashboard is not None:
                    self._serve()
            if self._dashboard is not None:
                self._dashboard.say_goodbye()
        finally:
            if self._status is not None:
                self._status.close()
            if self._dashboard is not None:
                self._dashboard.stop()

    def _await_handover(self) -> Handover | None:
        """Return the next handover; while none comes the page is told that the session is not heard."""
        while not self._connection.poll(UNHEARD):
            if self._view is not None:
                reason = f"the session has not been heard for more than {UNHEARD:.0f} s"
                self._show(dataclasses.replace(self._view, verdict=UNKNOWN, reasons=(reason,)), ())
        handover: Handover | None = self._connection.recv()
        return handover

    def _look(self, handover: Handover) -> View | None:
        """Return a new view; one that nobody may trust where it cannot be made, None where there is none to go by."""
        try:
            self._renew(handover)
        except Exception as error:  # of this state: the next may be seen again
            reason = f"the estimate could not be judged: {type(error).__name__}: {one_line(error)}"
            self._notices.say("look", f"replant: {reason}; going on")
            if self._view is not None:
                self._view = dataclasses.replace(
                    self._view, **vars(handover.pulse), verdict=UNKNOWN, reasons=(reason,)
                )  # fmt: skip
        view = self._view
        if view is not None and view.silence:
            reason = f"no sample has been accepted for {view.silence:.0f} s"
            view = dataclasses.replace(view, verdict=UNKNOWN, reasons=(reason,))
        return view

    def _renew(self, handover: Handover) -> None:
        """Look at what was handed over; where nothing was learned meanwhile, the old view gets the new pulse."""
        if handover.identifier is None:
            if self._view is not None:
                self._view = dataclasses.replace(self._view, **vars(handover.pulse))
            return
        identifier = Identifier.from_bytes(handover.identifier)
        if self._history is None:
            self._history = History(identifier.structure.size)
            if self._orders.history is not None:
                self._history.restore(self._orders.history)
        elif self._view is not None and identifier.samples < self._view.samples:  # it was reset
            self._history.clear()
        self._identifier, self._view = identifier, look(identifier, handover.pulse, self._history)

    def _show(self, view: View | None, lines: Sequence[str]) -> None:
        """Show a view at the terminal and on the page; lines are said even where there is none."""
        try:
            if self._status is not None:
                self._status.show(view, lines)
            if self._hub is not None and view is not None:
                self._hub.publish(view.to_json())
        except Exception as error:
            self._notices.say("show", f"replant: the estimate could not be shown: {one_line(error)}; going on")

    def _send(self, message: object) -> None:
        with self._sending:
            self._connection.send(message)

    def _serve(self) -> None:
        """Serve the dashboard if there is to be one and is none, and tell the session where, or why not."""
        address = self._orders.dashboard
        if address is None or (self._dashboard is not None and self._dashboard.alive):
            return
        if time.monotonic() < self._serve_again:
            return
        self._serve_again = time.monotonic() + AGAIN
        from replant.live.dashboard.hub import Hub
        from replant.live.dashboard.server import serve

        if self._hub is None:
            self._hub = Hub(
                command=lambda name: self._send(Command(name)),
                report=self._report,
                notice=lambda text: self._notices.say("dashboard", f"replant: the dashboard: {text}"),
            )
        try:
            self._dashboard = serve(self._hub, address.host, address.port, address.token)
        except (ReplantError, OSError, RuntimeError) as mistake:
            self._send(Failed(one_line(mistake)))
            return
        self._send(Serving(self._dashboard.url))

    def _report(self) -> bytes:
        """Return the report of the estimate as it is now, over the samples that are kept."""
        from replant.live.observer.report import report_of

        identifier, view = self._identifier, self._view
        if identifier is None or view is None:
            raise ReplantError("there is no model to report on yet")
        return report_of(identifier, view)
