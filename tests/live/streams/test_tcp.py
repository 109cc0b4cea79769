"""TCP lines: to the bit, across breaks, with back-pressure instead of loss."""

from __future__ import annotations

import signal
import socket
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest

from replant.live.streams import open_source
from replant.live.streams.reader_thread import CAPACITY
from support.wires import PATIENCE, Peer, Reading, csv, wait_until


def samples(count: int, first: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    generator = np.random.default_rng(3)
    u, y = generator.normal(size=(2, first + count))
    n = np.arange(first, first + count)
    return n, n * 1e-3, u[first:], y[first:]


def test_every_sample_comes_to_the_bit_however_the_stream_is_cut(peer: Peer, read: Callable[..., Reading]) -> None:
    n, t, u, y = samples(5000)
    reading = read(open_source(peer.url))
    connection = peer.accept()
    stream = csv(n, t, u, y)
    rest = memoryview(stream)
    for size in np.random.default_rng(4).integers(1, 400, len(stream)).tolist():
        connection.sendall(rest[:size])
        rest = rest[size:]
        if not rest:
            break
    reading.wait_for(5000)
    reading.stop()
    for name, expected in (("sequence", n), ("t", t), ("u", u), ("y", y)):
        assert np.array_equal(reading.column(name), expected)
    assert reading.source.counters == {}
    assert reading.source.state == "ended"
    assert reading.source.name == peer.url


def test_a_break_is_mended_and_the_peer_is_told_where_to_go_on(peer: Peer, read: Callable[..., Reading]) -> None:
    """The second connection begins after the last number; the half line of the first is counted, not used."""
    reading = read(open_source(peer.url))
    lines = csv(*samples(30)).splitlines(keepends=True)
    peer.accept().sendall(b"".join(lines[:10]) + lines[10][:-3])
    reading.wait_for(10)
    connection = peer.accept()
    assert connection.makefile().readline() == "after 9\n"
    connection.sendall(b"".join(lines[10:20]))
    reading.wait_for(20)
    peer.accept().sendall(b"".join(lines))  # this one does not listen: it begins from the start
    reading.wait_for(30)
    reading.stop()
    assert reading.column("sequence").tolist() == list(range(30))
    assert reading.source.counters == {"reconnects": 2, "cut off": 1, "duplicate": 20}


def test_seek_asks_the_peer_and_drops_what_is_there_already(peer: Peer, read: Callable[..., Reading]) -> None:
    source = open_source(peer.url)
    source.seek(3)
    reading = read(source)
    connection = peer.accept()
    assert connection.makefile().readline() == "after 3\n"
    connection.sendall(csv(*samples(10)))
    reading.wait_for(6)
    reading.stop()
    assert reading.column("sequence").tolist() == [4, 5, 6, 7, 8, 9]


def test_without_numbers_nothing_is_sent_to_the_peer(peer: Peer, read: Callable[..., Reading]) -> None:
    reading = read(open_source(peer.url))
    connection = peer.accept()
    connection.sendall(b"1,2\n3,4\n")
    reading.wait_for(2)
    reading.source.close()
    assert connection.recv(100) == b""


def test_a_peer_that_comes_later_is_waited_for(read: Callable[..., Reading]) -> None:
    early = Peer()
    early.close()
    reading = read(open_source(early.url))
    wait_until(lambda: bool(getattr(reading.source, "trouble", "")), "it was refused")
    assert reading.source.state == "connecting"
    late = Peer(early.port)
    try:
        late.accept().sendall(b"1,2\n3,4\n")
        reading.wait_for(2)
        assert reading.source.state == "connected"
        late.hang_up()
        reading.wait_state("waiting")
        reading.stop()
    finally:
        late.close()
    assert reading.source.counters == {}


def test_a_full_queue_makes_the_peer_wait(peer: Peer) -> None:
    """More than queue and sockets hold, to a session that does not take for a while: all arrives, in order."""
    source = open_source(peer.url)
    batches = source.batches()
    next(batches)
    connection = peer.accept()
    count = 4 * CAPACITY
    lines = b"".join(b"%d,0.5,1,2\n" % k for k in range(count))
    sender = threading.Thread(target=connection.sendall, args=[lines], daemon=True)
    sender.start()
    wait_until(lambda: len(source._inbox) == CAPACITY, "the queue is full")
    numbers: list[np.ndarray] = []
    for batch in batches:
        if batch.sequence is not None:
            numbers.append(batch.sequence)
        if sum(map(len, numbers)) == count:
            break
    sender.join(PATIENCE)
    source.close()
    assert not [batch for batch in batches if len(batch)]
    assert np.array_equal(np.concatenate(numbers), np.arange(count))
    assert source.counters == {}


def test_noise_between_good_lines_is_counted(peer: Peer, read: Callable[..., Reading]) -> None:
    reading = read(open_source(peer.url))
    connection = peer.accept()
    connection.sendall(b"0,0.0,1,1\n1,0.1,1,2\n")
    noise = np.random.default_rng(5).integers(128, 256, 4096, dtype=np.uint8).tobytes()
    connection.sendall(noise + b"\nhello\n2,0.2,1\n2,0.2,1,nan\n" + b"3" * 10_000_000 + b"\n3,0.3,1,4\n")
    reading.wait_for(4)
    reading.stop()
    assert reading.column("t").tolist() == [0.0, 0.1, 0.2, 0.3]
    assert np.isnan(reading.column("y")).tolist() == [False, False, True, False]
    assert reading.source.counters == {"not a number": 2, "fields missing": 1, "too long": 1}


def test_an_idle_source_ticks(peer: Peer, read: Callable[..., Reading]) -> None:
    reading = read(open_source(peer.url))
    peer.accept()
    reading.wait_state("connected")
    ticks = reading.ticks
    wait_until(lambda: reading.ticks > ticks + 1, "it ticked")
    assert reading.error is None


def test_closing_before_reading_ends_it_at_once(peer: Peer) -> None:
    source = open_source(peer.url)
    source.close()
    assert not [batch for batch in source.batches() if len(batch)]


def test_closing_from_a_signal_handler(peer: Peer) -> None:
    """The handler runs inside whatever the main thread was doing, locks held or not."""
    source = open_source(peer.url)
    before = signal.signal(signal.SIGALRM, lambda number, frame: source.close())
    try:
        batches = source.batches()
        next(batches)
        connection = peer.accept()
        connection.sendall(b"1,2\n3,4\n5,6\n")
        wait_until(lambda: len(source._inbox) == 3, "the samples came")
        signal.setitimer(signal.ITIMER_REAL, 0.02)
        assert sum(map(len, batches)) == 3
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def test_a_generator_that_is_left_lets_go_of_its_thread_and_socket(peer: Peer) -> None:
    source = open_source(peer.url)
    batches = source.batches()
    next(batches)
    connection = peer.accept()
    batches.close()
    assert connection.recv(1) == b""
    assert source.state == "ended"
    assert not [thread for thread in threading.enumerate() if peer.url in thread.name]


def test_arrival_is_told_by_the_monotonic_clock(peer: Peer, read: Callable[..., Reading]) -> None:
    before = time.monotonic()
    reading = read(open_source(peer.url))
    peer.accept().sendall(b"1,2\n3,4\n")
    reading.wait_for(2)
    assert before <= reading.batches[0].arrived <= time.monotonic()


def test_a_peer_gone_without_a_word_is_noticed(peer: Peer) -> None:
    """Not waited for here, which takes seconds: that the system is asked to look is what can be tested."""
    from replant.live.streams.serial_and_network import enable_keepalive

    with socket.create_connection(("127.0.0.1", peer.port)) as connection:
        enable_keepalive(connection)
        assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)


@pytest.mark.parametrize("known", [True, False])
def test_the_url_may_name_the_columns(peer: Peer, read: Callable[..., Reading], known: bool) -> None:
    reading = read(open_source(peer.url + ("?columns=y,u" if known else "")))
    peer.accept().sendall(b"1,2\n3,4\n")
    reading.wait_for(2)
    assert reading.column("y").tolist() == ([1.0, 3.0] if known else [2.0, 4.0])
