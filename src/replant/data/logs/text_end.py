"""The end of a text log: whether its last line was cut off, as by a power cut while it was written."""

from __future__ import annotations

import codecs
from pathlib import Path

from replant.data.logs.text_cells import CellError, split_line
from replant.data.logs.text_columns import parse_column
from replant.data.logs.text_layout import Layout, is_data
from replant.errors import LogError

_TAIL_BYTES = 1 << 16  # end of a file in which its last line is looked for [bytes]


def cut_line(path: Path, layout: Layout) -> str:
    r"""Return the last line if its writer was stopped in the middle of it, else an empty string.

    Such a line has no line feed, and fewer cells than there are columns, or a last cell that cannot be read, as that of
    the line before can.

    Examples
    --------
    >>> import tempfile
    >>> layout = Layout(("t", "u", "y"), ",", 1, 2, "utf-8")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "log.csv")
    ...     _ = file.write_text("t,u,y\n0,1,2\n1,2,3\n2,3")
    ...     cut_line(file, layout)
    '2,3'
    """
    before, line = _last_lines(path, layout.encoding)
    if not is_data(line):
        return ""
    last, width = _cells(line, layout), len(layout.names)
    if last is None or len(last) < width:
        return line
    previous = _cells(before, layout)
    was_readable = previous is not None and len(previous) >= width and _is_readable(path, layout, previous)
    return line if was_readable and not _is_readable(path, layout, last) else ""


def _cells(line: str, layout: Layout) -> list[str] | None:
    try:
        return split_line(line, layout.delimiter)
    except CellError:
        return None


def _is_readable(path: Path, layout: Layout, cells: list[str]) -> bool:
    """Return whether the last cell of a row is a number, a time stamp or missing, as its column is."""
    try:
        parse_column(path, layout, [(0, cells)], len(layout.names) - 1)
    except LogError:
        return False
    return True


def unended_line(path: Path, encoding: str) -> str:
    """Return the last line if it is not the first one and has no end, else an empty string."""
    return _last_lines(path, encoding)[1]


def _last_lines(path: Path, encoding: str) -> tuple[str, str]:
    """Return the line before the last one, and the last one if it is not the first one and has no end."""
    with path.open("rb") as file:
        head = file.read(2)
        end = file.seek(0, 2)
        start = max(0, end - _TAIL_BYTES) // 4 * 4  # a character of UTF-16 is not cut
        file.seek(start)
        tail = file.read()
    if encoding == "utf-16":
        encoding = "utf-16-le" if head == codecs.BOM_UTF16_LE else "utf-16-be"
    lines = tail.decode(encoding, errors="replace").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return (lines[-2], lines[-1]) if len(lines) > 1 else ("", "")
