"""A command's help, whose text is not markup, and the examples at its end, as a block of shell."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx


def as_shell(app: Sphinx, context: Any, lines: list[str]) -> None:
    """Rewrite the epilog of a command, which sphinx-click gives as a block of lines: a heading, then the examples."""
    plain = [line.removeprefix("|").strip() for line in lines]
    if plain and plain[0] == "Examples:":
        lines[:] = ["**Examples**", "", ".. code-block:: sh", "", *(f"   {line}" for line in plain[1:]), ""]


def as_plain(app: Sphinx, context: Any, lines: list[str]) -> None:
    """Escape what reStructuredText would take for emphasis or for a link, as of ``*.csv`` or ``tcp://HOST:PORT``."""
    lines[:] = [re.sub(r"\*|\b[a-z]+://", r"\\\g<0>", line) for line in lines]


def setup(app: Sphinx) -> dict[str, Any]:
    """Listen to sphinx-click."""
    app.setup_extension("sphinx_click")
    app.connect("sphinx-click-process-epilog", as_shell)
    app.connect("sphinx-click-process-description", as_plain)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
