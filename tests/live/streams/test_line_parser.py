"""Any line gives samples or is counted; numbers are exact to the bit, however blocks are cut."""

from __future__ import annotations

import itertools
import json
import re
import struct
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from replant.live.streams.line_parser import (
    FEW,
    MAGIC,
    Parser,
    table_from_json,
)
from replant.live.streams.reader_thread import LONGEST, LineSplitter
from replant.live.streams.source import Batch
from replant.logs import read_columns
from support.cases import every, examples

ANY = settings(derandomize=True, max_examples=examples(150), deadline=None)
COLUMNS = ("n", "t", "u", "y")


def parse(text: str | bytes, columns: tuple[str, ...] | None = COLUMNS) -> tuple[Batch | None, dict[str, int]]:
    counters: Counter[str] = Counter()
    parser = Parser(counters, columns)
    batch = parser.parse(text.encode() if isinstance(text, str) else text, arrived=3.0)
    return batch, dict(counters)


def bits(values: np.ndarray) -> list[int]:
    return values.view(np.int64).tolist()


def is_line(line: bytes) -> bool:
    return bool(line.decode("ascii", "replace").strip()) and not line.decode("ascii", "replace").lstrip().startswith(
        ("#", "%")
    )


def test_numbers_come_out_to_the_bit_as_a_log_reads_them(tmp_path: Path) -> None:
    """Every digit of every magnitude, in long and short forms; clean blocks and those with a bad line."""
    generator = np.random.default_rng(1)
    raw = generator.integers(0, 2**64, (4000, 2), dtype=np.uint64).view(np.float64)
    u, y = np.where(np.isfinite(raw), raw, 0.5).T
    forms = ["%r", "%.17e", "%.6g", "%.25g"]
    lines = [
        f"{k},{k * 1e-3:.3f},{forms[k % 4] % a},{forms[k % 4] % b}"
        for k, (a, b) in enumerate(zip(u.tolist(), y.tolist(), strict=True))
    ]
    file = tmp_path / "log.csv"
    file.write_text("n,t,u,y\n" + "\n".join(lines) + "\n")
    logged = read_columns(file).columns(["t", "u", "y"])
    clean, counters = parse("\n".join(lines) + "\n")
    spoilt, spoilt_counters = parse("\n".join([*lines[:1234], "1,x,2,3", *lines[1234:]]) + "\n")
    assert counters == {}
    assert spoilt_counters == {"not a number": 1}
    for batch in (clean, spoilt):
        assert batch is not None
        assert batch.t is not None
        assert batch.sequence is not None
        for column, expected in zip((batch.t, batch.u, batch.y), logged, strict=True):
            assert bits(column) == bits(expected)
        assert batch.sequence.tolist() == list(range(4000))
        assert batch.arrived == 3.0


@every(
    ("line", "reason"),
    [
        ("4,0.4,abc,1", "not a number"),
        ("4,0.4,1_0,1", "not a number"),
        ("4,0.4,0x10,1", "not a number"),
        ("4,0.4,1,2e", "not a number"),
        ("4,0.4,1", "fields missing"),
        ("4", "fields missing"),
        ("4,0.4,1,2,", "too many fields"),
        ("4,0.4,1,2,3", "too many fields"),
        ("4,nan,1,2", "time not finite"),
        ("4,inf,1,2", "time not finite"),
        ("4,,1,2", "time not finite"),
        ("4,1715680000000,1,2", "time beyond the year 5000"),
        ("4.5,0.4,1,2", "not a sequence number"),
        ("-4,0.4,1,2", "not a sequence number"),
        ("nan,0.4,1,2", "not a sequence number"),
        ("1e300,0.4,1,2", "not a sequence number"),
        ("\xff\xfe\x00\x01", "not a number"),
        ("\x00,\x00,\x00,\x00", "not a number"),
        ('{"n": 4, "t": 0.4, "u": 1', "not JSON"),
        ('{"n": 4, "t": 0.4, "u": 1}', "fields missing"),
        ('{"n": 4, "u": 1, "y": 2}', "fields missing"),
        ('{"n": 4, "t": 0.4, "u": "1", "y": 2}', "not a number"),
        ('{"n": 4, "t": 0.4, "u": true, "y": 2}', "not a number"),
        ('{"n": 4, "t": null, "u": 1, "y": 2}', "not a number"),
        ('{"n": 4, "t": NaN, "u": 1, "y": 2}', "time not finite"),
        ('{"n": 4, "t": 0.4, "u": 1' + "0" * 400 + ', "y": 2}', "not a number"),
        ('{"n": 4, "t": 0.4, "u": [1, 2], "y": [2, 3]}', "arrays of different lengths"),
        ('{"n": 4, "t": [0.4, 0.5], "u": [1, 2], "y": [2]}', "arrays of different lengths"),
        ("[1, 2, 3]", "not an object"),
        ("[" * 60000, "not JSON"),
    ],
)
@every("around", [1, 3 * FEW])
def test_a_line_that_is_off_is_counted_and_its_neighbours_are_kept(line: str, reason: str, around: int) -> None:
    before = [f"{k},{k / 10},{k},{k}" for k in range(around)]
    after = [f"{k},{k / 10},{k},{k}" for k in range(1000, 1000 + around)]
    batch, counters = parse("\n".join([*before, line, *after]).encode("latin-1") + b"\n")
    assert batch is not None
    assert batch.sequence is not None
    assert batch.sequence.tolist() == [*range(around), *range(1000, 1000 + around)]
    assert counters == {reason: 1}


@every(
    ("lines", "words"),
    [
        (
            "1715680000000,1,2\n1715680000010,1,2\n",
            "milliseconds since 1970, from 2024-05-14 on; write seconds, or first",
        ),
        ("1715680000000000,1,2\n1715680000010000,1,2\n", r"microseconds since 1970.* with t \[us\]"),
        ('{"t": 1715680000000, "u": 1, "y": 2}\n', "milliseconds since 1970"),
        ("2026-05-01T10:00:00.01Z,1,2\n" * 2, "dates and clock times are not read: write t in seconds"),
        ("10:00:00.01,1,2\n" * 2, "dates and clock times are not read: write t in seconds"),
    ],
)
def test_stamps_of_another_kind_are_told_apart(lines: str, words: str) -> None:
    counters: Counter[str] = Counter()
    parser = Parser(counters)
    batch = parser.parse(lines.encode(), 0.0)
    assert batch is None or not len(batch)
    assert sum(counters.values()) == lines.count("\n")
    assert re.search(words, parser.refused), parser.refused


@every("text", ["nan", "NaN", "inf", "-Infinity", "", " ", "NA", "null"])
def test_a_value_that_the_device_could_not_read_is_a_sample_that_is_not_finite(text: str) -> None:
    """It keeps its place in time, and the identifier counts it; as in a log, a missing cell is NaN."""
    batch, counters = parse(f"1,0.1,2,{text}\n")
    assert batch is not None
    assert not np.isfinite(batch.y[0])
    assert batch.u[0] == 2.0
    assert counters == {}


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_blank_lines_and_comments_are_no_lines(end: str) -> None:
    lines = [
        "# ready",
        "",
        *(f"{k},0.{k},1,{k}" for k in range(9)),
        "  ",
        "% done",
        *(f"{k},{k},1,{k}" for k in range(9, 40)),
    ]
    batch, counters = parse(end.join(lines) + end)
    assert batch is not None
    assert batch.y.tolist() == list(range(40))
    assert counters == {}


def test_columns_may_be_in_any_order() -> None:
    batch, _ = parse("5,1,7\n6,2,8\n", ("y", "u", "n"))
    assert batch is not None
    assert batch.t is None
    assert batch.sequence is not None
    assert (batch.y.tolist(), batch.u.tolist(), batch.sequence.tolist()) == ([5, 6], [1, 2], [7, 8])


@pytest.mark.parametrize(("width", "timed", "numbered"), [(2, False, False), (3, True, False), (4, True, True)])
def test_the_width_of_the_lines_tells_the_columns(width: int, timed: bool, numbered: bool) -> None:
    lines = "".join(",".join(str(10 * k + j) for j in range(width)) + "\n" for k in range(5))
    batch, counters = parse(lines, None)
    assert batch is not None
    assert (batch.t is not None, batch.sequence is not None) == (timed, numbered)
    assert batch.y.tolist() == [10 * k + width - 1 for k in range(5)]
    assert counters == {}


@every(
    ("text", "t", "y"),
    [
        ("5,1\n0.6,1,0.1\n0.7,1,0.2\n", [0.6, 0.7], [0.1, 0.2]),
        ('3,4\n{"n": 1, "u": 1, "y": 2}\n{"n": 2, "u": 1, "y": 3}\n', None, [2.0, 3.0]),
    ],
    ids=["of three columns", "before JSON"],
)
def test_half_a_first_line_does_not_decide_the_columns(text: str, t: list[float] | None, y: list[float]) -> None:
    """Whoever listens in begins in the middle of a line."""
    batch, counters = parse(text, None)
    assert batch is not None
    assert (None if batch.t is None else batch.t.tolist()) == t
    assert batch.y.tolist() == y
    assert counters == {"fields missing": 1}


def test_a_single_line_is_a_sample_at_the_end() -> None:
    parser = Parser(Counter())
    assert parser.parse(b"1,2\n", 0.0) is None
    batch = parser.finish(5.0)
    assert batch is not None
    assert (batch.u.tolist(), batch.y.tolist(), batch.arrived) == ([1.0], [2.0], 5.0)
    assert parser.finish(6.0) is None


def test_json_lines_equal_csv_to_the_bit() -> None:
    generator = np.random.default_rng(2)
    t, u, y = generator.normal(size=(3, 100))
    one = [json.dumps({"n": k, "t": t[k], "u": u[k], "y": y[k]}) for k in range(100)]
    arrays = [
        json.dumps({"n": k, "t": t[k : k + 10].tolist(), "u": u[k : k + 10].tolist(), "y": y[k : k + 10].tolist()})
        for k in range(0, 100, 10)
    ]
    objects = ["[" + ",".join(one[k : k + 25]) + "]" for k in range(0, 100, 25)]
    for lines in (one, arrays, objects):
        batch, counters = parse("\n".join(lines) + "\n", None)
        assert batch is not None
        assert batch.t is not None
        assert batch.sequence is not None
        assert (bits(batch.t), bits(batch.u), bits(batch.y)) == (bits(t), bits(u), bits(y))
        assert batch.sequence.tolist() == list(range(100))
        assert counters == {}


ODD_JSON = [
    '{"u": 1',
    '"y": 2}',
    '{"u": 1, "y": 2}, {"u": 3, "y": 4}',
    '{"u": 1, "y": 2}, null, {"u": 3, "y": 4}',
    '{"u": [1',
    '2], "y": [1, 2]}',
    '{"u": [1, 2], "y": [3, 4]}',
    '[{"u": 1, "y": 2}]',
    '{"u": true, "y": 2}',
    '{"u": "1", "y": 2}',
    '{"u": null, "y": 2}',
    '{"u": 1}',
    '{"u": 1e999, "y": -Infinity}',
    '{"u": 1' + "0" * 400 + ', "y": 2}',
    "null",
    "[]",
    "3",
    "5,6",
    "",
    "# comment",
    "[" * 2000,
]


@ANY
@given(st.lists(st.tuples(st.integers(0, 60), st.sampled_from(ODD_JSON)), max_size=4))
def test_json_read_at_once_equals_json_read_line_by_line(odd: list[tuple[int, str]]) -> None:
    lines = [json.dumps({"y": k / 7, "x": "text", "u": k}) for k in range(60)]
    for place, line in odd:
        lines.insert(place, line)
    whole, counters = parse("\n".join(lines) + "\n", ("u", "y"))
    one_by_one: Counter[str] = Counter()
    parser = Parser(one_by_one, ("u", "y"))
    batches = [batch for line in lines if (batch := parser.parse(line.encode(), 0.0)) is not None]
    assert whole is not None
    assert bits(whole.u) == bits(np.concatenate([batch.u for batch in batches]))
    assert bits(whole.y) == bits(np.concatenate([batch.y for batch in batches]))
    assert counters == one_by_one


def test_json_null_is_missing() -> None:
    batch, _ = parse('{"u": 1, "y": null}\n{"u": null, "y": 2}\n', None)
    assert batch is not None
    assert np.isnan([batch.y[0], batch.u[1]]).all()
    assert (batch.u[0], batch.y[1]) == (1.0, 2.0)


NUMBERS = st.sampled_from(["0", "1", "2.5", "-3e2", "+4.", ".5", "nan", "inf", "1e999", "1e-999", "007"])
PIECES = st.sampled_from(
    [
        ",",
        ",",
        "\n",
        "\n",
        "\r\n",
        "\r",
        " ",
        "\t",
        "x",
        "_",
        "#",
        "{",
        "}",
        "[",
        "]",
        '"u":',
        '"y":',
        "\x00",
        "\x0b",
        "\x1c",
        "\xa0",
        "\xb2",
        "\x85",
        "1d5",
        "infinity",
        "(1)",
        "1j",
        "'",
        '"',
    ]
)


def check(content: bytes, columns: tuple[str, ...] | None) -> None:
    """Check that whole, in two blocks and line by line, samples and counts are equal, and their sum is right."""
    results = []
    lines = content.split(b"\n")
    half = b"\n".join(lines[: len(lines) // 2]) + b"\n", b"\n".join(lines[len(lines) // 2 :])
    for blocks in ([content], half, [line + b"\n" for line in lines]):
        counters: Counter[str] = Counter()
        parser = Parser(counters, columns)
        batches = [*(parser.parse(block, 0.0) for block in blocks), parser.finish(0.0)]
        tables = [np.stack([batch.u, batch.y]) for batch in batches if batch is not None]
        samples = np.concatenate(tables, axis=1) if tables else np.empty((2, 0))
        results.append((samples.astype(np.float64).view(np.int64).tolist(), dict(counters)))
        if b"{" not in content and b"[" not in content:
            assert samples.shape[1] + sum(counters.values()) == sum(map(is_line, lines))
    assert results[0] == results[1] == results[2]


@ANY
@given(st.lists(NUMBERS | PIECES, max_size=80).map(lambda parts: "".join(parts).encode("latin-1")), st.booleans())
def test_any_text_adds_up_however_it_is_cut(content: bytes, known: bool) -> None:
    check(content, ("t", "u", "y") if known else None)


@ANY
@given(
    st.lists(st.lists(NUMBERS, min_size=2, max_size=4), max_size=60),
    st.lists(st.tuples(st.integers(0, 10**6), PIECES), max_size=3),
)
def test_grids_with_a_few_faults_add_up(rows: list[list[str]], faults: list[tuple[int, str]]) -> None:
    content = "\n".join(map(",".join, rows))
    for place, piece in faults:
        at = place % (len(content) + 1)
        content = content[:at] + piece + content[at:]
    check(content.encode("latin-1"), ("t", "u", "y"))


@ANY
@given(st.binary(max_size=400))
def test_any_bytes_add_up(content: bytes) -> None:
    check(content, None)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["n", "t", "u", "y", "x"]), inner, max_size=5)
    ),
    max_leaves=12,
)


@ANY
@given(st.lists(JSON, max_size=5))
def test_any_json_is_samples_or_counted(values: list[object]) -> None:
    counters: Counter[str] = Counter()
    batch = Parser(counters).parse("".join(json.dumps(value) + "\n" for value in values).encode(), 0.0)
    if batch is not None:
        assert batch.u.dtype == batch.y.dtype == np.float64
        assert batch.u.shape == batch.y.shape
    assert sum(counters.values()) >= sum(not isinstance(value, dict | list | int | float) for value in values)


@ANY
@given(st.lists(st.binary(max_size=60), max_size=6), st.booleans())
def test_any_payload_is_samples_or_counted(payloads: list[bytes], bare: bool) -> None:
    counters: Counter[str] = Counter()
    parser = Parser(counters, ("u", "y"))
    for prefix in (b"", MAGIC, MAGIC + b"ntuy", MAGIC + b"uy  "):
        batch = parser.payloads([prefix + payload for payload in payloads], 0.0, bare=bare)
        assert batch is None or batch.u.shape == batch.y.shape


def test_packed_payloads_are_read_and_faulty_ones_counted() -> None:
    counters: Counter[str] = Counter()
    rows = [(7.0, 0.7, 1.0, 0.25), (8.0, 0.8, 2.0, 0.5)]
    packed = MAGIC + b"ntuy" + b"".join(struct.pack("<4d", *row) for row in rows)
    payloads = [packed, packed[:-1], MAGIC + b"uy  " + packed[8:24], MAGIC + b"uyuy", b"9,0.9,3,1\n"]
    batch = Parser(counters).payloads(payloads, 0.0)
    assert batch is not None
    assert batch.sequence is not None
    assert (batch.sequence.tolist(), batch.y.tolist()) == ([7, 8, 9], [0.25, 0.5, 1.0])
    assert counters == {"not packed right": 2, "fields missing": 1}


def test_bare_doubles_in_the_order_of_the_columns() -> None:
    counters: Counter[str] = Counter()
    payloads = [struct.pack("<4d", 1, 2, 3, 4), b"1,2\n", struct.pack("<2d", 5, np.nan)]
    batch = Parser(counters, ("y", "u")).payloads(payloads, 0.0, bare=True)
    assert batch is not None
    assert batch.y.tolist() == [1.0, 3.0, 5.0]
    assert batch.u.tolist()[:2] == [2.0, 4.0]
    assert counters == {"not packed right": 1}


@ANY
@given(
    st.lists(st.sampled_from([b"\n", b"1", b"22", b"333", b"\r", b"4444"]), max_size=60).map(b"".join),
    st.lists(st.integers(0, 100), max_size=8),
)
def test_lines_are_the_same_however_the_stream_is_cut(content: bytes, cuts: list[int]) -> None:
    """So are those that are too long: they are passed over and counted."""
    places = [0, *sorted(min(cut, len(content)) for cut in cuts), len(content)]
    counters: Counter[str] = Counter()
    lines = LineSplitter(counters, longest=7)
    out = b"".join(lines.split(content[a:b]) for a, b in itertools.pairwise(places)) + lines.rest()
    *whole, tail = content.split(b"\n")
    expected = [*whole, *([tail] if tail.strip() else [])]
    assert out == b"".join(line + b"\n" for line in expected if len(line) <= 7)
    assert counters["too long"] == sum(len(line) > 7 for line in [*whole, tail])


def test_a_line_of_ten_megabytes_is_counted_once_and_takes_no_memory() -> None:
    counters: Counter[str] = Counter()
    lines = LineSplitter(counters)
    out = lines.split(b"1,2\n")
    for _ in range(160):
        out += lines.split(b"7" * LONGEST)
        assert len(lines._tail) <= LONGEST
    out += lines.split(b"7\n3,4\n5,")
    assert out == b"1,2\n3,4\n"
    assert counters == {"too long": 1}
    assert lines.split(b"6\n") == b"5,6\n"


def test_half_a_line_before_a_break_is_never_joined_to_what_comes_after() -> None:
    counters: Counter[str] = Counter()
    lines = LineSplitter(counters)
    assert lines.split(b"1,2\n3,4") == b"1,2\n"
    lines.restart()
    assert lines.split(b"5\n6,7\n") == b"5\n6,7\n"
    lines.restart_midway()
    assert lines.split(b"99,8\n8,9\n") == b"8,9\n"
    assert counters == {"cut off": 2}


def test_lines_of_whole_and_other_numbers_are_a_table_and_of_anything_else_none() -> None:
    mixed, odd = ['{"u": 1, "y": 2.5}', '{"y": 3, "u": 4.0}'], ['{"u": 1, "y": true}']
    np.testing.assert_array_equal(table_from_json(mixed, ("u", "y")), [[1.0, 2.5], [4.0, 3.0]])
    assert table_from_json(odd, ("u", "y")) is None
    assert table_from_json(['{"u": 1', '"y": 2}'], ("u", "y")) is None
    assert table_from_json(['{"u": 1, "y": 2},null,{"u": 3, "y": 4}'], ("u", "y")) is None


@pytest.mark.parametrize(
    ("line", "written"),
    [
        ("-0,61;-0,01", "-0.61,-0.01"), ("1;2;3", "1,2,3"), ("0.5 1e-3", "0.5,1e-3"), ("0.5\t2", "0.5,2"),
        ("1700000000123 1 2", "1700000000123,1,2"), ("u;y", None), ("1,2;", None), ("nan;2", None),
    ],
)  # fmt: skip
def test_numbers_with_other_separators_are_shown_as_they_are_to_be_written(line: str, written: str | None) -> None:
    parser = Parser(Counter(), None)
    parser.parse(f"{line}\n".encode(), arrived=0.0)
    assert parser.refused.endswith("not a number" if written is None else f"separate numbers by commas: {written}")
