"""Sinks: where estimates go.  One class a wire, chosen by an address: ``-``, ``udp://``, ``mqtt://``."""

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

from replant.data.streams.address import shown
from replant.errors import InvalidArgumentError, MissingDependencyError
from replant.live.outputs.message import (
    ENDED,
    LEAST_TTL,
    UNKNOWN,
    Estimate,
)

MQTT_PORT = 1883
"""Port of a broker, as registered [number]."""
PATIENCE = 5.0
"""Time that a broker may be away before it is said [s]."""
KEEPALIVE = 1, 15
"""Least and longest time in which the broker must hear of us [s]."""
#: What the broker says for a session that is gone without a word.
WILL = json.dumps({"trusted": 0, "ttl": 0.0, "status": ENDED, "verdict": UNKNOWN}, separators=(",", ":")).encode()


class Sink(Protocol):
    """Takes estimates; must not keep the session waiting.  One thread at a time sends."""

    name: str
    #: Least time between two estimates in s; those between are left out, the last of a batch of them never.
    interval: float
    #: Whether the other side lacks the newest estimate, so that it is to be sent again: it was left out because the
    #: other side is slow or away, or the other side is new.
    behind: bool

    def send(self, estimate: Estimate) -> None:
        """Send, or leave it out for now and be `behind`, or raise OSError with the reason."""

    def close(self) -> None:
        """Send what is left, and let go of the wire."""


class Lines:
    """JSON lines into an open file, as a rule standard output.

    Parameters
    ----------
    descriptor : int
        Of the open file.  Written to directly, each line at once: a reader sees it immediately.
    """

    name = "-"
    interval = 0.01

    def __init__(self, descriptor: int = 1) -> None:
        self._descriptor = descriptor
        self._cut = False  # whether what was written ends within a line
        self.behind = False
        self._is_pipe = False
        self._poll: Any = None
        try:
            mode = os.fstat(descriptor).st_mode
        except OSError:  # a closed standard output: writing says so
            return
        if hasattr(select, "poll") and not stat.S_ISREG(mode):
            self._is_pipe = stat.S_ISFIFO(mode)
            self._poll = select.poll()
            self._poll.register(descriptor, select.POLLOUT)

    def send(self, estimate: Estimate) -> None:
        """Write a line; a trusted one only when the reader of a pipe has taken those before.

        So a slow reader never finds a heap of lines of which each says that it may still be trusted.

        Raises
        ------
        BrokenPipeError
            When nobody reads any more.
        """
        self.behind = not self._has_room(alone=estimate.trusted)
        if self.behind:
            return
        rest = (b"\n" if self._cut else b"") + estimate.as_json() + b"\n"
        while rest:
            rest = rest[os.write(self._descriptor, rest) :]
            self._cut = bool(rest)  # cut off here, by a full disk, it must not swallow the next one

    def _has_room(self, *, alone: bool) -> bool:
        """Whether a line can be written without waiting, and with ``alone`` whether none is waiting to be read."""
        if self._poll is None:
            return True
        found = self._poll.poll(0)
        ready = found[0][1] if found else 0
        if ready & ~select.POLLOUT:  # the reader has gone: writing says so
            return True
        return bool(ready) and not (alone and self._is_pipe and _unread(self._descriptor))

    def close(self) -> None:
        """Nothing is left to do: lines go out at once."""


class Datagrams:
    """A UDP datagram an estimate; whether anyone listens does not matter.

    PlotJuggler's "UDP Server" with the JSON parser takes them as they are; "timestamp" is its field of time.
    """

    interval = 0.0005  # a controller wants the newest; faster than this no controller asks

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

    def send(self, estimate: Estimate) -> None:
        """Send a datagram; it may get lost, as datagrams do."""
        self.behind = False
        try:
            self._socket.sendto(estimate.as_json(), self._to)
        except BlockingIOError:  # the system has no room for it
            self.behind = True
        except ConnectionRefusedError:
            return

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class Retained:
    """MQTT: each estimate is retained by the broker, so that who comes later has the newest at once.

    Connects in the background, again and again while the broker is away; meanwhile estimates are left out, and the
    newest is sent as soon as it is back.  Should the session die, or its network, the broker publishes its last will:
    nothing is trusted.

    Parameters
    ----------
    address : SplitResult
    ttl : float
        Seconds within which the broker shall notice that the session is gone.
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
        # always by one name: a connection made anew replaces the one before, whose will then comes before what we say
        self._client: Any = Client(CallbackAPIVersion.VERSION2, f"replant-{uuid.uuid4().hex[:12]}")
        self._client.will_set(self._topic, WILL, qos=1, retain=True)
        if address.username:
            self._client.username_pw_set(unquote(address.username), unquote(address.password or ""))
        self._client.reconnect_delay_set(min_delay=1, max_delay=5)
        self._client.on_connect = self._answered
        self._client.on_publish = self._written
        self._trouble = "the broker does not answer"
        self._connected = time.monotonic()
        self._unsent = False  # an estimate waits for the network
        self.behind = True
        # a broker waits one and a half times as long, and may take another second to see it
        keepalive = min(max(KEEPALIVE[0], int(ttl / 2.0)), KEEPALIVE[1])
        self._client.connect_async(_host(address), port, keepalive)
        self._client.loop_start()

    def send(self, estimate: Estimate) -> None:
        """Publish, retained; nothing while the broker is away, or has not taken the one before.

        Raises
        ------
        ConnectionError
            When it has been away for some seconds.
        """
        now = time.monotonic()
        connected = self._client.is_connected()
        self.behind = not connected or self._unsent
        if connected:
            self._connected = now
        elif now - self._connected > PATIENCE:
            raise ConnectionError(self._trouble)
        if not self.behind:
            self._unsent = True
            self._client.publish(self._topic, estimate.as_json(), qos=0, retain=True)

    def _answered(self, *answer: Any) -> None:
        """Take the broker's answer: client, what was given along, flags, reason, properties."""
        refused = getattr(answer[3], "is_failure", False)
        self._trouble = f"the broker refuses: {answer[3]}" if refused else "the broker does not answer"
        self._unsent = False  # it was thrown away with the connection before
        self.behind = True  # what the broker retains is the will, or of somebody else, or nothing

    def _written(self, *_: Any) -> None:
        """Take note that the newest estimate is on its way."""
        self._unsent = False

    def close(self) -> None:
        """Send what is left and disconnect."""
        if self._client.is_connected():
            self._client.disconnect()
        self._client.loop_stop()


def open_sink(address: str, ttl: float = LEAST_TTL) -> Sink:
    """Return the sink that an address names.

    Parameters
    ----------
    address : str
        ``-`` (standard output), ``udp://HOST:PORT`` or ``mqtt://[USER:PASSWORD@]HOST[:PORT]/TOPIC``.
    ttl : float
        Seconds within which whoever is at the other side shall notice that the session is gone.

    Raises
    ------
    InvalidArgumentError
        For any other address.
    MissingDependencyError
        For MQTT without paho-mqtt.

    Examples
    --------
    >>> open_sink("-").name
    '-'
    """
    if address == "-":
        return Lines()
    parts = urlsplit(address)
    if parts.scheme == "udp":
        return Datagrams(parts)
    if parts.scheme == "mqtt":
        return Retained(parts, ttl)
    raise InvalidArgumentError(f"--to {address}: give -, udp://HOST:PORT or mqtt://HOST:PORT/TOPIC")


def _unread(descriptor: int) -> int:
    """Return how many bytes wait in a pipe; 0 where the system does not tell."""
    try:
        import fcntl
        import termios

        return int.from_bytes(fcntl.ioctl(descriptor, termios.FIONREAD, bytes(4)), sys.byteorder)
    except (ImportError, OSError):
        return 0


def _host(address: SplitResult) -> str:
    if not address.hostname:
        raise InvalidArgumentError(f"--to {shown(address)}: the host is missing, as in {address.scheme}://127.0.0.1")
    return address.hostname


def _port(address: SplitResult, usual: int | None) -> int:
    try:
        port = address.port or usual
    except ValueError:
        port = None
    if port is None:
        raise InvalidArgumentError(f"--to {shown(address)}: give a port from 1 to 65535 after the host")
    return port
