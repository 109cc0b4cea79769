"""The page in a browser: it moves, pauses, acts, comes back after a restart, and others can do none of that.

Driven by Playwright in the system's Chromium.
"""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from replant.live.dashboard import app
from replant.live.dashboard.app import Hub
from replant.live.dashboard.server import Dashboard, serve
from support.browsing import TEXTS, contrast, drawn_anew, new_page
from support.dashboard_feed import Feed
from support.dashboard_pages import Page

TOKEN = "a-token-of-some-length"


@pytest.fixture(scope="module")
def shared(browser, watched: tuple[Feed, Dashboard]) -> Iterator[Page]:
    """One page for the tests that leave it as they found it."""
    watched[0].settle()
    page = Page(browser, watched[1].url)
    yield page
    page.close()


@pytest.fixture
def opened(shared: Page, feed: Feed) -> Iterator[Page]:
    """The page, once it shows the feed as it is; it must not have complained by the end."""
    shared.until(lambda: shared.text("samples") == f"{feed.taken:,}")
    yield shared
    assert shared.complaints == []


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


def test_a_trusted_model_whose_input_rests_is_said_to_learn_nothing(opened: Page, feed: Feed) -> None:
    rests = "nothing can be learned"
    for verdict, excited, said in (("trusted", False, True), ("trusted", True, False), ("converging", False, False)):
        feed.change = {"verdict": verdict, "excited": excited}
        samples = feed.advance()["samples"]
        opened.until(lambda samples=samples: opened.text("samples") == f"{samples:,}")
        assert opened.text("headline") == {"trusted": "Trusted", "converging": "Still converging"}[verdict]
        assert (rests in opened.text("meaning")) == said
        assert (rests in (opened.page.locator("#announced").text_content() or "")) == said


def test_pausing_holds_the_drawing_and_nothing_else(opened: Page, feed: Feed) -> None:
    button = opened.page.locator("#pause")
    button.click()
    assert button.inner_text() == "Resume"
    before, samples = opened.pixels(), opened.text("samples")
    feed.advance(130)
    opened.until(lambda: feed.taken in opened.told)
    drawn_anew(opened.page)
    assert (opened.pixels(), opened.text("samples")) == (before, samples)
    assert "paused" in opened.text("link")
    assert feed.commands == []  # the identification was not asked to stop
    button.click()
    opened.until(lambda: opened.text("samples") == f"{feed.taken:,}")
    assert opened.pixels("output") != before[:1]
    assert button.inner_text() == "Pause"


def test_a_reset_asks_first(opened: Page, feed: Feed) -> None:
    opened.page.get_by_role("button", name="Reset…").click()
    dialog = opened.page.get_by_role("dialog", name="Discard everything that was learned?")
    assert dialog.is_visible()
    assert opened.page.evaluate("document.activeElement.textContent") == "Cancel"
    opened.page.keyboard.press("Escape")
    assert not dialog.is_visible()
    opened.page.get_by_role("button", name="Reset…").click()
    dialog.get_by_role("button", name="Cancel").click()
    assert feed.commands == []
    opened.page.get_by_role("button", name="Reset…").click()
    dialog.get_by_role("button", name="Reset").click()
    opened.until(lambda: feed.commands == ["reset"])
    feed.advance(100)
    opened.until(lambda: opened.text("headline") == "Collecting the first samples")
    assert opened.page.locator("#adapt").is_disabled()
    opened.seen("starting-1280")


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


@pytest.mark.slow
def test_it_comes_back_after_the_server_was_restarted(browser, feed: Feed) -> None:
    served = serve(feed.hub)
    page = Page(browser, served.url)
    assert page.complaints == []
    served.stop()
    page.until(lambda: page.text("link") == "reconnecting")
    assert page.page.locator("#reset").is_disabled()
    assert page.text("headline") == "Not connected"
    drawn, tried = page.drawn, len(page.complaints)
    page.until(lambda: len(page.complaints) > tried + 1)  # it tries in vain
    assert page.drawn == drawn
    with serve(feed.hub, port=served.port):
        page.until(lambda: page.text("link") == "connected")
        feed.advance()
        page.until(lambda: page.text("samples") == f"{feed.taken:,}")
        assert page.page.locator("#reset").is_enabled()
        page.close()
    assert {text for text in page.complaints if "WebSocket connection to" not in text} == set()


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.slow)])
def test_a_session_that_has_ended_is_said_and_not_looked_for(browser, feed: Feed, scheme: str) -> None:
    """The console stays empty: nothing is asked of a server that is gone."""
    hub = Hub(command=print, report=bytes)
    hub.publish(feed.hub.newest)
    with serve(hub) as served:
        page = Page(browser, served.url, color_scheme=scheme)
        hub.publish({**feed.hub.newest, "samples": 123_456})
        served.announce_end()
    page.until(lambda: page.text("link") == "session has ended")
    page.page.wait_for_timeout(2000)  # several of the pauses after which it would have tried again
    assert page.complaints == []
    assert page.text("samples") == "123,456"  # the last view came before the goodbye
    assert page.text("headline") == "The session has ended"
    assert "The last verdict was: " in page.text("meaning")
    assert "Reload this page" in page.text("notice")
    assert page.page.locator("#main").get_attribute("data-fresh") == "no"
    assert page.page.locator("#reset").is_disabled()
    assert not page.page.locator("#save").is_visible()
    texts = page.page.evaluate(TEXTS)
    assert {text: contrast(ink, paper) for text, ink, paper, _ in texts if contrast(ink, paper) < 4.5} == {}
    page.seen(f"ended-{scheme}")
    page.close()


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
        stranger = new_page(browser)
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
    browser, dashboard: Dashboard, feed: Feed, foreign: str
) -> None:
    """A foreign page in the same browser, of the same machine even: another port is another origin."""
    at = f"127.0.0.1:{dashboard.port}"
    page = new_page(browser)
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


def with_reference(feed: Feed, scale: float, offset: float) -> dict[str, object]:
    """The newest view's window with a reference, which is its output scaled and shifted."""
    assert feed.hub.newest is not None
    window = feed.hub.newest["window"]
    return {"window": {**window, "r": [scale * value + offset for value in window["y"]]}}


def test_a_set_point_is_drawn_beside_the_output_that_follows_it(opened: Page, feed: Feed) -> None:
    plain = opened.pixels("output")
    feed.change = with_reference(feed, 1.0, 0.01)
    samples = feed.advance()["samples"]
    opened.until(lambda: opened.text("samples") == f"{samples:,}")
    assert "reference" in opened.page.locator('[data-for="output"]').inner_text()
    assert not opened.page.locator("#apart").is_visible()
    feed.change = {"window": {**with_reference(feed, 1.0, 0.01)["window"], "r": []}}  # type: ignore[dict-item]
    drawn = opened.pixels("output")
    samples = feed.advance()["samples"]
    opened.until(lambda: opened.text("samples") == f"{samples:,}")
    assert "reference" not in opened.page.locator('[data-for="output"]').inner_text()
    assert opened.pixels("output") != drawn != plain


def test_a_dither_is_drawn_in_a_plot_of_its_own(opened: Page, feed: Feed) -> None:
    assert not opened.page.locator("#apart").is_visible()
    feed.change = with_reference(feed, 1e-3, 500.0)
    samples = feed.advance()["samples"]
    opened.until(lambda: opened.text("samples") == f"{samples:,}")
    opened.until(lambda: opened.page.locator("#apart").is_visible())
    assert "reference" not in opened.page.locator('[data-for="output"]').inner_text()
    assert "500" in opened.page.locator('[data-for="reference"]').inner_text()


def test_views_with_nothing_known_are_drawn(opened: Page, feed: Feed) -> None:
    unknown = [None] * 4
    nothing = {"omega": [], "magnitude_db": [], "phase_deg": [], "magnitude_low": [], "magnitude_high": []}
    feed.change = {
        **{"parameters": unknown, "std": unknown, "num": [None], "den": [None, None], "poles": [], "zeros": []},
        **{"pole_covariance": [], "dc_gain": None, "dc_gain_std": None, "simulated": None, "rate": None, "lag": None},
        **{
            "window": {"t": [], "u": [], "y": [], "model": [], "left_out": []},
            "bode": nothing,
            "reasons": [],
            "verdict": "diverged",
        },
        **{"history": {"t": [], "parameters": [], "std": []}, "status": "diverged", "source_state": "ended"},
    }
    feed.advance()
    opened.until(lambda: opened.text("headline") == "Diverged")
    assert opened.page.locator(".verdict").get_attribute("data-gravity") == "bad"
    assert opened.text("link") == "source has ended"
    assert "No model yet" in opened.text("formula")


def test_no_figure_needs_more_room_than_it_has(opened: Page, feed: Feed) -> None:
    huge = 1e300
    feed.change = {
        "at": huge,
        "samples": huge,
        "rate": huge,
        "lag": huge,
        "rejected": {"late": huge},
        "simulated": -huge,
    }
    feed.advance()
    opened.until(lambda: "×" in opened.text("clock"))
    for name in ("clock", "samples", "rate", "lag", "rejected", "fit", "losses"):
        assert len(opened.text(name)) < 40, name


@pytest.mark.slow
def test_the_page_keeps_no_past(browser, dashboard: Dashboard, feed: Feed, monkeypatch) -> None:
    """After many more views it holds as much as before: nothing is heaped up."""
    monkeypatch.setattr(app, "PERIOD", 0.0)
    monkeypatch.setattr(app, "HISTORY_PERIOD", 0.0)
    monkeypatch.setattr(app, "LOOK", 0.001)
    opened = Page(browser, dashboard.url)
    inspector = opened.page.context.new_cdp_session(opened.page)
    view = feed.hub.newest
    assert view is not None

    def held_after(drawings: int) -> tuple[float, ...]:
        end = opened.drawn + drawings
        while opened.drawn < end:
            feed.hub.publish({**view, "at": view["at"] + opened.drawn})
            opened.page.wait_for_timeout(5)
        return tuple(map(min, zip(*(held_now() for _ in range(5)), strict=True)))

    def held_now() -> tuple[float, int, int]:
        inspector.send("HeapProfiler.collectGarbage")  # at once it does not always find all: what is drawn just now
        opened.page.wait_for_timeout(50)
        counts = inspector.send("Memory.getDOMCounters")
        return inspector.send("Runtime.getHeapUsage")["usedSize"] / 1e6, counts["nodes"], counts["jsEventListeners"]

    before, after = held_after(30), held_after(150)
    opened.close()
    assert after[0] < before[0] + 4.0  # MB; 150 views are 8, and what the browser itself keeps for later comes and goes
    assert after[1] < before[1] + 100
    assert after[2] <= before[2] + 2
    assert opened.complaints == []
