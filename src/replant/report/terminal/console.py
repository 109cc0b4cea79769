"""The terminal: texts in styles, tables, lines broken at its width, and lines drawn again in place."""

from __future__ import annotations

import contextlib
import os
import re
import sys
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TextIO

#: The numbers of the escape sequences of the words that a style is made of.
CODES = {"bold": 1, "dim": 2, "red": 31, "green": 32, "yellow": 33}
USUAL_SIZE = (80, 25)  # where there is no terminal [columns, lines]
CUT = "…"  # in place of what does not fit
#: Control characters of what comes from a file, as a column's name: they would move the cursor.
CONTROL = dict.fromkeys({*range(32), 127} - {9, 10})


class Text:
    """Parts side by side, plain or with a style, as ``("trusted", "bold green")``; ``cut``: what does not fit goes."""

    def __init__(self, *parts: str | tuple[str, str], cut: bool = False) -> None:
        pairs = ((part, "") if isinstance(part, str) else part for part in parts)
        self.parts = [(text.translate(CONTROL), style) for text, style in pairs]
        self.cut = cut

    def __str__(self) -> str:
        return "".join(text for text, _ in self.parts)

    @classmethod
    def of(cls, shown: str | Text, style: str = "") -> Text:
        """Return something that is shown as a text, each of its parts in one more style."""
        text = shown if isinstance(shown, Text) else cls(shown)
        return cls(*((part, f"{own} {style}".strip()) for part, own in text.parts), cut=text.cut)

    def lines(self, width: int | None = None) -> list[Text]:
        """Return its lines, broken between words at a width, without blanks at their ends."""
        begin, found = 0, []
        for line in str(self).split("\n"):
            if self.cut and width is not None and cells(line) > width:
                kept = self._part(begin, begin + fitting(line, width - 1))
                found.append(Text(*kept.parts, CUT))
            else:
                ends = [0, *(() if width is None else _breaks(line, max(width, 1))), len(line)]
                pieces = ((one, one + len(line[one:other].rstrip())) for one, other in pairwise(ends))
                found += [self._part(begin + one, begin + other) for one, other in pieces]
            begin += len(line) + 1
        return found

    def _part(self, begin: int, end: int) -> Text:
        at, parts = 0, []
        for text, style in self.parts:
            piece = text[max(begin - at, 0) : max(end - at, 0)]
            at += len(text)
            if piece:
                parts.append((piece, style))
        return Text(*parts)

    def coded(self) -> str:
        """Return it with the escape sequences of its styles."""
        return "".join(_coded(text, style) for text, style in self.parts)


def _coded(text: str, style: str) -> str:
    codes = [str(CODES[word]) for word in style.split()]
    return f"\x1b[{';'.join(codes)}m{text}\x1b[0m" if codes else text


def cells(text: str) -> int:
    """Return the columns of a terminal that a text takes."""
    return len(text) if text.isascii() else sum(map(_width, text))


def _width(character: str) -> int:
    return 0 if unicodedata.combining(character) else 1 + (unicodedata.east_asian_width(character) in "WF")


def fitting(text: str, width: int) -> int:
    """Return how many of the first characters fit into so many columns."""
    taken = 0
    for number, character in enumerate(text):
        taken += _width(character)
        if taken > width:
            return number
    return len(text)


def _breaks(line: str, width: int) -> list[int]:
    """Return where a line is broken: before words that do not fit, and within those longer than a line."""
    room, found = width, []
    for word in re.finditer(r"\s*\S+\s*", line):
        at, text = word.start(), word[0]
        if cells(text.rstrip()) > room < width:
            found.append(at)
            room = width
        while cells(text.rstrip()) > room:
            taken = max(fitting(text, room), 1)
            at, text = at + taken, text[taken:]
            found.append(at)
        room -= cells(text)
    return found


@dataclass(frozen=True)
class Column:
    """A column: its heading, whether cells are flush right, and whether they may be broken."""

    heading: Text
    right: bool
    breaks: bool


class Table:
    """Rows below headings; ``ruled``: with a rule below these and an empty line between rows."""

    def __init__(self, *headings: str, gap: int = 2, ruled: bool = False) -> None:
        self.columns: list[Column] = []
        self.rows: list[list[Text]] = []
        self._gap, self._ruled = gap, ruled
        for heading in headings:
            self.column(heading)

    def column(self, heading: str, *, right: bool = True, breaks: bool = True) -> None:
        """Add a column."""
        self.columns.append(Column(Text((heading, "bold")), right, breaks))

    def row(self, *shown: str | Text, style: str = "") -> None:
        """Add a row."""
        self.rows.append([Text.of(each, style) for each in shown])

    def lines(self, width: int) -> list[Text]:
        """Return its lines for so many columns: cells are broken, and cut off only where that is not enough."""
        widths = self._widths(width)
        lines = self._side_by_side([column.heading for column in self.columns], widths)
        if self._ruled:
            lines.append(Text(" " + "─" * (sum(widths) + self._gap * (len(widths) - 1))))
        for number, row in enumerate(self.rows):
            lines += [Text()] if self._ruled and number else []
            lines += self._side_by_side(row, widths)
        return [Text(), *lines, Text()] if self._ruled else lines

    def _widths(self, room: int) -> list[int]:
        """Return the columns' widths, the widest made narrower as long as all together do not fit."""
        widths = [
            max(cells(line) for text in (column.heading, *cut) for line in str(text).split("\n"))
            for column, *cut in zip(self.columns, *self.rows, strict=True)
        ]
        room -= self._gap * (len(widths) - 1) + 2 * self._ruled
        while sum(widths) > room and max(widths) > 1:
            able = [k for k, column in enumerate(self.columns) if column.breaks and widths[k] > 1] or range(len(widths))
            widths[max(able, key=widths.__getitem__)] -= 1
        return widths

    def _side_by_side(self, row: Sequence[Text], widths: Sequence[int]) -> list[Text]:
        columns = [
            Text(*text.parts, cut=not column.breaks).lines(width)
            for text, column, width in zip(row, self.columns, widths, strict=True)
        ]
        lines = []
        for number in range(max(map(len, columns))):
            parts: list[str | tuple[str, str]] = [" "] if self._ruled else []
            for cell, column, width in zip(columns, self.columns, widths, strict=True):
                line = cell[number] if number < len(cell) else Text()
                blank = " " * (width - cells(str(line)))
                parts += [blank, *line.parts] if column.right else [*line.parts, blank]
                parts.append(" " * self._gap)
            lines += Text(*parts).lines()
        return lines


class Console:
    """Standard output, or another stream; colours where it is a terminal, as NO_COLOR, FORCE_COLOR and TERM say."""

    def __init__(self, stream: TextIO | None = None, *, stderr: bool = False, width: int | None = None) -> None:
        self._given, self._stderr, self._width = stream, stderr, width

    @property
    def stream(self) -> TextIO:
        """Where it writes to."""
        return self._given or (sys.stderr if self._stderr else sys.stdout)

    @property
    def width(self) -> int:
        """The columns of a line; that of the variable COLUMNS is right."""
        return self._width or _size()[0]

    @property
    def is_terminal(self) -> bool:
        """Whether it can draw again in place."""
        return self.stream.isatty() and os.environ.get("TERM") not in ("dumb", "unknown")

    @property
    def _coloured(self) -> bool:
        forced = bool(os.environ.get("FORCE_COLOR"))
        return not os.environ.get("NO_COLOR") and (forced or self.is_terminal)

    def print(self, *shown: str | Text | Table, style: str = "", indent: int = 0, whole: bool = False) -> None:
        """Print things below each other; ``whole``: lines are not broken at the width."""
        for line in laid_out(shown or ("",), None if whole else self.width - indent, style):
            self.write(" " * indent + (line.coded() if self._coloured else str(line)))

    def write(self, text: str, *, newline: bool = True) -> None:
        """Write text with its escape sequences; on Windows click has them understood."""
        import click  # a library that is embedded in another program prints nothing

        click.echo(text, file=self.stream, color=True, nl=newline)


def laid_out(shown: Iterable[str | Text | Table], width: int | None, style: str = "") -> list[Text]:
    """Return the lines of things that are shown below each other."""
    lines: list[Text] = []
    for each in shown:
        own = each.lines(width or USUAL_SIZE[0]) if isinstance(each, Table) else Text.of(each, style).lines(width)
        lines += own
    return lines


class Redrawn:
    """Lines at a terminal, the next in the place of those before."""

    def __init__(self, console: Console) -> None:
        self._console, self._lines = console, 0

    def show(self, *shown: str | Text | Table) -> None:
        """Draw as many lines as the terminal has."""
        lines = laid_out(shown, self._console.width)[: max(_size()[1] - 1, 1)]
        self._console.write(self._back() + "".join(line.coded() + "\n" for line in lines), newline=False)
        self._lines = len(lines)

    def clear(self) -> None:
        """Remove them."""
        self._console.write(self._back(), newline=False)
        self._lines = 0

    def _back(self) -> str:
        return f"\x1b[{self._lines}A\r\x1b[J" if self._lines else ""


def _size() -> tuple[int, int]:
    """Return the columns and lines of the terminal: of the variables, else of the first stream that is one."""
    size = USUAL_SIZE
    for number in (0, 2, 1):  # output is often a pipe
        with contextlib.suppress(OSError):
            size = os.get_terminal_size(number)
            break
    given = (os.environ.get(name, "") for name in ("COLUMNS", "LINES"))
    columns, lines = (int(text) if text.isdecimal() else 0 for text in given)
    return columns or size[0], lines or size[1]
