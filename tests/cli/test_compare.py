"""``replant compare``: every method's answer is its own command's, beside the others' on a terminal and on a page."""

from __future__ import annotations

import dataclasses
import html
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.optimizers import OPTIMIZERS
from replant.estimation.settings import Request
from replant.online.runs.run_log import METHODS, USUAL, Contender, best, compare
from replant.report.compared_page import claim, write_comparison
from replant.report.figures import draw_outputs, draw_overlay, draw_responses, style
from replant.report.panels import limits
from replant.report.results_as_text import cells_of
from replant.signals import prbs
from support.builders import with_model
from support.command import call

PLANT = rp.TransferFunction([2.0], [1.0, 0.5])
COLUMNS = ("--input", "u [V]", "--output", "y [rpm]", "--poles", "1")
FIGURES = ("outputs.png", "bode.png", "parameters.png")
SOME = ("default", "gradient", "srivc", "least_squares")


def chosen(*methods: str) -> list[str]:
    return [word for method in methods for word in ("--optimizer", method)]


def write(path: Path, u: np.ndarray, y: np.ndarray) -> Path:
    rows = [f"{0.05 * k:.2f},{u[k]:.17g},{y[k]:.17g}" for k in range(u.size)]
    path.write_text("t,u [V],y [rpm]\n" + "\n".join(rows) + "\n")
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of 2/(s + 0.5) under a PRBS, with a working point and a little noise."""
    u = 3.0 + prbs(3000, hold=10)
    y = 7.0 + PLANT.simulate(u - 3.0, dt=0.05) + 0.02 * np.random.default_rng(1).standard_normal(u.size)
    return write(tmp_path_factory.mktemp("rig") / "a<b>.csv", u, y)


@pytest.fixture(scope="module")
def contenders() -> list[Contender]:
    u = prbs(3000, hold=10)
    y = PLANT.simulate(u, dt=0.05) + 0.02 * np.random.default_rng(1).standard_normal(u.size)
    return compare(Request(rp.Structure(1), 0.05), u, y, SOME)


@pytest.mark.slow
def test_each_answer_is_that_of_its_own_command(capsys: Any, log: Path) -> None:
    code, out, err = call(capsys, "compare", log, *COLUMNS, *chosen(*SOME), "--json")
    assert (code, err) == (0, "")
    answers = json.loads(out)
    assert list(answers) == list(SOME)
    alone = {
        "default": ["run"],
        "gradient": ["run", "--optimizer", "gradient"],
        "srivc": ["fit", "--method", "srivc"],
        "least_squares": ["fit", "--method", "least_squares"],
    }
    for name, (command, *options) in alone.items():
        own = json.loads(call(capsys, command, log, *COLUMNS, *options, "--json")[1])
        for answer in (own, answers[name]):
            assert answer.pop("elapsed_seconds") >= 0.0
            del answer["provenance"]["date"]
        assert answers[name] == own
        assert own["parameters"]["a0"]["value"] == pytest.approx(0.5, rel=0.1)


def test_the_names_are_the_optimizers_and_three_more() -> None:
    assert set(METHODS) == {*OPTIMIZERS, "default", "srivc", "least_squares"}
    assert set(USUAL) <= set(METHODS)
    assert len(style.LINES) == len(set(map(str, style.LINES))) >= len(METHODS) - 1  # default is one of the optimizers


@pytest.mark.slow
def test_without_names_the_usual_ones_are_compared_and_none_twice(capsys: Any, log: Path) -> None:
    assert list(json.loads(call(capsys, "compare", log, *COLUMNS, "--json")[1])) == list(USUAL)
    out = call(capsys, "compare", log, *COLUMNS, *chosen("srivc", "gradient", "srivc"), "--json")[1]
    assert list(json.loads(out)) == ["srivc", "gradient"]


@pytest.mark.slow
def test_a_person_reads_one_table(capsys: Any, log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    code, out, err = call(capsys, "compare", log, *COLUMNS, *chosen(*SOME))
    assert (code, err) == (0, "")
    head, *lines = out.splitlines()
    assert head.split() == ["method", "verdict", "simulated", "one", "step", "time", "a0", "b0"]
    rows = {line.split()[0]: line for line in lines[:4]}
    assert list(rows) == list(SOME)
    for name in ("default", "srivc"):
        value, std = map(float, re.search(r"(0\.\d+) \+- (0\.\d+)", rows[name]).groups())
        assert abs(value - 0.5) < 5.0 * std
    assert " +- " not in rows["least_squares"]
    assert len({line.index("+-") for line in rows.values() if "+-" in line}) == 1, "signs below each other"


def test_a_model_that_is_trusted_while_the_input_rests_is_told_apart(contenders: list[Contender]) -> None:
    """The table shows no reasons."""
    moves = next(entry for entry in contenders if entry.name == "default")
    assert moves.result is not None
    verdict = dataclasses.replace(moves.result.verdict, excited=False)
    rests = dataclasses.replace(moves, result=dataclasses.replace(moves.result, verdict=verdict))
    assert cells_of(moves, 2)[0] == "trusted"
    assert cells_of(rests, 2)[0] == "trusted, not excited"


def test_a_narrow_terminal_breaks_the_table_and_cuts_nothing(
    capsys: Any, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    methods = chosen("srivc", "least_squares")
    _, out, _ = call(capsys, "compare", log, *COLUMNS[:4], "--poles", 2, "--zeros", 1, *methods)
    assert max(map(len, out.splitlines())) <= 60
    heads = [line.split() for line in out.splitlines() if line.startswith("method")]
    assert heads[0] == ["method", "verdict", "simulated", "one", "step", "time"]
    assert [name for head in heads[1:] for name in head[1:]] == ["a1", "a0", "b1", "b0"]
    assert "…" not in out


@pytest.mark.usefixtures("unrendered")
def test_a_method_without_a_model_does_not_keep_the_others_from_it(capsys: Any, tmp_path: Path) -> None:
    u = np.full(400, 1.5)
    still = write(tmp_path / "still.csv", u, 3.0 + 0.01 * np.random.default_rng(1).standard_normal(u.size))
    code, out, err = call(
        capsys, "compare", still, *COLUMNS, *chosen("srivc", "least_squares"), "--json", "--out", tmp_path
    )
    assert (code, err) == (0, "")
    answers = json.loads(out)
    assert "srivc finds no model" in answers["srivc"]["problem"]
    assert answers["least_squares"]["verdict"]["status"] == "not excited"
    page = (tmp_path / "report.html").read_text()
    assert "srivc: no model." in page
    assert "no model" in call(capsys, "compare", still, *COLUMNS, *chosen("srivc", "least_squares"))[1]


def test_no_model_at_all_is_one_line_and_exit_code_2(capsys: Any, tmp_path: Path) -> None:
    u = np.full(400, 1.5)
    still = write(tmp_path / "still.csv", u, 3.0 + 0.01 * np.random.default_rng(1).standard_normal(u.size))
    code, out, err = call(capsys, "compare", still, *COLUMNS, *chosen("srivc"))
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "no method found a model; srivc: " in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("compare", "x.csv", *COLUMNS, "--optimizer", "magic"), ["magic", "amsgrad", "least_squares"]),
        (("compare", "missing.csv", *COLUMNS), ["missing.csv"]),
        (("compare", "x.csv", *COLUMNS[:4], "--poles", "1:3"), ["--poles", "one number"]),
    ],
)
def test_a_wrong_call_is_one_line_and_exit_code_2(capsys: Any, arguments: tuple[str, ...], words: list[str]) -> None:
    code, out, err = call(capsys, *arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert all(word in err for word in words), err


@pytest.mark.slow
def test_the_page_holds_everything(capsys: Any, log: Path, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "folder"
    code, said, _ = call(capsys, "compare", log, *COLUMNS, *chosen(*SOME), "--out", out)
    assert code == 0
    assert {path.name for path in out.iterdir()} == {*FIGURES, "report.html"}
    assert said.endswith("".join(f"wrote {out / name}\n" for name in (*FIGURES, "report.html")))
    page = (out / "report.html").read_text(encoding="utf-8")
    assert not re.search(r"<script|<link(?! rel=\"icon\" href=\"data:,\")|src=|url\((?!#)", page), "asks for nothing"
    assert "<h1>a&lt;b&gt;.csv</h1>" in page
    # in the table and in three legends, one of them with the measured output
    assert page.count('<svg class="swatch" viewBox') == 4 * len(SOME) + 1
    assert re.search(r'<svg role="img" aria-label="Measured output, [^"]*; fit: default \d[^"]* %', page)
    assert '<svg role="img" aria-label="Bode diagram of each model' in page
    for name in ("a0", "b0"):
        assert re.search(rf'<svg role="img" aria-label="{name} over time by method; at the end: default 0?\.?\d', page)
    assert page.count(" alone, in Python</summary>") == len(SOME)
    listed = html.unescape(re.search(r'<pre class="shell"[^>]*><code>(.*?)</code>', page, re.DOTALL)[1])
    assert listed.startswith("replant compare ")
    assert listed.endswith("--poles 1 " + " ".join(chosen(*SOME)))


@pytest.mark.usefixtures("unrendered")
def test_its_programs_repeat_each_part(contenders: list[Contender], tmp_path: Path) -> None:
    u = prbs(3000, hold=10)
    y = PLANT.simulate(u, dt=0.05) + 0.02 * np.random.default_rng(1).standard_normal(u.size)
    log = rp.Log(u, y, 0.05, None, "u", "y", Path())
    page = write_comparison(tmp_path / "report.html", contenders, log, rp.Preprocess()).read_text(encoding="utf-8")
    programs = re.findall(r"<summary>(\S+) alone.*?<code>(.*?)</code>", page, re.DOTALL)
    assert [name for name, _ in programs] == list(SOME)
    for (_, program), entry in zip(programs, contenders, strict=True):
        names: dict[str, Any] = {"u": u, "y": y, "print": lambda model: None}
        exec(html.unescape(program), names)
        found = names["fitted"] if entry.fitted else names["ident"]
        np.testing.assert_allclose(found.parameters, entry.result.parameters, rtol=0.02)


def test_all_outputs_lie_over_the_measured_one(contenders: list[Contender]) -> None:
    results = {entry.name: entry.result for entry in contenders}
    y = np.sin(np.arange(3000) / 100.0)
    axis, last = draw_outputs(results, y, 0.05, output_label="speed [rpm]")
    measured, *models = axis.get_lines()
    assert last.get_xlim() == pytest.approx((135.0, 150.0), abs=0.1)
    np.testing.assert_allclose(last.get_lines()[0].get_ydata(), y[-300:])
    assert [line.get_label() for line in models] == list(SOME)
    assert np.ptp(measured.get_ydata()) == pytest.approx(np.ptp(y), rel=1e-3)
    for line in models:
        output = results[line.get_label()].simulation.output
        assert line.get_ydata().max() == pytest.approx(np.nanmax(output))
        assert line.get_xdata()[-1] == pytest.approx(0.05 * 3000, rel=0.01)
    assert len({(line.get_color(), line.get_linestyle()) for line in models}) > 1
    assert axis.get_ylabel() == "speed [rpm]"


def test_all_responses_stand_in_common_axes_and_a_wrong_one_does_not_flatten_them(contenders: list[Contender]) -> None:
    results = {entry.name: entry.result for entry in contenders}
    top, bottom = draw_responses(results, 0.05)
    for line in top.get_lines():
        omega, magnitude = line.get_xdata(), line.get_ydata()
        expected = np.abs(results[line.get_label()].transfer_function.response(omega))
        np.testing.assert_allclose(magnitude, 20 * np.log10(expected))
    assert [line.get_label() for line in bottom.get_lines()] == list(SOME)
    wrong = dataclasses.replace(
        results["default"].model, covariance=None, parameters=np.array([1e-12, 1e9])
    )  # flat at 180 dB at the slowest frequencies
    far = {**results, "wrong": dataclasses.replace(results["default"], model=wrong)}
    low, high = draw_responses(far, 0.05, reference="default")[0].get_ylim()
    assert high - low < top.get_ylim()[1] - top.get_ylim()[0] + 50.0
    nothing = dataclasses.replace(results["default"].model, covariance=None, parameters=np.zeros(2))
    empty = {"nothing": dataclasses.replace(results["default"], model=nothing)}
    assert draw_responses(empty, 0.05)[0].get_lines() == []


def test_the_claim_names_the_best_trusted_model_beside_a_better_fit(contenders: list[Contender]) -> None:
    known = next(entry for entry in contenders if entry.name == "default")
    doubted = dataclasses.replace(known.result.verdict, status="inconsistent")
    better = dataclasses.replace(known.result.simulation, fit=99.9)
    other = dataclasses.replace(known.result, verdict=doubted, simulation=better)
    both = [known, Contender("other", other)]
    said = claim(both).replace("\u00a0", " ")
    assert "the model of other has the best fit: 99.9 %" in said
    assert "It is not trusted; the best trusted model is that of default" in said
    assert "No model is trusted" in claim([Contender("other", other)])
    assert "trusted" not in claim([known])


def test_the_curves_hold_the_histories(contenders: list[Contender]) -> None:
    results = {entry.name: entry.result for entry in contenders}
    for i, axis in enumerate(draw_overlay(results, 0.05)):
        drawn = {line.get_label(): np.asarray(line.get_xydata()) for line in axis.get_lines()}
        assert list(drawn) == list(SOME)
        for name, result in results.items():
            last = result.parameters[i]
            assert drawn[name][-1, 1] == pytest.approx(last, rel=0.02)
            if result.history is None:
                np.testing.assert_array_equal(drawn[name][:, 1], last)
            else:
                assert np.isin(drawn[name][:, 1], result.history.parameters[:, i]).all()
        low, high = axis.get_ylim()
        assert all(low < result.parameters[i] < high for result in results.values())
        begun = drawn["default"][0, 0]
        first = 0.1 * 3000 / 16  # halves of the start-up, down to what a first model needs
        assert begun == pytest.approx(first * 0.05, abs=0.05), "nothing is drawn before there is an estimate"


def test_one_that_shoots_off_does_not_flatten_the_others(contenders: list[Contender]) -> None:
    *others, reference = [entry.result for entry in contenders if entry.result is not None]
    calm = limits(others, reference, 0)
    for value in (1e9, -1e300):
        wild = with_model(reference, parameters=[value, value])
        low, high = limits([*others, wild], reference, 0)
        assert low <= calm[0] < calm[1] <= high
        assert high - low < 5.0 * abs(reference.parameters[0])


def test_the_best_is_the_one_that_simulates_best(contenders: list[Contender]) -> None:
    fits = {entry.name: entry.result.simulation.fit for entry in contenders if entry.result is not None}
    assert best(contenders).name == max(fits, key=fits.get)
    assert best([Contender("srivc", None, problem="none")]) is None


@pytest.mark.usefixtures("unrendered")
def test_a_range_is_written_as_it_was_typed(capsys: Any, tmp_path: Path) -> None:
    u = prbs(60, hold=10)
    log = write(tmp_path / "log.csv", u, PLANT.simulate(u, dt=0.05))
    call(capsys, "fit", log, *COLUMNS[:4], "--poles", "1:2", "--delay", "0:0.2:0.1", "--out", tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "--poles 1:2 --delay 0:0.2:0.1" in page


def test_help_of_out_tells_of_plots_and_report(capsys: Any) -> None:
    for command in ("run", "fit", "compare"):
        assert "Write plots (PNG) and report.html here." in " ".join(call(capsys, command, "--help")[1].split())
