"""MQTT with a real broker: all forms of messages, restarts of the broker, no sample used twice."""

from __future__ import annotations

import contextlib
import json
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from replant.live.streams import open_source
from replant.live.streams.line_parser import MAGIC
from support.broker import MOSQUITTO, Broker
from support.cases import every
from support.wires import PATIENCE, Reading, csv, wait_until

mqtt = pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed")
pytestmark = pytest.mark.skipif(MOSQUITTO is None, reason="no mosquitto on the path: install Debian's package")
TOPIC = "rig/1"


class Publisher:
    """A device that publishes and waits until the broker has it."""

    def __init__(self, broker: Broker) -> None:
        self.client: Any = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
        self.client.reconnect_delay_set(0.05, 0.2)
        self.client.connect("127.0.0.1", broker.port)
        self.client.loop_start()

    def send(self, payload: bytes | str, topic: str = TOPIC, *, retain: bool = False) -> None:
        self.client.publish(topic, payload, qos=1, retain=retain).wait_for_publish(PATIENCE)

    def close(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()


class Cable:
    """A line between source and broker that can be cut."""

    def __init__(self, to: int) -> None:
        self._to = to
        self.port = 0
        self._ends: list[socket.socket] = []
        self.mend()

    def mend(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", self.port))
        self.port = self._listener.getsockname()[1]
        self._ends.append(self._listener)
        threading.Thread(target=self._carry, args=[self._listener], daemon=True).start()

    def cut(self) -> None:
        ends, self._ends = self._ends, []
        for end in ends:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
            end.close()

    def _carry(self, listener: socket.socket) -> None:
        with contextlib.suppress(OSError):
            near, _ = listener.accept()
            far = socket.create_connection(("127.0.0.1", self._to))
            self._ends += [near, far]
            threading.Thread(target=self._copy, args=[far, near], daemon=True).start()
            self._copy(near, far)

    def _copy(self, one: socket.socket, other: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := one.recv(1 << 16):
                other.sendall(data)


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    broker = Broker(tmp_path)
    yield broker
    broker.kill()


@pytest.fixture
def publisher(broker: Broker) -> Iterator[Publisher]:
    publisher = Publisher(broker)
    yield publisher
    publisher.close()


def record(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    u, y = np.random.default_rng(11).normal(size=(2, count))
    return np.arange(count), np.arange(count) * 1e-3, u, y


def as_csv(*columns: np.ndarray) -> bytes:
    return csv(*columns)


def as_arrays(*columns: np.ndarray) -> bytes:
    return json.dumps(dict(zip("ntuy", (column.tolist() for column in columns), strict=True))).encode()


def as_objects(*columns: np.ndarray) -> bytes:
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return json.dumps([dict(zip("ntuy", row, strict=True)) for row in rows]).encode()


def packed(*columns: np.ndarray) -> bytes:
    return MAGIC + b"ntuy" + np.column_stack(columns).astype("<f8").tobytes()


@every("form", [as_csv, as_arrays, as_objects, packed])
@every("qos", [0, 1])
def test_ten_samples_a_message_to_the_bit(
    broker: Broker, publisher: Publisher, read: Callable[..., Reading], form: Callable[..., bytes], qos: int
) -> None:
    columns = record(500)
    reading = read(open_source(f"{broker.url}/{TOPIC}?qos={qos}"))
    reading.wait_state("connected")
    for k in range(0, 500, 10):
        publisher.send(form(*(column[k : k + 10] for column in columns)))
    reading.wait_for(500)
    reading.stop()
    for name, expected in zip(("sequence", "t", "u", "y"), columns, strict=True):
        assert np.array_equal(reading.column(name), expected)
    assert reading.source.counters == {}
    assert reading.source.state == "ended"


def test_the_broker_killed_and_started_again(
    broker: Broker, publisher: Publisher, read: Callable[..., Reading]
) -> None:
    """Three times; each time the device repeats its last message, like a device that missed the confirmation."""
    reading = read(open_source(f"{broker.url}/{TOPIC}"))
    reading.wait_state("connected")
    sent: list[int] = []
    for round_ in range(4):
        for n in range(10 * round_, 10 * round_ + 10):
            for again in range(2 if n % 10 == 0 and n else 1):
                publisher.send(json.dumps({"n": n - again, "t": n - again, "u": 1.0, "y": 0.5}))
            sent.append(n)
        reading.wait_for(len(sent))
        if round_ < 3:
            broker.kill()
            reading.wait_state("waiting")
            assert getattr(reading.source, "trouble", "")
            broker.start()
            reading.wait_state("connected")
            wait_until(publisher.client.is_connected, "the device is connected, too")
    reading.wait_counted("duplicate", 3)
    reading.stop()
    assert reading.column("sequence").tolist() == list(range(40))
    counters = dict(reading.source.counters)
    assert counters.pop("duplicate") >= 3  # the broker, too, may send again what it was killed over
    assert counters == {"reconnects": 3}


@pytest.mark.parametrize("qos", [0, 1])
def test_a_short_network_failure_loses_samples_only_with_qos_0(
    broker: Broker, publisher: Publisher, read: Callable[..., Reading], qos: int
) -> None:
    """With qos 1 the broker keeps messages during the failure; with qos 0 the sequence numbers show the gap."""
    cable = Cable(broker.port)
    try:
        reading = read(open_source(f"mqtt://127.0.0.1:{cable.port}/{TOPIC}?qos={qos}"))
        for first in (0, 20):
            reading.wait_state("connected")
            publisher.send(csv(*(column[first : first + 10] for column in record(30))))
            reading.wait_for(20 if first and qos == 0 else first + 10)
            if first == 0:
                cable.cut()
                publisher.send(csv(*(column[10:20] for column in record(30))))
                cable.mend()
                reading.wait_counted("reconnects", 1)
        reading.stop()
    finally:
        cable.cut()
    expected = [*range(10), *range(10 if qos else 20, 30)]
    assert reading.column("sequence").tolist() == expected
    counters = dict(reading.source.counters)
    # what was on its way as the cable was cut may come twice with qos 1; each sample is still used once
    assert not counters.pop("duplicate", 0) or qos == 1
    assert counters == {"reconnects": 1, **({} if qos else {"lost": 10})}


def test_a_broker_that_comes_later_is_waited_for(broker: Broker, read: Callable[..., Reading]) -> None:
    broker.kill()
    reading = read(open_source(f"{broker.url}/{TOPIC}"))
    wait_until(lambda: bool(getattr(reading.source, "trouble", "")), "it was refused")
    assert reading.source.state == "connecting"
    broker.start()
    reading.wait_state("connected")
    reading.stop()
    assert reading.source.counters == {}


def test_what_the_broker_retained_and_noise_are_counted(
    broker: Broker, publisher: Publisher, read: Callable[..., Reading]
) -> None:
    publisher.send("1,2", retain=True)
    reading = read(open_source(f"{broker.url}/rig/+?columns=u,y"))
    reading.wait_counted("retained", 1)
    for payload in (b"\xff\xfe\x00", b"{", b"RPL1", b"5,", b"7" * 1_100_000, b"3,4"):
        publisher.send(payload)
    reading.wait_for(2)
    reading.stop()
    assert reading.column("u").tolist() == [5.0, 3.0]
    expected = {"retained": 1, "not a number": 1, "not JSON": 1, "not packed right": 1, "too long": 1}
    assert reading.source.counters == expected


def test_a_broker_that_refuses_us_says_why(tmp_path: Path, read: Callable[..., Reading]) -> None:
    broker = Broker(tmp_path, settings="allow_anonymous false\n")
    try:
        reading = read(open_source(f"mqtt://lab:wrong@127.0.0.1:{broker.port}/{TOPIC}"))
        wait_until(lambda: "ot authorized" in getattr(reading.source, "trouble", ""), "it was refused")
        assert reading.source.state == "connecting"
        reading.stop()
    finally:
        broker.kill()


def test_closing_lets_go_of_thread_and_socket(broker: Broker) -> None:
    source = open_source(f"{broker.url}/{TOPIC}")
    batches = source.batches()
    wait_until(lambda: not len(next(batches)) and source.state == "connected", "it is connected")
    batches.close()
    assert source.state == "ended"
    assert not [thread for thread in threading.enumerate() if broker.url in thread.name]


def test_a_peer_that_is_not_a_broker_is_tried_again(read: Callable[..., Reading]) -> None:
    """It answers with garbage; the source tries again until it is closed."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(PATIENCE)
        reading = read(open_source(f"mqtt://127.0.0.1:{listener.getsockname()[1]}/{TOPIC}"))
        for _ in range(2):
            connection, _ = listener.accept()
            connection.sendall(struct.pack("<4Q", 1, 2, 3, 2**64 - 1) * 100)
            connection.close()
        reading.stop()
    assert len(reading) == 0
