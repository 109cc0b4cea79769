"""The layout of a text log: encoding, delimiter, names of the columns, first line of data, dates and decimal mark."""

from __future__ import annotations

import codecs
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path

from replant.errors import LogError
from replant.logs.sampling_time import time_candidates
from replant.logs.table import LONGEST_NAME, MOST_COLUMNS, too_many_error
from replant.logs.text_cells import (
    CellError,
    DecimalMark,
    common_mark,
    is_number,
    mark_of,
    quote,
    split_line,
    units_in,
    with_units,
)
from replant.logs.text_times import StampFormat, find_format, is_missing


def with_content(layout: Layout, rows: Sequence[tuple[int, Sequence[str]]]) -> Layout:
    """Return a layout with the time stamps and decimal marks found in numbered rows of cells."""
    whole = [(line, cells) for line, cells in rows if len(cells) >= len(layout.names)]
    stamps = _stamps(layout.names, [cells for _, cells in whole])
    # with commas as delimiter a decimal comma is possible only in a quoted cell
    if layout.delimiter == "," and not any("," in cell for _, cells in whole for cell in cells):
        return replace(layout, stamps=stamps)
    own = {
        column: mark
        for column in range(len(layout.names))
        if column not in stamps
        and (mark := common_mark(mark_of(cells[column], line) for line, cells in whole)) is not None
    }
    common = common_mark(own.values())
    others = {column: mark for column, mark in own.items() if common and mark.certain and mark.mark != common.mark}
    return replace(layout, stamps=stamps, mark=common, marks=others)


def _stamps(names: Sequence[str], rows: Sequence[Sequence[str]]) -> dict[int, StampFormat]:
    """Return the columns of stamps that have a name of time; all columns of stamps if none has."""
    forms = [find_format([row[column] for row in rows], name) for column, name in enumerate(names)]
    found = {column: form for column, form in enumerate(forms) if form is not None}
    dates = [column for column, form in found.items() if form.parts == "d"]
    for column, form in found.items():
        if form.parts == "c" and len(dates) == 1:
            joined = find_format([joined_cell(row[dates[0]], row[column]) for row in rows])
            if joined is not None:
                found[column] = replace(joined, date_column=dates[0])
    named = set(time_candidates(names))
    for column, day in product(named - set(found), dates or range(len(names))):  # 20240501 and 235959 are numbers alone
        joined = find_format([joined_cell(row[day], row[column]) for row in rows])
        if joined is not None:
            found[column] = replace(joined, date_column=day)
    for form in list(found.values()):
        if form.date_column is not None:
            found.pop(form.date_column, None)
    return {column: form for column, form in found.items() if not named or column in named}


def joined_cell(day: str, clock: str) -> str:
    """Join the cells of a date and a clock time; the result is empty if either is missing."""
    return "" if is_missing(day) or is_missing(clock) else f"{day.strip()} {clock.strip()}"


COMMENT_MARKS = ("#", "%")
DELIMITERS = (";", "\t", "|", ",", None)  # None: runs of blanks; if two have equal scores, the first is taken
QUOTES_REMEDY = "correct it, write each row and its names in one line, and a quotation mark within a quoted cell twice"
LONGEST_LINE = 1 << 22  # longest line that is read: 131,072 columns of full precision [characters]
MOST_LINES_ABOVE = 100_000  # most lines without data before the first row, or between two of the first rows [lines]
_SAMPLE_ROWS = 100  # rows from which the layout is detected [rows]
_SAMPLE_CHARACTERS = 1 << 18  # characters from which the layout of very wide rows is detected [characters]
TAIL_BYTES = 1 << 16  # end of a file that is searched for its last line [bytes]
_HEAD_BYTES = 1 << 16  # beginning of a file from which its encoding is detected [bytes]
_CONTROL_BYTES = bytes(set(range(32)) - set(b"\t\n\v\f\r\x1a"))
BEGUN_NUMBER = re.compile(r"[+-]?[.,]?\d")
_WORD = re.compile(r"[^\s,;|]+")
_EXCEL_HINT = re.compile(r"sep=.?", re.IGNORECASE)  # a first line that tells Excel the delimiter
_HEADER_END = "***End_of_Header***"  # the last line of each of the two headers of a LabVIEW measurement file


@dataclass(frozen=True)
class Layout:
    """The layout of a text log."""

    path: Path
    names: tuple[str, ...]
    delimiter: str | None
    names_line: int | None
    data_line: int
    encoding: str
    title: range = range(0)
    stamps: Mapping[int, StampFormat] = field(default_factory=dict)
    mark: DecimalMark | None = None
    marks: Mapping[int, DecimalMark] = field(default_factory=dict)  # of columns whose mark differs from `mark`
    doubtful: Mapping[int, DecimalMark] = field(default_factory=dict)  # columns whose mark may separate thousands
    is_cut: bool = False
    end_line: int | None = None  # the first line below the data
    unused: tuple[str, ...] = ()  # names in a comment that has more names than columns
    unused_line: int = 0


def is_data(line: str) -> bool:
    """Return whether a line holds cells: it is neither blank nor a comment."""
    text = line.lstrip()
    return bool(text) and not text.startswith(COMMENT_MARKS)


def sniff(path: Path) -> Layout:
    """Determine the layout of a text log from its first lines."""
    encoding = _encoding(path)
    comment, rows = _sample(path, encoding)
    if not rows:
        with path.open("rb") as file:
            if file.seek(0, 2) > _HEAD_BYTES:
                raise LogError(f"{path}: no row of data in its first {MOST_LINES_ABOVE:,} lines; remove what is above")
        raise LogError(f"{path}: the file is empty; a log has a row of names and one row of numbers per sample")
    lines = [line for _, line in rows]
    scores = {delimiter: _score(lines, delimiter) for delimiter in DELIMITERS}
    delimiter = max(DELIMITERS, key=lambda delimiter: scores[delimiter]) if any(scores.values()) else ","
    above, rows = rows[0][0], _below_title(rows, delimiter)
    number, line = rows[0]
    try:
        first = split_line(line, delimiter)
    except CellError as error:
        raise LogError(f"{path}: line {number}, column {error.at}: {error}; {QUOTES_REMEDY}") from None
    if len(first) > MOST_COLUMNS:
        raise too_many_error(path, "columns")
    below = [(at, cells) for at, line in rows[1:] if (cells := split_or_none(line, delimiter)) is not None]
    units = units_in(below[0][1]) if len(below) > 1 and len(below[0][1]) <= len(first) + 1 else None
    others = [cells for _, cells in below[units is not None :]]
    if not _is_header(path, number, first, others):
        numbered = _names([str(column) if cell else "" for column, cell in enumerate(first)], others)
        at, text = comment
        found = _commented_names(text, delimiter)
        layout = Layout(path, numbered, delimiter, None, number, encoding, range(above, number))
        if len(found) == len(numbered):
            layout = replace(layout, names=found)
        elif len(found) > len(numbered) and delimiter is not None:  # with blanks as delimiter any comment would count
            layout = replace(layout, unused=found, unused_line=at)
        return with_content(layout, [(number, first), *below])
    if len(rows) == 1:
        raise LogError(f"{path}: only a header (line {number}) and no row of data; record some samples first")
    names = _names(first, others)
    if units is not None:
        names, rows, below = with_units(names, units), rows[1:], below[1:]
    for column, name in enumerate(names):
        if len(name) > LONGEST_NAME:
            raise LogError(
                f"{path}: line {number}, column {column}: {quote(name)} is a name of {len(name):,} characters; "
                f"shorten it to {LONGEST_NAME:,} or fewer"
            )
    return with_content(Layout(path, names, delimiter, number, rows[1][0], encoding, range(above, number)), below)


def lines_of(path: Path, encoding: str) -> Iterator[tuple[int, str]]:
    """Yield the lines of a text log, numbered from 1."""
    with path.open(encoding=encoding, errors="replace") as file:
        number = 1
        while line := file.readline(LONGEST_LINE + 1):
            if len(line) > LONGEST_LINE:
                raise too_long_error(path, number)
            yield number, line
            number += 1


def last_lines(path: Path, encoding: str) -> tuple[str, str]:
    """Return the last two lines; the last one is empty if the file ends with a line end or has one line."""
    lines = tail_of(path, encoding)
    return (lines[-2], lines[-1]) if len(lines) > 1 else ("", "")


def tail_of(path: Path, encoding: str) -> list[str]:
    """Return the lines at the end of a file; the first may be a part, the last is empty behind a line end."""
    with path.open("rb") as file:
        head = file.read(2)
        end = file.seek(0, 2)
        start = max(0, end - TAIL_BYTES) // 4 * 4  # does not split a character of UTF-16
        file.seek(start)
        tail = file.read()
    if encoding == "utf-16":
        encoding = "utf-16-le" if head == codecs.BOM_UTF16_LE else "utf-16-be"
    return tail.decode(encoding, errors="replace").replace("\r\n", "\n").replace("\r", "\n").split("\n")


def too_long_error(path: Path, number: int) -> LogError:
    """Return the error for a line that is longer than `LONGEST_LINE`."""
    return LogError(
        f"{path}: line {number} is longer than {LONGEST_LINE:,} characters; "
        "write one line for each sample, and end it with a line feed"
    )


def _sample(path: Path, encoding: str) -> tuple[tuple[int, str], list[tuple[int, str]]]:
    """Return the last comment before the first row, and the first rows: at least two, fewer if they are wide."""
    comment = 0, ""
    rows: list[tuple[int, str]] = []
    characters = last = 0
    for number, line in lines_of(path, encoding):
        is_enough = len(rows) == _SAMPLE_ROWS or (len(rows) > 1 and characters > _SAMPLE_CHARACTERS)
        if is_enough or number > last + MOST_LINES_ABOVE:
            break
        if line.startswith(_HEADER_END):
            rows, characters, last = [], 0, number
        elif is_data(line) and not _EXCEL_HINT.fullmatch(line.strip()):
            rows.append((number, line))
            characters, last = characters + len(line), number
        elif line.strip() and not rows and not is_data(line):
            comment = number, line
    return comment, rows


def is_prose(path: Path) -> bool:
    """Return whether a text has lines, but no row with a number in a cell of its own: a note, not a log."""
    try:
        _, rows = _sample(path, _encoding(path))
    except (LogError, OSError):  # to be said by who reads it
        return False
    # one line may be the header of a log that nothing was recorded into, and many lines may stand above its rows
    if not 1 < len(rows) < _SAMPLE_ROWS:
        return False
    for (_, line), delimiter in product(rows, DELIMITERS):
        numbers = sum(bool(cell) and is_number(cell, delimiter) for cell in split_or_none(line, delimiter) or [])
        if numbers > (delimiter is None):  # a sentence of words between blanks may hold one number
            return False
    return True


def _encoding(path: Path) -> str:
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    if head.translate(None, _CONTROL_BYTES) != head:
        text = head.replace(b"\0", b"")
        is_text = text.translate(None, _CONTROL_BYTES) == text
        if is_text and abs(head[::2].count(0) - head[1::2].count(0)) > len(head) // 4:  # most of every second byte
            raise LogError(f"{path}: a text in UTF-16 without a byte-order mark; save it as UTF-8")
        at = next(at for at, byte in enumerate(head) if byte in _CONTROL_BYTES)
        where = f"(line {head.count(10, 0, at) + 1} holds the control character 0x{head[at]:02x})"
        raise LogError(f"{path}: not a text file; export the log as CSV, Parquet, .mat or .npz {where}")
    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)  # a character cut off at the end is accepted
    except UnicodeDecodeError:
        return "cp1252"  # Windows tools write it; it has the degree sign
    return "utf-8-sig"


def _is_number_or_with_unit(cell: str, delimiter: str | None) -> bool:
    number, _, unit = cell.partition(" ")
    # 0,5 1,5 delimited by commas has two numbers in a cell
    return is_number(number, delimiter) and not (unit and is_number(unit, delimiter))


def _score(lines: Sequence[str], delimiter: str | None) -> float:
    """Score a delimiter: the share of rows with the most common width times the share of numbers among the cells."""
    rows = [cells for line in lines if (cells := split_or_none(line, delimiter)) is not None]
    widths = Counter(len(row) for row in rows)
    width, count = widths.most_common(1)[0] if rows else (0, 0)
    if width < 2:
        return 0.0
    cells = [cell for row in rows[1:] or rows for cell in row]
    numbers = sum(_is_number_or_with_unit(cell, delimiter) for cell in cells)
    return count / len(lines) * (numbers + 1e-3) / (len(cells) + 1e-3)  # equal widths alone: a small score


def split_or_none(line: str, delimiter: str | None) -> list[str] | None:
    """Split a line; return None if its quotation marks do not fit this delimiter."""
    try:
        return split_line(line, delimiter)
    except CellError:
        return None


def _below_title(rows: list[tuple[int, str]], delimiter: str | None) -> list[tuple[int, str]]:
    """Drop the title: narrower rows above the names, or rows of text above numbers."""
    split = [split_or_none(line, delimiter) or [] for _, line in rows]
    # empty cells at the end do not count: a spreadsheet fills up each line to the widest one
    widths = [max((number for number, cell in enumerate(cells, 1) if cell), default=0) for cells in split]
    usual = Counter(widths).most_common(1)[0][0]
    at = widths.index(usual)
    if at == 0 or len(rows) <= at + 1:
        return rows
    if all(is_number(cell, delimiter) for cell in split[at]):
        # a title is a line of text without one word per column; unless blanks delimit, it is a single cell
        is_title = all(
            (delimiter is None or width == 1) and cells and cells[0][:1].isalpha() and len(_WORD.findall(line)) != usual
            for (_, line), cells, width in zip(rows[:at], split, widths, strict=False)
        )
    else:
        is_title = max(widths[:at]) < usual and all(name[:1].isalpha() for name in split[at])
    return rows[at:] if is_title else rows


def _is_header(path: Path, line: int, first: Sequence[str], others: Sequence[Sequence[str]]) -> bool:
    """Return whether the first row holds names: text, and no numbers except plain counts such as 2."""
    is_text = [not is_number(cell, None) for cell in first]
    if not any(is_text):
        return False
    numbers = [cell for cell, text in zip(first, is_text, strict=True) if cell and not text]
    below = dict(enumerate(others[0])) if others else {}
    names = [
        column for column, text in enumerate(is_text) if text and column in below and is_number(below[column], None)
    ]
    if not names:
        return not numbers
    if not all(map(str.isdecimal, numbers)):
        return False
    # the row may also be damaged data: a usual name of the time, or names that begin with a letter in most columns,
    # show that it is a header; any other file is refused
    texts = [first[column] for column in names]
    unnamed = len(numbers) + sum(1 for column, cell in enumerate(first) if not cell and below.get(column))
    if unnamed:
        certain = len(names) > unnamed and all(text[0].isalpha() for text in texts)
    else:
        certain = not all(map(BEGUN_NUMBER.match, texts))
    if certain or time_candidates(texts):
        return True
    raise LogError(
        f"{path}: line {line}, column {names[0]}: {quote(texts[0])} is a name or a damaged number; correct it, or put "
        "# before the line; if the line holds names, give one to each column that begins with a letter"
    )


def _names(header: Sequence[str], rows: Sequence[Sequence[str]]) -> tuple[str, ...]:
    width = len(header)
    if width > 1 and not header[-1] and not any(row[width - 1 : width] != [""] for row in rows if len(row) >= width):
        width -= 1  # a delimiter at the end of each line, not a column
    return tuple(name or str(number) for number, name in enumerate(header[:width]))


def _commented_names(comment: str, delimiter: str | None) -> tuple[str, ...]:
    """Return the names in the last comment before the data, as numpy.savetxt writes them; empty if it holds others."""
    text = comment.strip().lstrip("".join(COMMENT_MARKS)).strip()
    names = (split_or_none(text, delimiter) if text else None) or []
    fit = all(name[:1].isalpha() and len(name) <= LONGEST_NAME and not is_number(name, None) for name in names)
    return tuple(names) if fit else ()
