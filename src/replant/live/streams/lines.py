"""Sources of lines: standard input, a serial port that is opened again when lost, and a TCP connection."""

from __future__ import annotations

import os
import socket
import stat
import sys
import time
from typing import Any

from replant.errors import InvalidArgumentError, MissingDependencyError
from replant.live.streams.opening import Address
from replant.live.streams.reader import Wire

BLOCK = 1 << 18  # bytes taken at once at the most [bytes]


class PipeSource(Wire):
    """Lines from an open file, ``-`` for standard input.  While the queue is full nothing is read: the writer waits."""

    def __init__(self, name: str, file: int, columns: tuple[str, ...] | None = None) -> None:
        super().__init__(name, columns, waits=True)
        self._file = file

    def _session(self) -> None:
        self._connected()
        # on POSIX select() also waits for pipes, on Windows for sockets only; a regular file is always readable
        waits = os.name == "posix" and not stat.S_ISREG(os.fstat(self._file).st_mode)
        while not self._stop.requested:
            if waits and not self._stop.wait_readable(self._file, 60.0):
                continue
            data = os.read(self._file, BLOCK)
            if not data:
                self._deliver(self._parser.parse(self._lines.rest(), time.monotonic()))
                return
            self._deliver_lines(data)


def open_pipe(address: Address, columns: tuple[str, ...] | None) -> PipeSource:
    """Return the source that reads standard input."""
    address.allow("columns")
    try:
        file = sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):
        raise InvalidArgumentError("-: there is no standard input; pipe samples into the command") from None
    return PipeSource(address.name, file, columns)


SERIAL_EXAMPLE = "serial:///dev/ttyUSB0?baud=115200"
BAUD = 115_200  # usual rate of a serial line [bit/s]
WAIT = 0.1  # the longest wait of one read; a closed source ends within this time [s]


class SerialSource(Wire):
    """Lines from a serial port, ``serial:///dev/ttyUSB0?baud=115200`` or ``serial://COM3``.

    The port is opened in the middle of a line: the rest of that line is skipped and counted as "cut off".  A full queue
    drops its oldest samples and counts them.  A board sends nothing again, and many boards restart when the port is
    opened: sequence numbers tell only which samples were lost.
    """

    def __init__(self, name: str, port: str, baud: int = BAUD, columns: tuple[str, ...] | None = None) -> None:
        super().__init__(name, columns, waits=False, replays=False)
        self._port_and_baud = port, baud
        self._port: Any = None
        try:
            self._port = self._open()
        except port_errors() as error:
            raise InvalidArgumentError(f"{name}: cannot be opened ({port_reason(error)}); {remedy(port)}") from None

    def seek(self, sequence: int) -> None:
        """Do nothing: the board's numbers may have started anew."""

    def close(self) -> None:
        """Stop reading, see `Source.close`."""
        super().close()
        if self._state == "connecting":  # the reading, which closes the port, has not begun
            self._port.close()

    def _open(self) -> Any:
        return import_pyserial(self.name).Serial(*self._port_and_baud, timeout=WAIT)

    def _session(self) -> str | None:
        try:
            with self._port or self._open() as port:
                self._port = None
                self._connected()
                self._lines.restart_midway()
                self._numbering.last = None
                while not self._stop.requested:
                    data = port.read(1)
                    if data:
                        self._deliver_lines(data + port.read(port.in_waiting))
        except port_errors() as error:
            self._lines.restart()
            return port_reason(error)
        return None


def import_pyserial(name: str) -> Any:
    """Return the module of pyserial; ``name`` is the source's URL, for the message."""
    try:
        import serial
    except ImportError as error:
        raise MissingDependencyError(f"{name}: serial ports need pyserial: pip install 'replant[live]'") from error
    return serial


def port_errors() -> tuple[type[Exception], ...]:
    """Return the errors that a lost port raises: pyserial passes on some of the system's own."""
    try:
        import termios
    except ImportError:  # Windows
        return OSError, TypeError, ValueError
    return OSError, TypeError, ValueError, termios.error


def port_reason(error: Exception) -> str:
    """Return the system's words for an error, without the port's name and the number that pyserial adds."""
    number = getattr(error, "errno", None)
    return os.strerror(number) if isinstance(number, int) else str(error)


def remedy(port: str) -> str:
    """Return what to do about a port that does not open, and the ports that exist."""
    from serial.tools.list_ports import comports

    ports = ", ".join(sorted(found.device for found in comports())) or "none"
    return f"ports found: {ports}; on Linux your user must be in the group dialout (asked for: {port})"


def open_serial(address: Address, columns: tuple[str, ...] | None) -> SerialSource:
    """Return the source of a URL ``serial://``."""
    address.allow("baud", "columns")
    port = address.path or address.host.upper()  # a host is COM3
    if not port:
        raise InvalidArgumentError(f"{address.name}: the port is missing; write {SERIAL_EXAMPLE}")
    return SerialSource(address.name, port, address.whole("baud", BAUD, least=1), columns)


TCP_EXAMPLE = "tcp://127.0.0.1:9000"
CONNECT_TIMEOUT = 5.0  # time that the peer may take to accept [s]
#: A peer that was switched off is noticed after 5 + 3 * 2 s.
KEEPALIVE = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}


class TcpSource(Wire):
    """Lines of a TCP peer, ``tcp://host:port``.

    While the queue is full nothing is read: the peer waits, and no sample is lost.  When a connection begins and a
    sequence number N is known, from `seek` or from earlier samples, the source sends the line ``after N``.  A peer that
    keeps its samples then continues with N + 1.  Samples that a peer sends again are dropped by their number.
    """

    def __init__(self, name: str, host: str, port: int, columns: tuple[str, ...] | None = None) -> None:
        super().__init__(name, columns, waits=True)
        self._place = host, port

    def _session(self) -> str:
        trouble = "the peer closed the connection"
        try:
            with socket.create_connection(self._place, CONNECT_TIMEOUT) as peer:
                self._connected()
                self._receive(peer)
        except OSError as error:
            trouble = error.strerror or str(error)
        self._lines.restart()
        return trouble

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
                self._deliver_lines(data)


def enable_keepalive(peer: socket.socket) -> None:
    """Have the system detect a peer that has vanished; options that the system lacks are left out."""
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in KEEPALIVE.items():
        option = getattr(socket, name, None)
        if option is not None:
            peer.setsockopt(socket.IPPROTO_TCP, option, value)


def open_tcp(address: Address, columns: tuple[str, ...] | None) -> TcpSource:
    """Return the source of a URL ``tcp://``."""
    address.allow("columns")
    return TcpSource(address.name, *address.host_and_port(TCP_EXAMPLE), columns)
