"""A page of the workbench in the browser, as tests see it."""

from __future__ import annotations

from pathlib import Path

from support.browsing import WatchedPage
from support.places import ROOT


class Workbench(WatchedPage):
    """A page of the workbench."""

    seen_in = ROOT / "out" / "workbench"

    def __init__(self, browser, url: str, width: int = 1280, height: int = 860, **options) -> None:
        super().__init__(browser, url, width, height, accept_downloads=True, **options)
        self.page.on("dialog", lambda dialog: self.complaints.append(f"dialog {dialog.message}"))
        self.page.goto(url)
        self.until(lambda: self.text("link") == "connected")

    def says(self) -> str:
        return f"; it says {self.text('notice')!r}; {self.cards()}"

    def text(self, name: str) -> str:
        return self.page.locator(f"#{name}").text_content() or ""

    def drop(self, *paths: Path) -> None:
        """Drop files onto the page, as from a file manager."""
        self.page.locator("#file").set_input_files([str(path) for path in paths])

    def is_read(self) -> None:
        """Wait until the log that is shown is read and drawn."""
        self.until(lambda: self.text("reading").endswith(" rows"))
        self.until(lambda: self.page.locator("#plots canvas").count() > 1)

    def view(self, name: str) -> None:
        self.page.locator(f"nav [data-view={name}]").click()

    def add(self, kind: str, begin: str, end: str) -> None:
        """Add a stretch of time by its numbers."""
        before = self.page.locator("#stretches li").count()
        self.page.select_option("#add-kind", kind)
        self.page.fill("#add-begin", begin)
        self.page.fill("#add-end", end)
        self.page.keyboard.press("Enter")
        self.until(lambda: self.page.locator("#stretches li").count() == before + 1)

    def fit(self, poles: str, kind: str = "fit", delay: str = "0.01") -> None:
        """Ask for models, and wait until they are made."""
        wanted = self.page.locator("#cards > li").count() + (len(poles.split(":")) == 1 or kind == "search")
        if not wanted or (":" in poles and kind != "search"):
            first, last = map(int, poles.split(":"))
            wanted = self.page.locator("#cards > li").count() + last - first + 1
        self.page.check(f"[name=kind][value={kind}]", force=True)
        self.page.fill("#poles", poles)
        self.page.fill("#delay", delay)
        self.page.click("#fit")
        self.until(lambda: self.done() == wanted)

    def cards(self) -> list[str]:
        """Return title and state of each card."""
        found = self.page.locator(".card").all()
        return [f"{each.locator('.title').text_content()}: {each.get_attribute('data-state')}" for each in found]

    def done(self) -> int:
        return self.page.locator(".card[data-state=done]").count()

    def zoomed(self) -> str:
        return self.text("shown")

    def reach(self, selector: str) -> None:
        """Go by Tab to what a selector names; once round the page at most."""
        for _ in range(150):
            if self.page.locator(f"{selector}:focus").count():
                return
            self.page.keyboard.press("Tab")
        raise AssertionError(f"Tab does not lead to {selector}")
