"""What tests of pages share: the system's Chromium, and whether what it shows can be read."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from support.waiting import PATIENCE

OPTIONS = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-disk_writer-networking"]
OPTIONS += ["--disable-component-update", "--disable-sync"]

# every piece of text that is shown, with its colour, what lies behind it and its size
TEXTS = """() => {
  const parse = colour => colour.match(/[\\d.]+/g).map(Number);
  const behind = element => {
    for (let at = element; at; at = at.parentElement) {
      const colour = parse(getComputedStyle(at).backgroundColor);
      if (colour.length === 3 || colour[3] > 0) return colour;
    }
    return [255, 255, 255];
  };
  const found = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode, element = node.parentElement;
    if (!node.data.trim() || element.closest("script, style") || !element.getClientRects().length) continue;
    const style = getComputedStyle(element);
    const colour = element.ownerSVGElement ? style.fill : style.color;
    found.push([node.data.trim().slice(0, 30), parse(colour), behind(element), style.opacity]);
  }
  const root = getComputedStyle(document.documentElement), probe = document.createElement("i");
  document.body.append(probe);
  probe.style.color = root.getPropertyValue("--muted");
  found.push(["axes of the plots", parse(getComputedStyle(probe).color), behind(probe), "1"]);
  return found;
}"""


@contextmanager
def chromium() -> Iterator:
    """A browser without a window; skips the test, with the reason, where there is none."""
    found = shutil.which("chromium")
    if found is None:
        pytest.skip("no chromium on the path: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as driver:
        launched = driver.chromium.launch(executable_path=found, args=OPTIONS, timeout=1000 * PATIENCE)
        yield launched
        launched.close()


def new_page(browser, **options):
    """Return a page of a context of its own; nothing that it does has to be done soon."""
    page = browser.new_page(**options)
    page.set_default_timeout(1000 * PATIENCE)
    return page


def drawn_anew(page) -> None:
    """Wait until the page has drawn whatever it was told before."""
    page.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


def luminance(colour: list[float]) -> float:
    linear = [
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in (value / 255 for value in colour[:3])
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: list[float], other: list[float]) -> float:
    darker, lighter = sorted([luminance(one), luminance(other)])
    return (lighter + 0.05) / (darker + 0.05)


def complaints_of(page, url: str) -> list[str]:
    """Return the list into which comes what a page says on its console, what fails in it, what it asks of others."""
    own = (url, url.replace("http", "ws", 1), f"blob:{url}")
    complaints: list[str] = []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    for event in ("request", "websocket"):
        page.on(event, lambda asked: asked.url.startswith(own) or complaints.append(f"asked for {asked.url}"))
    return complaints


class WatchedPage:
    """A page in the browser whose complaints are kept."""

    seen_in: Path  # folder of its pictures

    def __init__(self, browser, url: str, width: int, height: int, **options) -> None:
        self.page = new_page(browser, viewport={"width": width, "height": height}, **options)
        self.complaints = complaints_of(self.page, url.partition("?")[0])

    def close(self) -> None:
        self.page.context.close()

    def until(self, holds: Callable[[], object]) -> None:
        """Wait until something holds; what a page evaluates for itself its own policy forbids."""
        end = time.monotonic() + PATIENCE
        while not holds():
            assert time.monotonic() < end, f"the page never got there{self.says()}"
            self.page.wait_for_timeout(30)

    def says(self) -> str:
        """What it says that a failed wait should tell."""
        return ""

    def seen(self, name: str) -> None:
        """Keep a picture of the whole page."""
        self.seen_in.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=self.seen_in / f"{name}.png", full_page=True)
