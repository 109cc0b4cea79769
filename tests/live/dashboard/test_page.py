"""The page in a browser: it moves, pauses, acts, comes back after a restart, and can be read and used by everybody.

Driven by Playwright in the system's Chromium; screenshots are left in out/dashboard for a look.
"""

from __future__ import annotations

import json
import re
import threading
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from browsing import TEXTS, chromium, contrast, luminance
from live.dashboard.feed import Feed
from replant.live.dashboard import Dashboard, app, serve

SEEN = Path(__file__).resolve().parents[3] / "out" / "dashboard"
PATIENCE = 60.0  # s, only against hanging
TOKEN = "a-token-of-some-length"

PIXELS = "name => document.querySelector(`#${name} canvas`).toDataURL()"
CUT_OFF = """[...document.querySelectorAll("main *, header *")]
  .filter(element => element.getBoundingClientRect().right > innerWidth + 1).length"""
OVERFLOW = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
FOCUS = """() => {
  const at = document.activeElement, style = getComputedStyle(at);
  return [at.id || at.textContent.trim(), style.outlineStyle, parseFloat(style.outlineWidth)];
}"""


@pytest.fixture(scope="module")
def browser() -> Iterator:
    with chromium() as launched:
        yield launched


class Page:
    """A page of the dashboard; whatever it complains of, or asks of others, is kept."""

    def __init__(self, browser, url: str, width: int = 1280, height: int = 800, **options) -> None:
        self.context = browser.new_context(viewport={"width": width, "height": height}, **options)
        self.page = self.context.new_page()
        self.complaints: list[str] = []
        base = url.partition("?")[0]
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        for event in ("request", "websocket"):
            self.page.on(event, lambda asked: self._asked(asked.url, base))
        self.page.goto(url)
        self.until(lambda: self.drawn > 0)

    def close(self) -> None:
        self.context.close()

    def _asked(self, url: str, base: str) -> None:
        if not url.startswith((base, base.replace("http", "ws", 1), f"blob:{base}")):
            self.complaints.append(f"asked for {url}")

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


@pytest.fixture(scope="module")
def learned() -> Iterator[tuple[Feed, Dashboard]]:
    """A feed that has found its plant, being served; its views come when a test asks for them."""
    feed = Feed()
    for _ in range(40):
        feed.advance(100)
    with serve(feed.hub) as served:
        yield feed, served


@pytest.fixture
def feed(learned: tuple[Feed, Dashboard]) -> Feed:
    learned[0].forget()
    if not learned[0].adapting:
        learned[0].obey("adapt")
        learned[0].forget()
    learned[0].advance()
    return learned[0]


@pytest.fixture
def opened(browser, learned: tuple[Feed, Dashboard], feed: Feed) -> Iterator[Page]:
    """The page, which must not have complained by the end."""
    page = Page(browser, learned[1].url)
    yield page
    page.close()
    assert page.complaints == []


# --- it moves, pauses, acts ---


def test_plots_and_figures_move(opened: Page, feed: Feed) -> None:
    before, clock, samples = opened.pixels("output", "input"), opened.text("clock"), opened.text("samples")
    poles = opened.page.locator("#plane .pole").count()
    feed.advance(130)
    opened.until(lambda: opened.text("samples") == f"{feed.taken:,}")
    assert all(new != old for new, old in zip(opened.pixels("output", "input"), before, strict=True))
    assert (opened.text("clock"), opened.text("samples")) != (clock, samples)
    assert poles == 2


def test_what_is_shown_is_what_was_found(opened: Page, feed: Feed) -> None:
    view = feed.hub.newest
    assert view is not None
    formula = opened.page.locator("#formula math").text_content()
    for value in (*view["num"], *view["den"][1:]):
        assert f"{value:.4g}".rstrip("0") in formula
    figures = opened.page.locator("#multiples figure").all_inner_texts()
    assert [text.split()[0] for text in figures] == ["a₁", "a₀", "b₁", "b₀"]
    for text, value, std in zip(figures, view["parameters"], view["std"], strict=True):
        shown, spread = (float(part) for part in re.findall(r"[\d.]+", text.split(maxsplit=1)[1])[:2])
        assert shown == pytest.approx(value, abs=0.06 * std)
        assert spread == pytest.approx(std, rel=0.06)
    assert float(opened.text("fit").split()[0]) == pytest.approx(view["simulated"], abs=0.051)
    frequency = float(opened.page.locator("#modes td").first.inner_text().split()[0])
    assert frequency == pytest.approx(abs(complex(**view["poles"][0])) / 6.283185, rel=1e-3)
    assert opened.text("headline") == {"trusted": "Trusted", "converging": "Still converging"}[view["verdict"]]


def test_pausing_holds_the_drawing_and_nothing_else(opened: Page, feed: Feed) -> None:
    button = opened.page.locator("#pause")
    button.click()
    assert button.inner_text() == "Resume"
    before, samples = opened.pixels(), opened.text("samples")
    feed.advance(130)
    opened.page.wait_for_timeout(600)  # three views' time
    assert (opened.pixels(), opened.text("samples")) == (before, samples)
    assert "paused" in opened.text("link")
    assert feed.commands == []  # the identification was not asked to stop
    button.click()
    opened.until(lambda: opened.text("samples") == f"{feed.taken:,}")
    assert opened.pixels("output") != before[:1]
    assert button.inner_text() == "Pause"


def test_a_reset_asks_first(opened: Page, feed: Feed) -> None:
    opened.page.get_by_role("button", name="Reset…").click()
    dialog = opened.page.get_by_role("dialog", name="Forget all that was learned?")
    assert dialog.is_visible()
    assert opened.page.evaluate("document.activeElement.textContent") == "Keep it"
    opened.page.keyboard.press("Escape")
    assert not dialog.is_visible()
    opened.page.get_by_role("button", name="Reset…").click()
    dialog.get_by_role("button", name="Keep it").click()
    assert feed.commands == []
    opened.page.get_by_role("button", name="Reset…").click()
    dialog.get_by_role("button", name="Reset").click()
    opened.until(lambda: feed.commands == ["reset"])
    feed.advance(100)
    opened.until(lambda: opened.text("headline") == "Collecting the first samples")
    assert opened.page.locator("#adapt").is_disabled()
    opened.seen("starting-1280")
    for _ in range(40):
        feed.advance(100)


def test_freezing_and_adapting(opened: Page, feed: Feed) -> None:
    button = opened.page.locator("#adapt")
    button.click()
    opened.until(lambda: feed.commands == ["freeze"])
    frozen = feed.identifier.parameters.copy()
    feed.advance(200)
    assert (feed.identifier.parameters == frozen).all()
    opened.until(lambda: button.inner_text() == "Adapt")
    assert "frozen" in opened.text("link")
    button.click()
    opened.until(lambda: feed.commands == ["freeze", "adapt"])
    feed.advance(200)
    opened.until(lambda: button.inner_text() == "Freeze")
    assert (feed.identifier.parameters != frozen).any()


def test_downloads(opened: Page, feed: Feed, tmp_path: Path) -> None:
    for entry, role in (("Model as JSON", "link"), ("Model as Python", "link"), ("Report as HTML", "button")):
        opened.page.locator("summary").click()
        with opened.page.expect_download() as coming:
            opened.page.get_by_role(role, name=entry).click()
        coming.value.save_as(tmp_path / coming.value.suggested_filename)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model.json", "model.py", "report.html"]
    assert json.loads((tmp_path / "model.json").read_text())["den"] == feed.identifier.transfer_function.den.tolist()
    assert "<title>report</title>" in (tmp_path / "report.html").read_text()


# --- the connection ---


def test_it_comes_back_after_the_server_was_restarted(browser, feed: Feed) -> None:
    served = serve(feed.hub)
    page = Page(browser, served.url)
    assert page.complaints == []
    served.stop()
    page.until(lambda: page.text("link") == "reconnecting")
    assert page.page.locator("#reset").is_disabled()
    drawn = page.drawn
    page.page.wait_for_timeout(700)  # it tries in vain
    assert page.drawn == drawn
    with serve(feed.hub, port=served.port):
        page.until(lambda: page.text("link") == "connected")
        feed.advance()
        page.until(lambda: page.text("samples") == f"{feed.taken:,}")
        assert page.page.locator("#reset").is_enabled()
        page.close()
    assert {text for text in page.complaints if "WebSocket connection to" not in text} == set()


def test_with_a_token_the_page_opens_once_and_then_by_its_cookie(browser, feed: Feed) -> None:
    with serve(feed.hub, token=TOKEN) as served:
        page = Page(browser, served.url)
        page.until(lambda: page.text("link") == "connected")
        assert TOKEN not in page.page.url
        assert TOKEN not in page.page.evaluate("document.cookie + document.documentElement.outerHTML")
        page.page.locator("#adapt").click()
        page.until(lambda: feed.commands == ["freeze"])
        assert page.page.reload().status == 200
        page.until(lambda: page.drawn > 0)
        assert page.complaints == []
        page.close()
        stranger = browser.new_page()
        assert stranger.goto(served.url.partition("?")[0]).status == 401
        stranger.close()


@pytest.fixture
def foreign() -> Iterator[str]:
    """Where a server that is not ours serves a page without any policy."""

    class Empty(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<!doctype html><title>foreign</title><link rel=icon href='data:,'>")

        def log_message(self, *args: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Empty) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()


def test_another_page_can_neither_act_nor_listen_nor_frame(
    browser, learned: tuple[Feed, Dashboard], feed: Feed, foreign: str
) -> None:
    """A foreign page in the same browser, of the same machine even: another port is another origin."""
    at = f"127.0.0.1:{learned[1].port}"
    page = browser.new_page()
    page.goto(foreign)
    tried = """async at => {
      const got = [];
      await fetch(`http://${at}/command/reset`, {method: "POST", mode: "no-cors"}).catch(() => 0);
      got.push(await fetch(`http://${at}/model.json`).then(answer => answer.text(), () => "refused"));
      got.push(await new Promise(done => {
        const socket = new WebSocket(`ws://${at}/live`);
        socket.onmessage = () => done("heard");
        socket.onclose = () => done("refused");
      }));
      return got;
    }"""
    assert page.evaluate(tried, at) == ["refused", "refused"]
    assert feed.commands == []
    framed = "at => { const f = document.createElement('iframe'); f.src = `http://${at}/`; document.body.append(f); }"
    with page.expect_event(
        "framenavigated", predicate=lambda frame: frame.url not in ("about:blank", page.url)
    ) as came:
        page.evaluate(framed, at)
    assert came.value.url.startswith("chrome-error:")
    page.close()


def test_hostile_words_stay_words(opened: Page, feed: Feed) -> None:
    hostile = "<img src=x onerror=document.title='owned'>"
    feed.change = {
        "source": hostile,
        "reasons": [hostile],
        "verdict": hostile,
        "counters": {hostile: 3},
        "names": [hostile] * 4,
    }
    feed.advance()
    opened.until(lambda: opened.text("source") == hostile)
    opened.until(lambda: hostile in opened.page.locator("#multiples").inner_text())
    assert opened.page.locator("main img").count() == 0
    assert opened.page.title() == "replant live"


def test_views_with_nothing_known_are_drawn(opened: Page, feed: Feed) -> None:
    unknown = [None] * 4
    nothing = {"omega": [], "magnitude_db": [], "phase_deg": [], "magnitude_low": [], "magnitude_high": []}
    feed.change = {
        **{"parameters": unknown, "std": unknown, "num": [None], "den": [None, None], "poles": [], "zeros": []},
        **{"pole_covariance": [], "dc_gain": None, "dc_gain_std": None, "simulated": None, "rate": None, "lag": None},
        **{"window": {"t": [], "u": [], "y": [], "model": []}, "bode": nothing, "reasons": [], "verdict": "diverged"},
        **{"history": {"t": [], "parameters": [], "std": []}, "status": "diverged", "source_state": "ended"},
    }
    feed.advance()
    opened.until(lambda: opened.text("headline") == "Diverged")
    assert opened.page.locator(".verdict").get_attribute("data-gravity") == "bad"
    assert opened.text("link") == "source has ended"
    assert "No model yet" in opened.text("formula")


def test_the_page_keeps_no_past(browser, learned: tuple[Feed, Dashboard], feed: Feed, monkeypatch) -> None:
    """After many more views it holds as much as before: nothing is heaped up."""
    monkeypatch.setattr(app, "PERIOD", 0.0)
    monkeypatch.setattr(app, "HISTORY_PERIOD", 0.0)
    opened = Page(browser, learned[1].url)
    inspector = opened.context.new_cdp_session(opened.page)
    view = feed.hub.newest
    assert view is not None

    def held_after(drawings: int) -> tuple[float, int, int]:
        end = opened.drawn + drawings
        while opened.drawn < end:
            feed.hub.publish({**view, "at": view["at"] + opened.drawn})
            opened.page.wait_for_timeout(5)
        inspector.send("HeapProfiler.collectGarbage")
        counts = inspector.send("Memory.getDOMCounters")
        return inspector.send("Runtime.getHeapUsage")["usedSize"] / 1e6, counts["nodes"], counts["jsEventListeners"]

    before, after = held_after(30), held_after(150)
    opened.close()
    assert after[0] < before[0] + 0.5  # MB; 150 views are 8
    assert after[1] < before[1] + 100
    assert after[2] <= before[2] + 2
    assert opened.complaints == []


# --- for everybody ---


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


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 820, 400])
def test_it_can_be_read_and_fits(browser, learned: tuple[Feed, Dashboard], feed: Feed, width: int, scheme: str) -> None:
    opened = Page(
        browser, learned[1].url, width, 860 if width == 400 else 800, color_scheme=scheme, reduced_motion="reduce"
    )
    opened.page.wait_for_timeout(300)  # sizes have settled
    assert opened.page.evaluate(OVERFLOW) == 0
    assert opened.page.evaluate(CUT_OFF) == 0
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


def test_a_narrow_page_has_room_for_fingers(browser, learned: tuple[Feed, Dashboard], feed: Feed) -> None:
    opened = Page(browser, learned[1].url, 400, 860)
    for control in opened.page.locator(".actions > button, .actions summary").all():
        box = control.bounding_box()
        assert min(box["height"], box["width"]) >= 44
    opened.close()


def test_from_light_to_dark_without_reloading(opened: Page) -> None:
    before = opened.pixels("output")
    opened.page.emulate_media(color_scheme="dark")
    opened.until(lambda: opened.pixels("output") != before)
