"""Numbers in the cells of a column: decimal point or comma, thousands separators, missing values."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replant.data.logs.text_cells import parse_number, quote

_PLAIN = re.compile(r"[+-]?(?:\d+(?P<mark>[.,])\d*|(?P<first>[.,])\d+)(?:[eE][+-]?\d+)?")
_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}(?:(?P<mark>[.,])\d{3})(?:(?P=mark)\d{3})*(?P<end>[.,]\d*(?:[eE][+-]?\d+)?)?")


class NumberError(ValueError):
    """A cell that is no number; ``index`` is its place among the cells."""

    def __init__(self, index: int, problem: str) -> None:
        super().__init__(problem)
        self.index = index


class TwoMarksError(NumberError):
    """A cell with another decimal mark than the other cells, or perhaps a thousands separator."""


@dataclass(frozen=True)
class DecimalMark:
    """What separates the fraction of the numbers of a log."""

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
    """Return the decimal mark of a cell; None if it has none, or is no number.

    Examples
    --------
    >>> mark_of("0,5", 2)
    DecimalMark(mark=',', line=2, cell='0,5', certain=True, grouped=False)
    >>> mark_of("3.000,00", 2).mark, mark_of("1.234", 2).certain, mark_of("7", 2)
    (',', False, None)
    """
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
    """Return the first certain mark, else the first one; it is grouped if one with the same mark is.

    Examples
    --------
    >>> common_mark([mark_of("1.234", 2), mark_of("1.234,5", 3)]).mark
    ','
    """
    found = [mark for mark in marks if mark is not None]
    certain = [mark for mark in found if mark.certain]
    if not found:
        return None
    best = (certain or found)[0]
    grouped = any(mark.grouped and mark.mark == best.mark for mark in found)
    return DecimalMark(best.mark, best.line, best.cell, best.certain, grouped)


def parse_numbers(cells: Sequence[str], mark: DecimalMark | None) -> NDArray[np.float64]:
    """Turn the cells of a column into float64; a missing one is NaN.

    >>> parse_numbers(["3.000,25", "", "-2,5e-3"], mark_of("3.000,25", 2))
    array([ 3.00025e+03,          nan, -2.50000e-03])
    """
    mark = mark or DecimalMark(".", 0, "")
    if mark.mark == ",":
        plain = None if any("." in cell for cell in cells) else [cell.replace(",", ".") for cell in cells]
    else:
        plain = list(cells)
    values = None if plain is None else _plain_numbers(plain)
    if values is not None:
        return values
    values = np.empty(len(cells))
    for index, cell in enumerate(cells):
        try:
            values[index] = _number(cell, mark)
        except NumberError as error:
            error.index = index
            raise
        except ValueError:
            raise NumberError(index, f"{quote(cell)} is not a number") from None
    return values


def _number(cell: str, mark: DecimalMark) -> float:
    text = cell.strip()
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


def _plain_numbers(cells: Sequence[str]) -> NDArray[np.float64] | None:
    """Convert numbers at once, or return None if a cell is anything else."""
    text = "".join(cells)
    if "_" in text or not text.isascii():
        return None
    try:
        return np.fromiter(map(float, cells), np.float64, len(cells))
    except ValueError:
        return None
