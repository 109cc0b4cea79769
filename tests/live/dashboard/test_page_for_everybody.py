"""The page for everybody: read on any screen, used by keyboard and finger, heard by who does not see.

Screenshots are left in out/dashboard for a look.
"""

from __future__ import annotations

import itertools

import pytest

from replant.live.dashboard.server import Dashboard
from support.browsing import TEXTS, contrast, luminance
from support.cases import every
from support.dashboard_feed import Feed
from support.dashboard_pages import Page

pytestmark = pytest.mark.slow  # that it works is shown in test_page.py
CUT_OFF = """[...document.querySelectorAll("main *, header *")]
  .filter(element => element.getBoundingClientRect().right > innerWidth + 1).length"""
OVERFLOW = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
FOCUS = """() => {
  const at = document.activeElement, style = getComputedStyle(at);
  return [at.id || at.textContent.trim(), style.outlineStyle, parseFloat(style.outlineWidth)];
}"""


def test_everything_can_be_done_by_keyboard_and_is_seen_to_be(opened: Page, feed: Feed) -> None:
    met: dict[str, tuple[str, float]] = {}
    for _ in range(6):
        opened.page.keyboard.press("Tab")
        name, style, width = opened.page.evaluate(FOCUS)
        met[name] = (style, width)
    assert list(met)[:5] == ["pause", "adapt", "reset", "Save", "formula"]
    assert set(list(met.values())[:5]) == {("solid", 2)}
    opened.page.locator("#adapt").focus()
    opened.page.keyboard.press("Enter")
    opened.until(lambda: feed.commands == ["freeze"])
    opened.page.locator("summary").focus()
    opened.page.keyboard.press("Space")
    assert opened.page.get_by_role("link", name="Model as JSON").is_visible()
    opened.page.keyboard.press("Escape")
    assert not opened.page.get_by_role("link", name="Model as JSON").is_visible()
    assert opened.page.evaluate("document.activeElement.textContent") == "Save"


def test_a_new_verdict_is_read_aloud_and_has_a_shape_of_its_own(opened: Page, feed: Feed) -> None:
    shapes, told = set(), set()
    for verdict in ("trusted", "converging", "inconsistent"):
        feed.change = {"verdict": verdict}
        feed.advance()
        expected = {"trusted": "Trusted", "converging": "Still converging", "inconsistent": "Inconsistent"}[verdict]
        opened.until(lambda expected=expected: opened.text("headline") == expected)
        shapes.add(opened.page.locator(".sign path").first.get_attribute("d"))
        live = opened.page.locator("[aria-live=polite]#announced").text_content()
        assert live is not None
        assert expected in live
        told.add(live)
    assert len(shapes) == len(told) == 3


def test_everything_has_a_name_for_who_does_not_see(opened: Page) -> None:
    for control in opened.page.locator("button:visible, summary, a:visible").all():
        assert control.inner_text().strip()
    for picture in opened.page.locator("[role=img]").all():
        assert picture.get_attribute("aria-label")
    assert opened.page.locator("h1").count() == 1


@every(("width", "scheme"), list(itertools.product([1280, 820, 400], ["light", "dark"])))
def test_it_can_be_read_and_fits(browser, dashboard: Dashboard, feed: Feed, width: int, scheme: str) -> None:
    opened = Page(
        browser, dashboard.url, width, 860 if width == 400 else 800, color_scheme=scheme, reduced_motion="reduce"
    )
    opened.until(lambda: opened.page.evaluate(OVERFLOW) == opened.page.evaluate(CUT_OFF) == 0)  # sizes have settled
    for verdict in ("trusted", "converging", "inconsistent"):
        feed.change = {"verdict": verdict}
        feed.advance()
        opened.until(lambda: opened.text("samples") == f"{feed.taken:,}")
        texts = opened.page.evaluate(TEXTS)
        faint = {text: round(contrast(ink, paper), 2) for text, ink, paper, _ in texts if contrast(ink, paper) < 4.5}
        assert faint == {}
        assert (luminance(texts[0][2]) > 0.5) == (scheme == "light")
    if width == 1280:
        opened.seen(f"{scheme}-{width}-inconsistent")
    feed.change = {}
    feed.advance()
    opened.until(lambda: opened.text("samples") == f"{feed.taken:,}")
    opened.seen(f"{scheme}-{width}")
    opened.page.get_by_role("button", name="Reset…").click()
    texts = opened.page.evaluate(TEXTS)
    assert {text: round(contrast(ink, paper), 2) for text, ink, paper, _ in texts if contrast(ink, paper) < 4.5} == {}
    opened.close()
    assert opened.complaints == []


def test_a_narrow_page_has_room_for_fingers(browser, dashboard: Dashboard, feed: Feed) -> None:
    opened = Page(browser, dashboard.url, 400, 860)
    for control in opened.page.locator(".actions > button, .actions summary").all():
        box = control.bounding_box()
        assert min(box["height"], box["width"]) >= 44
    opened.close()


def test_from_light_to_dark_without_reloading(opened: Page) -> None:
    before = opened.pixels("output")
    opened.page.emulate_media(color_scheme="dark")
    opened.until(lambda: opened.pixels("output") != before)
