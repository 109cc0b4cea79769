"""What the pages say about wiring a rig works as it stands: the sketch, the Simulink block, the MQTT script."""

from __future__ import annotations

import re
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.state import REASONS
from replant.live.streams import open_source
from replant.live.streams.addresses import SCHEMES
from support.boards import Board
from support.broker import MOSQUITTO, Broker
from support.places import ROOT
from support.wires import Device, Reading, opened

PAGE = (ROOT / "docs" / "live.md").read_text(encoding="utf-8")
HOW_TO = ROOT / "docs" / "how-to"
BOARD = Path(__file__).parent / "arduino"


def block(language: str, page: str) -> str:
    """The first block of code in this language on a page."""
    found = re.search(rf"```{language}\n(.*?)```", (HOW_TO / page).read_text(encoding="utf-8"), re.DOTALL)
    assert found
    return found[1]


def first_order(reading: Reading, dt: float) -> tuple[float, float]:
    """Gain and time constant of what a source read."""
    ident = rp.Identifier(rp.Structure(1), dt, preprocess=rp.Preprocess("identity", "mean", "mean"))
    ident.update_many(reading.column("u"), reading.column("y"), reading.column("t"))
    b0, a0 = ident.transfer_function.num[-1], ident.transfer_function.den[-1]
    return b0 / a0, 1.0 / a0


@pytest.mark.slow
def test_the_arduino_sketch(tmp_path: Path, read: Callable[..., Reading]) -> None:
    """Compiled with a plant between its pins, and a clock that wraps; its lines go through a pseudo-terminal."""
    compiler = shutil.which("g++") or shutil.which("c++")
    if compiler is None:
        pytest.skip("no C++ compiler to compile the sketch with")
    pytest.importorskip("serial", reason="pyserial is not installed")
    pytest.importorskip("pty", reason="this system has no pseudo-terminals")
    sketch, program = tmp_path / "sketch.cpp", tmp_path / "sketch"
    sketch.write_text('#include <cstdint>\n#include "Arduino.h"\n' + block("cpp", "arduino.md"))
    subprocess.run([compiler, "-Wall", "-Werror", f"-I{BOARD}", "-o", str(program), str(sketch)], check=True)
    lines = subprocess.run([str(program), "4000"], capture_output=True, check=True).stdout

    wire = Board(tmp_path / "ttyUSB0")
    reading = read(open_source(wire.url))
    wire.send(b"\n" + lines)
    reading.wait_for(4000)
    reading.stop()
    wire.pull_out()
    numbers, t = reading.column("sequence"), reading.column("t")
    assert np.allclose(t, numbers * 0.005, rtol=0.0, atol=1e-9)
    assert reading.source.counters == {"lost": int(numbers[-1]) + 1 - 4000}
    assert reading.source.counters["lost"] > 0  # the board was held up seven times
    gain, time_constant = first_order(reading, 0.005)
    assert gain == pytest.approx(4.0, rel=0.02)  # pulses of 0..255 to counts of 0..1023, read to whole counts
    assert time_constant == pytest.approx(0.3, rel=0.02)


def test_the_sketch_is_thirty_lines() -> None:
    assert len([line for line in block("cpp", "arduino.md").splitlines() if line]) <= 30


def test_the_simulink_block(read: Callable[..., Reading]) -> None:
    """Byte Pack of three doubles with alignment 1, as UDP Send puts it on the wire."""
    (url,) = re.findall(r'replant live "(udp://[^"]*)"', (HOW_TO / "simulink.md").read_text(encoding="utf-8"))
    reading = read(opened("?" + url.partition("?")[2]))
    expected = np.random.default_rng(12).normal(size=(50, 3))
    with Device(reading.source) as model:
        for t, u, y in expected.tolist():
            model.send(struct.pack("<ddd", t, u, y))
    reading.wait_for(50)
    reading.stop()
    assert np.array_equal(np.column_stack([reading.column(name) for name in "tuy"]), expected)


@pytest.mark.skipif(MOSQUITTO is None, reason="no mosquitto on the path: install Debian's package")
def test_the_mqtt_script(tmp_path: Path, read: Callable[..., Reading]) -> None:
    pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed")
    (url,) = re.findall(r"replant live (mqtt://\S+)", (HOW_TO / "broker.md").read_text(encoding="utf-8"))
    broker = Broker(tmp_path)
    try:
        reading = read(open_source(url.replace("1883", str(broker.port))))
        reading.wait_state("connected")
        script = block("python", "broker.md").replace("1883", str(broker.port))
        subprocess.run([sys.executable, "-W", "error", "-c", script], check=True)
        reading.wait_for(1000)
        reading.stop()
    finally:
        broker.kill()
    assert reading.column("sequence").tolist() == list(range(1000))
    assert reading.source.counters == {}
    gain, time_constant = first_order(reading, 1e-3)
    assert gain == pytest.approx(2.0, rel=1e-3)
    assert time_constant == pytest.approx(-1e-3 / np.log(0.99), rel=1e-3)


def test_every_kind_of_url_is_on_the_page() -> None:
    for _, example in SCHEMES.values():
        assert f"`{example}`" in PAGE


def test_the_reasons_on_the_page_are_those_that_are_counted() -> None:
    """Each reason that the page quotes stands in the sources' code, or is one of the identifier's."""
    code = "".join(path.read_text() for path in Path(rp.__file__).parent.joinpath("live", "streams").glob("*.py"))
    code += "".join(f'"{reason}"' for reason in REASONS)
    table = PAGE.partition("## Faults of the connection")[2].partition("\n## ")[0]
    quoted = set(re.findall(r'"([^"]+)"', table))
    assert {"duplicate", "lost", "too long", "cut off"} <= quoted
    assert {reason for reason in quoted if f'"{reason}"' not in code} == set()
