"""Encoding: text for a terminal or file that cannot show every character is written in ASCII, without an error."""

from __future__ import annotations

import codecs
import io
import re
import sys

PLAIN = "replant.plain"  # the error handler's name

_SIGNS = str.maketrans({"±": "+-", "−": "-", "–": "-", "×": "x", "µ": "u", "μ": "u", "°": "deg", "∞": "inf"})
_SUPERSCRIPTS = "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"
_LOWERED = str.maketrans(_SUPERSCRIPTS, "-0123456789")


def replace_unencodable() -> None:
    """Have standard output and error write ASCII for characters that their encoding lacks."""
    codecs.register_error(PLAIN, _replaced)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=PLAIN)


def to_ascii(text: str) -> str:
    r"""Return text in ASCII; a character without a similar one in ASCII is written as its number.

    Examples
    --------
    >>> to_ascii("(1.2 ± 0.1)×10⁻⁷"), to_ascii("Döner")
    ('(1.2 +- 0.1)x10^-7', 'D\\xf6ner')
    """
    text = re.sub(f"[{_SUPERSCRIPTS}]+", lambda found: "^" + found[0].translate(_LOWERED), text)
    return text.translate(_SIGNS).encode("ascii", "backslashreplace").decode("ascii")


def _replaced(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return to_ascii(error.object[error.start : error.end]), error.end
