"""A last line that was cut off is left out, with a note."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

from replant.errors import LogError
from replant.logs import csv as csv_module
from replant.logs import read_columns, read_log
from support.cases import every

Write = Callable[..., Path]
WHOLE = "t,u,y\n0,1.5,2\n1,2.5,3\n2,3.5,4\n"


@every("end", ["3", "3,", "3,4.5", '3,4.5,"2', "3,4.5,-", "3,4.5,2e-"])
@every("line_end", ["\n", "\r\n", "\r"])
@every("encoding", ["utf-8", "utf-8-sig", "utf-16"])
@every("size", [1, 30, 1 << 20])
def test_a_line_that_was_cut_off_is_left_out(
    write: Write, monkeypatch: pytest.MonkeyPatch, end: str, line_end: str, encoding: str, size: int
) -> None:
    monkeypatch.setattr(csv_module, "BLOCK_BYTES", size)
    path = write((WHOLE + end).replace("\n", line_end).encode(encoding))
    with pytest.warns(UserWarning, match="the last line is cut off") as caught:
        log = read_log(path, input="u", output="y")
    assert [str(warning.message) for warning in caught] == [f"{path}: the last line is cut off ({end!r}) and left out"]
    assert log.output.tolist() == [2.0, 3.0, 4.0]


@every("end", ["", "3,4.5,5", "3,4.5,", "# end", "   ", "3,4.5,5\n"])
def test_a_complete_last_line_is_not_cut_off(write: Write, end: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_columns(write(WHOLE + end)).notes == ()


BELOW = {
    "means": ("t,u,y\n", "{0},1,2\n", "\nMean,5,40\n# of all\nStd,2,2\n", "lines 1502 to 1504"),
    "a sum": ("y,u,time\n", "2,1,{0}\n", "5,6,total\n", "line 1501"),
    "of dates": (
        "Date,Time,u,y\n",
        "2024-05-01,10:{1:02}:{2:02},1,2\n",
        "Total rows:,9,,\nMin,,0,1\n",
        "lines 1501 to",
    ),
}


@every(("names", "row", "below", "lines"), BELOW.values(), ids=BELOW)
@every("size", [1, 100, 1 << 20])
@every("encoding", ["utf-8", "utf-16"])
def test_rows_below_the_data_with_a_word_as_their_time_are_left_out(
    write: Write,
    monkeypatch: pytest.MonkeyPatch,
    names: str,
    row: str,
    below: str,
    lines: str,
    size: int,
    encoding: str,
) -> None:
    monkeypatch.setattr(csv_module, "BLOCK_BYTES", size)
    rows = "".join(row.format(k, k // 60, k % 60) for k in range(1499))
    with pytest.warns(UserWarning, match=f"{lines}.* below the data left out"):
        log = read_log(write((names + rows + below).encode(encoding)), input="u", output="y")
    assert log.dt == 1.0
    assert log.output.tolist() == [2.0] * 1499


OF_WORDS = {
    "everywhere": ("u,y,time\n", "{0},2,Mon 10:00\n", ""),
    "beside a clock": ("t,u,y,T\n", "{0},1,2,20.5\n", "{0},1,2,fault\n"),
}


@every(("names", "row", "last"), OF_WORDS.values(), ids=OF_WORDS)
@every("count", [1_000, 20_000])  # within the part of the file that is searched, and beyond it
def test_rows_with_a_word_in_a_column_that_is_no_clock_are_data(
    write: Write, names: str, row: str, last: str, count: int
) -> None:
    rows = [(last if last and k >= count - 100 else row).format(k) for k in range(count)]
    assert len(read_log(write(names + "".join(rows)), input="u", output="y", dt=1.0)) == count


@every(
    ("text", "words"),
    [
        ("t,u,y\n0,1,2\n0,1,2\n1,2,x\n", "is not a number"),
        ("t,u,y\n0,1,2\n0,1,2\nx,1,2\n1,2,3\n", "is not a number"),
        ("t,u,y\na,1,2\nb,2,3\nc,2,3\n", "is not a number"),
        ("t,u,y\n0,1,2\n0,1,2\n1x,2,3\n", "is not a number"),
        (WHOLE + "3,4.5\n", "line 5 has 2 cells where line 1 has 3"),  # it has its end
    ],
)
def test_other_rows_of_text_and_short_lines_stay_errors(write: Write, text: str, words: str) -> None:
    with pytest.raises(LogError, match=words):
        read_log(write(text), input="u", output="y")


def test_the_last_cell_is_cut_off_where_it_cannot_be_read(write: Write) -> None:
    for text in ("t;y\n0;3.000,5\n1;3.001,5\n2;3.0", "t,y\n0,1e-5\n1,1e-5\n2,1e-"):
        with pytest.warns(UserWarning, match="the last line is cut off"):
            assert len(read_log(write(text), input=0, output=1, dt=1.0)) == 2
    assert read_columns(write("u,state\n1,RUN\n2,STOP\n3,ST")).notes == ()  # a column of text
