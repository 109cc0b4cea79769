"""Sinks: the receivers of estimates, one class for each scheme of an address: ``-``, ``udp://``, ``mqtt://``."""

from __future__ import annotations

import json
import os
import select
import socket
import stat
import sys
import time
import uuid
from typing import Any, Protocol
from urllib.parse import SplitResult, unquote, urlsplit

from replant.data.streams.opening import without_password
from replant.errors import InvalidArgumentError, MissingDependencyError
from replant.live.outputs.message import (
    ENDED,
    LEAST_TTL,
    UNKNOWN,
    EstimateMessage,
)

MQTT_PORT = 1883  # port of a broker, as registered [number]
BROKER_TIMEOUT = 5.0  # time that a broker may be away before it is said [s]
KEEPALIVE = 1, 15  # least and longest time in which the broker must hear from the client [s]
#: The message that the broker publishes when the connection to the session breaks.
WILL = json.dumps(
    {"trusted": 0, "excited": 0, "ttl": 0.0, "status": ENDED, "verdict": UNKNOWN}, separators=(",", ":")
).encode()


class Sink(Protocol):
    """A receiver of estimates.  `send` must not block; only one thread at a time calls it."""

    name: str
    #: Least time between two estimates in s; estimates in between are left out, but never the newest one.
    interval: float
    #: Whether the receiver lacks the newest estimate, which must be sent again: the receiver is slow, was away, or has
    #: just connected.
    behind: bool

    def send(self, estimate: EstimateMessage) -> None:
        """Send the estimate, or leave it out and set `behind`, or raise OSError with the reason."""

    def close(self) -> None:
        """Send what is queued, and close the connection."""


class LineSink:
    """Writes JSON lines to an open file, by default standard output."""

    name = "-"
    interval = 0.01

    def __init__(self, descriptor: int = 1) -> None:
        self._descriptor = descriptor
        self._cut = False  # whether the last line was written in part
        self.behind = False
        self._is_pipe = False
        self._poll: Any = None
        try:
            mode = os.fstat(descriptor).st_mode
        except OSError:  # standard output is closed: writing raises the error
            return
        if hasattr(select, "poll") and not stat.S_ISREG(mode):
            self._is_pipe = stat.S_ISFIFO(mode)
            self._poll = select.poll()
            self._poll.register(descriptor, select.POLLOUT)

    def send(self, estimate: EstimateMessage) -> None:
        """Write a line; a line with ``trusted: 1`` only when the reader of a pipe has read the lines before.

        Thus a slow reader never finds a backlog of outdated lines that all say ``trusted: 1``.
        """
        self.behind = not self._has_room(alone=estimate.trusted)
        if self.behind:
            return
        rest = (b"\n" if self._cut else b"") + estimate.as_json() + b"\n"
        while rest:
            rest = rest[os.write(self._descriptor, rest) :]
            self._cut = bool(rest)  # if the line is cut, by a full disk, the next one must begin on a new line

    def _has_room(self, *, alone: bool) -> bool:
        """Return whether a line can be written without blocking; with ``alone``, also that no line is unread."""
        if self._poll is None:
            return True
        found = self._poll.poll(0)
        ready = found[0][1] if found else 0
        if ready & ~select.POLLOUT:  # the reader has closed the pipe: writing raises the error
            return True
        return bool(ready) and not (alone and self._is_pipe and _unread(self._descriptor))

    def close(self) -> None:
        """Do nothing: lines are written at once."""


class UdpSink:
    """Sends each estimate as a UDP datagram, whether or not a receiver listens.

    PlotJuggler's "UDP Server" with the JSON parser reads the datagrams; "timestamp" is the field of time.
    """

    interval = 0.0005  # no controller reads estimates faster

    def __init__(self, address: SplitResult) -> None:
        self.name = address.geturl()
        host, port = _host(address), _port(address, None)
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
        except OSError as error:
            raise InvalidArgumentError(f"--to {self.name}: no such host {host!r} ({error.strerror})") from None
        family, kind, protocol, _, to = found[0]
        self._to: Any = to
        self._socket = socket.socket(family, kind, protocol)
        self._socket.setblocking(False)
        self.behind = False

    def send(self, estimate: EstimateMessage) -> None:
        """Send a datagram, which the network may lose."""
        self.behind = False
        try:
            self._socket.sendto(estimate.as_json(), self._to)
        except BlockingIOError:  # the system's send buffer is full
            self.behind = True
        except ConnectionRefusedError:
            return

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class MqttSink:
    """Publishes estimates over MQTT; the broker retains the newest for clients that subscribe later.

    The sink connects in the background, and again after a break.  During a break estimates are left out; the newest one
    is sent after it.  If the session or its network dies, the broker publishes the session's last will, ``trusted: 0``.
    """

    interval = 0.01

    def __init__(self, address: SplitResult, ttl: float = LEAST_TTL) -> None:
        try:
            from paho.mqtt.client import Client
            from paho.mqtt.enums import CallbackAPIVersion
        except ImportError:
            raise MissingDependencyError("--to mqtt:// needs paho-mqtt: pip install 'replant[live]'") from None
        self._topic = unquote(address.path.lstrip("/"))
        port = _port(address, MQTT_PORT)
        self.name = f"mqtt://{address.hostname}:{port}/{self._topic}"
        if not self._topic or set(self._topic) & set("+#"):
            raise InvalidArgumentError(
                f"--to {self.name}: name one topic after the host, as in mqtt://host/rig/1/model"
            )
        # one client name for all connections: a new connection replaces the old one at the broker, which publishes the
        # old one's will first, and only then the estimates of the new one
        self._client: Any = Client(CallbackAPIVersion.VERSION2, f"replant-{uuid.uuid4().hex[:12]}")
        self._client.will_set(self._topic, WILL, qos=1, retain=True)
        if address.username:
            self._client.username_pw_set(unquote(address.username), unquote(address.password or ""))
        self._client.reconnect_delay_set(min_delay=1, max_delay=5)
        self._client.on_connect = self._on_connect
        self._client.on_publish = self._on_publish
        self._trouble = "the broker does not answer"
        self._connected = time.monotonic()
        self._unsent = False  # whether an estimate waits for the network
        self.behind = True
        # a broker waits for one and a half times the keep-alive interval, and may notice a second later
        keepalive = min(max(KEEPALIVE[0], int(ttl / 2.0)), KEEPALIVE[1])
        self._client.connect_async(_host(address), port, keepalive)
        self._client.loop_start()

    def send(self, estimate: EstimateMessage) -> None:
        """Publish the estimate as retained message, unless the broker is away or the one before is still unsent."""
        now = time.monotonic()
        connected = self._client.is_connected()
        self.behind = not connected or self._unsent
        if connected:
            self._connected = now
        elif now - self._connected > BROKER_TIMEOUT:
            raise ConnectionError(self._trouble)
        if not self.behind:
            self._unsent = True
            self._client.publish(self._topic, estimate.as_json(), qos=0, retain=True)

    def _on_connect(self, client: Any, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        refused = getattr(reason, "is_failure", False)
        self._trouble = f"the broker refuses: {reason}" if refused else "the broker does not answer"
        self._unsent = False  # paho discards it with the previous connection
        self.behind = True  # the broker retains the will, a message of another client, or none

    def _on_publish(self, *_: Any) -> None:
        self._unsent = False

    def close(self) -> None:
        """Send what is queued, and disconnect."""
        if self._client.is_connected():
            self._client.disconnect()
        self._client.loop_stop()


def open_sink(address: str, ttl: float = LEAST_TTL) -> Sink:
    """Return the sink of an address.

    >>> open_sink("-").name
    '-'
    """
    if address == "-":
        return LineSink()
    parts = urlsplit(address)
    if parts.scheme == "udp":
        return UdpSink(parts)
    if parts.scheme == "mqtt":
        return MqttSink(parts, ttl)
    raise InvalidArgumentError(f"--to {address}: give -, udp://HOST:PORT or mqtt://HOST:PORT/TOPIC")


def _unread(descriptor: int) -> int:
    """Return the number of unread bytes in a pipe; 0 where the system does not tell."""
    try:
        import fcntl
        import termios

        return int.from_bytes(fcntl.ioctl(descriptor, termios.FIONREAD, bytes(4)), sys.byteorder)
    except (ImportError, OSError):
        return 0


def _host(address: SplitResult) -> str:
    if not address.hostname:
        raise InvalidArgumentError(
            f"--to {without_password(address)}: the host is missing, as in {address.scheme}://127.0.0.1"
        )
    return address.hostname


def _port(address: SplitResult, default: int | None) -> int:
    try:
        port = address.port or default
    except ValueError:
        port = None
    if port is None:
        raise InvalidArgumentError(f"--to {without_password(address)}: give a port from 1 to 65535 after the host")
    return port
