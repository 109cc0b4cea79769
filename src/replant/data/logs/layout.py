"""How a text log is laid out: encoding, delimiter, names of the columns, first line of data."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from replant.errors import LogError

COMMENT_MARKS = ("#", "%")
DELIMITERS = (";", "\t", "|", ",", None)  # None: runs of blanks. In this order when two explain a file equally well
MISSING = frozenset({"", "na", "n/a", "null"})  # NaN, as nan, inf and infinity are numbers that float() knows

_SAMPLE_ROWS = 100
_HEAD_BYTES = 1 << 16
_CONTROL_BYTES = bytes(set(range(32)) - set(b"\t\n\v\f\r\x1a"))
_EXCEL_HINT = re.compile(r"sep=.?", re.IGNORECASE)  # a first line that tells Excel the delimiter
_WORDS = re.compile(r'"([^"]*)"|(\S+(?:\s+(?:\[[^\]]*\]|\([^)]*\)))?)')  # a unit in brackets belongs to its name


@dataclass(frozen=True)
class Layout:
    """The layout of a text log.

    Parameters
    ----------
    names : tuple of str
        The columns' names; "0", "1", ... where the file has none.
    delimiter : str or None
        What separates two cells; None stands for runs of blanks.
    names_line : int or None
        The 1-based line of the names, if there is one.
    data_line : int
        The 1-based line of the first row of data.
    encoding : str
        The text's encoding.
    """

    names: tuple[str, ...]
    delimiter: str | None
    names_line: int | None
    data_line: int
    encoding: str


def is_data(line: str) -> bool:
    """Tell whether a line holds cells: it is neither blank nor a comment."""
    text = line.lstrip()
    return bool(text) and not text.startswith(COMMENT_MARKS)


def split_line(line: str, delimiter: str | None) -> list[str]:
    """Split a line into stripped cells, with quotes removed.

    Examples
    --------
    >>> split_line('t; "u; V" ;y', ";")
    ['t', 'u; V', 'y']
    >>> split_line("time [s]  u", None)
    ['time [s]', 'u']
    """
    if delimiter is None:
        return [quoted or plain for quoted, plain in _WORDS.findall(line)]
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))]


def parse_number(cell: str) -> float:
    """Read one cell with a decimal point: a number, or NaN for a missing one.

    Raises
    ------
    ValueError
        If the cell holds anything else.

    Examples
    --------
    >>> parse_number("1.5e3"), parse_number("NA")
    (1500.0, nan)
    """
    text = cell.strip()
    if text.lower() in MISSING:
        return float("nan")
    if "_" in text or not text.isascii():  # float() takes 1_000 and the digits of every script
        raise ValueError(cell)
    return float(text)


def sniff(path: Path) -> Layout:
    """Find out the layout of a text log from its first lines.

    Raises
    ------
    LogError
        If the file is empty, is not text, or has no row of data.
    """
    encoding = _encoding(path)
    comment: str | None = None
    rows: list[tuple[int, str]] = []
    with path.open(encoding=encoding, errors="replace") as file:
        for number, line in islice(_significant(file), _SAMPLE_ROWS):
            if is_data(line):
                rows.append((number, line))
            elif not rows:
                comment = line
    if not rows:
        raise LogError(f"{path}: the file is empty; a log has a row of names and one row of numbers per sample")
    delimiter = _delimiter([line for _, line in rows])
    cells = [split_line(line, delimiter) for _, line in rows]
    if not _is_header(cells):
        names = _commented_names(comment, delimiter, cells)
        return Layout(names, delimiter, None, rows[0][0], encoding)
    if len(rows) == 1:
        raise LogError(f"{path}: only a header (line {rows[0][0]}) and no row of data; record some samples first")
    return Layout(_names(cells[0], cells[1:]), delimiter, rows[0][0], rows[1][0], encoding)


def _significant(lines: Iterator[str]) -> Iterator[tuple[int, str]]:
    """Yield rows, and of the comments before them the last."""
    comment: tuple[int, str] | None = None
    for number, line in enumerate(lines, 1):
        if _EXCEL_HINT.fullmatch(line.strip()):
            continue
        if is_data(line):
            if comment:
                yield comment
                comment = None
            yield number, line
        elif line.strip():
            comment = number, line


def _encoding(path: Path) -> str:
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if head.translate(None, _CONTROL_BYTES) != head:
        raise LogError(f"{path}: not a text file; export the log as CSV, Parquet, .mat or .npz")
    if len(head) == _HEAD_BYTES:
        head = head[: head.rfind(b"\n") + 1]  # whole lines, so that no character is cut
    try:
        head.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"  # what Windows tools write; it has the degree sign of a temperature
    return "utf-8-sig"


def _delimiter(lines: Sequence[str]) -> str | None:
    scores = {delimiter: _score(lines, delimiter) for delimiter in DELIMITERS}
    best = max(DELIMITERS, key=lambda delimiter: scores[delimiter])
    return best if scores[best] > 0.0 else ","


def _score(lines: Sequence[str], delimiter: str | None) -> float:
    """How well a delimiter explains the rows: the share of rows of one width times the share of numbers."""
    rows = [split_line(line, delimiter) for line in lines]
    widths = Counter(len(row) for row in rows)
    width, count = widths.most_common(1)[0]
    if width < 2:
        return 0.0
    cells = [cell for row in rows[1:] or rows for cell in row]
    numbers = sum(is_number(cell, delimiter) for cell in cells)
    return count / len(rows) * (numbers + 1e-3) / (len(cells) + 1e-3)  # a width alone counts a little


def is_number(cell: str, delimiter: str | None) -> bool:
    """Tell whether a cell is a number, or missing; a comma is a decimal comma unless it is the delimiter."""
    try:
        parse_number(cell if delimiter == "," else cell.replace(",", "."))
    except ValueError:
        return False
    return not cell.endswith(",")  # "0, 1, 2" is three cells with commas, not three decimals


def _is_header(rows: Sequence[Sequence[str]]) -> bool:
    """Tell whether the first row holds names: some text, and no number but plain counts such as 2."""
    first = rows[0]
    text = [column for column, cell in enumerate(first) if not is_number(cell, None)]
    if not text:
        return False
    values = [cell for column, cell in enumerate(first) if column not in text and any(map(str.isdigit, cell))]
    if not values or len(rows) == 1:
        return not values
    names_above_numbers = any(column < len(rows[1]) and is_number(rows[1][column], None) for column in text)
    return names_above_numbers and all(map(str.isdecimal, values))


def _names(header: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[str, ...]:
    width = len(header)
    if width > 1 and not header[-1] and not any(row[width - 1 : width] != [""] for row in rows if len(row) >= width):
        width -= 1  # a delimiter at the end of each line, not a column
    return tuple(name or str(number) for number, name in enumerate(header[:width]))


def _commented_names(comment: str | None, delimiter: str | None, rows: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Names from the last comment before the data if it has one name per column (as numpy.savetxt writes them)."""
    numbered = _names([str(column) if cell else "" for column, cell in enumerate(rows[0])], rows[1:])
    names = split_line(comment.strip().lstrip("".join(COMMENT_MARKS)).strip(), delimiter) if comment else []
    if len(names) == len(numbered) and all(name[:1].isalpha() and not is_number(name, None) for name in names):
        return tuple(names)
    return numbered
