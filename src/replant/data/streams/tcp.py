"""TCP: lines from a listening peer; after a break the source connects again and asks for the samples that follow."""

from __future__ import annotations

import socket
import time

from replant.data.streams.address import Address
from replant.data.streams.lines import LineSplitter
from replant.data.streams.parser import Parser
from replant.data.streams.reader import Reader

EXAMPLE = "tcp://127.0.0.1:9000"
BLOCK = 1 << 18  # largest number of bytes received at once [bytes]
CONNECT_TIMEOUT = 5.0  # time that the peer may take to accept [s]
#: A peer that was switched off is noticed after 5 + 3 * 2 s.
KEEPALIVE = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}


class TcpSource(Reader):
    """Lines of a TCP peer, ``tcp://host:port``.

    While the queue is full nothing is read: the peer waits, and no sample is lost.  When a connection begins and a
    sequence number N is known, from `seek` or from earlier samples, the source sends the line ``after N``.  A peer that
    keeps its samples then continues with N + 1.  Samples that a peer sends again are dropped by their number.
    """

    def __init__(self, name: str, host: str, port: int, columns: tuple[str, ...] | None = None) -> None:
        super().__init__(name, waits=True)
        self._place = host, port
        self._lines = LineSplitter(self._counts)
        self._parser = Parser(self._counts, columns)

    def _read(self) -> None:
        again = False
        while not self._stop.requested:
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
        """Deliver samples until the peer closes the connection or a stop is requested."""
        enable_keepalive(peer)
        if self._numbering.last is not None:
            peer.sendall(f"after {self._numbering.last}\n".encode())
        while not self._stop.requested:
            if self._stop.wait_readable(peer, 60.0):
                data = peer.recv(BLOCK)
                if not data:
                    return
                self._deliver(self._parser.parse(self._lines.split(data), time.monotonic()))


def enable_keepalive(peer: socket.socket) -> None:
    """Have the system detect a peer that has vanished; options that the system lacks are left out.

    Examples
    --------
    >>> with socket.socket() as peer:
    ...     enable_keepalive(peer)
    ...     peer.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) != 0
    True
    """
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in KEEPALIVE.items():
        option = getattr(socket, name, None)
        if option is not None:
            peer.setsockopt(socket.IPPROTO_TCP, option, value)


def open_tcp(address: Address, columns: tuple[str, ...] | None) -> TcpSource:
    """Return the source of a URL ``tcp://``.

    >>> open_tcp(Address("tcp://rig:9000", "tcp", "rig", 9000), None).name
    'tcp://rig:9000'
    """
    address.allow("columns")
    return TcpSource(address.name, *address.host_and_port(EXAMPLE), columns)
