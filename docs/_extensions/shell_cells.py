"""Executed shell blocks, and what cells print.

A cell that begins with ``%%sh -e`` is shown without that line, and as shell.  What a cell prints comes in pieces, as
the kernel empties its buffer; they are put together here, because MyST-NB ends each of them with a line break.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from docutils import nodes
from sphinx.transforms import SphinxTransform

if TYPE_CHECKING:
    from sphinx.application import Sphinx

MAGIC = "%%sh -e\n"


def replace(block: nodes.literal_block, text: str) -> None:
    """Give a literal block another text."""
    block.rawsource = text
    block.children = [nodes.Text(text)]


class ShellCells(SphinxTransform):
    """Makes shell blocks of cells that IPython gives to a shell."""

    default_priority = 850

    def apply(self, **kwargs: Any) -> None:
        """Rewrite the literal blocks of one page."""
        for block in self.document.findall(nodes.literal_block):
            if block.astext().startswith(MAGIC):
                block["language"] = "sh"
                replace(block, block.astext().removeprefix(MAGIC))


class WholeStreams(SphinxTransform):
    """Puts the pieces of a cell's standard output, and those of its standard error, together."""

    default_priority = 851

    def apply(self, **kwargs: Any) -> None:
        """Join the blocks of each cell of one page."""
        for cell in list(self.document.findall(nodes.container)):
            blocks = [one for one in cell.children if isinstance(one, nodes.literal_block)]
            if "cell_output" in cell["classes"]:
                for kind in ("stream", "stderr"):
                    join([one for one in blocks if kind in one["classes"]])


def join(pieces: list[nodes.literal_block]) -> None:
    """Put the text of all pieces into the first, and remove the others."""
    if len(pieces) > 1:
        replace(pieces[0], "".join(piece.astext() for piece in pieces))
        for piece in pieces[1:]:
            piece.parent.remove(piece)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the transforms."""
    app.add_transform(ShellCells)
    app.add_transform(WholeStreams)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
