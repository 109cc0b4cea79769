"""docs/modules.md: every folder and module of the package with the first line of its docstring."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "replant"
PAGE = ROOT / "docs" / "modules.md"

_HEAD = """# Every module of the package

*In which module does a line of code belong?*

This page is made from the first line of each module of `src/replant` by `make pages`. Which folder may import which is
described in [Architecture](architecture.md).
"""


def page() -> str:
    """Return the page."""
    parts = [_HEAD]
    for folder in sorted({path.parent for path in SOURCE.rglob("*.py")}):
        name = folder.relative_to(SOURCE).as_posix()
        title = "The top of the package" if folder == SOURCE else f"`{name}`"
        modules = [path for path in sorted(folder.glob("*.py")) if path.name != "__init__.py"]
        listed = [f"- `{path.stem}` – {first_line(path)}" for path in modules]
        paragraphs = [f"## {title}", first_line(folder / "__init__.py"), *(["\n".join(listed)] if listed else [])]
        parts.append("\n\n".join(paragraphs) + "\n")
    return "\n".join(parts)


def first_line(path: Path) -> str:
    """Return the first paragraph of a module's docstring, as Markdown."""
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    text = " ".join(docstring.split("\n\n")[0].split())
    return text.replace("``", "`").replace(":math:", "")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
