"""Text logs (.csv, .txt, .tsv, .dat, .lvm): read in blocks of lines, which NumPy parses in C.

Python parses a block with quotes, comments, dates or an error, and locates the error.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import LogError, shown
from replant.logs.sampling_time import time_candidates
from replant.logs.table import Arrays, Table, listed
from replant.logs.text_cells import (
    MISSING,
    CellError,
    NumberError,
    TwoMarksError,
    common_mark,
    is_number,
    later_mark,
    mark_of,
    parse_numbers,
    quote,
    split_line,
)
from replant.logs.text_layout import (
    BEGUN_NUMBER,
    COMMENT_MARKS,
    LONGEST_LINE,
    QUOTES_REMEDY,
    TAIL_BYTES,
    Layout,
    is_data,
    joined_cell,
    last_lines,
    lines_of,
    sniff,
    split_or_none,
    tail_of,
    too_long_error,
)
from replant.logs.text_times import READ, is_missing, with_stamps
from replant.model.interop import without_unit
from replant.numerics.arguments import FloatArray

_CELL_REMEDY = "correct it, leave the cell empty, or put # before the line"
_NAMES_REMEDY = "put # before each such line; where another recording begins, cut the file there and give both parts"
_DATE = re.compile(r"\s*\d+[-/.:]\d+[-/.:]\d+")
# a line of blanks alone: spreadsheets append them
_BLANK = re.compile(r"^[ \t]+(?:\n|\Z)", re.MULTILINE)
_DATE_REMEDY = f"convert dates and clock times to seconds, or give the sampling time (dt, --dt); as the time {READ}"
_WORDS = {".": "decimal point", ",": "comma"}


def _column(layout: Layout, rows: Sequence[tuple[int, Sequence[str]]], column: int) -> FloatArray:
    """Convert the cells of one column to float64: numbers, or seconds since the first stamp of the log."""
    cells = [row[column] for _, row in rows]
    form = layout.stamps.get(column)
    try:
        if form is not None:
            if form.date_column is not None:
                cells = [joined_cell(row[form.date_column], row[column]) for _, row in rows]
            return form.seconds(cells)
        mark = layout.marks.get(column, layout.mark)  # None if no number shows it, or commas delimit
        if mark is None and layout.delimiter != ",":
            mark = common_mark(mark_of(cell, line) for (line, _), cell in zip(rows, cells, strict=True))
        return parse_numbers(cells, mark)
    except CellError as error:
        line, name = rows[error.at][0], layout.names[column]
        if isinstance(error, TwoMarksError):  # 1.234 beside 0,5: the point may be a thousands separator
            assert mark is not None
            raise LogError(
                f"{layout.path}: column {shown(name)} has a {_WORDS[mark.other]} in line {line} ({quote(str(error))}) "
                f"and the log a {_WORDS[mark.mark]} in line {mark.line} ({quote(mark.cell)}); write all numbers one "
                "way, without thousands separators"
            ) from None
        if cells[error.at].strip() in (name, without_unit(name)):
            raise LogError(
                f"{layout.path}: line {line}, column {shown(name)}: the names again; {_NAMES_REMEDY}"
            ) from None
        remedy = _DATE_REMEDY if _DATE.match(cells[error.at]) else _CELL_REMEDY
        end = f"; {remedy}" if isinstance(error, NumberError) else ""
        raise LogError(f"{layout.path}: line {line}, column {shown(name)}: {error}{end}") from None


def _cut_line(layout: Layout) -> str:
    """Return the last line if it was cut off while it was written, else an empty string."""
    before, line = last_lines(layout.path, layout.encoding)
    if not is_data(line):
        return ""
    previous, last = (split_or_none(each, layout.delimiter) or [] for each in (before, line))
    if len(last) < len(layout.names):
        return line
    return line if _is_readable(layout, previous) and not _is_readable(layout, last) else ""


def _below_data(layout: Layout) -> range:
    """Return the last lines whose time is text, as of a row of means below the samples; empty if none is."""
    joined = [
        {column, column if form.date_column is None else form.date_column} for column, form in layout.stamps.items()
    ]
    alone = [{column} for column in time_candidates(layout.names) if not any(column in each for each in joined)]
    lines, clocks = tail_of(layout.path, layout.encoding), joined + alone
    lines = lines[layout.path.stat().st_size > TAIL_BYTES :]  # the first may be a part
    lines = lines[:-1] if lines and not lines[-1] else lines
    found = 0
    for back, line in enumerate(reversed(lines), 1):
        if not is_data(line):
            continue
        cells = split_or_none(line, layout.delimiter) or []
        if len(cells) < len(layout.names):
            break
        # while one clock can be read, a word in another is no sign of a row of another kind
        if not clocks or not all(any(_is_word(cells[column]) for column in each) for each in clocks):
            break
        found = back
    else:
        return range(0)  # the time is text everywhere
    if not found:
        return range(0)
    last = sum(1 for _ in lines_of(layout.path, layout.encoding))
    return range(last - found + 1, last + 1)


def _is_word(cell: str) -> bool:
    return not is_missing(cell) and not is_number(cell, None) and BEGUN_NUMBER.match(cell) is None


def _is_readable(layout: Layout, cells: list[str]) -> bool:
    """Return whether a row is complete and its last cell can be read as its column requires."""
    if len(cells) < len(layout.names):
        return False
    try:
        _column(layout, [(0, cells)], len(layout.names) - 1)
    except LogError:
        return False
    return True


BLOCK_BYTES = 1 << 21  # text of a log held at a time [bytes]
_HEAD_BYTES = 1 << 16  # beginning of a file that gives the mean length of a line [bytes]
_WIDE = "utf-16"  # converted to utf-8 while the file is read
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_ODD = ('"', *COMMENT_MARKS)  # Python parses a block with one of them


def read(path: Path) -> Table:
    """Open a text log; its first lines determine delimiter, decimal comma and header."""
    layout, notes = sniff(path), []
    there, left_out = listed(layout.names), dict[str, str]()
    if layout.title:
        first, last = layout.title[0], layout.title[-1]
        lines = f"line {first} is" if first == last else f"lines {first} to {last} are"
        what = "names" if layout.names_line else "data"
        called = "" if layout.names_line else f"; the columns are called {there}"
        notes.append(f"{path}: {lines} above the {what}, and left out{called}")
    if layout.unused:
        counts = f"{len(layout.unused)} names for {len(layout.names)} columns"
        why = f"line {layout.unused_line} has {counts}, and is left out"
        notes.append(f"{path}: {why}; the columns are called {there}")
        left_out = {name: f"no column {shown(name)}: {why}; there are: {there}" for name in layout.unused}
    if cut := _cut_line(layout):
        layout = replace(layout, is_cut=True)
        notes.append(f"{path}: the last line is cut off ({quote(cut)}) and left out")
    if layout.delimiter != "," and (layout.mark is None or not layout.mark.certain):
        mark, doubtful = later_mark(layout.mark, _rows_with_marks(layout), layout.stamps)
        layout = replace(layout, mark=mark, doubtful=doubtful)
    if below := _below_data(layout):
        layout = replace(layout, end_line=below[0])
        lines = f"line {below[0]}" if len(below) == 1 else f"lines {below[0]} to {below[-1]}"
        notes.append(f"{path}: {lines} below the data left out: a word stands in place of the time")
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    table = Table(
        path,
        layout.names,
        lambda columns: (_parse(layout, text, first, columns) for first, text in _texts(layout)),
        partial(_line_of_row, layout),
        # all lines are assumed to be as long as the first ones
        approximate_rows=path.stat().st_size * max(1, head.count(b"\n")) // max(1, len(head)),
        notes=tuple(notes),
        left_out=left_out,
    )
    return with_stamps(table, layout.stamps)


def _parse(layout: Layout, text: bytes, first: int, columns: Sequence[int]) -> Arrays:
    """Convert lines to an array for each column; the first line has number ``first``; skip blank lines and comments."""
    for column in columns:
        if doubt := layout.doubtful.get(column):
            raise LogError(
                f"{layout.path}: column {shown(layout.names[column])} has {quote(doubt.cell)} in line {doubt.line} "
                f"beside whole numbers: its {_WORDS[doubt.mark]} may separate thousands; write 1700 or 1.70 for 1.700"
            )
    decoded = _decoded(layout, text)
    if layout.end_line is not None and first + decoded.count("\n") >= layout.end_line:
        decoded = "\n".join(decoded.split("\n")[: max(0, layout.end_line - first)])
    if first < layout.data_line:
        above, first = layout.data_line - first, layout.data_line
        decoded = "\n".join(decoded.split("\n")[above:])
    values = _parse_in_c(layout, decoded, columns)
    if values is not None:
        return values
    lines = [(number, line) for number, line in enumerate(decoded.split("\n"), first) if is_data(line)]
    rows = [(number, _split(layout, number, line)) for number, line in lines]
    for number, row in rows:
        if len(row) != len(layout.names):
            _check_width(layout, number, row)
    return [_column(layout, rows, column) for column in columns]


def _decoded(layout: Layout, text: bytes) -> str:
    """Decode a text, with line feeds as its line ends."""
    decoded = text.decode("utf-8" if layout.encoding == _WIDE else layout.encoding, errors="replace")
    return decoded.replace("\r\n", "\n").replace("\r", "\n") if "\r" in decoded else decoded


def _may_separate(layout: Layout) -> bool:
    """Return whether a log has a number such as 1.700 and a whole number of at most three digits."""
    three_behind = re.compile(rb"\d[.,]\d{3}(?!\d)")
    if not any(three_behind.search(text) for _, text in _texts(layout)):
        return False
    # what stands before a cell is searched for at the speed of memory
    before = [each.encode() for each in ([layout.delimiter] if layout.delimiter else [" ", "\t"])] + [b"\n", b"\r"]
    short = [re.compile(re.escape(each) + rb" *[+-]?\d{1,3}(?=[;\t| \r\n]|$)") for each in before]
    return any(each.search(text) for _, text in _texts(layout) for each in short)


def _rows_with_marks(layout: Layout) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of blocks with a comma, and all rows of a log in which a mark may separate thousands."""
    may_separate = _may_separate(layout)
    for first, text in _texts(layout):
        if not may_separate and b"," not in text:
            continue
        for number, line in enumerate(_decoded(layout, text).split("\n"), first):
            if number >= layout.data_line and is_data(line) and '"' not in line:
                yield number, line.split(layout.delimiter)


def _texts(layout: Layout) -> Iterator[tuple[int, bytes]]:
    """Yield blocks of whole lines as bytes with the number of the first line; a line ends with LF, CR or CR LF."""
    with layout.path.open("rb") as opened:
        file: Any = codecs.EncodedFile(opened, "utf-8", "utf-16", "replace") if layout.encoding == _WIDE else opened
        first, rest = 1, file.read(len(_BYTE_ORDER_MARK)).removeprefix(_BYTE_ORDER_MARK)
        while block := file.read(BLOCK_BYTES):
            # a CR at the end of the block may be the first half of CR LF
            end = 1 + max(block.rfind(b"\n"), block[:-1].rfind(b"\r"))
            if end == 0:
                rest += block
                if len(rest) > LONGEST_LINE:
                    raise too_long_error(layout.path, first)
                continue
            text, rest = rest + block[:end], block[end:]
            if not text.isspace():
                yield first, text
            first += text.count(b"\n")
            if returns := text.count(b"\r"):
                first += returns - text.count(b"\r\n")
        if layout.is_cut:
            rest = rest[: 1 + max(rest.rfind(b"\n"), rest.rfind(b"\r"))]
        if rest and not rest.isspace():
            yield first, rest


def _line_of_row(layout: Layout, row: int) -> str:
    """Return the number of the line that holds a row; reads the file again, so only error messages use it."""
    numbers = (n for n, line in lines_of(layout.path, layout.encoding) if n >= layout.data_line and is_data(line))
    return f"line {next(islice(numbers, row, None))}"


def _parse_in_c(layout: Layout, text: str, columns: Sequence[int]) -> Arrays | None:
    """Parse a block with NumPy; return None if it holds more than full rows of numbers and missing cells."""
    width, delimiter = len(layout.names), layout.delimiter
    if any(column in layout.stamps for column in columns) or any(mark in text for mark in _ODD):
        return None
    if delimiter != ",":
        mark = layout.mark.mark if layout.mark else ""
        if ("," in text and ("." in text or mark == ".")) or ("." in text and mark == ","):
            return None
        text = text.replace(",", ".")
    if delimiter == "\t":
        text = _BLANK.sub("", text)
    if text.isspace() or not text:
        return None  # NumPy warns about a block without data
    chosen = None
    if len(set(columns)) < width and delimiter is not None and _are_full(text, delimiter, width):
        chosen = list(columns)
    table = _numbers(text, delimiter, chosen)
    if table is None and delimiter is not None:
        table = _numbers(_missing(delimiter).sub("nan", text), delimiter, chosen)
    if table is None or table.shape[1] != (width if chosen is None else len(chosen)):
        return None
    return [table[:, at] for at in (columns if chosen is None else range(len(chosen)))]


def _numbers(text: str, delimiter: str | None, chosen: Sequence[int] | None) -> FloatArray | None:
    try:
        return np.loadtxt(text.split("\n"), delimiter=delimiter, comments=None, ndmin=2, usecols=chosen)
    except ValueError:
        return None


def _are_full(text: str, delimiter: str, width: int) -> bool:
    """Return whether every line has ``width`` cells: NumPy does not check this if it reads only some columns."""
    characters = np.frombuffer((text if text.endswith("\n") else f"{text}\n").encode(), np.uint8)
    is_end = characters[(characters == ord(delimiter)) | (characters == ord("\n"))] == ord("\n")
    each = np.resize(np.arange(width) == width - 1, is_end.size)
    return is_end.size % width == 0 and np.array_equal(is_end, each)


@lru_cache(maxsize=8)
def _missing(delimiter: str) -> re.Pattern[str]:
    """Return the pattern of a missing cell next to a delimiter; a blank line does not match."""
    mark, words = re.escape(delimiter), "|".join(map(re.escape, filter(None, MISSING)))
    word = rf" *(?:{words})? *" if delimiter == "\t" else rf"[ \t]*(?:{words})?[ \t]*"
    return re.compile(rf"(?<={mark}){word}(?={mark}|$)|^{word}(?={mark})", re.IGNORECASE | re.MULTILINE)


def _split(layout: Layout, number: int, line: str) -> list[str]:
    if '"' not in line:
        return line.split(layout.delimiter, len(layout.names) + 1)
    try:
        return split_line(line, layout.delimiter)
    except CellError as error:
        name = layout.names[error.at] if error.at < len(layout.names) else str(error.at)
        raise LogError(f"{layout.path}: line {number}, column {shown(name)}: {error}; {QUOTES_REMEDY}") from None


def _check_width(layout: Layout, number: int, row: list[str]) -> None:
    """Drop the empty cell after a delimiter at the end of the line; refuse any other difference."""
    width = len(layout.names)
    if len(row) == width + 1 and not row[-1].strip():
        row.pop()
        return
    model = f"line {layout.names_line or layout.data_line}"
    cells = "1 cell" if len(row) == 1 else f"{len(row)} cells"
    remedy = "complete the line, or put # before it"
    if len(row) > width:
        remedy = "correct the line, or put # before each line above it that is no data"
    raise LogError(f"{layout.path}: line {number} has {cells} where {model} has {width}; {remedy}")
