"""The observer's own process: views for the terminal, the page and the session, at nobody's cost."""

from __future__ import annotations

import contextlib
import dataclasses
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

from replant.errors import ReplantError
from replant.live.observer.history import History
from replant.live.observer.make_view import look
from replant.live.observer.view import Pulse, Rows, View
from replant.model.transfer_function import TransferFunction
from replant.online.identifier import Identifier

if TYPE_CHECKING:
    from replant.live.dashboard.server import Dashboard

#: Signals that end a session, and the observer by it alone.
ENDING = (signal.SIGINT, signal.SIGTERM)


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
class Command:
    """What somebody at the dashboard asked for."""

    name: str


def observe(connection: Connection, orders: Orders) -> None:
    """Run the observer until the session hangs up."""
    for number in ENDING:  # where they could not be blocked before this process began
        signal.signal(number, signal.SIG_IGN)
    with contextlib.suppress(EOFError, OSError):  # the session has gone, whatever the reason
        _Observing(connection, orders).run()


class _Observing:
    """The observer at work: its newest identifier and view."""

    def __init__(self, connection: Connection, orders: Orders) -> None:
        from replant.live.observer.terminal import Status

        self._connection, self._sending = connection, threading.Lock()
        self._orders = orders
        self._history: History | None = None
        self._identifier: Identifier | None = None
        self._view: View | None = None
        self._publish, self._dashboard = self._serve()
        self._status = Status(orders.truth) if orders.terminal else None

    def run(self) -> None:
        """Take handovers, one view for each, until the session hangs up."""
        try:
            while (handover := self._connection.recv()) is not None:
                view = self._look(handover)
                self._send(view)
                if self._status is not None:
                    self._status.show(view, handover.lines)
                if self._publish is not None:
                    self._publish(view.to_json())
        finally:
            if self._status is not None:
                self._status.close()
            if self._dashboard is not None:
                self._dashboard.stop()

    def _look(self, handover: Handover) -> View:
        """Return a new view; where nothing was learned meanwhile, the old one with the new pulse."""
        if handover.identifier is None:
            assert self._view is not None
            self._view = dataclasses.replace(self._view, **vars(handover.pulse))
            return self._view
        identifier = Identifier.from_bytes(handover.identifier)
        if self._history is None:
            self._history = History(identifier.structure.size)
            if self._orders.history is not None:
                self._history.restore(self._orders.history)
        elif self._view is not None and identifier.samples < self._view.samples:  # it was reset
            self._history.clear()
        self._identifier, self._view = identifier, look(identifier, handover.pulse, self._history)
        return self._view

    def _send(self, message: object) -> None:
        with self._sending:
            self._connection.send(message)

    def _serve(self) -> tuple[Callable[[dict[str, Any]], None] | None, Dashboard | None]:
        """Serve the dashboard if there is to be one, and tell the session where."""
        address = self._orders.dashboard
        if address is None:
            return None, None
        from replant.live.dashboard.hub import Hub
        from replant.live.dashboard.server import serve

        hub = Hub(command=lambda name: self._send(Command(name)), report=self._report)
        try:
            dashboard = serve(hub, address.host, address.port, address.token)
        except ReplantError as mistake:
            self._send(Failed(str(mistake)))
            return None, None
        self._send(Serving(dashboard.url))
        return hub.publish, dashboard

    def _report(self) -> bytes:
        """Return the report of the estimate as it is now, over the samples that are kept."""
        from replant.live.observer.report import report_of

        identifier, view = self._identifier, self._view
        if identifier is None or view is None:
            raise ReplantError("there is no model to report on yet")
        return report_of(identifier, view)
