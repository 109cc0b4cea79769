"""Serial ports: lines of a microcontroller, with pyserial; opened again after the cable was out."""

from __future__ import annotations

import os
import time
from typing import Any

from replant.data.streams.address import Address
from replant.data.streams.lines import Lines
from replant.data.streams.parser import Parser
from replant.data.streams.reader import Reader
from replant.errors import InvalidArgumentError, MissingDependencyError

EXAMPLE = "serial:///dev/ttyUSB0?baud=115200"
BAUD = 115_200
"""Usual rate of a serial line [bit/s]."""
WAIT = 0.1
"""Longest time that a read waits: how soon a closed source is noticed [s]."""


class SerialSource(Reader):
    """Lines from a serial port, ``serial:///dev/ttyUSB0?baud=115200`` or ``serial://COM3``.

    The port is opened in the middle of a line, so what comes before the first line's end is passed over and counted as
    "cut off".  Nobody waits for a full queue: its oldest samples are dropped and counted.  Nothing is sent again over
    such a line, and many boards start anew when the port is opened: sequence numbers tell what was lost, no more.

    Parameters
    ----------
    name, port : str
    baud : int
    columns : tuple of str or None
        See `Parser`.

    Raises
    ------
    InvalidArgumentError
        If there is no such port or it may not be opened.
    MissingDependencyError
        Without pyserial.
    """

    def __init__(self, name: str, port: str, baud: int = BAUD, columns: tuple[str, ...] | None = None) -> None:
        super().__init__(name, waits=False, replays=False)
        self._place = port, baud
        self._lines = Lines(self._counts)
        self._parser = Parser(self._counts, columns)
        self._port: Any = None
        try:
            self._port = self._open()
        except broken() as error:
            raise InvalidArgumentError(f"{name}: cannot be opened ({reason_of(error)}); {remedy(port)}") from None

    def seek(self, sequence: int) -> None:
        """Go on with what comes: the board's numbers may have started anew."""

    def close(self) -> None:
        """Stop reading, see `Source.close`."""
        super().close()
        if self._state == "connecting":  # never read: nobody else closes it
            self._port.close()

    def _open(self) -> Any:
        return load(self.name).Serial(*self._place, timeout=WAIT)

    def _read(self) -> None:
        again = False
        while not self._alarm.rung:
            try:
                with self._port or self._open() as port:
                    self._port = None
                    self._connected(again=again)
                    again = True
                    self._receive(port)
            except broken() as error:
                self._lines.restart()
                self._wait_to_connect(reason_of(error), again=again)
        self._deliver(self._parser.finish(time.monotonic()))

    def _receive(self, port: Any) -> None:
        self._lines.restart_midway()
        self._numbering.last = None
        while not self._alarm.rung:
            data = port.read(1)
            if data:
                data += port.read(port.in_waiting)
                self._deliver(self._parser.parse(self._lines.split(data), time.monotonic()))


def load(name: str) -> Any:
    """Return pyserial."""
    try:
        import serial
    except ImportError as error:
        raise MissingDependencyError(f"{name}: serial ports need pyserial: pip install 'replant[live]'") from error
    return serial


def broken() -> tuple[type[Exception], ...]:
    """Return the errors of a port that is gone: pyserial lets some of the system's through."""
    try:
        import termios
    except ImportError:  # Windows
        return OSError, TypeError, ValueError
    return OSError, TypeError, ValueError, termios.error


def reason_of(error: Exception) -> str:
    """Return what pyserial says, without the port's name and the number that it puts around it."""
    number = getattr(error, "errno", None)
    return os.strerror(number) if isinstance(number, int) else str(error)


def remedy(port: str) -> str:
    """Return what to try for a port that does not open: those there are."""
    from serial.tools.list_ports import comports

    ports = ", ".join(sorted(found.device for found in comports())) or "none"
    return f"ports found: {ports}; on Linux your user must be in the group dialout (asked for: {port})"


def open_serial(address: Address, columns: tuple[str, ...] | None) -> SerialSource:
    """Return the source that a URL names."""
    address.allow("baud", "columns")
    port = address.path or address.host.upper()  # a host is COM3
    if not port:
        raise InvalidArgumentError(f"{address.name}: the port is missing; write {EXAMPLE}")
    return SerialSource(address.name, port, address.whole("baud", BAUD, least=1), columns)
