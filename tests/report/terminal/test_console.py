"""What is printed: broken between words, in columns, in colours where they are seen."""

from __future__ import annotations

import io
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from replant.report.terminal.console import Console, Redrawn, Table, Text, cells
from support.cases import every

WORDS = st.lists(st.text("aé温 -", max_size=9), max_size=12).map(" ".join)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def _plain(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("NO_COLOR", "FORCE_COLOR", "COLUMNS", "LINES"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm")


@given(text=WORDS, width=st.integers(2, 30))
def test_broken_lines_fit_and_lose_nothing_but_blanks(text: str, width: int) -> None:
    lines = [str(line) for line in Text(text, (text, "bold")).lines(width)]
    assert all(cells(line) <= width for line in lines)
    assert "".join("".join(lines).split()) == "".join((text + text).split())


@given(text=WORDS, width=st.integers(1, 30))
def test_a_line_that_is_cut_fits_and_says_so(text: str, width: int) -> None:
    (line,) = Text(text, cut=True).lines(width)
    assert cells(str(line)) <= width
    assert str(line) == text.rstrip() or str(line).endswith("…") or cells(text) <= width


def test_words_stay_whole_where_they_fit_into_a_line() -> None:
    lines = [str(line) for line in Text("a fit of 83.0 percent, incomprehensibilities").lines(12)]
    assert lines == ["a fit of", "83.0", "percent,", "incomprehens", "ibilities"]


def test_wide_characters_take_two_columns_and_marks_above_none() -> None:
    assert [cells(text) for text in ("Döner", "Do\u0308ner", "温度")] == [5, 5, 4]


def test_each_part_keeps_its_style_through_a_break() -> None:
    lines = Text("Verdict  ", ("not trusted", "bold red"), ": no").lines(14)
    assert [line.parts for line in lines] == [
        [("Verdict  ", ""), ("not", "bold red")],
        [("trusted", "bold red"), (": no", "")],
    ]


@given(
    rows=st.lists(st.lists(WORDS, min_size=3, max_size=3), max_size=4),
    width=st.integers(12, 60),
    ruled=st.booleans(),
    breaks=st.booleans(),
)
def test_a_table_keeps_within_its_width(rows: list[list[str]], width: int, ruled: bool, breaks: bool) -> None:
    table = Table(gap=2, ruled=ruled)
    for heading in ("name", "value", "of what"):
        table.column(heading, right=heading == "value", breaks=breaks)
    for row in rows:
        table.row(*row)
    lines = [str(line) for line in table.lines(width)]
    assert all(cells(line) <= width for line in lines)
    if breaks:
        assert sorted("".join("".join(lines).replace("─", "").split())) == sorted(
            "".join("".join(("name", "value", "of what", *(cell for row in rows for cell in row))).split())
        )


def test_columns_are_flush_and_rows_below_each_other() -> None:
    table = Table(gap=2)
    table.column("name", right=False)
    table.column("value")
    table.row("a0", "12.5")
    table.row("bias", "3\n4", style="dim")
    assert [str(line) for line in table.lines(80)] == ["name  value", "a0     12.5", "bias      3", "          4"]


@every("environment, coloured", [
    ({}, True), ({"NO_COLOR": "1"}, False), ({"TERM": "dumb"}, False), ({"FORCE_COLOR": "1", "TERM": "dumb"}, True),
])  # fmt: skip
def test_colours_follow_the_terminal(environment: dict[str, str], coloured: bool) -> None:
    with pytest.MonkeyPatch.context() as patch:
        for name, value in environment.items():
            patch.setenv(name, value)
        stream = Terminal()
        Console(stream).print(Text("Verdict ", ("trusted", "bold green")))
    assert stream.getvalue() == ("Verdict \x1b[1;32mtrusted\x1b[0m\n" if coloured else "Verdict trusted\n")


def test_a_pipe_has_no_colours_and_lines_of_80_columns() -> None:
    stream = io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "80")
        Console(stream).print("word " * 40, style="bold", indent=4)
        Console(stream).print("word " * 40, whole=True)
    lines = stream.getvalue().splitlines()
    assert "\x1b" not in stream.getvalue()
    assert [len(line) for line in lines] == [78, 78, 53, 199]
    assert lines[0].startswith("    word")


@every("columns", ["", "x", "-3", "0"])
def test_a_variable_without_a_size_is_not_one(columns: str) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", columns)
        assert Console().width > 0


def test_a_name_moves_no_cursor() -> None:
    assert str(Text("a\x1b[2Jb\rc\x07", ("\x7f", "bold"))) == "a[2Jbc"


def test_lines_are_drawn_in_the_place_of_those_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LINES", "4")
    stream = Terminal()
    drawn = Redrawn(Console(stream))
    drawn.show("one", "two")
    drawn.show("one", "two", "three", "four", "five")
    drawn.clear()
    drawn.clear()
    assert re.split(r"(\x1b\[\d+A)\r\x1b\[J", stream.getvalue()) == [
        "one\ntwo\n", "\x1b[2A", "one\ntwo\nthree\n", "\x1b[3A", "",
    ]  # fmt: skip
