"""Sources of lines and payloads: standard input, serial ports, TCP connections, UDP datagrams, MQTT messages."""

from __future__ import annotations

import contextlib
import os
import re
import socket
import sys
import time
import uuid
from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from replant.errors import InvalidArgumentError, LogError
from replant.live.streams.addresses import SCHEMES, Address
from replant.live.streams.line_parser import Parser
from replant.live.streams.reader_thread import BACKOFF, LineSplitter, Source
from replant.live.streams.source import UY, Columns, Signals
from replant.logs.table import needed
from replant.numerics.operating_system import reason_of

BLOCK = 1 << 18  # most bytes read at once [bytes]


class Wire(Source):
    """A connection whose lines or payloads are parsed; a lost connection is opened again."""

    options: tuple[str, ...] = ("columns",)  # options that its address may have
    _form = "or JSON objects with these names"  # how samples may come, beside lines of CSV

    def __init__(self, address: Address, columns: Columns, signals: Signals) -> None:
        super().__init__(address.name)
        address.allow(*self.options)
        self._unread: Any = None  # an open port or socket from which reading has not begun; reading closes it
        self._parser = Parser(self._counts, columns, signals)
        self._lines = LineSplitter(self._counts)

    def close(self) -> None:
        """Stop reading, see `Source.close`."""
        super().close()
        if self.state == "connecting" and self._unread is not None:
            self._unread.close()

    @property
    def refused(self) -> str:
        """The first line that is not a sample, and what is expected; empty if there is none."""
        parser = self._parser
        # a header may name anything: of its columns those are expected that are read
        known = tuple(name for name in parser.columns or () if name in parser.signals.fields)
        ways = [known] if known else parser.signals.by_width.values()
        expected = f"expected {' or '.join(map(','.join, ways))}, {self._form}"
        return f"{parser.refused}; {expected}" if parser.refused else ""

    @property
    def remark(self) -> str:
        """How the samples under a header with other names were read, see `Parser`."""
        return self._parser.remark

    @abstractmethod
    def _session(self) -> str | None:
        """Connect, and deliver samples until the connection ends; return the reason, None at the end of the stream."""

    def _read(self) -> None:
        while not self._stop.requested:
            trouble = self._session()
            if trouble is None or self._stop.requested:
                break
            self._pause(trouble)
        self._deliver(self._parser.finish(time.monotonic()))

    def _deliver_stream(self, file: socket.socket | int, read: Callable[[int], bytes]) -> None:
        """Deliver lines from a file or a connection with ``read`` until it ends or a stop is requested."""
        # select() waits for files on POSIX, but only for sockets on Windows
        waits = os.name == "posix" or isinstance(file, socket.socket)
        while not self._stop.requested:
            if not waits or self._stop.wait_readable(file, 60.0):
                data = read(BLOCK)
                if not data:
                    return
                self._deliver_lines(data)

    def _deliver_lines(self, data: bytes) -> None:
        self._deliver(self._parser.parse(self._lines.split(data), time.monotonic()))

    def _pause(self, trouble: str) -> None:
        """Pause before the next attempt to connect; each pause is twice the previous one."""
        self.state, self.trouble = "waiting" if self._again else "connecting", trouble
        self._stop.wait(self._backoff)
        self._backoff = min(2.0 * self._backoff, BACKOFF[1])


class PipeSource(Wire):
    """Lines from an open file, by default standard input; while the queue is full, the writer waits."""

    waits = True

    def __init__(
        self, address: Address, columns: Columns = None, signals: Signals = UY, file: int | None = None
    ) -> None:
        super().__init__(address, columns, signals)
        try:
            self._file = sys.stdin.fileno() if file is None else file
        except (AttributeError, OSError, ValueError):
            raise InvalidArgumentError("-: there is no standard input; pipe samples into the command") from None

    def _session(self) -> None:
        self._connected()
        self._deliver_stream(self._file, partial(os.read, self._file))
        if not self._stop.requested:
            self._deliver(self._parser.parse(self._lines.rest(), time.monotonic()))


BAUD = 115_200  # usual rate of a serial line [bit/s]
WAIT = 0.1  # timeout of a read; a closed source ends within this time [s]
#: The errors that a lost port raises; pyserial does not convert all errors of the system.
PORT_ERRORS: tuple[type[Exception], ...] = (OSError, TypeError, ValueError)
with contextlib.suppress(ImportError):  # Windows has no such module
    from termios import error as termios_error

    PORT_ERRORS = (*PORT_ERRORS, termios_error)


class SerialSource(Wire):
    """Lines from a serial port, ``serial:///dev/ttyUSB0?baud=115200`` or ``serial://COM3``.

    The port is opened in the middle of a line, whose rest is counted as "cut off".  A full queue drops its oldest
    samples.  A board does not send samples again, and many boards restart when the port is opened: sequence numbers
    only show losses.
    """

    replays = False
    options = "baud", "columns"

    def __init__(self, address: Address, columns: Columns, signals: Signals) -> None:
        super().__init__(address, columns, signals)
        port = address.path or address.host.upper()  # the host of serial://COM3 is the port
        address.check(port, "port")
        self._port_and_baud = port, int(address.number("baud", least=1, example=BAUD) or BAUD)
        try:
            self._unread = self._open()
        except PORT_ERRORS as error:
            raise InvalidArgumentError(
                f"{address.name}: cannot be opened ({port_reason(error)}); {remedy(port)}"
            ) from None

    def seek(self, sequence: int) -> None:
        """Do nothing: the board's numbers may have started anew."""

    def _open(self) -> Any:
        serial = needed(self.name, "serial", "serial ports need pyserial", "'replant[live]'")
        return serial.Serial(*self._port_and_baud, timeout=WAIT)

    def _session(self) -> str | None:
        try:
            with self._unread or self._open() as port:
                self._unread = None
                self._connected()
                self._lines.restart_midway()
                self._numbering.last = None
                while not self._stop.requested:
                    data = port.read(1)
                    if data:
                        self._deliver_lines(data + port.read(port.in_waiting))
        except LogError:  # of the lines, not of the port
            raise
        except PORT_ERRORS as error:
            self._lines.restart()
            return port_reason(error)
        return None


def port_reason(error: Exception) -> str:
    """Return the system's text for an error, without the port's name and the number that pyserial adds."""
    number = getattr(error, "errno", None)
    return os.strerror(number) if isinstance(number, int) else str(error)


def remedy(port: str) -> str:
    """Return the remedy for a port that does not open, with the existing ports."""
    from serial.tools.list_ports import comports

    ports = ", ".join(sorted(found.device for found in comports())) or "none"
    return f"ports found: {ports}; on Linux your user must be in the group dialout (asked for: {port})"


CONNECT_TIMEOUT = 5.0  # timeout of connecting [s]
#: A peer that was switched off is detected after 5 + 3 * 2 s.
KEEPALIVE = {"TCP_KEEPIDLE": 5, "TCP_KEEPINTVL": 2, "TCP_KEEPCNT": 3}


class TcpSource(Wire):
    """Lines of a TCP peer, ``tcp://host:port``, which waits while the queue is full: no sample is lost.

    If a sequence number N is known when a connection begins, the source sends the line ``after N``: a peer that keeps
    its samples continues with N + 1.  Repeated samples are dropped by their numbers.
    """

    waits = True

    def __init__(self, address: Address, columns: Columns, signals: Signals) -> None:
        super().__init__(address, columns, signals)
        self._place = address.place

    def _session(self) -> str:
        trouble = "the peer closed the connection"
        try:
            with socket.create_connection(self._place, CONNECT_TIMEOUT) as peer:
                self._connected()
                enable_keepalive(peer)
                if self._numbering.last is not None:
                    peer.sendall(f"after {self._numbering.last}\n".encode())
                self._deliver_stream(peer, peer.recv)
        except OSError as error:
            trouble = reason_of(error)
        self._lines.restart()
        return trouble


def enable_keepalive(peer: socket.socket) -> None:
    """Make the system detect a vanished peer; options that the system lacks are left out."""
    peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in KEEPALIVE.items():
        option = getattr(socket, name, None)
        if option is not None:
            peer.setsockopt(socket.IPPROTO_TCP, option, value)


BUFFER = 1 << 23  # requested size of the receive buffer; the system may grant less [bytes]
UDP_TOGETHER = 512  # most datagrams parsed together [count]
LARGEST_DATAGRAM = 1 << 16  # space for a datagram, more than UDP allows [bytes]


class UdpSource(Wire):
    """Datagrams with lines or packed numbers, received at ``udp://address:port``."""

    replays = False
    options = "columns", "format"

    def __init__(self, address: Address, columns: Columns, signals: Signals) -> None:
        super().__init__(address, columns, signals)
        bare = address.one_of("format", ("lines", "doubles"), "lines") == "doubles"
        if bare and columns is None:
            raise InvalidArgumentError(
                f"{address.name}: format=doubles needs columns; add &columns=t,{','.join(signals.names)}"
            )
        self._bare = bare
        if bare:
            self._form = "each a float64"
        self._socket = self._unread = listen(address)
        self.port: int = self._socket.getsockname()[1]

    def _session(self) -> None:
        with self._socket:
            self._connected()
            while not self._stop.requested:
                if self._stop.wait_readable(self._socket, 60.0):
                    self._deliver(self._parser.payloads(self._received(), time.monotonic(), bare=self._bare))

    def _received(self) -> list[bytes]:
        """Return the datagrams that have arrived."""
        datagrams: list[bytes] = []
        try:
            while len(datagrams) < UDP_TOGETHER:
                datagrams.append(self._socket.recv(LARGEST_DATAGRAM))
        except BlockingIOError:
            pass
        except OSError as error:  # the error concerns earlier datagrams; continue reading
            self.trouble = reason_of(error)
        return datagrams


def listen(address: Address) -> socket.socket:
    """Return a socket that receives datagrams."""
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(*address.place, type=socket.SOCK_DGRAM)[0]
        listener = socket.socket(family, kind, protocol)
    except OSError as error:
        raise InvalidArgumentError(f"{address.name}: {reason_of(error)}; write {SCHEMES[address.scheme][1]}") from None
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
        listener.bind(place)
    except OSError as error:
        listener.close()
        raise InvalidArgumentError(
            f"{address.name}: cannot listen there ({reason_of(error)}); choose another port, "
            "and an address of this computer or 0.0.0.0"
        ) from None
    listener.setblocking(False)
    return listener


PAHO = "paho.mqtt.client", "MQTT needs paho-mqtt", "'replant[live]'"  # module, what needs it, and what to install
TOPIC = re.compile(r"(?:(?:[^/#+]*|\+)/)*(?:[^/#+]*|[+#])", re.DOTALL)  # levels, of which + and # may stand for others
MQTT_PORT = 1883  # registered port of MQTT [number]
MQTT_KEEPALIVE = 15  # keep-alive interval of MQTT [s]
LONGEST_MESSAGE = 1 << 20  # longest message; a longer one is skipped and counted [bytes]
MQTT_TOGETHER = 256  # most messages parsed together [count]


class MqttSource(Wire):
    """Messages of a topic with lines, JSON or packed numbers, ``mqtt://user:password@host:port/topic?qos=0``."""

    options = "columns", "qos"

    def __init__(self, address: Address, columns: Columns, signals: Signals) -> None:
        super().__init__(address, columns, signals)
        address.check(address.host, "broker")
        address.check(address.path, "topic")
        if not TOPIC.fullmatch(address.path):
            raise InvalidArgumentError(
                f"{address.name}: + stands for a whole level, # for all that follow; write rig/+"
            )
        self._mqtt = needed(address.name, *PAHO)
        self._address = address
        self._qos = int(address.one_of("qos", ("0", "1"), "0"))
        self._id = f"replant-{uuid.uuid4().hex[:12]}"
        self._messages: deque[bytes] = deque()

    def _session(self) -> str:
        """Connect, and receive until a stop is requested or the connection ends; return why it ended."""
        self.trouble = ""
        client = self._client()
        try:
            client.connect(self._address.host, self._address.port or MQTT_PORT, MQTT_KEEPALIVE)
            while not self._stop.requested and client.socket() is not None:
                ready = self._stop.wait_readable(client.socket(), 0.05 if client.want_write() else 1.0)
                if client.want_write():
                    client.loop_write()
                if ready:
                    self._drain(client)
                client.loop_misc()
        except OSError as error:
            return reason_of(error)
        finally:
            if self._stop.requested:
                client.unsubscribe(self._address.path)  # otherwise the broker may queue messages for this client
            client.disconnect()
        return self.trouble or "the broker closed the connection"

    def _drain(self, client: Any) -> None:
        """Deliver the messages that have arrived."""
        for _ in range(MQTT_TOGETHER):
            waiting = len(self._messages)
            if client.loop_read() or len(self._messages) == waiting:
                break
        if self._messages:
            messages = list(self._messages)
            self._messages.clear()
            self._deliver(self._parser.payloads(messages, time.monotonic()))

    def _client(self) -> Any:
        client = self._mqtt.Client(self._mqtt.CallbackAPIVersion.VERSION2, self._id, clean_session=self._qos == 0)
        if self._address.user is not None:
            client.username_pw_set(self._address.user, self._address.password)
        client.on_connect = self._on_connect
        client.on_subscribe = self._on_subscribe
        client.on_message = self._on_message
        return client

    def _on_connect(self, client: Any, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        if reason.is_failure:
            self.trouble = f"the broker refuses: {reason}"
        else:
            client.subscribe(self._address.path, self._qos)

    def _on_subscribe(self, client: Any, data: Any, number: int, reasons: Any, properties: Any) -> None:
        if any(reason.is_failure for reason in reasons):
            self.trouble = f"the broker refuses the topic: {reasons[0]}"
            client.disconnect()
        else:
            self._connected()

    def _on_message(self, client: Any, data: Any, message: Any) -> None:
        if message.retain:
            self._counts["retained"] += 1
        elif len(message.payload) > LONGEST_MESSAGE:
            self._counts["too long"] += 1
        else:
            self._messages.append(message.payload)
