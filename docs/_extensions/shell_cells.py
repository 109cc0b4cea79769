"""Executed shell blocks: a cell that begins with ``%%sh -e`` is shown without that line, and as shell."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from docutils import nodes
from sphinx.transforms import SphinxTransform

if TYPE_CHECKING:
    from sphinx.application import Sphinx

MAGIC = "%%sh -e\n"


class ShellCells(SphinxTransform):
    """Makes shell blocks of cells that IPython gives to a shell."""

    default_priority = 850

    def apply(self, **kwargs: Any) -> None:
        """Rewrite the literal blocks of one page."""
        for block in self.document.findall(nodes.literal_block):
            if block.astext().startswith(MAGIC):
                text = block.astext().removeprefix(MAGIC)
                block["language"] = "sh"
                block.rawsource = text
                block.children = [nodes.Text(text)]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the transform."""
    app.add_transform(ShellCells)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
