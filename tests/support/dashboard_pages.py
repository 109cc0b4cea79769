"""A page of the dashboard in the browser, as tests see it."""

from __future__ import annotations

import json

from support.browsing import WatchedPage, drawn_anew
from support.places import ROOT

PIXELS = "name => document.querySelector(`#${name} canvas`).toDataURL()"


class Page(WatchedPage):
    """A page of the dashboard; the samples of each view that came to it, drawn or not, are kept, too."""

    seen_in = ROOT / "out" / "dashboard"

    def __init__(self, browser, url: str, width: int = 1280, height: int = 800, **options) -> None:
        super().__init__(browser, url, width, height, **options)
        self.told: list[int] = []
        self.page.on("websocket", lambda wire: wire.on("framereceived", self._told))
        self.page.goto(url)
        self.until(lambda: self.drawn > 0)

    def _told(self, frame: str | bytes) -> None:
        self.told += [view["samples"] for view in [json.loads(frame).get("view", {})] if "samples" in view]

    @property
    def drawn(self) -> int:
        """How often it has drawn."""
        return int(self.page.locator("#main").get_attribute("data-drawn") or 0)

    def text(self, name: str) -> str:
        return self.page.locator(f"#{name}").inner_text()

    def pixels(self, *names: str) -> list[str]:
        drawn_anew(self.page)  # what it was told or its size was changed to before
        return [self.page.evaluate(PIXELS, name) for name in names or ("output", "input", "magnitude", "phase")]
