"""The end of a text log: whether its last line was cut off, as by a power cut while it was written."""

from __future__ import annotations

import codecs
import re
from pathlib import Path

from replant.data.logs.text_cells import CellError, split_line
from replant.data.logs.text_layout import Layout, is_data

_TAIL_BYTES = 1 << 16
"""End of a file in which its last line is looked for [bytes]."""
_BEGUN_NUMBER = re.compile(r"[+-]|[+-]?\d*[.,]?\d*[eE][+-]?")


def cut_line(path: Path, layout: Layout) -> str:
    r"""Return the last line if its writer was stopped in the middle of it, else an empty string.

    Such a line has no line feed, and fewer cells than there are columns, or a number at its end that breaks off.

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
    line = unended_line(path, layout.encoding)
    if not is_data(line):
        return ""
    try:
        cells = split_line(line, layout.delimiter)
    except CellError:
        return line
    is_short = len(cells) < len(layout.names)
    return line if is_short or _BEGUN_NUMBER.fullmatch(cells[-1]) else ""


def unended_line(path: Path, encoding: str) -> str:
    """Return the last line if it is not the first one and has no end."""
    with path.open("rb") as file:
        head = file.read(2)
        end = file.seek(0, 2)
        start = max(0, end - _TAIL_BYTES) // 4 * 4  # a character of UTF-16 is not cut
        file.seek(start)
        tail = file.read()
    if encoding == "utf-16":
        encoding = "utf-16-le" if head == codecs.BOM_UTF16_LE else "utf-16-be"
    lines = tail.decode(encoding, errors="replace").replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return lines[-1] if len(lines) > 1 else ""
