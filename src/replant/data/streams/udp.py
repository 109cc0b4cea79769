"""UDP: datagrams that come to a port of ours, each with one or more samples."""

from __future__ import annotations

import socket
import time

from replant.data.streams.address import Address
from replant.data.streams.parser import Parser
from replant.data.streams.payload import Payloads
from replant.data.streams.reader import Reader
from replant.errors import InvalidArgumentError

EXAMPLE = "udp://0.0.0.0:9000"
BUFFER = 1 << 23
"""What the system is asked to keep for us; it may grant less [bytes]."""
TOGETHER = 512
"""Datagrams read together at the most [count]."""
LARGEST_DATAGRAM = 1 << 16
"""Room for one datagram, more than UDP allows [bytes]."""


class UdpSource(Reader):
    """Datagrams with lines or packed numbers, `udp://address:port` to listen at.

    Nobody waits for a full queue: its oldest samples are dropped and counted.

    Parameters
    ----------
    name, host : str
        Which of our addresses to listen at; "0.0.0.0" for all.
    port : int
        0 for any that is free, see `port`.
    columns : tuple of str or None
        See `Parser`.
    bare : bool
        Whether the datagrams hold float64 alone, see `Payloads`.

    Raises
    ------
    InvalidArgumentError
        If the port is taken, or the address is not ours.
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
        if self._state == "connecting":  # never read: nobody else closes it
            self._socket.close()

    def _read(self) -> None:
        with self._socket:
            self._connected(again=False)
            while not self._alarm.rung:
                if self._alarm.ready(self._socket, 60.0):
                    self._deliver(self._payloads.parse(self._waiting(), time.monotonic()))
        self._deliver(self._parser.finish(time.monotonic()))

    def _waiting(self) -> list[bytes]:
        """Return the datagrams that are there."""
        datagrams: list[bytes] = []
        try:
            while len(datagrams) < TOGETHER:
                datagrams.append(self._socket.recv(LARGEST_DATAGRAM))
        except BlockingIOError:
            pass
        except OSError as error:  # what the network says of earlier datagrams is no reason to stop
            self.trouble = error.strerror or str(error)
        return datagrams


def listen(name: str, host: str, port: int) -> socket.socket:
    """Return a socket at one of our addresses."""
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
    """Return the source that a URL names."""
    address.allow("columns", "format")
    bare = address.one_of("format", ("lines", "doubles"), "lines") == "doubles"
    if bare and columns is None:
        raise InvalidArgumentError(f"{address.name}: format=doubles needs columns; add &columns=t,u,y")
    return UdpSource(address.name, *address.place(EXAMPLE), columns, bare=bare)
