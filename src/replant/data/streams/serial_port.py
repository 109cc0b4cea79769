"""Serial ports: lines of a microcontroller, with pyserial; a port that was lost is opened again."""

from __future__ import annotations

import os
import time
from typing import Any

from replant.data.streams.address import Address
from replant.data.streams.lines import LineSplitter
from replant.data.streams.parser import Parser
from replant.data.streams.reader import Reader
from replant.errors import InvalidArgumentError, MissingDependencyError

EXAMPLE = "serial:///dev/ttyUSB0?baud=115200"
BAUD = 115_200  # usual rate of a serial line [bit/s]
WAIT = 0.1  # the longest wait of one read; a closed source ends within this time [s]


class SerialSource(Reader):
    """Lines from a serial port, ``serial:///dev/ttyUSB0?baud=115200`` or ``serial://COM3``.

    The port is opened in the middle of a line: the rest of that line is skipped and counted as "cut off".  A full queue
    drops its oldest samples and counts them.  A board sends nothing again, and many boards restart when the port is
    opened: sequence numbers tell only which samples were lost.
    """

    def __init__(self, name: str, port: str, baud: int = BAUD, columns: tuple[str, ...] | None = None) -> None:
        super().__init__(name, waits=False, replays=False)
        self._port_and_baud = port, baud
        self._lines = LineSplitter(self._counts)
        self._parser = Parser(self._counts, columns)
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

    def _read(self) -> None:
        again = False
        while not self._stop.requested:
            try:
                with self._port or self._open() as port:
                    self._port = None
                    self._connected(again=again)
                    again = True
                    self._receive(port)
            except port_errors() as error:
                self._lines.restart()
                self._wait_to_connect(port_reason(error), again=again)
        self._deliver(self._parser.finish(time.monotonic()))

    def _receive(self, port: Any) -> None:
        self._lines.restart_midway()
        self._numbering.last = None
        while not self._stop.requested:
            data = port.read(1)
            if data:
                data += port.read(port.in_waiting)
                self._deliver(self._parser.parse(self._lines.split(data), time.monotonic()))


def import_pyserial(name: str) -> Any:
    """Return the module of pyserial; ``name`` is the source's URL, for the message."""
    try:
        import serial
    except ImportError as error:
        raise MissingDependencyError(f"{name}: serial ports need pyserial: pip install 'replant[live]'") from error
    return serial


def port_errors() -> tuple[type[Exception], ...]:
    """Return the errors that a lost port raises: pyserial passes on some of the system's own.

    Examples
    --------
    >>> OSError in port_errors()
    True
    """
    try:
        import termios
    except ImportError:  # Windows
        return OSError, TypeError, ValueError
    return OSError, TypeError, ValueError, termios.error


def port_reason(error: Exception) -> str:
    """Return the system's words for an error, without the port's name and the number that pyserial adds.

    Examples
    --------
    >>> port_reason(OSError(2, "could not open port /dev/ttyUSB0"))
    'No such file or directory'
    """
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
        raise InvalidArgumentError(f"{address.name}: the port is missing; write {EXAMPLE}")
    return SerialSource(address.name, port, address.whole("baud", BAUD, least=1), columns)
