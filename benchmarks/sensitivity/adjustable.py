"""A copy of the package whose constants a fresh process can set as it imports them, kernels included.

Python modules: each assignment of a constant asks for its value, so whoever imports the name, and whatever is derived
from it, sees that.  Compiled kernels take constants as literals: those of the copy are compiled anew, in seconds, for
each value of a constant of theirs.
"""

from __future__ import annotations

import ast
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

RUNTIME = '''"""The values of constants in this copy of the package, see benchmarks/sensitivity/adjustable.py."""

import json
import os

CHANGED = json.loads(os.environ.get("ADJUSTED_CONSTANTS", "{}"))


def value(name, usual):
    """Return the value of a constant in this process."""
    now = CHANGED.get(name, usual)
    return tuple(now) if isinstance(usual, tuple) else now
'''


def make_copy(source: Path, target: Path, values: Mapping[str, Any]) -> None:
    """Copy the package ``source`` to ``target``/src with constants, as "numerics.levels.ALPHA", adjustable."""
    copy, unwanted = target / "src" / "replant", shutil.ignore_patterns("__pycache__", "compiled")
    shutil.copytree(source, copy, ignore=unwanted)
    shutil.copytree(source.parents[1] / "tools" / "translator", target / "tools" / "translator", ignore=unwanted)
    (target / "src" / "adjusted.py").write_text(RUNTIME, encoding="utf-8")
    for path in sorted(copy.rglob("*.py")):
        module = ".".join(path.relative_to(copy).with_suffix("").parts)
        text = path.read_text(encoding="utf-8")
        changed = _changed(module, ast.parse(text), values, text)
        if changed != text:
            path.write_text(changed, encoding="utf-8")


def _changed(module: str, tree: ast.Module, values: Mapping[str, Any], text: str) -> str:
    """Return the text of a module whose constants ask for their values."""
    found = [*_assignments(module, tree, values, text)]
    if not found:
        return text
    lines = text.splitlines(keepends=True)
    for node, new in sorted(found, key=lambda pair: (pair[0].lineno, pair[0].col_offset), reverse=True):
        first, last = node.lineno - 1, (node.end_lineno or node.lineno) - 1
        before, after = lines[first].encode()[: node.col_offset], lines[last].encode()[node.end_col_offset :]
        lines[first : last + 1] = [(before + new.encode() + after).decode()]
    place = next(
        i for i, node in enumerate(tree.body)
        if not (isinstance(node, ast.Expr) or (isinstance(node, ast.ImportFrom) and node.module == "__future__"))
    )  # fmt: skip
    lines.insert(tree.body[place].lineno - 1, "import adjusted\n")
    return "".join(lines)


def _assignments(module: str, tree: ast.Module, values: Mapping[str, Any], text: str) -> Iterator[tuple[ast.expr, str]]:
    for node in tree.body:
        target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
        name = f"{module}.{target.id}" if isinstance(target, ast.Name) else ""
        if name in values:
            plain = ast.get_source_segment(text, node.value)  # type: ignore[attr-defined]
            yield node.value, f'adjusted.value("{name}", ({plain}))'  # type: ignore[attr-defined]
