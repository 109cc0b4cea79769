"""The pages: each answers a question, its blocks are run, its links lead somewhere, all names are in the reference.

    python tools/pages.py

It prints each fault with its page; no fault, no output.  tests/test_page_cells.py runs the cells,
tests/test_built_site.py builds the site, `typos` looks at the spelling.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import replant

ROOT = Path(__file__).resolve().parents[1]
#: Pages whose blocks tests/test_documentation.py runs as they stand.
RUN_AS_THEY_STAND = ("README.md", "docs/models.md")
#: Blocks that a test finds by what is in them.
RUN_BY_NAME = {"docs/how-to/broker.md": ("import paho.mqtt.client",)}
FENCE = re.compile(r"^(?P<mark>`{3,})(?P<kind>[^\n`]*)\n(?P<text>.*?)^(?P=mark)\s*$", re.DOTALL | re.MULTILINE)
BLOCK = re.compile(r"^(?P<why><!-- not run: .+? -->\n)?```(?:sh|python)\n(?P<text>.*?)^```", re.DOTALL | re.MULTILINE)
HEADER = "---\nfile_format: mystnb\nkernelspec:\n  name: python3\n---\n"
LINK = re.compile(r"(?<!!)\[[^\]]*\]\((?!https?:|mailto:)(?P<path>[^)#\s]*)(?:#(?P<anchor>[^)\s]*))?\)")
PICTURE = re.compile(r"!\[[^\]]*\]\((?!https?:)(?P<path>[^)\s]+)\)")
DOWNLOAD = re.compile(r"\{download\}`[^<`]*<(?P<path>[^>`]+)>`")


class Pages:
    """The pages of a folder: those of its docs, and what is written beside them."""

    def __init__(self, root: Path = ROOT) -> None:
        self.root, self.docs = root, root / "docs"
        self.site = sorted(path.relative_to(root).as_posix() for path in self.docs.rglob("*.md"))
        beside = [*root.glob("*.md"), *(root / ".github").rglob("*.md")]
        self.written = [*self.site, *sorted(path.relative_to(root).as_posix() for path in beside)]

    def text(self, page: str) -> str:
        """Return a page."""
        return (self.root / page).read_text(encoding="utf-8")

    def prose(self, page: str) -> str:
        """Return a page without its blocks of code and without code in its lines."""
        return re.sub(r"`[^`\n]*`", "", FENCE.sub("", self.text(page)))


def anchor_of(heading: str) -> str:
    """Return the anchor of a heading, as GitHub and MyST make it.

    Examples
    --------
    >>> anchor_of("The JSON, in `words`")
    'the-json-in-words'
    """
    return re.sub(r"[^\w\- ]", "", heading.replace("`", "").strip().lower()).replace(" ", "-")


def anchors_of(path: Path) -> set[str]:
    """Return the anchors of all headings of a page."""
    text = FENCE.sub("", path.read_text(encoding="utf-8"))
    return {anchor_of(heading) for heading in re.findall(r"^#+ (.+)$", text, re.MULTILINE)}


def of_the_question(pages: Pages, page: str) -> Iterator[str]:
    """A page begins with its title and the question that it answers."""
    body = re.sub(r"\A---\n.*?^---\n", "", pages.text(page), flags=re.DOTALL | re.MULTILINE).strip()
    title, first, *_ = [*body.split("\n\n"), ""]
    if not re.fullmatch(r"# .+", title):
        yield "does not begin with a title"
    elif not re.fullmatch(r"\*[^*]+\?\*", first.strip().replace("\n", " ")):
        yield f"its title is not followed by a question in italics, but by {first[:40]!r}"


def of_the_blocks(pages: Pages, page: str) -> Iterator[str]:
    """Every block of code is a cell that is run, is run by a test, or says above it why not."""
    text = pages.text(page)
    if "```{code-cell}" in text and not text.startswith(HEADER):
        yield "has cells, but not the header without which none of them is executed"
    for block in BLOCK.finditer(text) if page not in RUN_AS_THEY_STAND else ():
        if not block["why"] and not any(words in block["text"] for words in RUN_BY_NAME.get(page, ())):
            first = block["text"].partition("\n")[0]
            yield f"{first!r} is not run: make it a {{code-cell}}, or say why above it: <!-- not run: reason -->"


def of_the_links(pages: Pages, page: str) -> Iterator[str]:
    """Links, pictures and downloads lead somewhere."""
    folder = (pages.root / page).parent
    for found in LINK.finditer(pages.prose(page)):
        target = (folder / found["path"]).resolve() if found["path"] else pages.root / page
        if not target.exists():
            yield f"{found[0]} leads nowhere"
        elif found["anchor"] and target.suffix == ".md" and found["anchor"] not in anchors_of(target):
            yield f"{found[0]}: {target.name} has no such heading"
    for found in [*PICTURE.finditer(pages.prose(page)), *DOWNLOAD.finditer(pages.text(page))]:
        if not (folder / found["path"]).is_file():
            yield f"{found[0]} leads nowhere"


def of_the_indices(pages: Pages, page: str) -> Iterator[str]:
    """Each folder with pages has an index, which lists what lies in it; the pages of `docs` itself are named in one."""
    folder = (pages.root / page).parent
    if folder != pages.docs:
        if not (folder / "index.md").is_file():
            yield "lies in a folder without an index.md"
        return
    indices = "\n".join(pages.text(each) for each in pages.site if each.endswith("index.md"))
    entries = re.findall(r"^/?([\w*-]+)$", indices, re.MULTILINE)
    named = [re.compile(entry.replace("*", ".*") + r"\Z") for entry in entries if entry != "*"]
    name = Path(page).stem
    if name != "index" and not any(one.match(name) for one in named):
        yield "stands in no index.md"


def of_the_reference(pages: Pages) -> Iterator[str]:
    """Every public name is in the reference."""
    text = "\n".join(pages.text(page) for page in pages.site if page.startswith("docs/reference/"))
    documented = set(re.findall(r"^\.\. auto(?:class|function|exception):: ([\w.]+)$", text, re.MULTILINE))
    modules = {name: f"replant.{name}." for name in ("examples", "fleet", "rigs", "signals")}
    modules["figures"] = "replant.report.figures."
    for name in replant.__all__:
        inside = name in modules and any(path.startswith(modules[name]) for path in documented)
        if name not in documented and name != "__version__" and not inside:
            yield f"docs/reference: replant.{name} is not documented"


def faults(pages: Pages) -> Iterator[str]:
    """Yield what is to be mended, a line each."""
    for rule in (of_the_question, of_the_blocks, of_the_indices):
        yield from (f"{page}: {fault}" for page in pages.site for fault in rule(pages, page))
    yield from (f"{page}: {fault}" for page in pages.written for fault in of_the_links(pages, page))
    yield from of_the_reference(pages)


if __name__ == "__main__":
    sys.exit("\n".join(faults(Pages())) or 0)
