"""The column r on every live source: in lines, objects and packets, through the inbox, from logs and the demo."""

from __future__ import annotations

import json
import socket
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from replant.errors import InvalidArgumentError, LogError
from replant.live.streams import Batch, open_source
from replant.live.streams.addresses import Address
from replant.live.streams.line_parser import MAGIC, Parser
from replant.live.streams.reader_thread import Inbox
from replant.live.streams.serial_and_network import PipeSource
from replant.live.streams.source import Numbering, joined
from support.cases import every
from support.wires import Peer, Reading

U, Y, R = np.array([1.0, 2.0, 3.0]), np.array([0.5, 0.6, 0.7]), np.array([7.0, 8.0, 9.0])
N = np.arange(3)


def batch_of(parser: Parser, lines: str) -> Batch:
    batch = parser.parse(lines.encode(), arrived=0.0)
    assert batch is not None
    return batch


@every("columns", [("u", "y", "r"), ("r", "n", "y", "u"), ("n", "t", "u", "y", "r")])
@every("copies", [1, 20])
def test_lines_whose_columns_are_named(columns: tuple[str, ...], copies: int) -> None:
    """Few lines are parsed one by one, many as a whole."""
    by_name = {"n": N, "t": 0.1 * N, "u": U, "y": Y, "r": R}
    rows = zip(*(by_name[name] for name in columns), strict=True)
    counters: Counter[str] = Counter()
    batch = batch_of(
        Parser(counters, columns), copies * "".join(",".join(map(repr, map(float, row))) + "\n" for row in rows)
    )
    np.testing.assert_array_equal(batch.r, np.tile(R, copies))
    np.testing.assert_array_equal(batch.u, np.tile(U, copies))
    assert counters == {}


def test_lines_without_names_have_none() -> None:
    assert batch_of(Parser(Counter()), "0,1,0.5\n1,1,0.6\n").r is None
    counters: Counter[str] = Counter()
    assert Parser(counters).parse(b"0,0.0,1,0.5,7\n1,0.1,1,0.6,7\n", 0.0) is None
    assert counters == {"too many fields": 2}


@pytest.mark.parametrize("copies", [1, 20])
def test_objects_and_arrays_have_it(copies: int) -> None:
    lines = "".join(json.dumps({"u": u, "r": r, "y": y}) + "\n" for u, y, r in zip(U, Y, R, strict=True))
    np.testing.assert_array_equal(batch_of(Parser(Counter()), copies * lines).r, np.tile(R, copies))
    arrays = json.dumps({"n": 4, "u": U.tolist(), "y": Y.tolist(), "r": [7.0, None, 9.0]}) + "\n"
    batch = batch_of(Parser(Counter()), arrays)
    np.testing.assert_array_equal(batch.r, [7.0, np.nan, 9.0])
    assert batch.sequence is not None
    assert batch.sequence.tolist() == [4, 5, 6]


def test_an_empty_cell_is_nan_and_text_is_refused() -> None:
    counters: Counter[str] = Counter()
    batch = batch_of(Parser(counters, ("u", "y", "r")), "1,2,\n1,2,red\n1,2,3\n1,2\n")
    np.testing.assert_array_equal(batch.r, [np.nan, 3.0])
    assert counters == {"not a number": 1, "fields missing": 1}


@pytest.mark.parametrize("letters", [b"uyr ", b"tuyr", b"nruy"])
def test_packed_payloads_have_it(letters: bytes) -> None:
    by_name = {"n": N, "t": 0.1 * N, "u": U, "y": Y, "r": R}
    table = np.column_stack([by_name[name] for name in letters.decode().strip()])
    batch = Parser(Counter()).payloads([MAGIC + letters + table.astype("<f8").tobytes()], arrived=0.0)
    assert batch is not None
    np.testing.assert_array_equal(batch.r, R)
    bare = Parser(Counter(), ("n", "t", "u", "y", "r"))
    batch = bare.payloads([np.column_stack([N, 0.1 * N, U, Y, R]).astype("<f8").tobytes()], arrived=0.0, bare=True)
    assert batch is not None
    np.testing.assert_array_equal(batch.r, R)


def test_a_batch_keeps_it() -> None:
    batch = Batch(U, Y, None, N, 0.0, R)
    np.testing.assert_array_equal(batch.select(np.array([0, 2])).r, R[[0, 2]])
    np.testing.assert_array_equal(joined([batch, batch]).r, np.tile(R, 2))
    assert joined([Batch(U, Y, None, N, 0.0)] * 2).r is None


def test_through_an_inbox_that_is_full_at_times() -> None:
    inbox, taken = Inbox(4, drop=False), []
    for _ in range(5):
        inbox.put(Batch(U, Y, None, None, 0.0, R))
        while len(inbox):
            taken.append(inbox.get(0.0).r)
    np.testing.assert_array_equal(np.concatenate(taken), np.tile(R, 5))


def test_a_number_that_leaps_keeps_it() -> None:
    numbering, parts = Numbering(Counter(), replays=True), []
    for numbers in ([0, 1, 2], [500, 501, 502]):
        for k, number in enumerate(numbers):
            parts.append(numbering.screen(Batch(U[[k]], Y[[k]], None, np.array([number]), 0.0, R[[k]])).r)
    np.testing.assert_array_equal(np.concatenate(parts), np.tile(R, 2))


def test_a_tcp_source_has_it(peer: Peer, read: Callable[..., Reading]) -> None:
    reading = read(open_source(f"tcp://127.0.0.1:{peer.port}?columns=n,u,y,r"))
    peer.accept().sendall(b"0,1,0.5,7\n1,2,0.6,8\n")
    reading.wait_for(2)
    np.testing.assert_array_equal(reading.column("r"), [7.0, 8.0])


def test_a_udp_source_has_it(read: Callable[..., Reading]) -> None:
    reading = read(source := open_source("udp://127.0.0.1:0?format=doubles&columns=t,u,y,r"))
    packet = np.array([[0.0, 1.0, 0.5, 7.0], [0.1, 2.0, 0.6, 8.0]], "<f8").tobytes()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(packet, ("127.0.0.1", source.port))  # type: ignore[attr-defined]
        reading.wait_for(2)
    np.testing.assert_array_equal(reading.column("r"), [7.0, 8.0])


def test_a_pipe_has_it(tmp_path: Path) -> None:
    path = tmp_path / "lines"
    path.write_text("1,0.5,7\n2,0.6,8\n")
    with path.open("rb") as file:
        batches = list(filter(len, PipeSource(Address("-", ""), ("u", "y", "r"), file=file.fileno()).batches()))
    np.testing.assert_array_equal(np.concatenate([batch.r for batch in batches]), [7.0, 8.0])


@pytest.mark.parametrize("clock", ["", "&dt=0.1", "&time=t"])
def test_a_replayed_log_has_it(tmp_path: Path, clock: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,u,y,w\n0,1,0.5,7\n0.1,2,0.6,\n0.2,3,0.7,9\n")
    (batch,) = filter(len, open_source(f"{path}?reference=w{clock}").batches())
    np.testing.assert_array_equal(batch.r, [7.0, np.nan, 9.0])
    np.testing.assert_array_equal(batch.y, [0.5, 0.6, 0.7])
    (plain,) = filter(len, open_source(str(path)).batches())
    assert plain.r is None
    with pytest.raises(LogError, match="no column 'v'"):
        open_source(f"{path}?reference=v")


@pytest.mark.parametrize("columns", ["r,u", "u,y,r,r", "u,y,x"])
def test_wrong_names_of_columns_are_refused(columns: str) -> None:
    with pytest.raises(InvalidArgumentError, match="may name n, t and r, each once"):
        open_source(f"tcp://127.0.0.1:9?columns={columns}")
