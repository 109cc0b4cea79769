"""The examples at the end of a command's help, as a block of shell."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx


def as_shell(app: Sphinx, context: Any, lines: list[str]) -> None:
    """Rewrite the epilog of a command, which sphinx-click gives as a block of lines: a heading, then the examples."""
    plain = [line.removeprefix("|").strip() for line in lines]
    if plain and plain[0] == "Examples:":
        lines[:] = ["**Examples**", "", ".. code-block:: sh", "", *(f"   {line}" for line in plain[1:]), ""]


def setup(app: Sphinx) -> dict[str, Any]:
    """Listen to sphinx-click."""
    app.setup_extension("sphinx_click")
    app.connect("sphinx-click-process-epilog", as_shell)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
