"""The page of several inputs: each has its samples, and a button that shows its model."""

from __future__ import annotations

import pytest

from replant.live.dashboard.app import Hub
from replant.live.dashboard.server import serve
from support.dashboard_pages import Page
from support.live_rows import learned, seen

POLES = "() => [...document.querySelectorAll('#modes th')].map(head => head.textContent)"
TITLES = "() => [...document.querySelectorAll('#multiples h3')].map(head => head.textContent)"


@pytest.mark.slow
def test_a_button_chooses_the_input_whose_model_is_shown(browser) -> None:
    hub = Hub()
    with serve(hub) as served:
        hub.publish(seen().to_json())
        opened = Page(browser, served.url)
        opened.seen("several-inputs")
        try:
            assert opened.text("inputs").split() == ["From", "Q1", "Q2"]
            before, gain, pictures = opened.page.evaluate(POLES), opened.text("gain"), opened.pixels("step", "phase")
            assert len(before) == 2
            opened.page.get_by_role("button", name="Q2", exact=True).click()
            opened.until(lambda: len(opened.page.evaluate(POLES)) == 1)
            assert opened.text("gain") != gain
            assert all(new != old for new, old in zip(opened.pixels("step", "phase"), pictures, strict=True))
            assert "0.3" in opened.text("formula")
            hub.publish(seen().to_json())  # what comes next is of the same input
            drawn = opened.drawn
            opened.until(lambda: opened.drawn > drawn)
            assert len(opened.page.evaluate(POLES)) == 1
            opened.page.get_by_role("button", name="Q1", exact=True).click()
            opened.until(lambda: opened.page.evaluate(POLES) == before)
            assert opened.text("gain") == gain
            assert (opened.text("input-name"), opened.text("input-2-name")) == ("Q1", "Q2")
            assert opened.pixels("input") != opened.pixels("input-2")
            assert opened.page.evaluate(TITLES) == ["a₁.Q1", "a₀.Q1", "b₀.Q1", "a₀.Q2", "b₀.Q2"]
            assert len(opened.page.evaluate(TITLES)) == learned().parameters.size
            assert opened.complaints == []
        finally:
            opened.close()


def test_one_input_has_no_buttons(opened: Page) -> None:
    assert not opened.page.locator("#inputs").is_visible()
    assert opened.page.locator("#input-2").count() == 0
