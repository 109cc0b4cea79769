"""A model saved, shown and validated at the command line: the figures are those of Python."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import replant as rp
from replant.cli import main
from support.cases import every
from support.full_disk import full_disk

pytestmark = pytest.mark.usefixtures("unrendered")

SCHEMA = json.loads(files("replant.fitting").joinpath("schema/model-1.json").read_text())
COLUMNS = ("--input", "voltage [V]", "--output", "speed")


def call(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = 0
    try:
        main([str(argument) for argument in arguments])
    except SystemExit as stop:
        code = int(stop.code or 0)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def write(path: Path, seed: int, gain: float = 2.0) -> Path:
    generator = np.random.default_rng(seed)
    u = np.repeat(generator.choice([1.0, 2.0], 60), 25)
    y = 5.0 + rp.TransferFunction([gain], [1.0, 0.5]).simulate(u - 1.0, 0.1) + 0.02 * generator.standard_normal(u.size)
    rows = np.column_stack([0.1 * np.arange(u.size), u, y])
    np.savetxt(path, rows, delimiter=",", header="t,voltage [V],speed", comments="")
    return path


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """The log of a plant, another one of the same plant, and one of another plant."""
    folder = tmp_path_factory.mktemp("logs")
    return write(folder / "a.csv", 0), write(folder / "b.csv", 1), write(folder / "c.csv", 2, gain=4.0)


@every("to", [("--save", "m.json"), ("--out", "plots"), ("--save", "m.json", "--json")])
def test_a_full_disk_does_not_cost_the_result(
    capsys: pytest.CaptureFixture[str],
    logs: tuple[Path, Path, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    to: tuple[str, ...],
) -> None:
    monkeypatch.chdir(tmp_path)
    with full_disk(100):
        code, out, err = call(capsys, "fit", logs[0], *COLUMNS, "--poles", 1, *to)
    assert (code, err.count("\n"), "wrote" in out) == (2, 1, False)
    assert "trusted" in out


def test_an_example_that_does_not_fit_on_the_disk_is_named_and_leaves_nothing(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for typed, file in ((("--out", tmp_path), tmp_path / "motor.csv"), ((), "motor.csv")):
        with full_disk(100):
            code, _, err = call(capsys, "examples", *typed)
        assert code == 2
        assert f"cannot write {file}: " in err
        assert ("--out" in err) == bool(typed)
        assert [*tmp_path.iterdir()] == []


@pytest.mark.parametrize("command", ["run", "fit"])
def test_from_a_log_to_a_validated_model(
    capsys: pytest.CaptureFixture[str], logs: tuple[Path, Path, Path], tmp_path: Path, command: str
) -> None:
    first, second, other = logs
    file = tmp_path / "motor.json"
    arguments = (command, first, *COLUMNS, "--poles", 1, "--save", file, "--validate", second)
    code, out, err = call(capsys, *arguments, "--json", "--require", "trusted")
    assert (code, err) == (0, "")
    printed = json.loads(out)
    jsonschema.Draft202012Validator(SCHEMA).validate(printed)
    model = rp.load_model(file)
    assert rp.Model.from_json(out) == model
    validation = model.validate(rp.read_log(second, input="voltage [V]", output="speed"))
    assert printed["validations"][0]["fit"]["simulated"] == validation.fit
    code, out, _ = call(capsys, "validate", file, second, other, "--json")  # the columns are the model's
    assert code == 0
    same, different = json.loads(out)
    assert same == printed["validations"][0]
    assert (same["verdict"]["status"], different["verdict"]["status"]) == ("trusted", "inconsistent")
    for each in (same, different):
        jsonschema.Draft202012Validator({**SCHEMA["$defs"]["validation"], "$defs": SCHEMA["$defs"]}).validate(each)


def test_read_by_a_person(capsys: pytest.CaptureFixture[str], logs: tuple[Path, Path, Path], tmp_path: Path) -> None:
    first, second, other = logs
    file = tmp_path / "motor.json"
    code, out, _ = call(capsys, "fit", first, *COLUMNS, "--poles", 1, "--save", file, "--validate", second)
    assert (code, f"wrote {file}" in out.replace("\n", ""), "On b.csv" in out) == (0, True, True)
    code, out, _ = call(capsys, "show", file)
    assert code == 0
    for words in ("G(s) = ", "voltage [V] -> speed", "a.csv", "srivc", "trusted"):
        assert words in out
    assert call(capsys, "show", file, "--json")[1] == file.read_text()
    code, out, _ = call(capsys, "validate", file, second, other, "--out", tmp_path / "out")
    assert [path.name for path in sorted((tmp_path / "out").iterdir())] == ["b-validation.png", "c-validation.png"]
    for words in ("On c.csv", "inconsistent", "beside the model's working point"):
        assert words in out


@pytest.mark.slow
def test_the_report_has_the_other_log_beside_the_first(
    capsys: pytest.CaptureFixture[str], logs: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    first, second, other = logs
    arguments = ("fit", first, *COLUMNS, "--poles", 1, "--out", tmp_path)
    assert call(capsys, *arguments)[0] == 0
    assert "On other logs" not in (tmp_path / "report.html").read_text()
    assert call(capsys, *arguments, "--validate", second, "--validate", other)[0] == 0
    page = (tmp_path / "report.html").read_text()
    assert page.index("Step response of G(s)") < page.index("On other logs") < page.index("b.csv: measured")
    assert page.index("b.csv: measured") < page.index("c.csv: measured")


def test_on_its_own_log_a_model_keeps_its_verdict(
    capsys: pytest.CaptureFixture[str], logs: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    file = tmp_path / "motor.json"
    assert call(capsys, "fit", logs[0], *COLUMNS, "--poles", 1, "--save", file)[0] == 0
    code, out, err = call(capsys, "validate", file, logs[0], "--json")
    assert (code, err.count("made from this log, and keeps its verdict")) == (0, 1)
    (found,) = json.loads(out)
    assert found["verdict"]["reasons"] == list(rp.load_model(file).verdict.reasons)


def test_a_verdict_that_is_required_and_missed_ends_with_3(
    capsys: pytest.CaptureFixture[str], logs: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    first, second, other = logs
    file = tmp_path / "motor.json"
    arguments = ("fit", first, *COLUMNS, "--poles", 1, "--require", "trusted", "--save", file)
    assert call(capsys, *arguments, "--validate", second)[0] == 0
    code, _, err = call(capsys, *arguments, "--validate", other)
    assert (code, err) == (
        3,
        "replant: the verdict is trusted (model), inconsistent (validation on c.csv), --require asks for trusted\n",
    )
    assert file.exists()
    assert call(capsys, "validate", file, other, "--require", "trusted")[0] == 3


@every(
    ("arguments", "words"),
    [
        (("show", "none.json"), "none.json: no such file"),
        (("validate", "LOG", "LOG"), "it is not JSON"),
        (("show", "id.bin"), "it is a checkpoint of an identifier; `replant.load` reads it"),
        (("validate", "MODEL", "none.csv"), "none.csv"),
        (("validate", "MODEL", "LOG", "--input", "flow"), "flow"),
        (("fit", "LOG", *COLUMNS, "--poles", "1", "--save", "no/m.json"), "there is no folder"),
        (("fit", "LOG", *COLUMNS, "--poles", "1", "--validate", "none.csv"), "none.csv"),
        (("fit", "LOG", *COLUMNS, "--poles", "1", "--save", "LOG"), "exists and is no model"),
        (("fit", "LOG", *COLUMNS, "--poles", "1", "--save", "."), "exists and is no model"),
    ],
)
def test_mistakes_are_one_line(
    capsys: pytest.CaptureFixture[str],
    logs: tuple[Path, Path, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    call(capsys, "fit", logs[0], *COLUMNS, "--poles", 1, "--save", "MODEL")
    rp.Identifier(rp.Structure(1), dt=0.1).save("id.bin")
    code, out, err = call(capsys, *[str(logs[0]) if word == "LOG" else word for word in arguments])
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert words in err
