"""The report in a browser: it loads alone, zooms as one, can be read in light and dark, on paper and on a telephone.

Driven by Playwright in the system's Chromium; screenshots are left in out/report for a look.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

import replant as rp
from replant.estimation.settings import Request
from replant.online.runs.run_log import compare
from replant.paper.figures import run, save
from replant.paper.rendering import as_element
from replant.paper.rendering import write_report as write_reproduction
from replant.report.compared_page import write_comparison
from replant.report.result_page import write_report
from support.browsing import TEXTS, chromium, complaints_of, contrast, drawn_anew, luminance, new_page
from support.places import ROOT

SEEN = ROOT / "out" / "report"
RANGES = "replantCharts.map(chart => [chart.scales.x.min, chart.scales.x.max])"


@pytest.fixture(scope="module")
def browser() -> Iterator:
    with chromium() as launched:
        yield launched


@pytest.fixture(scope="module")
def length(long_case) -> float:
    """Duration of the long record, in s."""
    return long_case.log.dt * long_case.log.input.size


def opened(browser, path: Path, width: int = 1366, scheme: str = "light"):
    """The page, once it has drawn; whatever it complains of or asks for fails the test."""
    page = new_page(browser, viewport={"width": width, "height": 800}, color_scheme=scheme)
    complaints = complaints_of(page, path.as_uri())
    page.goto(path.as_uri())
    page.wait_for_function("window.replantCharts && replantCharts.every(chart => chart.scales.x.max > 0)")
    drawn_anew(page)
    assert complaints == []
    return page


def seen(page, name: str) -> None:
    """Keep a picture of the whole page."""
    SEEN.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SEEN / f"{name}.png", full_page=True)


def marked_pages(page, pictures: str, path: Path) -> tuple[list[list[int]], list[list[int]]]:
    """Print with a mark in each picture's first and last line; return on which pages each is found."""
    if shutil.which("pdftotext") is None:
        pytest.skip("no pdftotext on the path: apt-get install poppler-utils")
    page.emulate_media(media="print")
    count = page.evaluate(
        """pictures => {
      const shown = [...document.querySelectorAll(pictures)].filter(svg => svg.getClientRects().length);
      shown.forEach((svg, i) => {
        const box = svg.viewBox.baseVal;
        for (const [name, y] of [["TOP", box.y + 8], ["END", box.y + box.height]]) {
          const text = document.createElementNS("http://www.w3.org/2000/svg", "text");
          text.textContent = name + i + "X";
          text.setAttribute("x", box.x + box.width / 2);
          text.setAttribute("y", y);
          text.setAttribute("font-size", "8");
          svg.append(text);
        }
      });
      return shown.length;
    }""",
        pictures,
    )
    assert count > 0
    page.pdf(path=path, prefer_css_page_size=True, print_background=True)
    text = subprocess.run(["pdftotext", "-layout", path, "-"], capture_output=True, text=True, check=True).stdout
    sheets = text.split("\f")

    def found(mark: str) -> list[list[int]]:
        return [[n for n, words in enumerate(sheets) if f"{mark}{i}X" in words] for i in range(count)]

    return found("TOP"), found("END")


@pytest.mark.slow
def test_a_formula_has_no_vertical_scrollbar(browser, plain, tmp_path: Path) -> None:
    page = opened(browser, write_report(tmp_path / "report.html", plain.result, plain.log))
    overflow = page.evaluate("[...document.querySelectorAll('.math')].map(box => getComputedStyle(box).overflowY)")
    assert overflow
    assert {*overflow} == {"hidden"}
    page.close()


@pytest.mark.slow
def test_a_million_samples_load_alone(browser, long_report) -> None:
    page = opened(browser, long_report)
    assert page.evaluate("replantCharts.length") == 9
    assert page.evaluate("document.querySelectorAll('.plot canvas').length") == 9
    assert page.evaluate("replantCharts[1].data[0].length") > 30_000
    seen(page, "light-1366")
    page.close()


@pytest.mark.slow
def test_zooming_one_plot_zooms_its_linked_ones(browser, long_report, length: float) -> None:
    page = opened(browser, long_report)
    whole = page.evaluate(RANGES)
    assert whole == [whole[0]] * 9
    assert whole[0] == pytest.approx([0, length], rel=1e-3)
    page.locator("#output").scroll_into_view_if_needed()
    box = page.locator("#output .u-over").bounding_box()
    page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 40)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 60, steps=4)
    page.mouse.up()
    drawn_anew(page)
    zoomed = page.evaluate(RANGES)
    assert zoomed == [zoomed[0]] * 9
    assert zoomed[0] == pytest.approx([0.25 * length, 0.5 * length], rel=0.01)
    shown = page.locator(".range").inner_text()
    assert [float(number) for number in re.findall(r"\d+", shown)] == pytest.approx(zoomed[0], abs=60)
    seen(page, "zoomed")
    page.get_by_role("button", name="Show all").click()
    drawn_anew(page)
    assert page.evaluate(RANGES) == whole
    page.close()


@pytest.mark.slow
def test_keyboard_moves_and_zooms(browser, long_report, length: float) -> None:
    page = opened(browser, long_report)
    for _ in range(12):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.id") == "input":
            break
    assert page.evaluate("document.activeElement.id") == "input"
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    page.keyboard.press("+")
    drawn_anew(page)
    near = page.evaluate(RANGES)
    assert near == [near[0]] * 9
    assert near[0][1] - near[0][0] == pytest.approx(0.5 * length, rel=1e-3)
    page.keyboard.press("ArrowRight")
    drawn_anew(page)
    assert page.evaluate(RANGES)[4][0] == pytest.approx(near[0][0] + 0.1 * length, rel=1e-3)
    page.keyboard.press("Escape")
    drawn_anew(page)
    assert page.evaluate(RANGES)[8] == pytest.approx([0, length], rel=1e-3)
    page.close()


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.slow)])
def test_text_stands_out(browser, long_report, scheme: str) -> None:
    page = opened(browser, long_report, scheme=scheme)
    texts = page.evaluate(TEXTS)
    assert len(texts) > 150
    faint = {text: round(contrast(ink, paper), 2) for text, ink, paper, _ in texts if contrast(ink, paper) < 4.5}
    assert faint == {}
    assert {opacity for *_, opacity in texts} == {"1"}
    assert (luminance(texts[0][2]) > 0.5) == (scheme == "light")
    if scheme == "dark":
        seen(page, "dark-1366")
    page.close()


def test_bad_news_can_be_read_too(browser, bad_report) -> None:
    name, path = bad_report
    page = new_page(browser, viewport={"width": 900, "height": 800})
    complaints = complaints_of(page, path.as_uri())
    page.goto(path.as_uri())
    seen(page, f"bad-{name.replace(' ', '-')}")
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        assert all(contrast(ink, paper) >= 4.5 for _, ink, paper, _ in page.evaluate(TEXTS))
    assert complaints == []
    page.close()


@pytest.fixture(scope="module", params=["compare", "reproduce"])
def other_page(request, plain, tmp_path_factory) -> tuple[str, Path]:
    """A page without scripts: its name and its path."""
    path = tmp_path_factory.mktemp("other") / "report.html"
    if request.param == "compare":
        asked = Request(rp.Structure(poles=2, zeros=1), plain.log.dt)
        found = compare(asked, plain.log.input, plain.log.output, ["default", "gradient", "least_squares"])
        return request.param, write_comparison(path, found, plain.log, asked.preprocess, "replant compare")
    names = ["table2", "fig2", "fig3"]
    outcome = run(names)
    drawn = {name: as_element(canvas, name) for name, canvas, _ in save(outcome, names, path.parent)}
    return request.param, write_reproduction(path, outcome, drawn, "replant reproduce")


@pytest.mark.slow
def test_the_other_pages_load_alone_stand_out_and_fit(browser, other_page) -> None:
    name, path = other_page
    page = new_page(browser, viewport={"width": 1280, "height": 800})
    complaints = complaints_of(page, path.as_uri())
    page.goto(path.as_uri())
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        texts = page.evaluate(TEXTS)
        assert len(texts) > 40
        assert {text for text, ink, paper, _ in texts if contrast(ink, paper) < 4.5} == set()
        seen(page, f"{name}-{scheme}")
    page.set_viewport_size({"width": 400, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    assert complaints == []
    page.close()


@pytest.mark.slow
def test_the_other_pages_print_with_no_figure_in_two(browser, other_page, tmp_path) -> None:
    page = new_page(browser, viewport={"width": 1280, "height": 800})
    page.goto(other_page[1].as_uri())
    first, last = marked_pages(page, ".paper svg, .panels svg", tmp_path / "marked.pdf")
    assert first == last
    assert all(first)
    page.close()


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.slow)])
def test_telephone_needs_no_scrolling_sideways(browser, long_report, scheme: str) -> None:
    page = opened(browser, long_report, width=400, scheme=scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    beyond = page.evaluate(
        "[...document.querySelectorAll('.plot, .still svg, .verdict, h1, p')].filter(e => e.getClientRects().length)"
        ".filter(e => e.getBoundingClientRect().right > 400.5).map(e => e.className || e.tagName)"
    )
    assert beyond == []
    seen(page, f"{scheme}-400")
    page.close()


@pytest.mark.slow
def test_paper_cuts_no_plot_in_two(browser, long_report, tmp_path) -> None:
    """A mark in the first and the last line of each picture: both are on the same page of the PDF."""
    page = opened(browser, long_report, scheme="dark")
    page.emulate_media(media="print")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    SEEN.mkdir(parents=True, exist_ok=True)
    page.pdf(path=SEEN / "report.pdf", prefer_css_page_size=True, print_background=True)
    first, last = marked_pages(page, ".still svg", tmp_path / "marked.pdf")
    page.close()
    assert len(first) == 9
    assert first == last
    assert all(first)
    assert max(number for numbers in last for number in numbers) < 6


@pytest.mark.slow
def test_without_scripts_the_pictures_stand_in(browser, uncertain, tmp_path) -> None:
    path = write_report(tmp_path / "report.html", uncertain.result, uncertain.log)
    page = new_page(browser, java_script_enabled=False, viewport={"width": 1000, "height": 800})
    page.goto(path.as_uri())
    assert page.locator("figure .still svg").filter(visible=True).count() == 7
    for fold in page.locator(".fold > summary").all():
        fold.click()
    assert page.locator("figure .still svg").filter(visible=True).count() == 9
    assert page.locator(".plot").filter(visible=True).count() == 0
    page.close()
