"""URLs: what is wrong with one is said in one line with the remedy; a password is never shown."""

from __future__ import annotations

import subprocess
import sys

import pytest

from replant.errors import InvalidArgumentError
from replant.live.streams import Source, open_source
from replant.live.streams.addresses import split
from support.cases import every


@every(
    ("url", "message"),
    [
        ("ftp://host/file", "unknown scheme 'ftp'; known are tcp://127.0.0.1:9000, udp://"),
        ("", "the source is missing"),
        ("tcp://127.0.0.1", "the port is missing; write tcp://127.0.0.1:9000"),
        ("tcp://:9000", "the host is missing; write tcp://127.0.0.1:9000"),
        ("tcp://127.0.0.1:port", "the port must be a number from 0 to 65535"),
        ("tcp://127.0.0.1:99999", "the port must be a number from 0 to 65535"),
        ("tcp://[::1", "not a URL"),
        ("tcp://127.0.0.1:9000?colums=u,y", "unknown option 'colums'; known are: columns"),
        ("tcp://127.0.0.1:9000?columns=t,u", "must name u and y"),
        ("tcp://127.0.0.1:9000?columns=u,y,y", "each once"),
        ("tcp://127.0.0.1:9000?columns=u,y,z", "write columns=n,t,u,y"),
        ("udp://127.0.0.1", "the port is missing"),
        ("udp://127.0.0.1:0?format=doubles", "needs columns"),
        ("udp://127.0.0.1:0?format=floats", "format must be one of lines, doubles"),
        ("serial://", "the port is missing; write serial:///dev/ttyUSB0?baud=115200"),
        ("serial:///dev/ttyUSB0?baud=fast", "baud must be a whole number"),
        ("mqtt://127.0.0.1", "the topic is missing; write mqtt://127.0.0.1:1883/rig/1"),
        ("mqtt://127.0.0.1/rig+", "+ stands for a whole level"),
        ("mqtt://127.0.0.1/rig/%23/1", "# for all that follow"),
        ("mqtt:///rig", "the broker is missing"),
        ("mqtt://127.0.0.1/rig?qos=2", "qos must be one of 0, 1"),
        ("nothing-of-the-kind", "no such file"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(url: str, message: str) -> None:
    with pytest.raises(ValueError, match=r"^\S") as caught:
        open_source(url)
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_a_password_is_used_and_never_shown() -> None:
    url = "mqtt://lab:s3cret@10.0.0.7/rig/1"
    address = split(url)
    assert (address.user, address.password, address.port, address.path) == ("lab", "s3cret", None, "rig/1")
    assert "s3cret" not in repr(address)
    assert "s3cret" not in address.name
    pytest.importorskip("paho.mqtt.client")
    assert "s3cret" not in open_source(url).name
    with pytest.raises(InvalidArgumentError) as caught:
        open_source(url + "?qos=7")
    assert "s3cret" not in str(caught.value)


def test_a_closed_standard_input_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(InvalidArgumentError, match="no standard input"):
        open_source("-")


def test_a_source_can_be_closed_before_its_first_sample() -> None:
    source: Source = open_source("tcp://127.0.0.1:9000")
    assert source.state == "connecting"
    assert source.counters == {}
    source.seek(3)
    source.close()


def test_only_what_a_source_needs_is_imported() -> None:
    program = (
        "import sys; from replant.live.streams import open_source; open_source('tcp://127.0.0.1:9000');"
        "print(sorted({'scipy', 'paho', 'serial', 'pyarrow'} & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert run.stdout == "[]\n"
