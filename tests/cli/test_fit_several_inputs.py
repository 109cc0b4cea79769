"""`replant fit` of several inputs: a model of each log that it takes, and one line for each mistake."""

from __future__ import annotations

import html
import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

import replant as rp
from support.cases import every
from support.command import call
from support.rows_in_feedback import looped

DT, SAMPLES = 0.1, 900
FIRST, SECOND = rp.TransferFunction([2.0], [1.0, 1.0]), rp.TransferFunction([0.5], [1.0, 0.2], delay=0.3)
NAMED = ("-i", "Q1", "-i", "Q2", "-o", "T1")


def written(path: Path, seed: int) -> Path:
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], (SAMPLES // 10, 2)).repeat(10, axis=0)
    y = FIRST.simulate(u[:, 0].copy(), DT) + SECOND.simulate(u[:, 1].copy(), DT) + 0.1 * rng.standard_normal(SAMPLES)
    second = SECOND.simulate(u[:, 0].copy(), DT) + 0.1 * rng.standard_normal(SAMPLES)
    rows = np.column_stack([DT * np.arange(SAMPLES), u, y + 20.0, second])
    np.savetxt(path, rows, "%.6g", ",", header="t,Q1 [%],Q2 [%],T1 [degC],T2 [degC]", comments="")
    return path


@pytest.fixture(scope="module")
def log(tmp_path_factory: Any) -> Path:
    return written(tmp_path_factory.mktemp("heaters") / "first.csv", 0)


def test_the_model_is_printed_saved_shown_and_validated(capsys: Any, log: Path, tmp_path: Path) -> None:
    saved, other = tmp_path / "row.json", written(tmp_path / "second.csv", 1)
    asked = (*NAMED, "-p", "1,1", "--delay", "0,0.3")
    code, out, err = call(capsys, "fit", log, *asked, "--save", saved, "--validate", other, "--require", "trusted")
    assert (code, err) == (0, "")
    for words in (
        "From Q1 [%] to T1 [degC]",
        "From Q2 [%] to T1 [degC]",
        "exp(-0.3 s)",
        "On second.csv",
        f"wrote {saved}",
    ):
        assert words in out
    model = rp.load_model(saved)
    assert isinstance(model, rp.RowModel)
    direct = rp.fit(rp.read_log(log, input=["Q1", "Q2"], output="T1"), poles=(1, 1), delay=(0.0, 0.3)).model
    assert (model.parameters == direct.parameters).all()
    assert model.provenance.source == "first.csv" != ""
    assert len(model.provenance.sha256) == 64
    code, out, _ = call(capsys, "show", saved)
    assert code == 0
    assert "Made of  first.csv" in out
    code, out, _ = call(capsys, "validate", saved, other, "--json")
    assert code == 0
    assert json.loads(out)[0]["verdict"]["status"] == "trusted"


@pytest.mark.slow
def test_the_next_command_has_the_orders_that_were_found_and_runs(
    capsys: Any, log: Path, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, _ = call(capsys, "fit", log, *NAMED, "-p", "1:2,1", "--delay", "0,0.3")
    assert code == 0
    typed = out.splitlines()[-1].replace("LOG2", str(written(tmp_path / "second.csv", 1)))
    assert "--poles 1,1 --zeros 0,0 --delay 0,0.3" in typed
    code, out, _ = call(capsys, *shlex.split(typed)[1:])
    assert code == 0
    assert "On second.csv" in out


def test_the_json_is_that_of_the_model(capsys: Any, log: Path) -> None:
    code, out, _ = call(capsys, "fit", log, *NAMED, "-p", "1,1", "--delay", "0,0.3", "--json")
    whole = json.loads(out)
    assert code == 0
    assert whole["schema_version"] == 2
    assert [each["name"] for each in whole["input"]] == ["Q1 [%]", "Q2 [%]"]
    assert whole["den"][0][1] == pytest.approx(1.0, rel=0.1)
    assert whole["delay"] == [0.0, 0.3]


def test_one_pass_over_a_log_ends_at_its_fit(capsys: Any, log: Path, tmp_path: Path) -> None:
    asked = (*NAMED, "-p", "1,1", "--delay", "0,0.3", "--json")
    ran, fitted = (json.loads(call(capsys, command, log, *asked)[1]) for command in ("run", "fit"))
    assert ran["provenance"] | {"date": "", "method": ""} == fitted["provenance"] | {"date": "", "method": ""}
    assert ran["provenance"]["method"] == "recursive srivc"
    assert ran["verdict"]["status"] == fitted["verdict"]["status"] == "trusted"
    assert list(ran["parameters"]) == list(fitted["parameters"])
    for name, entry in ran["parameters"].items():
        assert entry["value"] == pytest.approx(fitted["parameters"][name]["value"], rel=1e-3)
    code, out, _ = call(
        capsys, "run", log, *asked[:-1], "--decimate", "2", "--startup", "400", "--save", tmp_path / "row.json"
    )
    assert code == 0
    assert "From Q2 [%] to T1 [degC]" in out
    kept = rp.load_model(tmp_path / "row.json")
    assert (kept.input_hold, kept.output_name) == ("foh", "T1 [degC]")
    assert kept.transfer_functions[0].dc_gain == pytest.approx(2.0, rel=0.1)


def test_two_logs_give_one_model_and_decimated_inputs_run_straight(capsys: Any, log: Path, tmp_path: Path) -> None:
    other = written(tmp_path / "second.csv", 1)
    code, out, _ = call(capsys, "fit", log, other, *NAMED, "-p", "1,1", "--delay", "0,0.3", "--decimate", "2", "--json")
    whole = json.loads(out)
    assert code == 0
    assert whole["input_hold"] == "foh"
    assert whole["samples"] > 0.93 * SAMPLES
    assert whole["dc_gain"] == pytest.approx([2.0, 2.5], rel=0.1)


ONLY_OF_A_PASS = {"--optimizer", "--full-trace", "--startup"}


@every(
    "words, asked",
    [
        ("--poles must have a number for each of 2 inputs (Q1, Q2), as in 1,1: got one", [*NAMED, "-p", 2]),
        ("got 3 numbers", [*NAMED, "-p", "1,1,1"]),
        ("--delay must have a number for each", [*NAMED, "-p", "1,1", "--delay", 0.3]),
        ("'1,x' must be a whole number for each input", [*NAMED, "-p", "1,x"]),
        ("--poles has 2 numbers, and there is one input", ["-i", "Q1", "-o", "T1", "-p", "1,1"]),
        ("column 'T1 [degC]' is the output and an input", ["-i", "Q1", "-i", "T1", "-o", "T1", "-p", "1,1"]),
        ("-i Q1 is given twice", ["-i", "Q1", "-i", "Q2", "-i", "Q1", "-o", "T1", "-p", "1,1,1"]),
        ("no column 'Q3'", ["-i", "Q1", "-i", "Q3", "-o", "T1", "-p", "1,1"]),
        ("missing --poles, a number for each input", list(NAMED)),
        ("several inputs take no --bias yet", [*NAMED, "-p", "1,1", "--bias"]),
        ("several inputs take no --method yet", [*NAMED, "-p", "1,1", "--method", "srivc"]),
        ("several inputs take no --optimizer yet", [*NAMED, "-p", "1,1", "--optimizer", "adam"]),
        ("several inputs take no --full-trace yet", [*NAMED, "-p", "1,1", "--full-trace", "trace.parquet"]),
        ("startup must be at least 1", [*NAMED, "-p", "1,1", "--startup", "0"]),
    ],
)
def test_a_mistake_is_one_line(capsys: Any, log: Path, words: str, asked: list[Any]) -> None:
    command = "run" if set(asked) & ONLY_OF_A_PASS else "fit"
    code, out, err = call(capsys, command, log, *asked)
    assert (code, out, err.count("\n")) == (2, "", 1), err
    assert words in err


@pytest.mark.slow
@pytest.mark.usefixtures("unrendered")
def test_a_second_output_is_a_second_row(capsys: Any, log: Path, tmp_path: Path) -> None:
    saved, other = tmp_path / "matrix.json", written(tmp_path / "second.csv", 1)
    asked = ("-i", "Q1", "-o", "T2", "-o", "T1", "-p", 1, "--save", saved, "--validate", other)
    code, out, _ = call(capsys, "fit", log, *asked, "--out", tmp_path / "out")
    assert code == 0
    for words in ("From Q1 [%] to T2 [degC]", "From Q1 [%] to T1 [degC]", "On second.csv, T2 [degC]", "report.html"):
        assert words in out, words
    assert "<h2>T2 [degC]: " in (tmp_path / "out" / "report.html").read_text()
    code, out, _ = call(capsys, "show", saved)
    assert code == 0
    assert out.count("From Q1 [%]") == 2
    code, out, _ = call(capsys, "validate", saved, other, "--json")
    assert [each["source"] for each in json.loads(out)] == ["second.csv, T2 [degC]", "second.csv, T1 [degC]"]
    code, out, _ = call(capsys, "validate", saved, other, other, "--json")
    assert [each["source"] for each in json.loads(out)] == [f"{other}, T2 [degC]", f"{other}, T1 [degC]"] * 2
    code, out, _ = call(capsys, "run", log, *NAMED, "-o", "T2", "-p", "1,1", "--delay", "0,0.3", "--json")
    whole = json.loads(out)
    assert whole["schema_version"] == 3
    assert [row["output"]["name"] for row in whole["rows"]] == ["T1 [degC]", "T2 [degC]"]
    assert whole["rows"][0]["dc_gain"] == pytest.approx([2.0, 2.5], rel=0.1)
    _, _, err = call(capsys, "compare", saved, log)
    assert "it has several outputs, and replant compare takes models of one" in err


@pytest.mark.slow
def test_columns_are_validated_by_their_names_or_in_the_order_of_the_model(
    capsys: Any, log: Path, tmp_path: Path
) -> None:
    row, matrix, other = tmp_path / "row.json", tmp_path / "matrix.json", written(tmp_path / "second.csv", 1)
    call(capsys, "fit", log, *NAMED, "-p", "1,1", "--delay", "0,0.3", "--save", row)
    call(capsys, "fit", log, *NAMED, "-o", "T2", "-p", "1,1", "--save", matrix)
    renamed = tmp_path / "renamed.csv"
    renamed.write_text(other.read_text().replace("Q1 [%],Q2 [%],T1 [degC],T2 [degC]", "heater,fan,a,b"))

    def fits(*asked: Any) -> list[float]:
        code, out, err = call(capsys, "validate", *asked, "--json")
        assert (code, err) == (0, "")
        return [each["fit"] for each in json.loads(out)]

    wanted = fits(row, other)
    for asked in (["Q2", "Q1"], ["Q2 [%]", "Q1 [%]"], [2, 1]):
        assert fits(row, other, "-i", asked[0], "-i", asked[1]) == wanted
    assert fits(row, renamed, "-i", "heater", "-i", "fan", "-o", "a") == wanted
    assert fits(matrix, other, "-o", "T2", "-o", "T1") == fits(matrix, other)
    code, _, err = call(capsys, "validate", row, other, "-i", "Q1", "-i", "T2")
    assert (code, err.count("\n")) == (2, 1)
    assert "the log has no input Q2" in err


@pytest.mark.slow
def test_a_range_is_searched_for_each_input_and_output(capsys: Any, log: Path, tmp_path: Path) -> None:
    asked = ("-o", "T1", "-p", "1:2,1", "--zeros", "0,0", "--delay", "0,0:0.6:0.3", "--to", 40)
    code, out, _ = call(capsys, "fit", log, *NAMED[:4], *asked, "--out", tmp_path / "out")
    assert code == 0
    assert "chosen" in out
    assert "1, 1" in out
    assert "exp(-0.3 s)" in out
    assert "Structures tried" in (tmp_path / "out" / "report.html").read_text()
    code, out, _ = call(capsys, "fit", log, "-i", "Q1", "-o", "T2", "-o", "T1", "-p", "1:2", "--to", 40, "--json")
    whole = json.loads(out)
    assert [row["structure"][0]["poles"] >= 1 for row in whole["rows"]] == [True, True]
    assert [any(each["chosen"] for each in tried) for tried in whole["candidates"]] == [True, True]
    code, _, err = call(capsys, "run", log, *NAMED, "-p", "1:2")
    assert (code, err.count("\n")) == (2, 1)
    assert "a range is searched by replant fit" in err


def test_compare_names_the_command_for_a_model_of_several_inputs(capsys: Any, log: Path, tmp_path: Path) -> None:
    saved = tmp_path / "row.json"
    call(capsys, "fit", log, *NAMED, "-p", "1,1", "--save", saved)
    code, _, err = call(capsys, "compare", saved, log)
    assert code == 2
    assert "it has several inputs, and replant compare takes models of one" in err


@pytest.fixture(scope="module")
def followed(tmp_path_factory: Any) -> Path:
    """A log of two inputs that follow a set-point each, behind a lag."""
    rng = np.random.default_rng(0)
    r = rng.uniform(-1.0, 1.0, (SAMPLES // 15, 2)).repeat(15, axis=0)
    noise = lfilter([0.03], [1.0, -0.9], rng.standard_normal(SAMPLES))
    u = lfilter([0.4], [1.0, -0.6], r, axis=0) - 0.5 * np.column_stack([noise, -noise])
    y = FIRST.simulate(u[:, 0].copy(), DT) + SECOND.simulate(u[:, 1].copy(), DT) + noise
    path = tmp_path_factory.mktemp("followed") / "followed.csv"
    columns = np.column_stack([DT * np.arange(SAMPLES), u, y, r])
    np.savetxt(path, columns, "%.9g", ",", header="t,Q1,Q2,T1,r1,r2 [V]", comments="")
    return path


SET_POINTS = ("--reference", "r1", "--reference", "r2")
ORDERS = ("-p", "1,1", "--delay", "0,0.3")


@pytest.mark.slow
@pytest.mark.usefixtures("unrendered")
@every("command", ["fit", "run"], quick=1)
def test_each_input_has_a_reference(capsys: Any, followed: Path, tmp_path: Path, command: str) -> None:
    log = rp.read_log(followed, input=["Q1", "Q2"], output="T1", reference=["r1", "r2"])
    direct = getattr(rp, command)(log, poles=(1, 1), delay=(0.0, 0.3)).model
    asked = (followed, *NAMED, *SET_POINTS, *ORDERS)
    code, out, _ = call(capsys, command, *asked, "--json", "--out", tmp_path / "out", "--validate", followed)
    assert code == 0
    whole = json.loads(out)
    assert whole["dc_gain"] == [g.dc_gain for g in direct.transfer_functions]
    for name in ("Q1", "Q2"):
        assert f"input {name} is moved by the reference" in " ".join(whole["verdict"]["reasons"])
    report = html.unescape((tmp_path / "out" / "report.html").read_text())
    for words in ("r1, r2 [V]", "reference=['r1', 'r2']", "--reference r1 --reference r2"):
        assert words in report, words
    assert ("log.references" in report) == (command == "run")


def test_the_next_command_repeats_all_references(capsys: Any, followed: Path, tmp_path: Path) -> None:
    code, out, _ = call(capsys, "fit", followed, *NAMED, *SET_POINTS, *ORDERS)
    assert code == 0
    *_, command = out.splitlines()
    assert "--reference r1 --reference r2" in command
    words = [str(followed) if word == "LOG2" else word for word in shlex.split(command)[1:]]
    words[words.index("model.json")] = str(tmp_path / "model.json")
    assert call(capsys, *words)[0] == 0


@every(
    "words, asked",
    [
        ("one input takes one reference, got 2: give one reference", ["-i", "Q1", "-o", "T1", *SET_POINTS, "-p", "1"]),
        ("one input takes one reference", ["-i", "Q1", "-o", "T1", *SET_POINTS, "-p", "1:2"]),
        ("--reference r1 is given twice", [*NAMED, *SET_POINTS, "--reference", "r1", *ORDERS]),
        ("column 'r1' is a reference twice", [*NAMED, "--reference", "r1", "--reference", "R1", *ORDERS]),
        ("column 'Q2' is an input and a reference", [*NAMED, "--reference", "r1", "--reference", "Q2", *ORDERS]),
        ("column 'T1' is the output and a reference", [*NAMED, "--reference", "r1", "--reference", "T1", *ORDERS]),
        ("no column 'r3'", [*NAMED, "--reference", "r1", "--reference", "r3", *ORDERS]),
    ],
)
def test_references_that_cannot_be_are_one_line(capsys: Any, followed: Path, words: str, asked: list[Any]) -> None:
    for command in ("fit", "run"):
        code, out, err = call(capsys, command, followed, *asked)
        assert (code, out, err.count("\n")) == (2, "", 1), err
        assert words in err


def test_two_inputs_with_one_name_are_said_to_be_columns(capsys: Any, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,u,u,y\n" + "".join(f"{k},{k % 7},{k % 5},{k % 3}\n" for k in range(100)))
    code, _, err = call(capsys, "fit", path, "-i", "1", "-i", "2", "-o", "y", "-p", "1,1")
    assert code == 2
    assert err.endswith("inputs must have different names, but columns 1, 2 are called 'u', 'u': rename them\n")


def test_compare_takes_one_reference(capsys: Any, followed: Path) -> None:
    code, _, err = call(capsys, "compare", followed, "-i", "Q1", "-o", "T1", "-p", 1, *SET_POINTS)
    assert code == 2
    assert "only replant fit, run, validate and fleet take several references: name one of them here" in err


@pytest.mark.slow
def test_a_reference_is_a_column(capsys: Any, tmp_path: Path) -> None:
    u, y, r = looped(0, load=True, pole=0.95, samples=1500)
    path = tmp_path / "loop.csv"
    columns = np.column_stack([0.1 * np.arange(1500), u, y, r])
    np.savetxt(path, columns, delimiter=",", header="t,u1,u2,y,r", comments="", fmt="%.9g")
    asked = ("-i", "u1", "-i", "u2", "-o", "y", "--reference", "r", "-p", "2,1", "--delay", "0,0.3")
    direct = rp.fit(u, y, 0.1, poles=(2, 1), delay=(0.0, 0.3), reference=r)
    gains = np.array([g.dc_gain for g in direct.transfer_functions])
    # all come to rest at one point, of which each is within a thousandth of a deviation by the instruments' measure; a
    # gain is b0 / a0, and a0 what is known the least
    deviations = gains * (np.sqrt(np.diag(direct.covariance)) / direct.parameters)[[1, 3]]
    for command in ("fit", "run"):
        code, out, _ = call(capsys, command, path, *asked, "--json")
        assert code == 0, command
        whole = json.loads(out)
        assert "input u1 is moved by the reference" in " ".join(whole["verdict"]["reasons"]), command
        assert (np.abs(whole["dc_gain"] - gains) < 0.002 * deviations).all(), command
