"""TCP: lines from a peer that listens; connected again when the line breaks, gone on with where the peer can."""

from __future__ import annotations

import socket
import time

from replant.data.streams.address import Address
from replant.data.streams.lines import Lines
from replant.data.streams.parser import Parser
from replant.data.streams.reader import Reader

EXAMPLE = "tcp://127.0.0.1:9000"
BLOCK = 1 << 18
"""Bytes taken at once at the most [bytes]."""
CONNECT_TIMEOUT = 5.0
"""Time that the peer may take to accept [s]."""
#: A peer that was switched off is noticed after 5 + 3 * 2 s.
KEEPALIVE = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}


class TcpSource(Reader):
    """Lines of a TCP peer, `tcp://host:port`.

    A full queue stops the reading, so that the peer waits and nothing is lost.  Whenever a connection begins and a
    sequence number is known, by `seek` or from the samples before, the line ``after N`` is sent: a peer that can goes
    on with N + 1.  From one that cannot, what was there already is dropped by its number.

    Parameters
    ----------
    name, host : str
    port : int
    columns : tuple of str or None
        See `Parser`.
    """

    def __init__(self, name: str, host: str, port: int, columns: tuple[str, ...] | None = None) -> None:
        super().__init__(name, waits=True)
        self._place = host, port
        self._lines = Lines(self._counts)
        self._parser = Parser(self._counts, columns)

    def _read(self) -> None:
        again = False
        while not self._alarm.rung:
            try:
                with socket.create_connection(self._place, CONNECT_TIMEOUT) as peer:
                    self._connected(again=again)
                    again = True
                    self._receive(peer)
                trouble = "the peer closed the connection"
            except OSError as error:
                trouble = error.strerror or str(error)
            self._lines.restart()
            self._wait_to_connect(trouble, again=again)
        self._deliver(self._parser.finish(time.monotonic()))

    def _receive(self, peer: socket.socket) -> None:
        """Deliver what comes until the peer closes the connection or the alarm is rung."""
        watch(peer)
        if self._numbering.last is not None:
            peer.sendall(f"after {self._numbering.last}\n".encode())
        while not self._alarm.rung:
            if self._alarm.ready(peer, 60.0):
                data = peer.recv(BLOCK)
                if not data:
                    return
                self._deliver(self._parser.parse(self._lines.split(data), time.monotonic()))


def watch(peer: socket.socket) -> None:
    """Notice a peer that is gone without a word; what the system cannot set stays as it is."""
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in KEEPALIVE.items():
        option = getattr(socket, name, None)
        if option is not None:
            peer.setsockopt(socket.IPPROTO_TCP, option, value)


def open_tcp(address: Address, columns: tuple[str, ...] | None) -> TcpSource:
    """Return the source that a URL names."""
    address.allow("columns")
    return TcpSource(address.name, *address.place(EXAMPLE), columns)
