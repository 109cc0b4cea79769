"""The cells of a line of text: splitting, numbers and decimal marks, and the row of units below the names."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from replant.logs.table import MOST_COLUMNS
from replant.model.interop import unit_of
from replant.numerics.arguments import FloatArray

# as spreadsheets and the C library of Windows print it
_NOT_A_NUMBER = ("#nv", "#n/a", *(f"{sign}1.#{what}" for sign in ("", "-") for what in ("qnan", "ind", "inf")))
MISSING = frozenset(
    {"", "na", "n/a", "null", "none", *_NOT_A_NUMBER}
)  # no dash: it may be a unit or a truncated number
# only in data: a column of true values may be called true
_TRUTH = {"true": 1.0, "false": 0.0, "wahr": 1.0, "falsch": 0.0}
_SHOWN = 40  # longest text of a cell in an error [characters]
_QUOTED = r'"([^"]*+(?:""[^"]*+)*+)"'  # a doubled mark inside is one mark; ++ and *+ keep the time linear
_UNIT_BEHIND = r"(?:\s+(?:\[[^\[\]]*\]|\([^()]*\)))?"  # a unit in brackets belongs to its name


_MINUS = "−"  # that of Unicode
_FORTRAN = re.compile(r"(\d*\.\d*)[dD]([+-]?\d+)$")  # the exponent of Fortran's double precision


class CellError(ValueError):
    """A cell that cannot be read; ``at`` is its 0-based index in the line or column that was parsed."""

    def __init__(self, at: int, problem: str) -> None:
        super().__init__(problem)
        self.at = at


class NumberError(CellError):
    """A cell that is not a number."""


class TwoMarksError(NumberError):
    """A cell whose decimal mark differs from the other cells', or may be a thousands separator."""


def split_line(line: str, delimiter: str | None) -> list[str]:
    """Split a line into stripped cells, at blanks if the delimiter is None; only a cell's first character may quote."""
    if delimiter is not None and '"' not in line:
        return [cell.strip() for cell in line.split(delimiter, MOST_COLUMNS)]
    pattern, text = _cell_pattern(delimiter), line.rstrip("\r\n")
    cells: list[str] = []
    at = 0
    while True:
        found = pattern.match(text, at)
        if found is None:
            raise _broken(len(cells), text[at:], delimiter)
        quoted, plain, end = found.groups()
        if quoted is None and plain is None:  # blanks behind the last word
            return cells
        cells.append((plain if quoted is None else quoted.replace('""', '"')).strip())
        if (delimiter is not None and not end) or len(cells) > MOST_COLUMNS:
            return cells
        at = found.end()


@lru_cache(maxsize=8)
def _cell_pattern(delimiter: str | None) -> re.Pattern[str]:
    if delimiter is None:
        return re.compile(rf'\s*+(?:{_QUOTED}(?!\S)|([^\s"]\S*+{_UNIT_BEHIND})|\Z)()')
    mark = re.escape(delimiter)
    return re.compile(rf' *+(?:{_QUOTED} *+|([^"{mark}][^{mark}]*+|))({mark}|\Z)')


def _broken(column: int, rest: str, delimiter: str | None) -> CellError:
    quoted = re.match(rf"\s*{_QUOTED}", rest)
    if quoted is None:
        return CellError(column, f"{quote(rest)} has no closing quotation mark")
    tail = rest[quoted.end() :].split(delimiter, 1)[0]
    return CellError(column, f"{quote(quoted[0] + tail)} goes on after its closing quotation mark")


def parse_number(cell: str) -> float:
    """Read one cell with a decimal point: a number, or NaN if it is missing."""
    text = cell.strip()
    if text.lower() in MISSING:
        return float("nan")
    text = _FORTRAN.sub(r"\1e\2", text.replace(_MINUS, "-"))
    if "_" in text or not text.isascii():  # float() accepts 1_000 and the digits of every script
        raise ValueError(cell)
    return float(text)


def as_float(number: float) -> float:
    """Return a number as float64; infinite if it overflows."""
    try:
        return float(number)
    except OverflowError:
        return math.inf if number > 0 else -math.inf


def is_number(cell: str, delimiter: str | None) -> bool:
    """Return whether a cell is a number or missing; a comma is a decimal comma unless it is the delimiter."""
    grouped = None if delimiter == "," else _GROUPED.fullmatch(cell)
    if grouped and grouped["end"] and grouped["end"][0] != grouped["mark"]:
        return True
    try:
        parse_number(cell if delimiter == "," else cell.replace(",", "."))
    except ValueError:
        return False
    return not cell.endswith(",")  # "0, 1, 2" is three cells with commas, not three decimals


def quote(cell: str) -> str:
    """Return a cell in quotation marks for a message; a long cell is cut."""
    text = cell.strip()
    return repr(text if len(text) <= _SHOWN else text[:_SHOWN] + "...")


_PLAIN = re.compile(r"[+\-−]?(?:\d+(?P<mark>[.,])\d*|(?P<first>[.,])\d+)(?:[eEdD][+-]?\d+)?")
_GROUPED = re.compile(
    r"[+\-−]?[1-9]\d{0,2}(?:(?P<mark>[.,])\d{3})(?:(?P=mark)\d{3})*(?P<end>[.,]\d*(?:[eE][+-]?\d+)?)?"
)


@dataclass(frozen=True)
class DecimalMark:
    """The decimal mark of a log's numbers, with the cell that shows it."""

    mark: str
    line: int
    cell: str
    certain: bool = True
    grouped: bool = False

    @property
    def other(self) -> str:
        """The thousands separator."""
        return "," if self.mark == "." else "."


def mark_of(cell: str, line: int) -> DecimalMark | None:
    """Return the decimal mark of a cell; None if it has none or is not a number."""
    text = cell.strip()
    if text.isdecimal():
        return None
    grouped = _GROUPED.fullmatch(text)
    if grouped and grouped["end"] and grouped["end"][0] != grouped["mark"]:
        return DecimalMark(grouped["end"][0], line, text, grouped=True)
    if grouped and text.count(grouped["mark"]) > 1 and not grouped["end"]:
        return DecimalMark("," if grouped["mark"] == "." else ".", line, text, grouped=True)
    plain = _PLAIN.fullmatch(text)
    if plain is None:
        return None
    mark: str = plain["mark"] or plain["first"]
    return DecimalMark(mark, line, text, certain=not (grouped and not grouped["end"]))


def common_mark(marks: Iterable[DecimalMark | None]) -> DecimalMark | None:
    """Return the first certain mark, else the first one; it is grouped if any equal mark is."""
    found = [mark for mark in marks if mark is not None]
    certain = [mark for mark in found if mark.certain]
    if not found:
        return None
    best = (certain or found)[0]
    return replace(best, grouped=any(mark.grouped and mark.mark == best.mark for mark in found))


_GROUP = 3  # digits between two thousands separators [count]


def later_mark(
    mark: DecimalMark | None, rows: Iterable[tuple[int, Sequence[str]]], left_out: Iterable[int]
) -> tuple[DecimalMark | None, dict[int, DecimalMark]]:
    """Return the first certain decimal mark in further rows, else the mark of the first rows; and doubtful columns.

    A column is written in thousands, or doubtful, if 1.700 stands beside 100: a program that prints three decimals
    prints them always, and one that prints no more than needed prints 1.7.  Two marks in a log tell which is which.
    """
    best, skipped = mark, set(left_out)
    found, lengths = dict[tuple[int, str], DecimalMark](), dict[int, int]()
    for line, cells in rows:
        for column, cell in enumerate(cells):
            if column in skipped:
                continue
            here, digits = mark_of(cell, line), cell.strip().lstrip("+-")
            if here is not None and here.certain:
                return here, {}
            if here is not None:
                found.setdefault((column, here.mark), here)
            elif digits.isdecimal():
                lengths[column] = max(len(digits), lengths.get(column, 0))
    doubtful = {column: here for (column, _), here in found.items() if 0 < lengths.get(column, 0) <= _GROUP}
    others = [here for here in found.values() if here.mark not in {each.mark for each in doubtful.values()}]
    if doubtful and others:
        return replace(others[0], certain=True, grouped=True), {}
    return best or next(iter(found.values()), None), doubtful


def parse_numbers(cells: Sequence[str], mark: DecimalMark | None) -> FloatArray:
    """Convert the cells of a column to float64; a missing one is NaN."""
    mark = mark or DecimalMark(".", 0, "")
    values = _plain_numbers(cells, mark)
    if values is not None:
        return values
    values = np.empty(len(cells))
    for index, cell in enumerate(cells):
        try:
            values[index] = _number(cell, mark)
        except NumberError as error:
            error.at = index
            raise
        except ValueError:
            raise NumberError(index, f"{quote(cell)} is not a number") from None
    return values


def _number(cell: str, mark: DecimalMark) -> float:
    text = cell.strip()
    if text.lower() in _TRUTH:
        return _TRUTH[text.lower()]
    if text.lower() in MISSING:
        return math.nan
    if mark.other not in text:
        return parse_number(text.replace(mark.mark, "."))
    grouped = _GROUPED.fullmatch(text)
    if grouped is None or grouped["mark"] != mark.other or (grouped["end"] or mark.mark)[0] != mark.mark:
        if _PLAIN.fullmatch(text) and mark.line:
            raise TwoMarksError(0, text)
        raise ValueError(cell)
    if not grouped["end"] and text.count(mark.other) == 1 and mark.line and not mark.grouped:
        raise TwoMarksError(0, text)
    return parse_number(text.replace(mark.other, "").replace(mark.mark, "."))


def _plain_numbers(cells: Sequence[str], mark: DecimalMark) -> FloatArray | None:
    """Convert all cells at once; return None if one is not a plain number."""
    text = "".join(cells)
    if "_" in text or not text.isascii() or (mark.mark == "," and "." in text):
        return None
    plain = cells if mark.mark == "." else [cell.replace(",", ".") for cell in cells]
    try:
        return np.fromiter(map(float, plain), np.float64, len(cells))
    except ValueError:
        return None


_BRACKETED = re.compile(r"[\[(]\s*([^\[\]()]{0,30}?)\s*[\])]")
_PREFIXED = r"[numµμkMGcdhT]?(?:m|g|A|V|W|N|Nm|J|K|Pa|Hz|Ω|[Oo]hm|C|F|H|T|L|l|mol|s|rad|bar|VA|Wh|eV|B|Bd|dB|t)"
_OTHERS = (
    r"%|‰|°[CFK]?|℃|deg(?:C|F|K)?|rpm|RPM|U/min|rev|sec|second|seconds|min|minutes|h|hr|hours|d|days|counts?|psi|in|ft|"
    r"lbf|inch|ppm|px|digits?|inc|volts?|amps?|ampere|newton|met(?:er|re)s?|degrees?|radians?|-"
)
_ATOM = rf"(?:{_PREFIXED}|{_OTHERS})(?:\^?-?\d|[²³]|⁻[¹²³])?"
_UNIT = re.compile(rf"(?:1\s*/\s*)?{_ATOM}(?:\s*[*·/ ]\s*{_ATOM})*")
_NONE = frozenset({"", "-", "1"})


def units_in(cells: Sequence[str]) -> list[str] | None:
    """Return the units in a row whose cells are bracketed, known units or empty; None for any other row."""
    units = []
    for cell in cells:
        bracketed = _BRACKETED.fullmatch(cell.strip())
        text = bracketed[1] if bracketed else cell.strip()
        is_unit = _UNIT.fullmatch(text) and (text == "nA" or not is_number(text, None))  # "na" is a missing value
        if text and not bracketed and not is_unit:
            return None
        units.append("" if text in _NONE else text)
    return units if any(units) else None


def with_units(names: Sequence[str], units: Sequence[str]) -> tuple[str, ...]:
    """Append the units to the names that do not state one."""
    given = [*units, *[""] * (len(names) - len(units))]
    return tuple(
        f"{name} [{unit}]" if unit not in _NONE and not unit_of(name) else name
        for name, unit in zip(names, given, strict=False)
    )
