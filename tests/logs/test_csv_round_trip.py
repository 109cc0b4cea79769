"""Any table of numbers, written in any of the usual ways, is read back to the bit."""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from replant.logs import read_columns
from support.cases import examples

NAME = st.from_regex(r"[A-Za-z][A-Za-z0-9]{0,5}( \[[a-zA-Z/]{1,3}\])?", fullmatch=True).filter(
    lambda name: name.lower() not in {"na", "nan", "none", "null", "inf", "infinity"}
)
NUMBER = st.floats(width=64) | st.integers(-1000, 1000).map(float) | st.just(math.nan)


@dataclass(frozen=True)
class Text:
    names: list[str] | None
    rows: list[list[float]]
    delimiter: str
    decimal: str
    newline: str
    comments: list[int]  # before which rows a comment and a blank line stand
    trailing: bool

    def write(self, path: Path) -> None:
        end = self.delimiter + self.newline if self.trailing else self.newline
        lines = [self.delimiter.join(self.names) + end] if self.names else []
        for number, row in enumerate(self.rows):
            if number in self.comments:
                lines.append(f"# {number}: {self.delimiter} note{self.newline}{self.newline}")
            lines.append(self.delimiter.join(repr(x).replace(".", self.decimal) for x in row) + end)
        path.write_bytes("".join(lines).encode())


@st.composite
def texts(draw: st.DrawFn) -> Text:
    width = draw(st.integers(2, 5))
    delimiter = draw(st.sampled_from([",", ";", "\t", "|", " ", "  ", " \t ", ", ", " ; "]))
    names = draw(st.none() | st.lists(NAME, min_size=width, max_size=width, unique_by=str.casefold))
    rows = draw(st.lists(st.lists(NUMBER, min_size=width, max_size=width), min_size=2, max_size=12))
    decimal = "." if "," in delimiter else draw(st.sampled_from(".,"))
    newline = draw(st.sampled_from(["\n", "\r\n"]))
    trailing = bool(delimiter.strip()) and draw(st.booleans())
    return Text(names, rows, delimiter, decimal, newline, draw(st.lists(st.integers(0, 11), max_size=3)), trailing)


@settings(max_examples=examples(200), deadline=None)
@given(texts())
@example(Text(None, [[0.0, 1.5, 2.0], [3.0, 4.5, 5.5]], " ", ",", "\n", [], trailing=False))
def test_round_trip_to_the_bit(text: Text) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "log.csv")
        text.write(path)
        table = read_columns(path)
        columns = table.columns(list(range(len(table.names))))
    width = len(text.rows[0])
    assert table.names == tuple(text.names or map(str, range(width)))
    expected = np.array(text.rows).T
    expected[np.isnan(expected)] = np.nan  # text keeps neither the sign nor the payload of a NaN
    np.testing.assert_array_equal(np.array(columns).view(np.uint64), expected.copy().view(np.uint64))
