"""The cells of a line of text: where each begins and ends, and which are numbers."""

from __future__ import annotations

import re
from functools import lru_cache

from replant.data.logs.limits import MOST_COLUMNS

MISSING = frozenset({"", "na", "n/a", "null"})  # NaN, as nan, inf and infinity are numbers that float() knows

_SHOWN = 40  # characters of a cell that an error shows [characters]
_QUOTED = r'"([^"]*+(?:""[^"]*+)*+)"'  # a doubled mark inside stands for one; ++ and *+: linear time on any text
_UNIT = r"(?:\s+(?:\[[^\[\]]*\]|\([^()]*\)))?"  # a unit in brackets belongs to its name
_WORD = re.compile(rf'\s*+(?:{_QUOTED}(?!\S)|([^\s"]\S*+{_UNIT})|\Z)')


class CellError(ValueError):
    """A cell with faulty quotation marks; ``column`` is its 0-based column."""

    def __init__(self, column: int, problem: str) -> None:
        super().__init__(problem)
        self.column = column


def split_line(line: str, delimiter: str | None) -> list[str]:
    """Split a line into stripped cells, with quotes removed; without a delimiter at runs of blanks.

    Of a line with more than `MOST_COLUMNS` cells, one more is returned.

    A quotation mark begins a quoted cell only as the first character of the cell; elsewhere it is ordinary text.

    >>> split_line('t; "u; V" ;y', ";")
    ['t', 'u; V', 'y']
    >>> split_line("time [s]  u", None)
    ['time [s]', 'u']
    >>> split_line('0,"1"0.13', ",")
    Traceback (most recent call last):
    replant.data.logs.text_cells.CellError: '"1"0.13' goes on after its closing quotation mark
    """
    if delimiter is None:
        return _split_words(line)
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter, MOST_COLUMNS)]
    pattern, text = _cell_pattern(delimiter), line.rstrip("\r\n")
    cells: list[str] = []
    at = 0
    while True:
        found = pattern.match(text, at)
        if found is None:
            raise _broken(len(cells), text[at:], delimiter)
        quoted, plain, end = found.groups()
        cells.append((plain if quoted is None else quoted.replace('""', '"')).strip())
        if not end or len(cells) > MOST_COLUMNS:
            return cells
        at = found.end()


@lru_cache(maxsize=8)
def _cell_pattern(delimiter: str) -> re.Pattern[str]:
    mark = re.escape(delimiter)
    return re.compile(rf' *+(?:{_QUOTED} *+|([^"{mark}][^{mark}]*+|))({mark}|\Z)')


def _split_words(line: str) -> list[str]:
    cells: list[str] = []
    at = 0
    while True:
        found = _WORD.match(line, at)
        if found is None:
            raise _broken(len(cells), line[at:], None)
        quoted, plain = found.groups()
        if (quoted is None and plain is None) or len(cells) > MOST_COLUMNS:
            return cells
        cells.append(quoted.replace('""', '"') if plain is None else plain)
        at = found.end()


def _broken(column: int, rest: str, delimiter: str | None) -> CellError:
    quoted = re.match(rf"\s*{_QUOTED}", rest)
    if quoted is None:
        return CellError(column, f"{quote(rest)} has no closing quotation mark")
    tail = rest[quoted.end() :].split(delimiter, 1)[0]
    return CellError(column, f"{quote(quoted[0] + tail)} goes on after its closing quotation mark")


def parse_number(cell: str) -> float:
    """Read one cell with a decimal point: a number, or NaN for a missing one.

    >>> parse_number("1.5e3"), parse_number("NA")
    (1500.0, nan)
    """
    text = cell.strip()
    if text.lower() in MISSING:
        return float("nan")
    if "_" in text or not text.isascii():  # float() takes 1_000 and the digits of every script
        raise ValueError(cell)
    return float(text)


def is_number(cell: str, delimiter: str | None) -> bool:
    """Return whether a cell is a number, or missing; a comma is a decimal comma unless it is the delimiter.

    Examples
    --------
    >>> is_number("1,5", ";"), is_number("1,5", ","), is_number("NA", ";")
    (True, False, True)
    """
    try:
        parse_number(cell if delimiter == "," else cell.replace(",", "."))
    except ValueError:
        return False
    return not cell.endswith(",")  # "0, 1, 2" is three cells with commas, not three decimals


def quote(cell: str) -> str:
    """Return a cell in quotation marks for a message; a long cell is cut.

    Examples
    --------
    >>> print(quote(" 1.5x "), quote(50 * "x"))
    '1.5x' 'xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx...'
    """
    text = cell.strip()
    return repr(text if len(text) <= _SHOWN else text[:_SHOWN] + "...")
