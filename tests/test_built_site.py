"""The site: it is built without a warning, asks no other host, has no link to nowhere, and its search finds.

What `make docs` has built is looked at; where there is nothing, the pages are built here without executing their cells.
That is what test_page_cells.py does.
"""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import quote, unquote

import pytest

from support.browsing import chromium, new_page
from support.cases import every
from support.places import ROOT
from support.waiting import PATIENCE

#: It takes half a minute of processor time to build it; `make lint` checks the sources, their links among them.
pytestmark = pytest.mark.slow
MADE = ROOT / "out" / "docs" / "html"
#: Where a page loads something by itself: element and attribute.
LOADED = {("script", "src"), ("img", "src"), ("iframe", "src"), ("source", "src"), ("video", "src"), ("object", "data")}
#: Kinds of `link` that say something and load nothing.
SAID = {"canonical", "next", "prev", "author", "index", "search", "copyright"}
OTHER_HOSTS = ("http:", "https:", "//")
PAGES = ["index", "start/index", "reference/cli", "gallery/responses"]


class Page(HTMLParser):
    """What a page loads, where its links lead, and which anchors it has."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.links: list[str] = []
        self.anchors: set[str] = {""}
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        of = {name: value or "" for name, value in attrs}
        self.anchors |= {of[name] for name in ("id", "name") if name in of}
        self.loaded += [of[name] for element, name in LOADED if element == tag and name in of]
        if tag == "link" and of.get("rel") not in SAID:
            self.loaded.append(of.get("href", ""))
        if tag == "a" and "href" in of:
            self.links.append(of["href"])


@cache
def parsed(path: Path) -> Page:
    return Page(path)


def pages_of(site: Path) -> list[Path]:
    return sorted(path for path in site.rglob("*.html") if "_static" not in path.parts)


def build(site: Path) -> None:
    """Build the pages, warnings as errors; without execution no kernel tells the language of a cell."""
    unexecuted = ["-D", "nb_execution_mode=off", "-D", "suppress_warnings=myst-nb.lexer"]
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", *unexecuted, "-d", site.parent / "doctrees"]
    done = subprocess.run([*command, ROOT / "docs", site], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the built site; the workers of pytest-xdist share one."""
    if (MADE / "index.html").is_file():
        return MADE
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent
    with (shared / "site.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (shared / "site" / "index.html").is_file():
            build(shared / "site")
    return shared / "site"


def test_no_page_loads_anything_from_another_host(site: Path) -> None:
    found = {path.name: [url for url in parsed(path).loaded if url.startswith(OTHER_HOSTS)] for path in pages_of(site)}
    assert {name: urls for name, urls in found.items() if urls} == {}


def test_style_sheets_load_nothing_from_another_host(site: Path) -> None:
    sheets = list((site / "_static").rglob("*.css"))
    assert sheets
    assert [path.name for path in sheets for begin in OTHER_HOSTS if f"url({begin}" in path.read_text("utf-8")] == []


def test_every_link_leads_somewhere(site: Path) -> None:
    wrong = []
    for path in pages_of(site):
        for link in parsed(path).links:
            if "://" in link or link.startswith("mailto:"):
                continue
            where, _, anchor = link.partition("#")
            target = (path.parent / unquote(where.partition("?")[0])).resolve() if where else path
            is_there = target.is_file() and (target.suffix != ".html" or unquote(anchor) in parsed(target).anchors)
            wrong += [] if is_there else [(path.relative_to(site).as_posix(), link)]
    assert wrong == []


def test_every_figure_is_shown(site: Path) -> None:
    """Without matplotlib's inline backend a cell shows the words `<Figure size ...>` in place of a figure."""
    assert [path.name for path in pages_of(site) if "&lt;Figure size" in path.read_text("utf-8")] == []


@pytest.fixture(scope="module")
def browser() -> Iterator:
    with chromium() as launched:
        yield launched


@every("name", PAGES)
@every("width", [400, 1280])
def test_a_page_asks_no_other_host_and_fits_its_window(browser, site: Path, name: str, width: int) -> None:
    page = new_page(browser, viewport={"width": width, "height": 900})
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto((site / f"{name}.html").as_uri(), wait_until="networkidle")
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []
    assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")
    page.close()


def test_the_search_finds_a_page_offline(browser, site: Path) -> None:
    page = new_page(browser)
    page.goto((site / "search.html").as_uri() + "?q=verdict")
    page.wait_for_selector("#search-results li a", timeout=1000 * PATIENCE)
    assert any("erdict" in text for text in page.locator("#search-results li a").all_inner_texts())
    page.close()


#: What people look for, and a page that answers it.
SEARCHES = {
    "verdict": "verdict",
    "memory of a rig": "questions",
    "RAM": "questions",
    "Raspberry Pi": "questions",
    "ARM": "questions",
    "cite": "questions",
    "PLC": "questions",
    "jitter": "how-to/irregular-clocks",
    "licence": "questions",
    "add optimizer": "reference/contributing",
    "SysIdentPy": "questions",
    "several inputs": "questions",
    "step test": "questions",
    "PlotJuggler": "live",
    "dither": "how-to/set-point",
    "my fit is 40": "how-to/poor-fit",
    "inconsistent": "how-to/inconsistent",
    "sampling time": "how-to/sampling-and-excitation",
    "not excited": "how-to/not-excited",
    "set-point": "how-to/set-point",
    "two heaters": "how-to/inputs-and-outputs",
    "tfest": "coming-from",
    "STM32": "explanation/not-yet",
    "trust the std": "how-to/trust-the-std",
    "dead time": "how-to/dead-time",
    "irregular": "how-to/irregular-clocks",
    "outliers": "how-to/missing-data",
    "Arduino": "how-to/arduino",
    "power cut": "how-to/resume",
    "token": "how-to/secure-dashboard",
    "PI controller": "how-to/controller",
    "fleet": "fleet",
    "scikit-learn": "how-to/use-a-model",
    "drift": "tutorials/changing-plant",
    "Excel": "how-to/read-files",
    "RAM per rig": "questions",
    "bump test": "questions",
    "latency": "questions",
    "embedded": "questions",
    "thread safe": "explanation/threads",
    "dead time unknown": "how-to/dead-time",
    "stuck sensor": "how-to/missing-data",
    "plant changes while running": "tutorials/changing-plant",
    "not trusted": "verdict",
    "C code": "explanation/not-yet",
}


@every(("words", "page"), SEARCHES.items(), ids=list(SEARCHES))
def test_the_search_leads_to_the_answer(browser, site: Path, words: str, page: str) -> None:
    """Among the first ten results: those that are seen without scrolling far."""
    tab = new_page(browser)
    tab.goto((site / "search.html").as_uri() + f"?q={quote(words)}")
    tab.wait_for_function(
        "document.querySelector('.search-summary')?.innerText.includes('ound')", timeout=1000 * PATIENCE
    )
    tab.wait_for_selector("#search-results li a", timeout=1000 * PATIENCE)
    found = tab.locator("#search-results ul.search > li > a").evaluate_all("all => all.map(each => each.href)")
    tab.close()
    assert any(f"/{page}.html" in href for href in found[:10]), found[:10]
