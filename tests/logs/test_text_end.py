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


def test_a_short_line_that_has_its_end_is_refused(write: Write) -> None:
    with pytest.raises(LogError, match="line 5 has 2 cells where line 1 has 3"):
        read_columns(write(WHOLE + "3,4.5\n")).column("u")


def test_the_last_cell_is_cut_off_where_it_cannot_be_read(write: Write) -> None:
    for text in ("t;y\n0;3.000,5\n1;3.001,5\n2;3.0", "t,y\n0,1e-5\n1,1e-5\n2,1e-"):
        with pytest.warns(UserWarning, match="the last line is cut off"):
            assert len(read_log(write(text), input=0, output=1, dt=1.0)) == 2
    assert read_columns(write("u,state\n1,RUN\n2,STOP\n3,ST")).notes == ()  # a column of text
