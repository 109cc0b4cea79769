"""UDP: datagrams sent to a port of this computer, each with one or more samples."""

from __future__ import annotations

import socket
import time

from replant.data.streams.address import Address
from replant.data.streams.parser import Parser
from replant.data.streams.payload import Payloads
from replant.data.streams.reader import Reader
from replant.errors import InvalidArgumentError

EXAMPLE = "udp://0.0.0.0:9000"
BUFFER = 1 << 23  # receive buffer that is requested from the system; the system may grant less [bytes]
TOGETHER = 512  # largest number of datagrams parsed together [count]
LARGEST_DATAGRAM = 1 << 16  # room for one datagram, more than UDP allows [bytes]


class UdpSource(Reader):
    """Datagrams with lines or packed numbers, received at ``udp://address:port``.

    A full queue drops its oldest samples and counts them.
    """

    def __init__(
        self, name: str, host: str, port: int, columns: tuple[str, ...] | None = None, *, bare: bool = False
    ) -> None:
        super().__init__(name, waits=False, replays=False)
        self._parser = Parser(self._counts, columns)
        self._payloads = Payloads(self._parser, bare=bare)
        self._socket = listen(name, host, port)
        self.port: int = self._socket.getsockname()[1]

    def close(self) -> None:
        """Stop listening, see `Source.close`."""
        super().close()
        if self._state == "connecting":  # the reading, which closes the socket, has not begun
            self._socket.close()

    def _read(self) -> None:
        with self._socket:
            self._connected(again=False)
            while not self._stop.requested:
                if self._stop.wait_readable(self._socket, 60.0):
                    self._deliver(self._payloads.parse(self._received(), time.monotonic()))
        self._deliver(self._parser.finish(time.monotonic()))

    def _received(self) -> list[bytes]:
        """Return the datagrams that have arrived."""
        datagrams: list[bytes] = []
        try:
            while len(datagrams) < TOGETHER:
                datagrams.append(self._socket.recv(LARGEST_DATAGRAM))
        except BlockingIOError:
            pass
        except OSError as error:  # the network reports a fault of earlier datagrams; reading continues
            self.trouble = error.strerror or str(error)
        return datagrams


def listen(name: str, host: str, port: int) -> socket.socket:
    """Return a socket that receives datagrams.

    >>> with listen("udp://127.0.0.1:0", "127.0.0.1", 0) as listener:
    ...     listener.getsockname()[0]
    '127.0.0.1'
    """
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        listener = socket.socket(family, kind, protocol)
    except OSError as error:
        raise InvalidArgumentError(f"{name}: {error.strerror or error}; write {EXAMPLE}") from None
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
        listener.bind(place)
    except OSError as error:
        listener.close()
        raise InvalidArgumentError(
            f"{name}: cannot listen there ({error.strerror or error}); choose another port, "
            "and an address of this computer or 0.0.0.0"
        ) from None
    listener.setblocking(False)
    return listener


def open_udp(address: Address, columns: tuple[str, ...] | None) -> UdpSource:
    """Return the source of a URL ``udp://``."""
    address.allow("columns", "format")
    bare = address.one_of("format", ("lines", "doubles"), "lines") == "doubles"
    if bare and columns is None:
        raise InvalidArgumentError(f"{address.name}: format=doubles needs columns; add &columns=t,u,y")
    return UdpSource(address.name, *address.host_and_port(EXAMPLE), columns, bare=bare)
