"""The workbench in a browser: from a dropped log to a model that its command makes again, to the bit.

Driven by Playwright in the system's Chromium; screenshots are left in out/workbench for a look.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from pathlib import Path
from threading import Event

import pytest

import replant as rp
from replant.workbench.app import ACTIONS, opened
from support.browsing import TEXTS, contrast
from support.cases import every
from support.waiting import PATIENCE
from support.workbench_pages import Workbench

OVERFLOW = "document.documentElement.scrollWidth - document.documentElement.clientWidth"


@pytest.mark.slow
def test_from_a_dropped_log_to_a_model_that_its_command_makes_again(browser, motor: Path, tmp_path: Path) -> None:
    with opened([]) as served:
        at = Workbench(browser, served.url)
        at.drop(motor)
        at.is_read()
        at.page.get_by_label("Role of column pump").select_option("input")
        at.until(lambda: at.page.get_by_label("Role of column a").input_value() == "")
        at.page.get_by_label("Role of column a").select_option("input")  # corrected
        at.until(lambda: at.page.get_by_label("Role of column pump").input_value() == "")
        at.page.get_by_label("Role of column b").select_option("output")
        at.add("leave_out", "10", "12")
        at.add("validate_on", "40", "")
        at.fit("1:3")
        assert at.page.locator("#cards > li").count() == 3
        at.view("compare")
        at.until(lambda: at.page.locator("#verdicts b").all_inner_texts()[-1].endswith("%"))
        assert "40 s" in at.page.locator("#part option:checked").inner_text()
        at.page.locator(".card .title").nth(1).click()
        command = at.text("code")
        with at.page.expect_download() as coming:
            at.page.click("#save-model")
        coming.value.save_as(tmp_path / "saved.json")
        with at.page.expect_download() as coming:
            at.page.click("#picture")
        assert Path(coming.value.path()).read_bytes().startswith(b"\x89PNG")
        at.close()
        assert at.complaints == []
    words = shlex.split(command)
    assert words[:2] == ["replant", "fit"]
    subprocess.run([sys.executable, "-m", *words, "--quiet"], check=True, capture_output=True, cwd=tmp_path)
    typed, saved = (rp.load_model(tmp_path / name) for name in ("model.json", "saved.json"))
    assert saved == typed
    assert saved.structure.poles == 2
    assert saved.provenance.source == "motor.csv"
    assert Path(words[2]).read_bytes() == motor.read_bytes()


@pytest.mark.slow
def test_a_search_an_online_pass_and_a_stop(browser, motor: Path) -> None:
    with opened([motor]) as served:
        at = Workbench(browser, served.url)
        at.is_read()
        at.page.get_by_label("Role of column a").select_option("input")
        at.page.get_by_label("Role of column b").select_option("output")
        at.fit("1", "run")
        at.fit("1:2", "search", "0:0.02:0.01")
        assert "structures tried" in at.page.locator(".card summary").last.inner_text()
        at.page.locator(".card summary").last.click()
        at.page.get_by_role("button", name="Fit 1 poles, 0 zeros, 0.01 s").click()
        at.until(lambda: at.done() == 3)
        at.page.check("[name=kind][value=search]", force=True)
        at.page.fill("#poles", "1:9")
        at.page.fill("#delay", "0:0.4:0.01")
        at.page.click("#fit")
        stop = at.page.get_by_role("button", name="Stop")
        at.until(lambda: stop.count() == 1)
        stop.click()
        at.until(lambda: at.page.locator(".card[data-state=stopped]").count() == 1)
        at.page.locator(".card[data-state=stopped]").get_by_role("button", name="Remove").click()
        at.page.select_option("#order", "name")
        at.until(lambda: at.page.locator(".card .title").first.inner_text() == "1 pole, 0.01 s")
        at.page.get_by_role("button", name="Rename").nth(1).click()  # the one that was made first
        at.page.keyboard.type("the one")
        at.page.keyboard.press("Enter")
        at.until(lambda: "the one" in at.page.locator(".card .title").all_inner_texts())
        other = Workbench(browser, served.url)  # which moves the card whose name is being typed
        at.page.get_by_role("button", name="Rename").last.click()
        last = at.page.locator(".card").last.get_attribute("data-key")
        other.page.select_option("#order", "made")
        at.until(lambda: at.page.locator(".card").last.get_attribute("data-key") != last)
        at.page.keyboard.type("still typed")
        at.page.keyboard.press("Enter")
        at.until(lambda: "still typed" in at.page.locator(".card .title").all_inner_texts())
        other.close()
        at.close()
        assert at.complaints == []


@pytest.mark.slow
def test_what_was_typed_is_not_undone_by_a_state_from_before(browser, motor: Path, monkeypatch) -> None:
    arrived, answered, (wish, *names) = Event(), Event(), ACTIONS["wish"]

    def held(*given) -> None:
        arrived.set()
        answered.wait(PATIENCE)
        wish(*given)

    monkeypatch.setitem(ACTIONS, "wish", (held, *names))
    with opened([motor]) as served:
        at = Workbench(browser, served.url)
        at.is_read()
        at.page.fill("#poles", "5")
        at.page.keyboard.press("Tab")
        at.until(arrived.is_set)
        other = Workbench(browser, served.url)
        other.add("leave_out", "10", "12")
        at.until(lambda: at.page.locator("#stretches li").count() == 1)  # from a state without the five poles
        assert at.page.input_value("#poles") == "5"
        at.page.get_by_label("leave out to, in s").fill("14")
        at.page.get_by_label("leave out from, in s").fill("11")  # before the session knows of either
        at.page.keyboard.press("Enter")
        answered.set()
        other.until(lambda: other.page.input_value("#poles") == "5")
        other.until(lambda: other.page.get_by_label("leave out from, in s").input_value() == "11")
        assert other.page.locator("#stretches li").count() == 1
        assert other.page.get_by_label("leave out to, in s").input_value() == "14"
        other.page.fill("#poles", "2")
        other.page.keyboard.press("Tab")
        at.until(lambda: at.page.input_value("#poles") == "2")
        assert at.complaints == other.complaints == []


@pytest.mark.slow
def test_while_a_comparison_is_computed_the_page_says_so(browser, motor: Path) -> None:
    held = []
    with opened([motor]) as served:
        at = Workbench(browser, served.url)
        at.is_read()
        at.page.get_by_label("Role of column a").select_option("input")
        at.page.get_by_label("Role of column b").select_option("output")
        at.page.route("**/ask/compared?*", lambda route: held.append(route))
        at.fit("1")
        at.view("compare")
        first = at.page.locator("#verdicts .first")
        at.until(lambda: first.all_inner_texts() == ["computing output, residual and verdict…"])
        at.page.unroute("**/ask/compared?*")  # which lets the one that is held go on
        at.until(lambda: not first.inner_text().startswith("computing"))
        at.close()


@pytest.mark.slow
def test_nothing_is_lost_by_a_reload_a_second_page_or_a_restart(browser, motor: Path, state: Path) -> None:
    with opened([motor]) as served:
        one = Workbench(browser, served.url)
        one.is_read()
        port = served.port
        two = Workbench(browser, served.url)
        one.add("leave_out", "10", "12")
        two.until(lambda: two.page.locator("#stretches li").count() == 1)
        two.page.get_by_label("leave out to, in s").fill("13")
        two.page.keyboard.press("Tab")
        one.until(lambda: one.page.get_by_label("leave out to, in s").input_value() == "13")
        one.page.get_by_role("button", name="Zoom in").first.click()
        one.until(lambda: one.zoomed().startswith("20"))
        zoomed = one.zoomed()
        one.page.reload()
        one.is_read()
        one.until(lambda: one.zoomed() == zoomed)
        assert one.complaints == two.complaints == []
        two.close()
    assert json.loads(next((state / "sessions").iterdir()).read_text())["logs"][0]["setup"]["leave_out"] == [[10, 13]]
    one.until(lambda: "is kept" in one.text("notice"))
    with opened([], port=port):
        one.until(lambda: one.text("link") == "connected")
        one.until(lambda: one.page.get_by_label("leave out to, in s").input_value() == "13")
        one.close()


@pytest.mark.slow
def test_an_entry_that_is_refused_stays_to_be_corrected(browser, motor: Path) -> None:
    with opened([motor]) as served:
        at = Workbench(browser, served.url)
        at.is_read()
        at.page.fill("#poles", "2")
        at.page.fill("#delay", "0,1")
        at.page.keyboard.press("Tab")
        at.until(lambda: "with a decimal point" in at.text("notice"))
        assert [at.page.input_value(f"#{name}") for name in ("poles", "delay")] == ["2", "0,1"]
        at.page.fill("#delay", " 0.1")
        at.page.keyboard.press("Tab")
        at.until(lambda: at.page.input_value("#delay") == "0.1")
        assert (at.page.input_value("#poles"), at.text("notice")) == ("2", "")
        at.close()


@pytest.mark.slow
def test_an_entry_that_is_refused_goes_with_its_log(browser, motor: Path, tmp_path: Path) -> None:
    """Back at that log its own orders are shown again, not those of the log between."""
    other = tmp_path / "other.csv"
    other.write_bytes(motor.read_bytes())
    with opened([other, motor]) as served:
        at = Workbench(browser, served.url)
        for log, poles in (("other.csv", "3"), ("motor.csv", "2")):
            at.page.select_option("#logs", label=log)
            at.until(lambda log=log: at.page.title().startswith(log))
            at.is_read()
            at.page.fill("#poles", poles)
            at.page.keyboard.press("Tab")
            at.until(lambda: at.page.evaluate("document.activeElement.id") != "poles")
        at.page.fill("#delay", "0,1")
        at.page.keyboard.press("Tab")
        at.until(lambda: "with a decimal point" in at.text("notice"))
        for log, poles in (("other.csv", "3"), ("motor.csv", "2")):
            at.page.select_option("#logs", label=log)
            at.until(lambda log=log: at.page.title().startswith(log))
            at.until(lambda poles=poles: at.page.input_value("#poles") == poles)
        assert at.page.input_value("#delay") != "0,1"
        at.close()


@pytest.mark.slow
def test_hostile_names_and_values_stay_words(browser, tmp_path: Path) -> None:
    evil = "<img src=x onerror=document.title='owned'>"
    rows = "".join(f"{k},{k % 5},{k % 7 / 3},=cmd()\n" for k in range(400))
    path = tmp_path / "<b>&'evil.csv"
    path.write_text(f't,{evil},"</script><script>document.title=1</script>",{evil}2\n{rows}')
    with opened([path]) as served:
        at = Workbench(browser, served.url)
        at.is_read()
        assert evil in at.page.locator("#columns").inner_text()
        at.page.fill("#poles", "1")
        at.page.click("#fit")
        at.until(lambda: at.page.locator(".card:is([data-state=done], [data-state=failed])").count() == 1)
        at.page.get_by_role("button", name="Rename").click()
        at.page.keyboard.type(evil)
        at.page.keyboard.press("Enter")
        at.until(lambda: evil in at.page.locator(".card .title").inner_text())
        assert at.page.locator("main img, main script").count() == 0
        assert "evil.csv" in at.page.title()
        at.close()
        assert at.complaints == []


@pytest.mark.slow
def test_from_a_log_to_a_saved_model_without_a_mouse(browser, motor: Path, tmp_path: Path) -> None:
    with opened([motor]) as served:
        at = Workbench(browser, served.url)
        at.is_read()
        press, write = at.page.keyboard.press, at.page.keyboard.type
        for column, role in (("a", "input"), ("b", "output")):
            at.reach(f'[aria-label="Role of column {column}"]')
            write(role)
            at.until(lambda: at.page.get_by_label(f"Role of column {column}").input_value() == role)  # noqa: B023
        at.reach("#add-kind")
        write("leave")
        for field, value in (("begin", "10"), ("end", "12")):
            at.reach(f"#add-{field}")
            write(value)
        press("Enter")
        at.until(lambda: at.page.locator("#stretches li").count() == 1)
        at.reach("#delay")
        press("ControlOrMeta+a")
        write("0.01")
        press("Enter")
        at.until(lambda: at.done() == 3)
        at.reach('nav [data-view="compare"]')
        press("Enter")
        at.until(lambda: at.page.locator("#verdicts b").count() == 3)
        with at.page.expect_download() as coming:
            at.reach("#save-model")
            press("Enter")
        coming.value.save_as(tmp_path / "saved.json")
        at.close()
        assert at.complaints == []
    assert rp.load_model(tmp_path / "saved.json").delay == 0.01


@pytest.mark.slow
def test_every_action_by_keyboard(browser, motor: Path) -> None:
    """What the mouse drags can be typed, and plots are zoomed by keys."""
    with opened([motor]) as served:
        at = Workbench(browser, served.url)
        at.is_read()
        at.page.locator("#plots .plot").first.focus()
        whole = at.zoomed()
        at.page.keyboard.press("+")
        at.until(lambda: at.zoomed() != whole)
        at.page.keyboard.press("Escape")
        at.until(lambda: at.zoomed() == whole)
        met = set()
        at.page.locator("#open").focus()
        for _ in range(60):
            at.page.keyboard.press("Tab")
            met.add(at.page.evaluate("document.activeElement.id || document.activeElement.textContent.trim()"))
        assert {"add-kind", "add-begin", "detrend", "decimate", "poles", "fit", "validate on", "All"} <= met
        at.page.locator("[name=kind]:checked").focus()
        at.page.keyboard.press("ArrowRight")
        at.until(lambda: at.text("fit") == "Search")
        at.page.locator("#session summary").focus()
        at.page.keyboard.press("Space")
        assert at.page.get_by_role("link", name="Save the session").is_visible()
        at.page.keyboard.press("Escape")
        assert not at.page.get_by_role("link", name="Save the session").is_visible()
        at.close()


@pytest.mark.slow
@every("scheme", ["light", "dark"])
def test_it_can_be_read_and_fits(browser, motor: Path, scheme: str) -> None:
    with opened([motor]) as served:
        at = Workbench(browser, served.url, color_scheme=scheme)
        at.is_read()
        if not at.done():  # else it is the session of the case before
            at.page.get_by_label("Role of column a").select_option("input")
            at.page.get_by_label("Role of column b").select_option("output")
            at.add("leave_out", "10", "12")
            at.add("validate_on", "40", "")
            at.fit("1:3")
        for width in (1280, 820, 400):
            at.page.set_viewport_size({"width": width, "height": 860})
            for view in ("data", "models", "compare") if width < 1152 else ("data", "compare"):
                at.view(view)
                if view == "compare":
                    at.until(lambda: at.page.locator("#verdicts b").all_inner_texts()[-1].endswith("%"))
                at.until(lambda: at.page.evaluate(OVERFLOW) <= 0)
                texts = at.page.evaluate(TEXTS)
                faint = {text: round(contrast(ink, paper), 2) for text, ink, paper, _ in texts}
                assert {text: found for text, found in faint.items() if found < 4.5} == {}
                if width != 820:
                    at.seen(f"{view}-{width}-{scheme}")
        at.close()
        assert at.complaints == []


def stuck_log(path: Path) -> Path:
    """A motor whose sensor is stuck for a while, and whose second half has another gain."""
    log = rp.examples.motor()
    output = log.output.copy()
    output[1000:1150] = 150.125
    output[2500:] += 0.4 * (output[2500:] - output.mean())
    rows = zip(log.input.tolist(), output.tolist(), strict=True)
    path.write_text("t,u,y\n" + "".join(f"{0.02 * k:.2f},{u},{y}\n" for k, (u, y) in enumerate(rows)))
    return path


@pytest.mark.slow
def test_what_the_inspection_and_a_reason_speak_of_is_shown(browser, tmp_path: Path) -> None:
    with opened([stuck_log(tmp_path / "stuck.csv")]) as served:
        at = Workbench(browser, served.url)
        at.is_read()
        stuck = at.page.locator("#doubts .reason")
        at.until(lambda: stuck.count() == 1)
        assert "stays at" in stuck.inner_text()
        stuck.click()
        at.until(lambda: at.zoomed().startswith("14"))
        at.page.locator("#doubts .small").click()
        at.until(lambda: at.page.get_by_label("leave out from, in s").input_value() == "20")
        at.page.locator("#detrend").check()
        at.until(lambda: "are identified" in at.text("conditioned"))
        at.add("validate_on", "60", "")
        at.fit("1")
        at.page.locator(".card summary").click()
        reasons = at.page.locator(".card .reason")
        place = at.page.locator(".looked h2")
        for k in range(reasons.count()):
            reasons.nth(k).click()
            at.until(lambda: place.count() == 1)
        at.until(lambda: at.page.locator("#verdicts b").first.inner_text().endswith("%"))
        at.seen("reason")
        with at.page.expect_download() as coming:
            at.page.click("#save-report")
        assert b"<!doctype html>" in Path(coming.value.path()).read_bytes()[:40].lower()
        at.page.check("[name=form][value=python]", force=True)
        assert "rp.detrend(log)" in at.text("code")
        at.close()
        assert at.complaints == []
