"""The pages of the site: each answers a question, its blocks run, its links lead somewhere, its spelling is right.

test_page_cells.py runs their code cells; test_built_site.py builds the pages with warnings as errors.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import replant
from support.cases import every
from support.places import ROOT
from test_documentation import PAGES as RUN_HERE

DOCS = ROOT / "docs"
PAGES = sorted(path.relative_to(ROOT).as_posix() for path in DOCS.rglob("*.md"))
WRITTEN = [*PAGES, "README.md", "CHANGELOG.md", "CONTRIBUTING.md"]
#: Blocks that a test finds by what is in them.
RUN_BY_NAME = {"docs/how-to/broker.md": ("import paho.mqtt.client",)}
FENCE = re.compile(r"^(?P<mark>`{3,})(?P<kind>[^\n`]*)\n(?P<text>.*?)^(?P=mark)\s*$", re.DOTALL | re.MULTILINE)
BLOCK = re.compile(r"^(?P<why><!-- not run: .+? -->\n)?```(?:sh|python)\n(?P<text>.*?)^```", re.DOTALL | re.MULTILINE)
HEADER = "---\nfile_format: mystnb\nkernelspec:\n  name: python3\n---\n"
LINK = re.compile(r"(?<!!)\[[^\]]*\]\((?!https?:|mailto:)(?P<path>[^)#\s]*)(?:#(?P<anchor>[^)\s]*))?\)")
PICTURE = re.compile(r"!\[[^\]]*\]\((?!https?:)(?P<path>[^)\s]+)\)")


def text_of(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def prose_of(page: str) -> str:
    """Return a page without its blocks of code and without code in its lines."""
    return re.sub(r"`[^`\n]*`", "", FENCE.sub("", text_of(page)))


def anchor_of(heading: str) -> str:
    """Return the anchor of a heading, as GitHub and MyST make it.

    >>> anchor_of("The JSON, in `words`")
    'the-json-in-words'
    """
    return re.sub(r"[^\w\- ]", "", heading.replace("`", "").strip().lower()).replace(" ", "-")


def anchors_of(path: Path) -> set[str]:
    text = FENCE.sub("", path.read_text(encoding="utf-8"))
    return {anchor_of(heading) for heading in re.findall(r"^#+ (.+)$", text, re.MULTILINE)}


@every("page", PAGES)
def test_a_page_begins_with_the_question_that_it_answers(page: str) -> None:
    body = re.sub(r"\A---\n.*?^---\n", "", text_of(page), flags=re.DOTALL | re.MULTILINE).strip()
    title, first, *_ = body.split("\n\n")
    assert re.fullmatch(r"# .+", title)
    assert re.fullmatch(r"\*[^*]+\?\*", first.strip().replace("\n", " ")), f"a question in italics, not: {first}"


@every("page", PAGES)
def test_every_block_of_code_is_run(page: str) -> None:
    """By test_page_cells.py if it is a code cell, by another test, or not for a reason that stands above it."""
    if page in RUN_HERE:
        return
    left = [
        block["text"]
        for block in BLOCK.finditer(text_of(page))
        if not block["why"] and not any(words in block["text"] for words in RUN_BY_NAME.get(page, ()))
    ]
    assert left == [], "make it a {code-cell}, or say why above it: <!-- not run: reason -->"


@every("page", PAGES)
def test_a_page_with_cells_is_executed(page: str) -> None:
    """Without this header MyST-NB shows the cells of a page and executes none of them."""
    text = text_of(page)
    assert "```{code-cell}" not in text or text.startswith(HEADER)


@every("page", WRITTEN)
def test_links_within_the_repository_lead_somewhere(page: str) -> None:
    folder = (ROOT / page).parent
    for found in LINK.finditer(prose_of(page)):
        target = (folder / found["path"]).resolve() if found["path"] else ROOT / page
        assert target.exists(), found[0]
        if found["anchor"] and target.suffix == ".md":
            assert found["anchor"] in anchors_of(target), found[0]
    for found in PICTURE.finditer(prose_of(page)):
        assert (folder / found["path"]).is_file(), found[0]


def test_spelling() -> None:
    """`typos` knows common mistakes; names that it takes for one are listed in pyproject.toml."""
    program = shutil.which("typos", path=str(Path(sys.executable).parent)) or shutil.which("typos")
    if program is None:
        pytest.skip("typos is not installed: `pip install typos`")
    command = [program, "--format", "brief", *WRITTEN, "src"]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert found.stdout == ""
    assert found.returncode == 0, found.stderr


def test_every_page_is_listed() -> None:
    """Each folder with pages has an index, which lists what lies in it; the pages of `docs` itself are named in one."""
    for page in PAGES:
        folder = (ROOT / page).parent
        assert folder == DOCS or (folder / "index.md").is_file(), page
    indices = "\n".join(text_of(page) for page in PAGES if page.endswith("index.md"))
    entries = re.findall(r"^/?([\w*-]+)$", indices, re.MULTILINE)
    named = [re.compile(entry.replace("*", ".*") + r"\Z") for entry in entries if entry != "*"]
    top = [Path(page).stem for page in PAGES if Path(page).parent == Path("docs") and Path(page).stem != "index"]
    assert [name for name in top if not any(one.match(name) for one in named)] == []


def test_every_public_name_is_in_the_reference() -> None:
    pages = "\n".join(text_of(page) for page in PAGES if page.startswith("docs/reference/"))
    documented = set(re.findall(r"^\.\. auto(?:class|function|exception):: ([\w.]+)$", pages, re.MULTILINE))
    modules = {"examples": "replant.examples.", "figures": "replant.report.figures.", "fleet": "replant.fleet."}
    lacking = [
        name
        for name in replant.__all__
        if name not in documented
        and name != "__version__"
        and not (name in modules and any(path.startswith(modules[name]) for path in documented))
    ]
    assert lacking == []
