"""The message that a real broker retains of a session that was killed, ended, stopped or cut off is not trusted."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from replant.live.outputs.message import ENDED, WAITING, EstimateMessage, Notices
from replant.live.outputs.sinks import Publisher, open_sink
from support.broker import MOSQUITTO, Broker
from support.live_command import ReplayingPeer, lines, live, wait_for
from support.live_fakes import DT, record

TOPIC = "rig/1/model"
pytestmark = pytest.mark.skipif(MOSQUITTO is None, reason="no mosquitto: install it to test against a real broker")


class Listener:
    """A controller: keeps the messages, and reconnects by itself."""

    def __init__(self, broker: Broker) -> None:
        mqtt = pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed")
        self.heard: list[dict[str, Any]] = []
        self._client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
        self._client.on_connect = lambda client, *_: client.subscribe(TOPIC, qos=1)
        self._client.on_message = lambda *arguments: self.heard.append(json.loads(arguments[2].payload))
        self._client.reconnect_delay_set(min_delay=1, max_delay=1)
        self._client.connect("127.0.0.1", broker.port)
        self._client.loop_start()

    def until(self, *, trusted: bool) -> dict[str, Any]:
        """Wait until the newest message says so, and return it."""
        found = wait_for(lambda: self.heard and bool(self.heard[-1]["trusted"]) == trusted and self.heard[-1])
        assert isinstance(found, dict)
        return found

    def forget(self) -> None:
        self.heard.clear()

    def publish(self, message: dict[str, Any]) -> None:
        self._client.publish(TOPIC, json.dumps(message), qos=1, retain=True).wait_for_publish(60.0)

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    started = Broker(tmp_path)
    yield started
    started.kill()


@pytest.fixture
def controller(broker: Broker) -> Iterator[Listener]:
    listener = Listener(broker)
    yield listener
    listener.close()


@pytest.fixture
def rig() -> Iterator[ReplayingPeer]:
    """Samples for minutes, about 1000 a second."""
    u, y = record(200_000)
    peer = ReplayingPeer(lines(u, y, DT * np.arange(u.size), first=0), block=20, pause=0.02)
    yield peer
    peer.close()


def retained(broker: Broker) -> dict[str, Any]:
    """Return the retained message that a new subscriber receives."""
    newcomer = Listener(broker)
    wait_for(lambda: newcomer.heard)
    newcomer.close()
    return newcomer.heard[0]


@pytest.mark.parametrize(
    "number",
    [signal.SIGKILL, *(pytest.param(each, marks=pytest.mark.slow) for each in (signal.SIGTERM, signal.SIGINT))],
)
def test_a_session_that_is_over_is_not_trusted(
    broker: Broker, controller: Listener, rig: ReplayingPeer, number: signal.Signals
) -> None:
    with live(rig.url, "--to", f"{broker.url}/{TOPIC}") as process:
        assert controller.until(trusted=True)["ttl"] > 0.0
        process.send_signal(number)
        last = controller.until(trusted=False)
        wait_for(lambda: controller.heard[-1]["status"] == ENDED)
        process.wait(120.0)
    assert last["ttl"] == 0.0
    left = retained(broker)
    assert (left["trusted"], left["excited"], left["ttl"], left["status"]) == (0, 0, 0.0, ENDED)


@pytest.mark.slow
def test_a_session_that_is_stopped_and_a_broker_that_was_away(
    broker: Broker, controller: Listener, rig: ReplayingPeer
) -> None:
    """The will speaks for a process that does not run; it is armed again with each connection."""
    with live(rig.url, "--to", f"{broker.url}/{TOPIC}") as process:
        controller.until(trusted=True)
        process.send_signal(signal.SIGSTOP)
        controller.until(trusted=False)
        process.send_signal(signal.SIGCONT)
        controller.until(trusted=True)
        broker.kill()
        controller.forget()
        broker.start()
        controller.until(trusted=True)
        process.kill()
        assert controller.until(trusted=False)["status"] == ENDED


def test_what_a_dead_session_left_is_replaced_before_the_first_sample(broker: Broker, controller: Listener) -> None:
    """Also by a session that never gets one, and again after the broker has lost everything."""
    controller.publish({"trusted": 1, "status": "running", "verdict": "trusted"})
    controller.until(trusted=True)
    publisher = Publisher(
        [open_sink(f"{broker.url}/{TOPIC}")], None, 5.0, notices=Notices(print), on_reader_gone=lambda: None
    )
    unknown = np.full(2, np.nan)
    publisher.start(EstimateMessage(0.0, None, 0, ("a0", "b0"), unknown, unknown, "starting", "unknown"))
    assert controller.until(trusted=False)["status"] == WAITING
    broker.kill()
    controller.forget()
    broker.start()
    assert controller.until(trusted=False)["status"] == WAITING
    publisher.end()
    assert wait_for(lambda: controller.heard[-1]["status"] == ENDED)
