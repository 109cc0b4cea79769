"""The report's contents, without a browser: all that is needed to trust or distrust the model, bad news first."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import html as escaping
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import replant as rp
from replant.cli import main
from replant.errors import MissingDependencyError
from replant.fitting.model import Model
from replant.report import result_page as module
from replant.report.contents import captions, poles_and_zeros
from replant.report.findings import findings
from replant.report.outputs import Output, panels_of
from replant.report.page_frame import charts_of
from replant.report.result_page import write_report
from support.builders import with_model


class Page(HTMLParser):
    """Tags in their order, with the text that a reader sees."""

    VOID = frozenset({"meta", "link", "br", "wbr", "input", "path", "use", "circle"})

    APART = frozenset({"h1", "h2", "h3", "p", "li", "dt", "dd", "th", "td", "figcaption", "pre"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag in self.APART:
            self.words.append(" ")
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.open.pop() == tag, f"{tag} closes what it did not open"

    def handle_data(self, data: str) -> None:
        if not {"script", "style"} & set(self.open):
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join("".join(self.words).split())


def report(case, folder: Path, **options) -> tuple[str, Page]:
    text = write_report(folder / "report.html", case.result, case.log, **options).read_text(encoding="utf-8")
    return text, Page(text)


def payload(text: str) -> list[dict]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    return [chart for section in json.loads(found[1]).values() for chart in section]


def values(curve: dict) -> np.ndarray:
    return np.frombuffer(base64.b64decode(curve["data"]), "<f4") + curve["offset"]


@pytest.fixture(scope="module")
def good(uncertain, tmp_path_factory) -> tuple[str, Page]:
    """The report of a good model, its log a file."""
    path = tmp_path_factory.mktemp("logs") / "my log.csv"
    path.write_text("the record")
    case = dataclasses.replace(uncertain, log=dataclasses.replace(uncertain.log, path=path))
    return report(case, path.parent, command="replant run 'my log.csv' --poles 2", truth=[1.6, 4.0, 3.0, 6.0])


def test_top_says_model_verdict_and_fit(good, uncertain) -> None:
    text, page = good
    result = uncertain.result
    marks = ('class="verdict good"', "<math", f"<dd>{result.simulation.fit:.1f} %", "over time")
    order = [text.index(mark) for mark in marks]
    assert order == sorted(order)
    assert "Trusted" in page.text
    for words in (f"{result.one_step:.1f} %", "4,000", "DC gain [rpm/V]"):
        assert words in page.text


def test_the_three_questions_come_first_and_what_few_look_for_is_folded(good) -> None:
    """May I use it, how well does it follow, what is left; at most 600 words before anything is unfolded."""
    text, _ = good
    marks = ('class="verdict good"', "How well does it follow?", "What is left?", "Residual with itself", "Dynamics")
    order = [text.index(mark) for mark in marks]
    assert order == sorted(order)
    body = text[text.index("<main>") : text.index("</main>")]
    open_at_first = re.sub(r"(<summary>.*?</summary>).*?</details>", r"\1", body, flags=re.DOTALL)
    open_at_first = re.sub(r"<svg.*?</svg>", "", open_at_first, flags=re.DOTALL)
    read = Page(re.sub("<details[^>]*>", "", open_at_first)).text
    assert len(re.findall(r"\w[^ ]*", read)) < 600
    for words in ("off by", "SHA-256", "import replant as rp", "smallest eigenvalue", "Power spectral"):
        assert words in body
        assert words not in open_at_first


@pytest.mark.usefixtures("unrendered")
def test_the_verdict_says_what_to_do_and_shows_one_reason(plain, tmp_path) -> None:
    verdict = rp.verdict.Assessment("inconsistent", ("first of all", "then this", "and that"))
    case = dataclasses.replace(plain, result=dataclasses.replace(plain.result, verdict=verdict))
    text, _ = report(case, tmp_path, advice=("try one pole", "replant fit log.csv -p 1"))
    shown, _, rest = text[text.index('class="verdict') :].partition("<details")
    assert "Inconsistent: try one pole" in shown
    assert "First of all." in shown
    assert "Then this." not in shown
    for words in ("2 more reasons, and the command", "Then this.", "And that.", "replant fit log.csv -p 1"):
        assert words in rest


@pytest.mark.usefixtures("unrendered")
def test_a_trusted_model_with_a_warning_is_called_trusted_and_coloured_by_the_warning(plain, tmp_path) -> None:
    verdict = rp.verdict.Assessment("trusted", ("it fits",))
    result = dataclasses.replace(plain.result, verdict=verdict, rejected={"no output": 2000})
    text, _ = report(
        dataclasses.replace(plain, result=result), tmp_path, advice=("keep the model", "replant show m.json")
    )
    shown = text[text.index('class="verdict warn"') :]
    assert shown.index("Trusted: keep the model") < shown.index("Rejected samples.")


def test_all_that_the_contract_asks_for_is_there(good, uncertain) -> None:
    _, page = good
    for words in (
        "a₁ [1/s]",
        "b₀ [rpm/V/s²]",
        "estimate ± std",
        "off by",
        "damping",
        "time constant [s]",
        "zero [rad/s]",
    ):
        assert words in page.text
    std = np.sqrt(np.diag(uncertain.result.covariance))
    assert f"± {std[0]:.2g}" in page.text
    for words in (
        "my log.csv",
        hashlib.sha256(b"the record").hexdigest(),
        "replant run 'my log.csv' --poles 2",
        "ident = rp.Identifier( rp.Structure(poles=2",
        "rejected none",
        "numpy " + np.__version__,
    ):
        assert words in page.text


def test_captions_tell_what_is_drawn(uncertain, plain) -> None:
    """No bands where there is no standard deviation, figures with their units, how long there was no estimate."""
    with_bands, without = (Output(case.result, case.log) for case in (uncertain, plain))
    assert "with bands of two standard deviations" in captions([with_bands])["parameters"]
    assert "bands" not in captions([without])["parameters"]
    history = dataclasses.replace(plain.result.history, std=np.full_like(plain.result.history.parameters, np.nan))
    unknown = Output(dataclasses.replace(plain.result, history=history), plain.log)
    assert "bands" not in captions([unknown])["parameters"]
    held = int((plain.result.history.parameters != 0.0).any(axis=1).argmax()) + 1
    assert f"The first estimate is made from the first {held * plain.log.dt:g} s." in captions([without])["parameters"]
    size = np.sqrt(np.mean((plain.log.output - plain.result.simulation.output) ** 2))
    assert f"root mean square of the residual is {size:.3g} rpm" in captions([without])["fit"]
    assert captions([without])["bode"].endswith("rpm/V.")


def test_a_zero_of_unknown_spread_has_its_frequency_in_hertz() -> None:
    """At a double zero the covariance is unbounded, also where that of the poles is known."""
    parameters = [6.0, 11.0, 6.0, 1.0, 4.0, 4.0]  # (s + 2)^2 over (s + 1) (s + 2) (s + 3)
    model = Model(rp.Structure(3, 2), parameters, 0.1, covariance=1e-4 * np.eye(6))
    table = Page(poles_and_zeros([model])).text
    assert "zero [rad/s] frequency [Hz] −2 0.3183" in table
    assert "distance from 0" not in table


def test_the_method_is_named(uncertain) -> None:
    settings = uncertain.result.settings
    assert module._method(settings) == "recursive refined instrumental variables"
    plain = dataclasses.replace(settings, instruments=False, optimizer=rp.Adam(step_size=1e-3))
    assert module._method(plain) == "Adam"
    assert module._method(dataclasses.replace(plain, instruments=True)) == "Adam with instruments"


@pytest.mark.usefixtures("unrendered")
def test_python_in_the_report_repeats_the_run(plain, tmp_path) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, u=plain.log.input, y=plain.log.output)
    log = dataclasses.replace(plain.log, path=path, input_name="u", output_name="y")
    text, _ = report(dataclasses.replace(plain, log=log), tmp_path)
    program = escaping.unescape(re.search(r'<pre class="python"[^>]*><code>(.*?)</code>', text, re.DOTALL)[1])
    names: dict = {}
    exec(program.replace("print(", "repr("), names)
    assert names["ident"].parameters == pytest.approx(plain.result.parameters, rel=1e-5)


def test_nothing_is_fetched(good) -> None:
    text, page = good
    for tag, attributes in page.tags:
        for name in ("src", "href", "xlink:href", "action", "data"):
            value = attributes.get(name) or ""
            assert value.startswith(("#", "data:,")) or not value, (tag, value)
    assert "@import" not in text
    assert "default-src 'none'" in text
    assert not re.search(r"url\((?!#)", text)


def test_every_figure_has_words_and_every_plot_a_place_for_the_keyboard(good) -> None:
    _, page = good
    pictures = [
        attributes for tag, attributes in page.tags if tag == "svg" and "icon" not in (attributes.get("class") or "")
    ]
    assert len(pictures) >= 7
    assert all(picture["role"] == "img" and len(picture["aria-label"]) > 40 for picture in pictures)
    plots = [attributes for _, attributes in page.tags if attributes.get("class") == "plot"]
    assert len(plots) == 9
    assert all(plot["tabindex"] == "0" and "Arrow keys" in plot["aria-label"] for plot in plots)


def test_ids_are_unique(good) -> None:
    ids = [attributes["id"] for _, attributes in good[1].tags if attributes.get("id")]
    assert len(ids) == len(set(ids))


def test_whatever_a_file_calls_itself_is_text(plain, tmp_path) -> None:
    nasty = "<img src=x onerror=alert(1)>\"'&</script>$title"
    log = dataclasses.replace(plain.log, input_name=nasty, output_name=nasty + " [µm]", path=Path("<b>$x.csv"))
    text, page = report(dataclasses.replace(plain, log=log), tmp_path, command=nasty)
    assert "<img" not in text
    assert page.text.count(nasty) >= 3
    assert not any(tag == "img" or "onerror" in attributes for tag, attributes in page.tags)


def test_plots_hold_the_record(uncertain) -> None:
    found = charts_of(panels_of([Output(uncertain.result, uncertain.log)]))
    measured, model = found["fit"][1]["curves"]
    np.testing.assert_allclose(values(measured), uncertain.log.output, atol=1e-6)
    np.testing.assert_allclose(values(model), uncertain.result.simulation.output, atol=1e-6)
    assert (found["fit"][1]["start"], found["fit"][1]["step"]) == (0.0, 0.05)
    first = found["parameters"][0]
    assert [curve["kind"] for curve in first["curves"]] == ["line", "band"]
    estimate = uncertain.result.history.parameters.copy()
    estimate[(estimate == 0.0).all(axis=1)] = np.nan
    np.testing.assert_allclose(values(first["curves"][0]), estimate[:, 0], atol=1e-6)
    assert first["start"] == pytest.approx(0.05)


def test_a_million_samples_make_a_small_file_that_lost_no_peak(long_case, long_report) -> None:
    text = long_report.read_text(encoding="utf-8")
    page = Page(text)
    assert len(text.encode()) < 3_000_000
    _, output, _, *_ = payload(text)
    drawn = values(output["curves"][0])
    y = long_case.log.output
    assert drawn.size <= 36_000
    assert np.nanmax(drawn) == pytest.approx(9.5)
    assert np.nanmin(drawn) == pytest.approx(np.nanmin(y))
    assert output["start"] + output["step"] * drawn.size == pytest.approx(0.05 * y.size, rel=1e-3)
    gone = np.flatnonzero(np.isnan(drawn)) * output["step"] + output["start"]
    hole = 0.4 * 0.05 * y.size  # s
    assert (gone.min(), gone.max()) == pytest.approx((hole, hole + 15), abs=4)
    assert "300 no output" in page.text


def first_words(page: Page) -> str:
    """What is read before the model: everything up to G(s)."""
    return page.text.split("G ( s )")[0].split("G(s)")[0]


SAID = {
    "diverged": ["Diverged", "do not use"],
    "still": ["Not excited", "do not use"],
    "three": ["Too short 3 samples cannot determine 4 parameters: record at least 40."],
    "rejected": ["No sample used", "Every sample was rejected", "500 not finite"],
    "empty": ["No sample used", "empty"],
    "beyond float32": [],
}


def test_bad_news_come_first(bad_report) -> None:
    name, path = bad_report
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    for words in SAID[name]:
        assert words in first_words(page)
    assert ("could not be estimated" in page.text) == (name in ("still", "three", "rejected", "empty"))
    assert "identified online" in page.text
    if SAID[name]:
        assert 'class="verdict bad"' in text
        assert "Do not use this model" in page.text
    assert "NaN" not in re.search(r'id="data">(.*?)</script>', text, re.DOTALL)[1]
    payload(text)


def test_gravest_finding_leads_and_rejected_samples_are_named(plain) -> None:
    result = dataclasses.replace(
        plain.result,
        rejected={"not finite": 600, "too large": 1},
        verdict=rp.verdict.Assessment("diverged", ("updates left the range",)),
    )
    found = findings(result, 4601)
    assert [finding.gravity for finding in found] == ["bad", "warn"]
    assert found[0].text.endswith("Updates left the range.")
    assert "13.1 % of the record could not be used: 600 not finite, 1 too large." in found[1].text


def test_status_that_is_not_known_is_a_warning(plain) -> None:
    result = dataclasses.replace(plain.result, verdict=rp.verdict.Assessment("biased", ()))
    assert [(finding.gravity, finding.headline) for finding in findings(result, 4000)] == [("warn", "Biased")]


def test_unstable_model_is_named(plain) -> None:
    found = findings(with_model(plain.result, parameters=[-0.2, 4.0, 0.0, 1.0]), 4000)
    assert "0.1 ± 1.997i rad/s" in found[0].text


@pytest.mark.usefixtures("unrendered")
@pytest.mark.parametrize("command", [pytest.param("run", marks=pytest.mark.slow), "fit"])
def test_commands_write_it_and_say_how_to_repeat_themselves(plain, tmp_path, capsys, command) -> None:
    path = tmp_path / "my log.csv"
    rows = np.column_stack([plain.log.input[:1500], plain.log.output[:1500]])
    np.savetxt(path, rows, delimiter=",", header="voltage [V],speed", comments="")
    arguments = ["--input", "voltage [V]", "--output", "speed", "--poles", "2", "--zeros", "1", "--dt", "0.05"]
    main([command, str(path), *arguments, "--json", "--out", str(tmp_path / "out")])
    page = Page((tmp_path / "out/report.html").read_text(encoding="utf-8"))
    assert f"replant {command} '{path}' --input 'voltage [V]' --output speed --poles 2 --zeros 1 --dt 0.05" in page.text
    assert ("ident = rp.Identifier(" in page.text) == (command == "run")
    assert ("rp.fit( log, structure=rp.Structure(poles=2, zeros=1)" in page.text) == (command == "fit")
    assert "smallest eigenvalue" in page.text
    assert hashlib.sha256(path.read_bytes()).hexdigest() in page.text
    assert json.loads(capsys.readouterr().out)["samples"] == 1500


def test_standard_deviations_reach_the_json(uncertain) -> None:
    from replant.report.results_as_text import as_json

    entries = as_json(uncertain.result)["parameters"].values()
    assert [entry["std"] for entry in entries] == pytest.approx(np.sqrt(np.diag(uncertain.result.covariance)))


@pytest.fixture
def bare_uplot(monkeypatch):
    """The module that finds uPlot, where there is none: neither in the package nor from uplot-python."""
    from replant.report import page_frame

    page_frame.uplot.cache_clear()
    monkeypatch.setattr(page_frame, "OWN", ("missing.js", "missing.css"))
    monkeypatch.setattr(page_frame.importlib.util, "find_spec", lambda name: None)
    yield page_frame
    page_frame.uplot.cache_clear()


@pytest.mark.usefixtures("unrendered")
def test_without_uplot_it_says_what_to_install(plain, tmp_path, bare_uplot) -> None:
    with pytest.raises(
        MissingDependencyError, match="install npm and then replant once more, or: pip install"
    ) as found:
        write_report(tmp_path / "report.html", plain.result, plain.log)
    assert "\n" not in str(found.value)
    assert not (tmp_path / "report.html").exists()


def test_where_uplot_was_not_fetched_that_of_uplot_python_is_taken(tmp_path, monkeypatch, bare_uplot) -> None:
    (tmp_path / "static").mkdir()
    (tmp_path / "static" / "uPlot.iife.js").write_text("script")
    (tmp_path / "static" / "uPlot.min.css").write_text("style")
    found = SimpleNamespace(submodule_search_locations=[str(tmp_path)])
    monkeypatch.setattr(bare_uplot.importlib.util, "find_spec", lambda name: found)
    assert bare_uplot.uplot() == ("script", "style")


def test_plots_over_time_know_what_is_left_out(uncertain) -> None:
    result = dataclasses.replace(uncertain.result, left_out=np.array([[10, 30]]))
    found = charts_of(panels_of([Output(result, uncertain.log)]))
    dt = uncertain.log.dt
    for chart in found["fit"]:
        assert chart["left_out"] == [[pytest.approx(9 * dt), pytest.approx(30 * dt)]]
