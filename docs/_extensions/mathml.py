"""Formulas as MathML, which every browser draws by itself: no script, no picture, nothing to fetch."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util import logging
from sphinx.util.math import wrap_displaymath

if TYPE_CHECKING:
    from docutils import nodes
    from sphinx.application import Sphinx
    from sphinx.writers.html5 import HTML5Translator

logger = logging.getLogger(__name__)
SIZES = re.compile(r"\\[bB]igg?[lmr]?(?![a-zA-Z])")  # of brackets, which docutils does not know; browsers stretch them


def converted(formula: str, node: nodes.Element, *, as_block: bool) -> str:
    """Return the MathML of a LaTeX formula; one that cannot be converted is a warning, and shown as it was written."""
    try:
        return tex2mathml(SIZES.sub("", formula).replace("\\dots", "\\ldots"), as_block=as_block)
    except MathError as reason:
        logger.warning("this formula cannot be converted: %s", reason, location=node)
        return f"<code>{formula}</code>"


def visit_inline(self: HTML5Translator, node: nodes.math) -> None:
    """Write a formula within a line."""
    from docutils.nodes import SkipNode

    self.body.append(converted(node.astext(), node, as_block=False))
    raise SkipNode


def visit_block(self: HTML5Translator, node: nodes.math_block) -> None:
    """Write a formula on lines of its own."""
    from docutils.nodes import SkipNode

    formula = node.astext()
    if "\\\\" in formula and "\\begin" not in formula:
        formula = wrap_displaymath(formula, None, numbering=False).replace("split", "aligned")
    number = f'<span class="eqno">({node["number"]})</span>' if node.get("number") else ""
    anchor = f' id="equation-{node["label"]}"' if node.get("label") else ""
    self.body.append(f'<div class="math"{anchor}>{number}{converted(formula, node, as_block=True)}</div>\n')
    raise SkipNode


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the renderer under the name `mathml`."""
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
