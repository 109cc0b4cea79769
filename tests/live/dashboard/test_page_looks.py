"""What the page shows of time, residual, responses, truth and reasons, and how one looks closer."""

from __future__ import annotations

import itertools
from typing import Any

import pytest

from replant.report.findings import VERDICTS
from support.cases import every
from support.dashboard_feed import PLANT, Feed
from support.dashboard_pages import Page

pytestmark = pytest.mark.slow  # that it works is shown in test_page.py
TIME = ("output", "residual", "input")
REASON = "the input could explain another 3 % of the output's power, unexplained by the model: too few poles or zeros"
BOXES = """[...document.querySelectorAll("#plane text")].map(text => {
  const { x, y, width, height } = text.getBoundingClientRect();
  return { x, y, width, height, text: text.textContent };
})"""
HIDDEN = "name => document.getElementById(name).scrollHeight - document.getElementById(name).clientHeight"


def told(opened: Page, feed: Feed, **change: Any) -> None:
    """Have the page show a view with these changes."""
    feed.change = change
    samples = feed.advance()["samples"]
    opened.until(lambda: opened.text("samples") == f"{samples:,}")


def small(opened: Page) -> str:
    script = "document.querySelector('#multiples canvas').toDataURL()"
    return opened.page.evaluate(script)


def drag(opened: Page, name: str, begin: float, end: float) -> None:
    """Draw from one part of a plot's width to another."""
    box = opened.page.locator(f"#{name} .u-over").bounding_box()
    middle = box["y"] + box["height"] / 2
    opened.page.mouse.move(box["x"] + begin * box["width"], middle)
    opened.page.mouse.down()
    opened.page.mouse.move(box["x"] + end * box["width"], middle, steps=4)
    opened.page.mouse.up()


def test_the_plots_show_the_last_seconds_or_all(opened: Page) -> None:
    before = small(opened)
    assert opened.page.locator("[data-last][aria-pressed=true]").inner_text() == "all"
    opened.page.get_by_role("button", name="10 s", exact=True).click()
    opened.until(lambda: small(opened) != before)
    assert opened.page.locator("[data-last][aria-pressed=true]").inner_text() == "10 s"
    opened.page.get_by_role("button", name="10 min").click()
    opened.until(lambda: "of the signals the newest 10.0 s are kept" in opened.text("span"))
    opened.page.get_by_role("button", name="all", exact=True).click()
    opened.until(lambda: "drag to zoom" in opened.text("span"))
    opened.until(lambda: small(opened) == before)


def test_dragging_looks_closer_at_all_signals_and_a_double_click_goes_back(opened: Page) -> None:
    opened.page.mouse.move(1, 1)
    before = opened.pixels(*TIME)
    drag(opened, "output", 0.6, 0.8)
    opened.until(lambda: opened.page.locator("#unzoom").is_visible())
    opened.until(lambda: all(new != old for new, old in zip(opened.pixels(*TIME), before, strict=True)))
    opened.page.locator("#residual .u-over").dblclick()
    opened.page.mouse.move(1, 1)
    opened.until(lambda: opened.pixels(*TIME) == before)
    assert not opened.page.locator("#unzoom").is_visible()


def test_a_zoom_is_left_by_its_button_and_works_on_a_paused_page(opened: Page) -> None:
    opened.page.locator("#pause").click()
    opened.page.mouse.move(1, 1)
    before = opened.pixels(*TIME)
    drag(opened, "input", 0.1, 0.4)
    opened.until(lambda: opened.pixels(*TIME) != before)
    opened.page.locator("#unzoom").click()
    opened.page.mouse.move(1, 1)
    opened.until(lambda: opened.pixels(*TIME) == before)


def test_frequencies_and_the_step_are_looked_at_closer_each_by_itself(opened: Page) -> None:
    opened.page.mouse.move(1, 1)
    before = opened.pixels("magnitude", "phase", "step", "output")
    drag(opened, "phase", 0.5, 0.7)
    opened.page.mouse.move(1, 1)
    opened.until(lambda: opened.pixels("magnitude")[0] != before[0])
    assert opened.pixels("phase", "step", "output")[1:] == before[2:]
    opened.page.locator("#magnitude .u-over").dblclick()
    opened.page.mouse.move(1, 1)
    opened.until(lambda: opened.pixels("magnitude", "phase", "step", "output") == before)
    drag(opened, "step", 0.0, 0.2)
    opened.page.mouse.move(1, 1)
    opened.until(lambda: opened.pixels("step")[0] != before[2])
    assert opened.pixels("magnitude") == before[:1]


def test_the_truth_of_a_simulated_rig_stands_beside_the_estimate(opened: Page, feed: Feed) -> None:
    assert opened.page.locator("#plane .true").count() == 0
    assert "true" not in opened.page.locator(".bode").inner_text()
    without = opened.pixels("magnitude", "step")
    assert feed.hub.newest is not None
    bode, step = feed.hub.newest["bode"], feed.hub.newest["step"]
    poles = [{"real": pole.real, "imag": pole.imag} for pole in PLANT.poles.tolist()]
    far = {"magnitude_db": [value + 6.0 for value in bode["magnitude_db"]], "phase_deg": bode["phase_deg"]}
    truth = {"parameters": [1.6, 40.0, 3.0, 6.0], "poles": poles, "zeros": [], **far, "step": [0.1] * len(step["t"])}
    told(opened, feed, truth=truth)
    opened.until(lambda: opened.page.locator("#plane .true").count() == 2)  # it comes though no view follows
    assert opened.page.locator(".bode").inner_text().count("true") == 3
    assert all(new != old for new, old in zip(opened.pixels("magnitude", "step"), without, strict=True))


def test_the_residual_has_its_limits_where_the_noise_is_known(opened: Page, feed: Feed) -> None:
    legend = opened.page.locator('[data-for="residual"]')
    assert "± 3σ 0.30" in legend.inner_text()
    told(opened, feed, residual_std=None)
    assert "σ" not in legend.inner_text()


def test_named_signals_are_named(opened: Page, feed: Feed) -> None:
    assert opened.text("input-name") == ""
    told(opened, feed, input_label="voltage² [kV²]", output_label="displacement [mm]")
    assert (opened.text("input-name"), opened.text("output-name")) == ("voltage² [kV²]", "displacement [mm]")


def test_many_reasons_do_not_push_the_plots_away_and_can_all_be_read(opened: Page, feed: Feed) -> None:
    told(opened, feed, reasons=["in order"])
    top = opened.page.locator("#output").bounding_box()["y"]
    assert not opened.page.locator("#more").is_visible()
    told(opened, feed, reasons=[f"{number}: {REASON}" for number in range(6)], verdict="inconsistent")
    assert opened.page.locator("#output").bounding_box()["y"] == top
    opened.page.get_by_role("button", name="All reasons").click()
    assert opened.page.evaluate(HIDDEN, "words") <= 1
    assert opened.page.locator("#more").get_attribute("aria-expanded") == "true"
    opened.seen("all-reasons-1280")
    opened.page.get_by_role("button", name="Fewer reasons").click()
    assert opened.page.locator("#output").bounding_box()["y"] == top


@every("pole", [-0.05 + 300j, -1.6 + 76j, -3.0 + 4j, -80.0 + 1j])
def test_labels_of_the_damping_do_not_overlap(opened: Page, feed: Feed, pole: complex) -> None:
    told(opened, feed, poles=[{"real": pole.real, "imag": pole.imag}], zeros=[], pole_covariance=[])
    boxes = opened.page.evaluate(BOXES)  # of one drawing
    assert len(boxes) > 4
    for one, other in itertools.combinations(boxes, 2):
        across = min(one["x"] + one["width"], other["x"] + other["width"]) - max(one["x"], other["x"])
        along = min(one["y"] + one["height"], other["y"] + other["height"]) - max(one["y"], other["y"])
        assert across <= 0 or along <= 2, (one, other)  # some of the line's height is above and below its letters


@every("width", [390, 1280])
def test_labels_of_far_poles_are_not_cut_off_and_leave_the_axis_free(opened: Page, feed: Feed, width: int) -> None:
    opened.page.set_viewport_size({"width": width, "height": 800})
    told(opened, feed, poles=[{"real": at, "imag": 0.0} for at in (-15002.0, -2.2)], zeros=[], pole_covariance=[])
    frame = opened.page.locator("#plane svg").bounding_box()
    axis = opened.page.locator("#plane .unstable-half").bounding_box()["x"]
    boxes = opened.page.evaluate(BOXES)
    assert any("000" in box["text"] for box in boxes)
    for box in boxes:
        left, right = box["x"], box["x"] + box["width"]
        assert frame["x"] - 1.0 < left, box
        assert right < frame["x"] + frame["width"] + 1.0, box
        assert "ζ" not in box["text"] or right <= axis, box


def test_the_words_of_a_verdict_are_those_of_the_report(opened: Page, feed: Feed) -> None:
    for status, words in VERDICTS.items():
        told(opened, feed, verdict=status, excited=True, status="running")
        assert (opened.text("headline"), opened.text("meaning")) == (words.headline, words.text)
        assert opened.page.locator(".verdict").get_attribute("data-gravity") == words.gravity
