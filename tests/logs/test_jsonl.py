"""JSON lines: keys are columns."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from replant.errors import LogError
from replant.logs import read_columns, read_log, typed_cells
from support.cases import every

Write = Callable[..., Path]


def lines(*rows: object) -> str:
    return "".join(json.dumps(row) + "\n" for row in rows)


@every("name", ["log.jsonl", "log.NDJSON"])
@every("rows", [1, 3, 1 << 14])
def test_objects_are_rows(write: Write, monkeypatch: pytest.MonkeyPatch, name: str, rows: int) -> None:
    monkeypatch.setattr(typed_cells, "BLOCK_ROWS", rows)
    u = np.random.default_rng(0).standard_normal(20)
    text = lines(*({"t": k / 10, "rig": {"u": u[k]}, "y": k, "state": "RUN", "list": [1]} for k in range(20)))
    path = write(text, name)
    assert read_columns(path).names == ("t", "rig.u", "y", "state")
    log = read_log(path, input="rig.u", output="y")
    assert log.dt == 0.1
    np.testing.assert_array_equal(log.input, u)


def test_null_and_absent_keys_are_missing(write: Write) -> None:
    path = write(lines({"u": 1}, {"u": None, "y": True}, {"y": 2.5}, {"u": -(10**400), "y": False}), "log.jsonl")
    u, y = read_columns(path).columns(["u", "y"])
    np.testing.assert_array_equal(u, [1.0, np.nan, np.nan, -np.inf])
    np.testing.assert_array_equal(y, [np.nan, 1.0, 2.5, 0.0])


def test_dates_are_read_as_seconds(write: Write) -> None:
    path = write(lines(*({"when": f"2024-05-01T10:00:0{k}.5Z", "u": k, "y": 1} for k in range(5))), "log.jsonl")
    assert read_log(path, input="u", output="y").time.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]  # type: ignore[union-attr]


@every(
    ("stamps", "message"),
    [
        (["2024-10-27 02:59:58", "2024-10-27 02:59:59", "2024-10-27 02:00:00"],
         "line 3, column 't': the clock goes back by 3599 s, as at the end of daylight"),
        (["10:00:00", 3], "line 2, column 't': '3' is no date or clock time"),
    ],
    ids=["a shift", "a number among dates"],
)  # fmt: skip
def test_a_clock_that_is_none_is_refused(write: Write, stamps: list[object], message: str) -> None:
    path = write(lines(*({"t": stamp, "u": 1, "y": 1} for stamp in stamps)), "log.jsonl")
    with pytest.raises(LogError, match=message):
        read_log(path, input="u", output="y")


@pytest.mark.parametrize("end", ['{"u": 3, "y"', '{"u": 3, "y": 4', "{"])
def test_a_line_that_was_cut_off_is_left_out(write: Write, end: str) -> None:
    path = write(lines({"u": 1, "y": 2}, {"u": 2, "y": 3}) + end, "log.jsonl")
    with pytest.warns(UserWarning, match=re.escape(f"the last line is cut off ({end!r}) and left out")):
        assert len(read_log(path, input="u", output="y", dt=1)) == 2


def test_a_whole_last_line_needs_no_line_feed(write: Write) -> None:
    table = read_columns(write(lines({"u": 1}) + '{"u": 2}', "log.jsonl"))
    assert (table.notes, table.column("u").tolist()) == ((), [1.0, 2.0])


def test_a_key_that_comes_late_is_not_said_to_be_absent(write: Write) -> None:
    path = write(lines(*[{"u": 1}] * 1000, {"u": 1, "r": 2}), "log.jsonl")
    with pytest.raises(
        LogError, match="no column 'r' in its first 1,000 objects, which name the columns: give it there"
    ):
        read_columns(path).find("r")
    path.write_text(path.read_text().replace('"u": 1', '"u": 1, "r": null', 1))
    assert read_columns(path).column("r")[-1] == 2.0


BAD = {
    "text": (lines({"u": 1, "y": 1}, {"u": "x", "y": 2}), "line 2, column 'u': '\"x\"' is not a number; write numbers"),
    "list": (lines({"u": 1, "y": 1}, {"u": [1], "y": 2}), "line 2, column 'u': '[1]' is not a number"),
    "after a blank line": (lines({"u": 1, "y": 1}) + "\n" + lines({"u": "x"}), "line 3, column 'u'"),
    "no JSON": (lines({"u": 1, "y": 1}) + "u: 1\n", "line 2 is not JSON (Expecting value"),
    "no object": (lines({"u": 1, "y": 1}, [1, 2]), "line 2 is not a JSON object, such as"),
    "one array of all": (json.dumps([{"u": 1}]) + "\n", "line 1 is not a JSON object, such as"),
    "no key": (lines({}, {}), "no object with a key; a log has one object for each sample"),
    "deep": ("[" * 100_000 + "\n", "line 1 is not JSON"),
    "no such column": (lines({"u": 1, "x": 1}, {"u": 1}), "no column 'y'; there are: u, x"),
}


@every(("text", "message"), BAD.values(), ids=BAD)
def test_a_bad_file_is_refused_in_one_line(write: Write, text: str, message: str) -> None:
    path = write(text, "log.jsonl")
    with pytest.raises(LogError, match=re.escape(message)) as caught:
        read_log(path, input="u", output="y", dt=1)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_objects_are_looked_into_as_deep_as_it_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(typed_cells, "DEEPEST", 2)
    row = {"a": {"b": {"x": 1, "c": {"d": 2}}, "y": 3}}
    assert dict(typed_cells._items_of(row)) == {("a", "b", "x"): 1, ("a", "y"): 3}
