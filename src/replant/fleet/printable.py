"""Printable: file names whose bytes are no valid text, made printable."""

from __future__ import annotations


def printable(text: str) -> str:
    r"""Return a text with the bytes of a file's name that are no UTF-8 written out: tables and pages hold text alone.

    Examples
    --------
    >>> print(printable("rig \udcff.csv"))
    rig \udcff.csv
    """
    return text.encode("utf-8", "backslashreplace").decode("utf-8")
