"""Sinks: where estimates go.  One class a wire, chosen by an address: ``-``, ``udp://``, ``mqtt://``."""

from __future__ import annotations

import os
import socket
import time
from typing import Any, Protocol
from urllib.parse import SplitResult, unquote, urlsplit

from replant.data.streams.address import shown
from replant.errors import InvalidArgumentError, MissingDependencyError
from replant.live.outputs.message import Estimate

MQTT_PORT = 1883
PATIENCE = 5.0  # s that a broker may be away before it is said


class Sink(Protocol):
    """Takes estimates; must not keep the session waiting."""

    name: str
    #: Least time between two estimates in s; those between are left out, the last of a batch of them never.
    interval: float

    def send(self, estimate: Estimate) -> None:
        """Send, or raise OSError with the reason."""

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

    def send(self, estimate: Estimate) -> None:
        """Write a line.

        Raises
        ------
        BrokenPipeError
            When nobody reads any more.
        """
        rest = estimate.as_json() + b"\n"
        while rest:
            rest = rest[os.write(self._descriptor, rest) :]

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

    def send(self, estimate: Estimate) -> None:
        """Send a datagram; one that the system has no room for is lost, as datagrams are."""
        try:
            self._socket.sendto(estimate.as_json(), self._to)
        except (BlockingIOError, ConnectionRefusedError):
            return

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class Retained:
    """MQTT: each estimate is retained by the broker, so that who comes later has the newest at once.

    Connects in the background, again and again while the broker is away; meanwhile estimates are left out.
    """

    interval = 0.01

    def __init__(self, address: SplitResult) -> None:
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
        self._client: Any = Client(CallbackAPIVersion.VERSION2)
        if address.username:
            self._client.username_pw_set(unquote(address.username), unquote(address.password or ""))
        self._client.reconnect_delay_set(min_delay=1, max_delay=30)
        self._client.on_connect = self._answered
        self._trouble = "the broker does not answer"
        self._connected = time.monotonic()
        self._client.connect_async(_host(address), port, keepalive=15)
        self._client.loop_start()

    def send(self, estimate: Estimate) -> None:
        """Publish, retained; nothing while the broker is away.

        Raises
        ------
        ConnectionError
            When it has been away for some seconds.
        """
        now = time.monotonic()
        if self._client.is_connected():
            self._connected = now
            self._client.publish(self._topic, estimate.as_json(), qos=0, retain=True)
        elif now - self._connected > PATIENCE:
            raise ConnectionError(self._trouble)

    def _answered(self, *answer: Any) -> None:
        """Take the broker's answer: client, what was given along, flags, reason, properties."""
        refused = getattr(answer[3], "is_failure", False)
        self._trouble = f"the broker refuses: {answer[3]}" if refused else "the broker does not answer"

    def close(self) -> None:
        """Send what is left and disconnect."""
        if self._client.is_connected():
            self._client.disconnect()
        self._client.loop_stop()


def open_sink(address: str) -> Sink:
    """Return the sink that an address names.

    Parameters
    ----------
    address : str
        ``-`` (standard output), ``udp://HOST:PORT`` or ``mqtt://[USER:PASSWORD@]HOST[:PORT]/TOPIC``.

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
        return Retained(parts)
    raise InvalidArgumentError(f"--to {address}: give -, udp://HOST:PORT or mqtt://HOST:PORT/TOPIC")


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
