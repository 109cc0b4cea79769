"""The page of the whole reproduction: each table's numbers, each figure once, no external files; the demo's report."""

import html
import re
from itertools import chain

import click
import pytest

from replant.cli import main
from replant.cli.demo import deliver, reproduce_command
from replant.paper import rendering
from replant.paper.actuator import NOTES
from replant.paper.figures import FIGURES, Outcome, run, save
from replant.paper.rendering import CAPTIONS, as_element, summary, typeset, write_report
from replant.plotting.numbers import number, uncertain

DRAWN = ("fig1", "fig2", "fig3", "fig4", "fig6", "fig7", "fig7-exact", "fig8", "fig8-exact")


def as_text(page):
    """The page's words."""
    words = re.sub(r"<[^>]*>", " ", re.sub(r"<style>.*?</style>", "", page, flags=re.DOTALL))
    return " ".join(html.unescape(words).split())


def assert_alone(page):
    """Check that the page asks for nothing: no script of elsewhere, no picture, no style sheet, no font."""
    assert not re.search(r"<script[^>]+src|<img|<link(?! rel=\"icon\" href=\"data:,\")|@import|url\((?!#)", page)
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    for target in re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', page):
        assert "".join(target) in ids


@pytest.fixture(scope="module")
def page(results, actuator, tmp_path_factory):
    """The page of everything, with the lightest of pictures."""
    outcome = Outcome(results, record=actuator.record, offline=actuator.offline, actuator=actuator)
    pictures = {name: f'<svg viewBox="0 0 7 5"><title>{name}</title></svg>' for name in DRAWN}
    path = tmp_path_factory.mktemp("page") / "deep" / "report.html"
    return write_report(path, outcome, pictures, "replant reproduce").read_text(encoding="utf-8")


def test_the_page_holds_every_table(page, results, actuator):
    text = as_text(page)
    for result in results.values():
        assert text.count(result.table.title) == 2  # in the contents, and above the table
        for row in result.rows:
            assert row.row.label in text
            for cell in row.cells:
                ours = number(cell.ours, 3) if cell.std is None else uncertain(cell.ours, cell.std)
                assert f"{ours} published {number(cell.published, 3)}, {cell.verdict}" in text
    for row in actuator.rows:
        assert row.label in text
    for line in summary(list(results.values())):
        assert line in text
    for line in (*rendering.actuator_summary(actuator), *rendering.LEGEND, *NOTES):
        assert as_text(typeset(line)) in text
    assert "28 of 28 figures and 12 of 12 sums equal in all printed digits." in text


def test_the_page_holds_every_figure_once_and_asks_for_nothing(page):
    assert_alone(page)
    assert re.findall(r"<title>(fig.*?)</title>", page) == list(DRAWN)
    assert list(CAPTIONS) == list(DRAWN)
    for name in DRAWN:
        assert f'<svg role="img" aria-label="{html.escape(CAPTIONS[name])}" viewBox' in page
    assert "<code>replant reproduce</code>" in page


@pytest.mark.slow
def test_its_pictures_are_those_of_the_files(tmp_path):
    """The same curves, to the digits that a picture needs."""
    for name, canvas, paths in save(run(list(FIGURES)), list(FIGURES), tmp_path):
        on_page, on_disk = as_element(canvas, name), paths[1].read_text(encoding="utf-8")
        curves = [re.findall(r"-?\d+\.?\d*", path) for path in re.findall(r'<path d="([^"]*)" clip-path', on_disk)]
        shown = [re.findall(r"-?\d+\.?\d*", path) for path in re.findall(r'<path d="([^"]*)" clip-path', on_page)]
        assert len(curves) == len(shown) > 2
        assert sum(map(len, curves)) == sum(map(len, shown)) > 1000
        for ours, theirs in zip(chain(*shown), chain(*curves), strict=True):
            assert abs(float(ours) - float(theirs)) < 0.02  # of a point, 72 to the inch
        assert "<text" in on_page, "text is text"
        assert "var(--" not in on_page, "on white, whatever the page's colours"


def test_what_was_not_asked_for_is_not_on_the_page(tmp_path):
    outcome = run(["table2"])
    page = write_report(tmp_path / "a" / "report.html", outcome, {}, "replant reproduce table2").read_text()
    assert_alone(page)
    text = as_text(page)
    assert "Table 2" in text
    assert "Table 1:" not in text
    assert "The actuator" not in text
    assert "<figure" not in page
    empty = write_report(tmp_path / "report.html", Outcome(), {}).read_text()
    assert "How to reproduce this" not in empty


def test_names_alone_make_no_report(capsys, tmp_path):
    main(["reproduce", "fig4", "--out", str(tmp_path)])
    assert not (tmp_path / "report.html").exists()


def test_a_report_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "report.html").mkdir()
    with click.Context(reproduce_command), pytest.raises(click.BadParameter, match=r"report\.html"):
        deliver(("table2",), tmp_path, report=True)


def test_the_demo_in_full_asks_for_the_report(tmp_path, monkeypatch):
    asked = {}
    monkeypatch.setattr("replant.cli.demo.deliver", lambda names, out, **how: asked.update(how, names=names, out=out))
    main(["demo", "--full", "--out", str(tmp_path)])
    assert asked == {"names": ("fig6", "fig7", "fig8", "actuator"), "out": tmp_path, "report": True}


@pytest.mark.slow
def test_the_demo_writes_its_report_with_the_truth(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("replant.cli.demo.SAMPLES", 20_000)
    main(["demo", "--out", str(tmp_path)])
    said = capsys.readouterr().out
    assert said.endswith(f"wrote {tmp_path / 'report.html'}\n")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    text = as_text(page)
    assert "<h1>Dielectric elastomer actuator, simulated</h1>" in page
    assert "voltage [kV], displacement [mm]" in text
    assert "none: the record is simulated" in text
    assert "off by" in text
    assert "replant demo" in text
