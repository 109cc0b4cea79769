"""Several inputs on every live source: in lines with or without a header, objects and packets, and from logs."""

from __future__ import annotations

import json
import socket
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from replant.errors import InvalidArgumentError, LogError
from replant.live.streams import Batch, Signals, open_source
from replant.live.streams.line_parser import MAGIC, Parser
from replant.live.streams.reader_thread import Inbox
from replant.live.streams.source import Numbering
from support.cases import every
from support.wires import Peer, Reading

HEATERS = Signals(("Q1", "Q2"), "T1")
U, Y = np.array([[1.0, 4.0], [2.0, 5.0], [3.0, 6.0]]), np.array([0.5, 0.6, 0.7])
N = np.arange(3)
BY_NAME = {"n": N, "t": 0.1 * N, "Q1": U[:, 0], "Q2": U[:, 1], "T1": Y, "r": 7.0 + Y}


def read(text: str, columns: tuple[str, ...] | None = None, signals: Signals = HEATERS) -> tuple[Batch, Counter[str]]:
    counters: Counter[str] = Counter()
    batch = Parser(counters, columns, signals).parse(text.encode(), arrived=0.0)
    assert batch is not None
    return batch, counters


def csv(columns: tuple[str, ...], copies: int = 1) -> str:
    rows = zip(*(BY_NAME[name] for name in columns), strict=True)
    return copies * "".join(",".join(map(repr, map(float, row))) + "\n" for row in rows)


@every("columns", [("Q1", "Q2", "T1"), ("t", "Q1", "Q2", "T1"), ("n", "t", "Q1", "Q2", "T1")])
@every("copies", [1, 20])
def test_the_width_tells_the_columns_of_lines_without_a_header(columns: tuple[str, ...], copies: int) -> None:
    batch, counters = read(csv(columns, copies))
    np.testing.assert_array_equal(batch.u, np.tile(U, (copies, 1)))
    np.testing.assert_array_equal(batch.y, np.tile(Y, copies))
    assert (batch.t is None, batch.sequence is None) == ("t" not in columns, "n" not in columns)
    assert counters == {}


@every("copies", [1, 20])
def test_a_header_names_the_columns_in_any_order_and_others_are_left_out(copies: int) -> None:
    columns = ("T1", "r", "Q2", "t", "Q1")
    batch, counters = read(f'time, "Q2",T1 ,room,Q1\n{csv(("t", "Q2", "T1", "n", "Q1"), copies)}')
    np.testing.assert_array_equal(batch.u, np.tile(U, (copies, 1)))
    np.testing.assert_array_equal(batch.t, np.tile(0.1 * N, copies))
    assert (batch.sequence, batch.r, counters) == (None, None, {})
    batch, _ = read(f"{','.join(columns)}\n{csv(columns, copies)}")
    np.testing.assert_array_equal(batch.r, np.tile(7.0 + Y, copies))


@every(("name", "unit"), [("t [ms]", 1e-3), ("time_us", 1e-6), ("timestamp (min)", 60.0), ("Time [s]", 1.0)])
@every("copies", [1, 20])
def test_a_header_may_state_the_unit_of_the_time(name: str, unit: float, copies: int) -> None:
    batch, counters = read(f"{name},Q1,Q2,T1\n{csv(('t', 'Q1', 'Q2', 'T1'), copies)}")
    np.testing.assert_array_equal(batch.t, np.tile(0.1 * N, copies) * unit)
    assert counters == {}


def test_the_unit_of_a_header_is_that_of_its_rows_alone() -> None:
    """Objects have their time in s; a time that leaves float64 is refused."""
    batch, counters = read('t [ms],u,y\n500,1,2\n{"t": 0.75, "u": 3, "y": 4}\n', signals=Signals())
    assert (batch.t.tolist(), batch.u.tolist(), counters) == ([0.5, 0.75], [1.0, 3.0], {})
    batch, counters = read("t [h],u,y\n1e306,1,2\n1,3,4\n", signals=Signals())
    assert (batch.t.tolist(), counters) == ([3600.0], {"time not finite": 1})


@every("rows", ["500,1,2\n", "500,1,2\n1000,1,2\n"])
@every("name", ["time", "t [ms]"])
def test_how_lines_under_other_names_are_read_is_said(name: str, rows: str) -> None:
    counters: Counter[str] = Counter()
    parser = Parser(counters)
    batches = [parser.parse(f"{name},volt,speed\n{rows}".encode(), arrived=0.0), parser.finish(arrived=0.0)]
    batch = next(filter(None, batches))
    unit = 1.0 if name == "time" else 1e-3
    assert (batch.t[0], batch.u[0], batch.y[0]) == (500.0 * unit, 1.0, 2.0)
    assert f"does not name u and y: read t from '{name}', u from 'volt', y from 'speed'" in parser.remark


VOLTAGE = Signals(("voltage",), "speed")


@every(
    ("text", "asked", "message"),
    [
        *(
            (f"{header}\n" + 2 * f"{','.join('1' * len(header.split(',')))}\n", Signals(),
             f"no column '[uy]' in the header; there are: '{header.split(',')[0]}', ")
            for header in ("y,volt", "speed,time,volt", "volt,u", "n,volt,speed")
        ),
        ("time,speed,volt\n0,1,2\n1,1,2\n", VOLTAGE,
         "no column 'voltage' in the header; there are: 'time', 'speed', 'volt';"),
        # who has named the signals is not told to name them
        ("q,T\n1,2\n3,4\n", Signals(("Q",), "T"),
         r"no column 'Q' in the header; .*; correct -i and -o, or the header$"),
    ],
)  # fmt: skip
def test_a_header_that_contradicts_its_rows_or_lacks_what_was_asked_for_is_refused(
    text: str, asked: Signals, message: str
) -> None:
    with pytest.raises(LogError, match=message):
        Parser(Counter(), None, asked).parse(text.encode(), arrived=0.0)


def test_where_the_columns_are_given_a_header_is_not_asked_for_names() -> None:
    batch, _ = read("time,speed,volt\n0,1,2\n1,1,2\n", ("t", "voltage", "speed"), VOLTAGE)
    assert batch.u.tolist() == [1.0, 1.0]


@every("asked", [Signals(), Signals(("Q",), "T")])
@every("text", ["hello,world", "booting firmware,version 2"])
def test_a_greeting_of_the_width_of_the_rows_is_no_header(text: str, asked: Signals) -> None:
    parser = Parser(Counter(), None, asked)
    batch = parser.parse(f"{text}\n1,2\n3,4\n".encode(), arrived=0.0)
    assert (batch.u.tolist(), batch.y.tolist()) == ([1.0, 3.0], [2.0, 4.0])
    assert f"the line '{text}' before the rows names no signal" in parser.remark
    assert "from" not in parser.remark


@every(
    ("header", "read_as"),
    [("Q,T", "uy"), ("T,Q", "uy"), ("time,volt,T", "tuy"), ("T,volt,speed", "tuy"), ("time,T,u,y", "t-uy"),
     ("u [V],y [rpm]", "uy"), ("y [rpm],t [s],u", "ytu"), ("T,u [V],y", "tuy"), ("u,y,T", "uyt")],
)  # fmt: skip
def test_names_are_compared_without_units_and_t_in_capitals_may_be_a_temperature(header: str, read_as: str) -> None:
    parser, row = Parser(Counter()), range(1, len(read_as) + 1)
    batch = parser.parse(2 * f"{header}\n{','.join(map(str, row))}\n".encode(), arrived=0.0)
    value = dict(zip(read_as, row, strict=True))
    assert (batch.u[0], batch.y[0], None if batch.t is None else batch.t[0]) == (value["u"], value["y"], value.get("t"))
    assert parser.remark == "" or not {"u", "y"} <= {title.split()[0] for title in header.split(",")}


@every("text", ["ready", "rig 7, ready", "1,ready", "ready,,", "volt,volt"])
def test_other_text_before_the_rows_is_no_header(text: str) -> None:
    batch, counters = read(f"{text}\n1,2,3,4\n1,2,3,4\n")
    assert (batch.t.tolist(), counters) == ([1.0, 1.0], {"not a number": 1})


@every(
    ("text", "signals", "u", "y", "t"),
    [
        ("time,y\n1,2\n", Signals(("time",), "y"), [1.0], [2.0], None),  # an input may be called time
        ("time,y,t [ms]\n1,2,500\n", Signals(("time",), "y"), [1.0], [2.0], [0.5]),  # beside the time
        ("speed,volt\n3,1\n4,2\n", Signals(("volt",), "speed"), [1.0, 2.0], [3.0, 4.0], None),
        ("t,u,y\n0.5,1,2\n", Signals(), [1.0], [2.0], [0.5]),
        ("t,y,u\n0.5,2,1\n", Signals(), [1.0], [2.0], [0.5]),
        ("y,u,n\n2,1,3\n", Signals(), [1.0], [2.0], None),
        ("u,t,y\n1,0.5,2\n", Signals(), [1.0], [2.0], [0.5]),
        ("u,y,r\n1,2,4\n", Signals(), [1.0], [2.0], None),
    ],
)
def test_one_input_may_stand_anywhere_under_any_name(
    text: str, signals: Signals, u: list[float], y: list[float], t: list[float] | None
) -> None:
    batch, counters = read(text, signals=signals)
    assert (batch.u.tolist(), batch.y.tolist(), counters) == (u, y, {})
    assert (None if batch.t is None else batch.t.tolist()) == t


@every("copies", [1, 20])
def test_objects_and_arrays(copies: int) -> None:
    lines = copies * "".join(json.dumps({"Q2": b, "T1": y, "Q1": a}) + "\n" for (a, b), y in zip(U, Y, strict=True))
    batch, counters = read(lines)
    np.testing.assert_array_equal(batch.u, np.tile(U, (copies, 1)))
    arrays = json.dumps({"n": 4, "Q1": [1, None, 3], "Q2": [4, 5, 6], "T1": Y.tolist()}) + "\n"
    batch, counters = read(copies * arrays)
    np.testing.assert_array_equal(batch.u[:3], [[1.0, 4.0], [np.nan, 5.0], [3.0, 6.0]])
    assert batch.sequence.tolist()[:3] == [4, 5, 6]
    assert counters == {}


def test_faulty_lines_are_counted_and_the_others_used() -> None:
    batch, counters = read("1,4,0.5\n2,5,0.6\n2,0.6\n2,x,0.6\n3,6,0.7\n1,2,3,4,5,6\n")
    np.testing.assert_array_equal(batch.u, U)
    assert counters == {"fields missing": 1, "not a number": 1, "too many fields": 1}
    assert read('{"Q1": 1, "T1": 2}\n{"Q1": 1, "Q2": 2, "T1": 3}\n')[1] == {"fields missing": 1}


def test_packed_payloads_with_letters_as_names_and_without_a_header() -> None:
    table = np.column_stack([U, Y]).astype("<f8").tobytes()
    of_letters = Parser(Counter(), None, Signals(("v", "w"), "y"))
    np.testing.assert_array_equal(of_letters.payloads([MAGIC + b"vwy " + table], 0.0).u, U)
    bare = Parser(Counter(), HEATERS.names, HEATERS)
    np.testing.assert_array_equal(bare.payloads([table], 0.0, bare=True).u, U)


def test_the_inbox_and_the_numbering_keep_rows_together() -> None:
    """Round the end of the ring, and with a sample held back until the next one confirms its number."""
    inbox = Inbox(capacity=4, drop=False)
    for _ in range(5):
        inbox.put(Batch(U, Y, None, None, 0.0))
        taken = [inbox.get(0.0)]
        while sum(map(len, taken)) < 3:
            taken.append(inbox.get(0.0))
        np.testing.assert_array_equal(np.concatenate([batch.u for batch in taken]), U)
    numbering, kept = Numbering(Counter(), replays=False), []
    for k, number in enumerate([1, 500, 501]):
        kept.append(numbering.screen(Batch(U[[k]], Y[[k]], None, np.array([number]), 0.0)).u)
    np.testing.assert_array_equal(np.concatenate(kept), U)


def test_a_peer_whose_columns_the_url_names() -> None:
    peer = Peer()
    reading = Reading(open_source(f"{peer.url}?columns=n,T1,Q2,Q1", HEATERS))
    peer.accept().sendall(csv(("n", "T1", "Q2", "Q1")).encode())
    reading.wait_for(3)
    reading.finish()
    peer.close()
    np.testing.assert_array_equal(reading.column("u"), U)


def test_datagrams_without_a_header() -> None:
    source = open_source("udp://127.0.0.1:0?format=doubles&columns=Q1,Q2,T1", HEATERS)
    reading = Reading(source)
    reading.wait_state("connected")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.sendto(np.column_stack([U, Y]).astype("<f8").tobytes(), ("127.0.0.1", source.port))
        reading.wait_for(3)
    reading.finish()
    np.testing.assert_array_equal(reading.column("u"), U)


@every("named", [True, False])
def test_a_log_is_replayed_by_the_names_of_its_columns(named: bool, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    columns = ("t", "T1", "r", "Q1", "Q2")
    path.write_text(f"{','.join(columns)}\n{csv(columns)}")
    clock = "&time=t" if named else ""
    (batch,) = filter(len, open_source(f"{path}?reference=r{clock}", HEATERS).batches())
    np.testing.assert_array_equal(batch.u, U)
    np.testing.assert_array_equal(batch.y, Y)
    np.testing.assert_array_equal(batch.r, 7.0 + Y)
    np.testing.assert_array_equal(batch.t, 0.1 * N)
    with pytest.raises(InvalidArgumentError, match="name the signals in the address or with -i and -o, not both"):
        open_source(f"{path}?input=Q1", HEATERS)


def test_columns_that_lack_a_signal_are_refused() -> None:
    with pytest.raises(InvalidArgumentError, match=r"columns=t,Q1,T1 must name Q1, Q2 and T1.* columns=n,t,Q1,Q2,T1"):
        open_source("tcp://127.0.0.1:9?columns=t,Q1,T1", HEATERS)
