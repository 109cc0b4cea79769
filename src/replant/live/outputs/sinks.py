"""Sinks: the receivers of estimates, one class for each scheme; and the thread that sends to them.

No receiver holds ``trusted: 1`` for longer than the time to live without an accepted sample.  Each message carries the
rest of that time, for receivers that get no further message.  If the time expires while the session's thread waits for
samples, for a disk or for a solution, the watchdog's thread sends ``trusted: 0`` instead.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import socket
import stat
import sys
import threading
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from replant.errors import InvalidArgumentError
from replant.live.outputs.message import ENDED, LEAST_TTL, UNKNOWN, WAITING, EstimateMessage, Notices, Sink
from replant.live.streams.addresses import NO_PORT, Address, split
from replant.live.streams.serial_and_network import MQTT_PORT, PAHO
from replant.logs.table import needed
from replant.numerics.operating_system import Worker, one_line

PORT = "give a port from 1 to 65535 after the host"
BROKER_TIMEOUT = 5.0  # time without a broker after which it is reported [s]
KEEPALIVE = 1, 15  # shortest and longest keep-alive interval [s]
#: The message that the broker publishes when the connection to the session breaks.
WILL = json.dumps(
    {"trusted": 0, "excited": 0, "ttl": 0.0, "status": ENDED, "verdict": UNKNOWN, "coefficients": 0},
    separators=(",", ":"),
).encode()


class LineSink(Sink):
    """Writes JSON lines to an open file, by default standard output."""

    name = "-"
    interval = 0.01

    def __init__(self, descriptor: int = 1) -> None:
        self._descriptor = descriptor
        self._cut = False  # whether the last line was written in part
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
        """Write a line; with ``trusted: 1`` only into an empty pipe, as a line that waits there may become outdated."""
        self.behind = not self._has_room(alone=estimate.trusted)
        if self.behind:
            return
        rest = (b"\n" if self._cut else b"") + estimate.as_json() + b"\n"
        while rest:
            rest = rest[os.write(self._descriptor, rest) :]
            self._cut = bool(rest)  # after a line cut by a full disk, the next one must begin on a new line

    def _has_room(self, *, alone: bool) -> bool:
        """Return whether a line can be written without blocking; with ``alone``, also whether no line is unread."""
        if self._poll is None:
            return True
        found = self._poll.poll(0)
        ready = found[0][1] if found else 0
        if ready & ~select.POLLOUT:  # the reader has closed the pipe: writing raises the error
            return True
        return bool(ready) and not (alone and self._is_pipe and _unread(self._descriptor))


class UdpSink(Sink):
    """Sends each estimate as a UDP datagram without confirmation; PlotJuggler's "UDP Server" reads its JSON."""

    interval = 0.0005  # no controller reads estimates faster

    def __init__(self, address: Address) -> None:
        self.name = address.name
        try:
            found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
        except OSError as error:
            raise InvalidArgumentError(f"--to {self.name}: no such host {address.host!r} ({error.strerror})") from None
        family, kind, protocol, _, to = found[0]
        self._to: Any = to
        self._socket = socket.socket(family, kind, protocol)
        self._socket.setblocking(False)

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


class MqttSink(Sink):
    """Publishes estimates over MQTT; the broker retains the newest for clients that subscribe later.

    While the broker is disconnected, estimates are skipped; then the newest one is sent.  If the session or its network
    dies, the broker publishes the session's last will, ``trusted: 0``.
    """

    interval = 0.01

    def __init__(self, address: Address, ttl: float = LEAST_TTL) -> None:
        self._topic, port = address.path, address.port or MQTT_PORT
        self.name = f"mqtt://{address.host}:{port}/{self._topic}"
        client = needed(f"--to {self.name}", *PAHO)
        if not self._topic or set(self._topic) & set("+#"):
            raise InvalidArgumentError(
                f"--to {self.name}: name one topic after the host, as in mqtt://host/rig/1/model"
            )
        # one client name for all connections: the broker replaces the old connection and publishes its will before the
        # estimates of the new one
        self._client: Any = client.Client(client.CallbackAPIVersion.VERSION2, f"replant-{uuid.uuid4().hex[:12]}")
        self._client.will_set(self._topic, WILL, qos=1, retain=True)
        if address.user:
            self._client.username_pw_set(address.user, address.password or "")
        self._client.reconnect_delay_set(min_delay=1, max_delay=5)
        self._client.on_connect = self._on_connect
        self._client.on_publish = self._on_publish
        self._trouble = "the broker does not answer"
        self._connected = time.monotonic()
        self._unsent = False  # whether an estimate waits for the network
        self.behind = True
        # a broker waits for one and a half keep-alive intervals, and may notice the loss a second later
        keepalive = min(max(KEEPALIVE[0], int(ttl / 2.0)), KEEPALIVE[1])
        self._client.connect_async(address.host, port, keepalive)
        self._client.loop_start()

    def send(self, estimate: EstimateMessage) -> None:
        """Publish the estimate as a retained message, unless the broker is away or the previous one is still unsent."""
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
        """Send queued messages, and disconnect."""
        if self._client.is_connected():
            self._client.disconnect()
        self._client.loop_stop()


def open_sink(address: str, ttl: float = LEAST_TTL) -> Sink:
    """Return the sink of an address."""
    if address == "-":
        return LineSink()
    scheme = address.partition("://")[0].lower()
    if scheme not in ("udp", "mqtt") or "://" not in address:
        raise InvalidArgumentError(f"--to {address}: give -, udp://HOST:PORT or mqtt://HOST:PORT/TOPIC")
    try:
        parts = split(address)
    except InvalidArgumentError as mistake:
        raise InvalidArgumentError(f"--to {mistake}".replace(NO_PORT, PORT)) from None
    if not parts.host:
        raise InvalidArgumentError(f"--to {parts.name}: the host is missing, as in {scheme}://127.0.0.1")
    if not parts.port and (scheme == "udp" or parts.port == 0):
        raise InvalidArgumentError(f"--to {parts.name}: {PORT}")
    return UdpSink(parts) if scheme == "udp" else MqttSink(parts, ttl)


def _unread(descriptor: int) -> int:
    """Return the number of unread bytes in a pipe; 0 if the system does not report it."""
    try:
        import fcntl
        import termios

        return int.from_bytes(fcntl.ioctl(descriptor, termios.FIONREAD, bytes(4)), sys.byteorder)
    except (ImportError, OSError):
        return 0


TICK = 0.05  # longest time between two checks of the watchdog [s]
GOODBYE = 2.0  # timeout for sending the last message to the sinks [s]


@dataclass
class _Receiver:
    """A sink and its state: pending estimate, due time, whether the receiver may hold trust, and has ended."""

    sink: Sink
    pending: bool = False
    due: float = 0.0
    trusted: bool = False
    ended: bool = False
    lock: threading.Lock = field(default_factory=threading.Lock)


class Publisher:
    """Sends estimates to sinks, each at its own rate."""

    def __init__(
        self,
        sinks: Sequence[Sink],
        archive: Sink | None,
        ttl: float,
        *,
        notices: Notices,
        on_reader_gone: Callable[[], None],
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._watched = [_Receiver(sink) for sink in sinks]
        self._all = [*self._watched, *([_Receiver(archive)] if archive is not None else [])]
        self._ttl, self._notices, self._on_reader_gone, self._now = ttl, notices, on_reader_gone, now
        self._accepted = -math.inf  # time of the last accepted sample
        self._newest: EstimateMessage | None = None
        self._ended = threading.Event()
        self._thread: Worker | None = None

    def start(self, estimate: EstimateMessage) -> None:
        """Start the watchdog; ``estimate`` is sent to receivers that connect before the first sample."""
        self._newest = estimate
        if self._watched:
            self._thread = Worker(self._watch)
            self._thread.start()

    def accepted(self) -> None:
        """Record that a sample has been accepted just now."""
        self._accepted = self._now()

    @property
    def silence(self) -> float:
        """Seconds since a sample was accepted, if longer than the time to live; else 0."""
        since = self._now() - self._accepted
        return since if self._ttl <= since < math.inf else 0.0

    def mark(self) -> None:
        """Mark a new estimate as pending."""
        for receiver in self._all:
            receiver.pending = True

    def send(self, estimate: Callable[[], EstimateMessage], *, immediately: bool = False) -> None:
        """Send the newest estimate to each receiver that is due; with ``immediately`` to each that lacks it."""
        now = self._now()
        due = [receiver for receiver in self._all if receiver.pending and (immediately or now >= receiver.due)]
        if not due:
            return
        self._newest = estimate()
        for receiver in due:
            receiver.pending, receiver.due = False, now + receiver.sink.interval
            self._transmit(receiver)

    def check(self) -> None:
        """Do the watchdog's work once: withdraw expired trust, and send estimates again that did not arrive."""
        expired = self._remaining() <= 0.0
        for receiver in self._watched:
            if receiver.sink.behind or (expired and receiver.trusted):
                self._transmit(receiver, wait=0.0)  # do not wait for the other thread, which may be sending

    def end(self) -> None:
        """Send ``status: ended`` on every sink, and close them; a second call has no effect."""
        if self._ended.is_set():
            return
        self._ended.set()
        if self._thread is not None:
            self._thread.join(GOODBYE)
        for receiver in self._watched:
            self._transmit(receiver, wait=GOODBYE)  # the watchdog may be blocked by its connection
        deadline = time.monotonic() + GOODBYE
        while any(receiver.sink.behind for receiver in self._watched) and time.monotonic() < deadline:
            time.sleep(0.2 * TICK)
            self.check()
        for receiver in self._watched:
            with contextlib.suppress(OSError):
                receiver.sink.close()

    def _watch(self) -> None:
        pause = TICK
        while not self._ended.wait(pause):
            self.check()
            left = self._remaining()
            pause = min(left, TICK) if left > 0.0 else TICK

    def _remaining(self) -> float:
        """Return the rest of the time to live in s: how long a controller may still use the estimate."""
        return 0.0 if self._ended.is_set() else max(self._accepted + self._ttl - self._now(), 0.0)

    def _transmit(self, receiver: _Receiver, wait: float = -1.0) -> None:
        """Send the newest estimate with its present time to live; give up if another thread sends for ``wait`` s."""
        if self._newest is None or not receiver.lock.acquire(timeout=wait):
            return
        try:
            if receiver.ended:  # the other thread has sent the end meanwhile
                return
            estimate = self._stamped(self._newest)
            receiver.trusted |= estimate.trusted
            receiver.sink.send(estimate)
            if not receiver.sink.behind:
                receiver.trusted, receiver.ended = estimate.trusted, estimate.status == ENDED
        except BrokenPipeError:  # the reader has closed the pipe, as `| head` does
            receiver.trusted = False
            self._on_reader_gone()
        except Exception as error:  # a fault of one sink; the others, and the watchdog, continue
            name = receiver.sink.name
            self._notices.say(name, f"replant: {name}: {one_line(error)}; identification continues")
        finally:
            receiver.lock.release()

    def _stamped(self, estimate: EstimateMessage) -> EstimateMessage:
        """Return the estimate with the present time to live, the time of sending and the resulting status."""
        ttl = math.floor(1e3 * self._remaining()) / 1e3
        sent = round(time.time(), 3)
        if ttl > 0.0:
            return replace(estimate, ttl=ttl, sent=sent)
        estimate = replace(estimate, ttl=0.0, sent=sent, excited=False)  # without samples there is no excitation
        if self._ended.is_set():  # the last verdict stays
            return replace(estimate, status=ENDED)
        return replace(estimate, status=WAITING, verdict=UNKNOWN)
