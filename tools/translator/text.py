"""Small parts of text: of C that comes out, and of Python that goes in."""

from __future__ import annotations

import io
import re
import tokenize


def bare(code: str) -> str:
    """Return an expression without the parentheses around all of it."""
    if not (code.startswith("(") and code.endswith(")")):
        return code
    depth = 0
    for place, letter in enumerate(code):
        depth += (letter == "(") - (letter == ")")
        if depth == 0 and place < len(code) - 1:
            return code
    return code[1:-1]


def product(code: str, first: int, dimensions: int) -> str:
    """Return the product of an array's sizes from an axis on; "" where there is none."""
    return " * ".join(f"{code}.n{axis}" for axis in range(first, dimensions))


def short(module: str) -> str:
    """Return the last part of a module's name; the schema is known as ``at`` everywhere."""
    last = module.rpartition(".")[2]
    return "at" if last == "schema" else last


def comments_of(source: str) -> dict[int, tuple[str, bool]]:
    """Return the comments by line, and whether nothing else stands on it."""
    found = {}
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT and not token.string.startswith(("# noqa", "# fmt", "# type")):
            text = token.string.lstrip("# ").replace("*/", "* /")
            found[token.start[0]] = text, not token.line[: token.start[1]].strip()
    return found


#: A variable, or what a parameter points to; or a part of such a tuple.
PATH = re.compile(r"(\(\*)?(?P<root>\w+)\)?(?:(?:\.|->)f\d+)*")


def field(code: str, index: int) -> str:
    """Return a part of a tuple."""
    return f"{code[2:-1]}->f{index}" if code.startswith("(*") and code.endswith(")") else f"{code}.f{index}"


def pointer(code: str) -> str:
    """Return where a tuple is; "" for one that has no place yet."""
    if code.startswith("(*") and code.endswith(")"):
        return code[2:-1]
    return f"&{code}" if PATH.fullmatch(code) or code.startswith("(parts") else ""
