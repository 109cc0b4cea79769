"""Saved models over one record: a table, a page, and one line where something is missing."""

import json
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from support.command import call, log_of_a_lag


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return log_of_a_lag(tmp_path_factory.mktemp("log"))


@pytest.fixture(scope="module")
def saved(log: Path) -> list[Path]:
    """Models of one and of two poles, and one of another gain, made from the log."""
    files = [log.parent / f"{name}.json" for name in ("one", "two", "half")]
    whole = rp.read_log(log, input="u", output="y")
    for poles, file in zip((1, 2), files, strict=False):
        rp.fit(whole, poles=poles).model.save(file)
    rp.fit(rp.Log(2.0 * whole.input, whole.output, whole.dt), poles=1).model.save(files[2])
    return files


def test_the_table_has_a_row_for_each_and_the_best_is_the_true_one(capsys, log, saved) -> None:
    code, out, err = call(capsys, "compare", *saved, log, "-i", "u", "-o", "y")
    assert (code, err) == (0, "")
    assert [line.split()[0] for line in out.splitlines()[:4]] == ["model", "one", "two", "half"]
    assert out.splitlines()[1].split()[1] == "trusted"
    assert out.splitlines()[3].split()[1] == "inconsistent"


def test_a_narrow_terminal_gets_whole_words(capsys, log, saved, monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "50")
    _, out, _ = call(capsys, "compare", *saved, log, "-i", "u", "-o", "y")
    assert "…" not in out
    assert out.splitlines()[5].split() == ["model", "poles", "zeros", "dead", "time"]


def test_json_holds_a_validation_of_each_by_name(capsys, log, saved) -> None:
    _, out, _ = call(capsys, "compare", *saved, log, "--json")
    found = json.loads(out)
    assert list(found) == ["one", "two", "half"]
    assert found["one"]["fit"]["simulated"] > 99.9 > found["half"]["fit"]["simulated"]


def test_a_model_that_is_named_twice_is_compared_once_and_that_is_noted(capsys, log, saved) -> None:
    code, out, err = call(capsys, "compare", saved[0], saved[2], saved[0], log, "--json")
    assert (code, list(json.loads(out))) == (0, ["one", "half"])
    assert err == f"replant: note: {saved[0]} is named 2 times, and compared once\n"


@pytest.mark.slow
def test_one_page_shows_all_of_them(capsys, log, saved, tmp_path) -> None:
    code, out, _ = call(capsys, "compare", *saved, log, "--out", tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert code == 0
    assert f"wrote {tmp_path / 'out' / 'report.html'}" in out
    for words in (
        "Outputs",
        "Step responses and poles",
        "Frequency responses",
        " follows the record best",
        "cut off far beyond the range of one",
    ):
        assert words in page
    assert page.count("<tr>") == 1 + len(saved)
    assert (tmp_path / "out" / "models.png").stat().st_size > 10_000


def test_what_is_missing_is_one_line(capsys, log, saved, tmp_path) -> None:
    for arguments, words in (
        ((saved[0],), "name the log behind the models"),
        ((log, saved[0], saved[1]), "name the log behind the models"),
        ((saved[0], saved[1]), "name the log behind the models"),
        ((saved[0], tmp_path / "no.csv"), "no.csv"),
        ((saved[0], log, log), "no model that --save has written"),
        ((saved[0], log, "-p", 2), "--poles does not apply to saved models"),
    ):
        code, out, err = call(capsys, "compare", *arguments)
        assert (code, out, err.count("\n")) == (2, "", 1), arguments
        assert words in err


def test_python_compares_the_same(log, saved) -> None:
    record = rp.read_log(log, input="u", output="y")
    models = {file.stem: rp.load_model(file) for file in saved}
    found = rp.compare(models, record)
    assert found.best in ("one", "two")
    assert found.validations["two"].fit == models["two"].validate(record).fit
    assert [row[0] for row in found.rows] == ["one", "two", "half"]
    assert len(repr(found).splitlines()) == 4
    assert "<img" in found._repr_html_()
    assert list(rp.compare(list(models.values()), record).models) == ["model 1", "model 2", "model 3"]
    output, step, _, poles = found.plot()
    assert len(output.get_lines()) == 4
    np.testing.assert_allclose(
        step.get_lines()[0].get_ydata(), models["one"].step(step.get_lines()[0].get_xdata()[-1]).output
    )
    assert poles.get_xlim()[0] < min(models["two"].transfer_function.poles.real)


def test_a_single_model_or_none_is_answered(log, saved) -> None:
    record = rp.read_log(log, input="u", output="y")
    with pytest.raises(rp.ArgumentTypeError, match=r"compare\(\[model, other\], log\)"):
        rp.compare(rp.load_model(saved[0]), record)
    with pytest.raises(rp.InvalidArgumentError, match="no model to compare"):
        rp.compare([], record)
    with pytest.raises(rp.ArgumentTypeError, match="log must be"):
        rp.compare([rp.load_model(saved[0])], record.input)
