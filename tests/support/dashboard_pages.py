"""A page of the dashboard in the browser, as tests see it."""

from __future__ import annotations

import json
import time
from collections.abc import Callable

from support.browsing import new_page
from support.places import ROOT
from support.waiting import PATIENCE

SEEN = ROOT / "out" / "dashboard"
PIXELS = "name => document.querySelector(`#${name} canvas`).toDataURL()"


class Page:
    """A page of the dashboard; whatever it complains of, or asks of others, is kept."""

    def __init__(self, browser, url: str, width: int = 1280, height: int = 800, **options) -> None:
        self.page = new_page(browser, viewport={"width": width, "height": height}, **options)
        self.context = self.page.context
        self.complaints: list[str] = []
        self.told: list[int] = []  # the samples of each view that came to it, drawn or not
        base = url.partition("?")[0]
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        for event in ("request", "websocket"):
            self.page.on(event, lambda asked: self._asked(asked.url, base))
        self.page.on("websocket", lambda wire: wire.on("framereceived", self._told))
        self.page.goto(url)
        self.until(lambda: self.drawn > 0)

    def close(self) -> None:
        self.context.close()

    def _asked(self, url: str, base: str) -> None:
        if not url.startswith((base, base.replace("http", "ws", 1), f"blob:{base}")):
            self.complaints.append(f"asked for {url}")

    def _told(self, frame: str | bytes) -> None:
        self.told += [view["samples"] for view in [json.loads(frame).get("view", {})] if "samples" in view]

    @property
    def drawn(self) -> int:
        """How often it has drawn."""
        return int(self.page.locator("#main").get_attribute("data-drawn") or 0)

    def until(self, holds: Callable[[], object]) -> None:
        """Wait until something holds; what a page evaluates for itself its own policy forbids."""
        end = time.monotonic() + PATIENCE
        while not holds():
            assert time.monotonic() < end, "the page never got there"
            self.page.wait_for_timeout(30)

    def text(self, name: str) -> str:
        return self.page.locator(f"#{name}").inner_text()

    def pixels(self, *names: str) -> list[str]:
        return [self.page.evaluate(PIXELS, name) for name in names or ("output", "input", "magnitude", "phase")]

    def seen(self, name: str) -> None:
        """Keep a picture of the whole page."""
        SEEN.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=SEEN / f"{name}.png", full_page=True)
