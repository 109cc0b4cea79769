"""`replant live` measured from outside: throughput over TCP and MQTT, latency over UDP, memory, dashboard open.

    python benchmarks/live.py [--seconds 60] [tcp] [mqtt] [udp] [crowd]

Sender, broker and session share the machine's cores.  The record is periodic, so that a few megabytes of lines can be
sent again and again; its samples carry no numbers then, and the count of samples learned tells whether any was lost.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import re
import select
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from replant.rigs import deap_rig, deap_voltage

PERIOD = 100_000  # samples of the record
MODEL = ("--poles", "3", "--zeros", "1", "--dt", "0.001", "--input-map", "square")
SETTLED = 10.0  # s after which memory has to stand still
MESSAGE = 10  # samples in an MQTT message
MQTT_RATE = 60_000  # samples/s sent over MQTT, where nobody makes the sender wait
UDP_RATE = 1000
CROWD, ROUNDS = 100, 3  # browsers; how often the session is measured without and with them
WARM_UP = 5  # records learned before it is measured


def record() -> tuple[np.ndarray, np.ndarray]:
    """Input and output of the demo's rig in its periodic steady state."""
    rig = deap_rig()
    u = deap_voltage(PERIOD, seed=6)
    return u, rig.measure(np.tile(u, 4))[-PERIOD:]


@dataclass
class Watched:
    """A session under measurement."""

    process: subprocess.Popen[str]
    url: str = ""
    memory: list[tuple[float, float]] = field(default_factory=list)  # s since it began, MB
    frames: int = 0

    def watch(self) -> None:
        """Follow its memory, and look at its dashboard as a browser does, in another process."""
        begun = time.monotonic()
        command = [sys.executable, __file__, "--browse", self.url]
        browser = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        while self.process.poll() is None:
            with contextlib.suppress(OSError, ValueError, IndexError):
                pages = int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1])
                self.memory.append((time.monotonic() - begun, pages * 4096 / 1e6))
            time.sleep(0.5)
        self.frames = int(browser.communicate()[0] or 0)

    def growth(self) -> str:
        """Return what its memory did after it had settled: from the first five seconds to the last five."""
        settled = [size for at, size in self.memory if at > SETTLED]
        if len(settled) < 20:
            return "too short to tell memory"
        first, last = np.median(settled[:10]), np.median(settled[-10:])
        return f"memory {first:.0f} MB after {SETTLED:.0f} s, {last - first:+.1f} MB until the end"


def browse(url: str, clients: int) -> None:
    """Take views as so many pages do until the session ends, and print how many there were."""
    import asyncio

    from websockets.asyncio.client import connect
    from websockets.exceptions import WebSocketException

    frames = 0

    async def page() -> None:
        nonlocal frames
        where, origin = url.replace("http", "ws", 1) + "live", url.rstrip("/")
        with contextlib.suppress(WebSocketException, OSError):
            async with connect(where, origin=origin, max_size=2**24) as views:
                async for _ in views:
                    frames += 1

    async def pages() -> None:
        await asyncio.gather(*(page() for _ in range(clients)))

    asyncio.run(pages())
    print(frames)


@contextlib.contextmanager
def session(*arguments: str, watch: bool = True) -> Iterator[Watched]:
    """Run a session; it is ready for samples at the beginning of the block."""
    command = [sys.executable, "-m", "replant", "live", *arguments, *MODEL, "--dashboard", "127.0.0.1:0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    watched = Watched(process)
    assert process.stderr is not None
    for line in process.stderr:
        found = re.search(r"http://\S+", line)
        if found:
            watched.url = found[0]
            break
    threading.Thread(target=process.stderr.read, daemon=True).start()
    watcher = threading.Thread(target=watched.watch if watch else process.stdout.read)  # type: ignore[union-attr]
    watcher.start()
    try:
        yield watched
    finally:
        process.kill()
        watcher.join()


def learned(watched: Watched) -> tuple[int, str]:
    """Wait for the end; return the samples learned, and what was counted beside them."""
    assert watched.process.stdout is not None
    summary = watched.process.stdout.read()
    watched.process.wait()
    line = summary.splitlines()[1]
    found = re.search(r"([\d,]+) samples(.*)", line)
    assert found is not None, summary
    return int(found[1].replace(",", "")), found[2].strip() or "nothing lost"


def tcp(seconds: float) -> None:
    """As many lines as it takes."""
    u, y = record()
    block = "".join(f"{a:.6g},{b:.6g}\n" for a, b in zip(u.tolist(), y.tolist(), strict=True)).encode()
    with socket.create_server(("127.0.0.1", 0)) as listening:
        with session(f"tcp://127.0.0.1:{listening.getsockname()[1]}") as watched:
            peer, _ = listening.accept()
            begun, sent = time.monotonic(), 0
            while time.monotonic() - begun < seconds:
                peer.sendall(block)
                sent += PERIOD
            peer.shutdown(socket.SHUT_WR)
            elapsed = time.monotonic() - begun
            time.sleep(3.0)  # it learns what is on the way
            watched.process.terminate()
            samples, lost = learned(watched)
            peer.close()
        _report("TCP lines", sent, elapsed, samples, lost, watched)


def mqtt(seconds: float) -> None:
    """Ten samples a message, at a steady rate."""
    from paho.mqtt.client import Client
    from paho.mqtt.enums import CallbackAPIVersion

    u, y = record()
    messages = [
        json.dumps({"u": u[k : k + MESSAGE].round(6).tolist(), "y": y[k : k + MESSAGE].round(6).tolist()}).encode()
        for k in range(0, PERIOD, MESSAGE)
    ]
    with _broker() as port, session(f"mqtt://127.0.0.1:{port}/rig") as watched:
        client = Client(CallbackAPIVersion.VERSION2)
        client.max_queued_messages_set(0)
        client.connect("127.0.0.1", port)
        client.loop_start()
        time.sleep(10.0)  # until the session has subscribed
        begun, sent = time.monotonic(), 0
        while (elapsed := time.monotonic() - begun) < seconds:
            due = int(elapsed * MQTT_RATE / MESSAGE)
            while sent < due:
                client.publish("rig", messages[sent % len(messages)], qos=0)
                sent += 1
            time.sleep(0.002)
        elapsed = time.monotonic() - begun
        time.sleep(3.0)
        watched.process.terminate()
        samples, lost = learned(watched)
        client.disconnect()
        client.loop_stop()
    _report("MQTT JSON", sent * MESSAGE, elapsed, samples, lost, watched)


def crowd(seconds: float) -> None:
    """What a hundred browsers, and one client that sends garbage, cost the session: its own processor time a sample.

    Each in turn, alone and watched, a few times over: where others use the machine, the ratio still tells.
    """
    u, y = record()
    block = "".join(f"{a:.6g},{b:.6g}\n" for a, b in zip(u.tolist(), y.tolist(), strict=True)).encode()
    found: dict[int, list[tuple[float, float]]] = {0: [], CROWD: []}
    for _ in range(ROUNDS):
        for clients, figures in found.items():
            figures.append(_watched_by(clients, block, seconds / (2 * ROUNDS)))
    alone, watched = (np.median(figures, axis=0) for figures in found.values())
    for name, (cost, rate) in (("alone", alone), (f"{CROWD} browsers, and garbage", watched)):
        print(f"{name:<31}{1e6 * cost:.3f} us of the session's processor time a sample; {rate:,.0f} samples/s")
    print(f"{'':<31}processor time {watched[0] / alone[0] - 1.0:+.1%}, samples/s {watched[1] / alone[1] - 1.0:+.1%}")


def _watched_by(clients: int, block: bytes, seconds: float) -> tuple[float, float]:
    """Return the session's processor time a sample and samples/s, while so many clients are there."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        url = f"tcp://127.0.0.1:{listening.getsockname()[1]}"
        with session(url, watch=False) as watched, listening.accept()[0] as peer:
            crowd = [
                subprocess.Popen([sys.executable, __file__, *what, watched.url], stdout=subprocess.DEVNULL)
                for what in (["--browse-by", str(clients), "--browse"], ["--litter"])
                if clients
            ]
            for _ in range(WARM_UP):
                peer.sendall(block)
            time.sleep(5.0 if clients else 0.0)  # until they are there
            begun, spent, sent = time.monotonic(), _processor_time(watched.process.pid), 0
            while (elapsed := time.monotonic() - begun) < seconds:
                peer.sendall(block)
                sent += PERIOD
            spent = _processor_time(watched.process.pid) - spent
            for client in crowd:
                client.kill()
                client.wait()
    return spent / sent, sent / elapsed


def _processor_time(process: int) -> float:
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def litter(url: str) -> None:
    """Send noise, as requests and as websockets, twenty times a second for ever."""
    port, noise = int(url.rstrip("/").rpartition(":")[2]), np.random.default_rng(0).bytes(1 << 16)
    upgrade = f"GET /live HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: {url.rstrip('/')}\r\n".encode() + (
        b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    )
    for k in itertools.count():
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1.0) as wire:
            wire.sendall((upgrade if k % 2 else b"") + noise)
        time.sleep(0.05)


def _report(wire: str, sent: int, elapsed: float, samples: int, lost: str, watched: Watched) -> None:
    print(f"{wire:<15}{sent / elapsed:,.0f} samples/s for {elapsed:.0f} s; sent {sent:,}, learned {samples:,}; {lost}")
    print(f"{'':<15}{watched.growth()}; {watched.frames} messages in a browser")


@contextlib.contextmanager
def _broker() -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    found = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
    assert found, "mosquitto is missing"
    with tempfile.NamedTemporaryFile("w", suffix=".conf") as config:
        config.write(f"listener {port} 127.0.0.1\nallow_anonymous true\nmax_queued_messages 0\n")
        config.flush()
        Path(config.name).chmod(0o644)
        process = subprocess.Popen([found, "-c", config.name], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            time.sleep(1.0)
            yield port
        finally:
            process.kill()
            process.wait()


def udp(seconds: float) -> None:
    """A sample in a datagram at 1 kHz; the estimate that contains it comes back."""
    u, y = record()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire, socket.create_server(("127.0.0.1", 0)) as taken:
        wire.bind(("127.0.0.1", 0))
        wire.setblocking(False)
        port = taken.getsockname()[1]
        sink = f"udp://127.0.0.1:{wire.getsockname()[1]}"
        with session(f"udp://127.0.0.1:{port}?columns=n,t,u,y", "--to", sink) as watched:
            time.sleep(10.0)
            count = int(seconds * UDP_RATE)
            sent, back = np.full(count, np.nan), np.full(count, np.nan)
            begun = time.perf_counter()
            for n in range(count):
                due = begun + n / UDP_RATE
                while (left := due - time.perf_counter()) > 0:
                    if select.select([wire], [], [], left)[0]:
                        _take(wire, back)
                sent[n] = time.perf_counter()
                line = f"{n},{n / UDP_RATE:.6f},{u[n % PERIOD]:.6g},{y[n % PERIOD]:.6g}\n"
                wire.sendto(line.encode(), ("127.0.0.1", port))
            end = time.perf_counter() + 1.0
            while (left := end - time.perf_counter()) > 0:
                if select.select([wire], [], [], left)[0]:
                    _take(wire, back)
            watched.process.terminate()
            samples, lost = learned(watched)
    # an estimate with a later number contains this sample, too
    back = np.minimum.accumulate(np.where(np.isnan(back), np.inf, back)[::-1])[::-1]
    latency = 1e3 * (back - sent)
    late = np.diff(sent, prepend=sent[0])
    solved = int(SETTLED * UDP_RATE)  # until then the record is solved again as a whole, each time it has doubled
    print(
        f"UDP at 1 kHz   median {np.median(latency):.2f} ms, 99 % {np.quantile(latency, 0.99):.2f} ms, "
        f"largest {latency.max():.1f} ms; sent {count:,}, learned {samples:,}; {lost}"
    )
    print(
        f"               from {SETTLED:.0f} s on: median {np.median(latency[solved:]):.2f} ms, "
        f"99 % {np.quantile(latency[solved:], 0.99):.2f} ms, largest {latency[solved:].max():.1f} ms"
    )
    print(
        f"               {watched.growth()}; {watched.frames} messages in a browser; "
        f"sender's own pace: 99 % of intervals under {1e3 * np.quantile(late, 0.99):.2f} ms"
    )


def _take(wire: socket.socket, back: np.ndarray) -> None:
    with contextlib.suppress(BlockingIOError):
        while True:
            number = json.loads(wire.recv(4096))["sequence"]
            if np.isnan(back[number]):
                back[number] = time.perf_counter()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", nargs="*", metavar="tcp|mqtt|udp|crowd")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--browse", metavar="URL", help=argparse.SUPPRESS)
    parser.add_argument("--browse-by", type=int, default=1, help=argparse.SUPPRESS)
    parser.add_argument("--litter", metavar="URL", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.browse:
        browse(arguments.browse, arguments.browse_by)
        return
    if arguments.litter:
        litter(arguments.litter)
    for name in arguments.what or ["tcp", "mqtt", "udp", "crowd"]:
        {"tcp": tcp, "mqtt": mqtt, "udp": udp, "crowd": crowd}[name](arguments.seconds)


if __name__ == "__main__":
    main()
