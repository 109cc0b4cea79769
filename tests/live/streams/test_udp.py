"""UDP datagrams with one or many samples: late, repeated and lost ones; a full queue drops the oldest."""

from __future__ import annotations

import struct
from collections.abc import Callable

import numpy as np
import pytest

from replant.errors import InvalidArgumentError
from replant.live.streams import open_source
from replant.live.streams.reader_thread import CAPACITY
from support.cases import every
from support.wires import Device, Reading, csv, opened, wait_until


@every("end", [b"", b"\n", b"\r\n"], quick=1)
@every("together", [1, 7])
def test_datagrams_with_lines_are_read_to_the_bit(read: Callable[..., Reading], end: bytes, together: int) -> None:
    t, u, y = np.random.default_rng(6).normal(size=(3, 210))
    reading = read(opened())
    lines = csv(t, u, y).splitlines()
    with Device(reading.source) as device:
        for k in range(0, len(lines), together):
            device.send(b"\n".join(lines[k : k + together]) + end)
            reading.wait_for(k + together if k else 0)
    reading.wait_for(210)
    reading.stop()
    for name, expected in (("t", t), ("u", u), ("y", y)):
        assert np.array_equal(reading.column(name), expected)
    assert reading.source.counters == {}


def test_late_repeated_and_lost_datagrams(read: Callable[..., Reading]) -> None:
    """One in ten never comes, one in twenty comes twice, some overtake."""
    reading = read(opened())
    generator = np.random.default_rng(7)
    numbers = [n for n in range(1000) if n in (0, 999) or generator.random() > 0.1]
    sent = []
    for n in numbers:
        sent += [n, n] if generator.random() < 0.05 else [n]
    for k in range(10, len(sent) - 10, 50):
        sent[k], sent[k + 1] = sent[k + 1], sent[k]
    expected, last = [], -1
    for n in sent:
        if n > last:
            expected.append(n)
            last = n
    with Device(reading.source) as device:
        for done, n in enumerate(sent):
            device.send(b"%d,%f,1,2" % (n, n / 1000))
            wait_until(lambda done=done: len(reading) + reading.source.counters.get("duplicate", 0) >= done, "it came")
    reading.wait_for(len(expected))
    reading.wait_counted("duplicate", len(sent) - len(expected))
    reading.stop()
    assert reading.column("sequence").tolist() == expected
    assert reading.source.counters == {"duplicate": len(sent) - len(expected), "lost": 1000 - len(expected)}


def test_a_full_queue_drops_the_oldest_and_says_how_many(read: Callable[..., Reading]) -> None:
    source = opened("?columns=n,u,y")
    batches = source.batches()
    next(batches)
    per_datagram, datagrams = 4000, CAPACITY // 4000 + 10
    with Device(source) as device:
        for k in range(datagrams):
            numbers = range(k * per_datagram, (k + 1) * per_datagram)
            device.send(b"\n".join(b"%d,1,2" % n for n in numbers))
            received = min((k + 1) * per_datagram, CAPACITY)
            wait_until(lambda received=received: len(source._inbox) == received, "the datagram is in the queue")
        total = datagrams * per_datagram
        wait_until(lambda: source.counters.get("dropped", 0) == total - CAPACITY, "the rest was dropped")
    source.close()
    numbers = np.concatenate([batch.sequence for batch in batches if batch.sequence is not None])
    assert np.array_equal(numbers, np.arange(total - CAPACITY, total))
    assert source.counters == {"dropped": total - CAPACITY}


def test_a_single_datagram_is_a_sample(read: Callable[..., Reading]) -> None:
    """There is no second datagram to confirm its columns."""
    source = opened()
    reading = read(source)
    with Device(source) as device:
        device.send(b"1,2")
        wait_until(lambda: source._parser._waiting is not None, "it came")
    reading.stop()
    assert reading.column("y").tolist() == [2.0]


def test_a_reset_device_goes_on(read: Callable[..., Reading]) -> None:
    reading = read(opened())
    with Device(reading.source) as device:
        device.send(b"5000,1,0,0\n5001,2,0,0")
        reading.wait_for(2)
        device.send(b"0,0,0,1\n1,1,0,1\n2,2,0,1")
        reading.wait_for(4)
    reading.stop()
    assert reading.column("sequence").tolist() == [5000, 5001, 1, 2]
    assert reading.source.counters == {"duplicate": 1, "restarts": 1}


def test_noise_is_counted(read: Callable[..., Reading]) -> None:
    reading = read(opened("?columns=u,y"))
    with Device(reading.source) as device:
        for payload in (b"", b"\xff\x00\x80", b"1,2,3", b"1", b"{", b"RPL1uy  1234567"):
            device.send(payload)
        device.send(b"1,2")
        reading.wait_for(1)
    reading.stop()
    expected = {"not a number": 1, "too many fields": 1, "fields missing": 1, "not JSON": 1, "not packed right": 1}
    assert reading.source.counters == expected


def test_bare_doubles_are_read_and_other_sizes_counted(read: Callable[..., Reading]) -> None:
    reading = read(opened("?format=doubles&columns=t,u,y"))
    with Device(reading.source) as device:
        device.send(struct.pack("<3d", 0.1, 2.0, 3.0))
        device.send(struct.pack("<6d", 0.2, 4.0, 5.0, 0.3, 6.0, 7.0))
        device.send(b"123")
        reading.wait_for(3)
        reading.wait_counted("not packed right", 1)
        assert reading.source.refused.endswith("not packed right; expected t,u,y, each a float64")
    reading.stop()
    assert reading.column("t").tolist() == [0.1, 0.2, 0.3]
    assert reading.column("y").tolist() == [3.0, 5.0, 7.0]


@pytest.mark.parametrize("where", ["udp://127.0.0.1:{taken}", "udp://192.0.2.1:9000", "udp://nowhere.invalid:9000"])
def test_an_address_that_cannot_be_listened_at(where: str) -> None:
    taken = opened()
    with pytest.raises(InvalidArgumentError, match=r"^udp://\S+: .*; ") as caught:
        open_source(where.format(taken=taken.port))
    assert len(str(caught.value).splitlines()) == 1
    taken.close()
