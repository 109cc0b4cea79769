"""`replant run -p 1:3`: structures that learn side by side in one pass over a log."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

import replant as rp
from replant.cli import main
from replant.signals import prbs
from support.cases import every

pytestmark = pytest.mark.usefixtures("unrendered")
DT = 0.05
SCHEMA = json.loads(files("replant.fitting").joinpath("schema/model-1.json").read_text())


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Return a log of a plant with two poles."""
    u = prbs(900, hold=8)
    y = rp.TransferFunction([9.0], [1.0, 2.0, 9.0]).simulate(u, DT)
    y += 0.05 * np.random.default_rng(0).standard_normal(u.size)
    path = tmp_path / "log.csv"
    path.write_text("u,y\n" + "".join(f"{a},{b:.17g}\n" for a, b in zip(u, y, strict=True)))
    return path


def run(log: Path, *arguments: str) -> None:
    main(["run", str(log), "--input", "u", "--output", "y", "--dt", str(DT), *arguments])


@pytest.mark.slow
def test_the_most_probable_structure_is_served_and_the_weights_are_told(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path
) -> None:
    kept = tmp_path / "model.json"
    run(log, "-p", "1:2", "--json", "--save", str(kept))
    answer = json.loads(capsys.readouterr().out)
    jsonschema.Draft202012Validator(SCHEMA).validate(answer)
    assert [each["poles"] for each in answer["structures"]] == [1, 2]
    assert sum(each["weight"] for each in answer["structures"]) == pytest.approx(1.0)
    assert answer["structures"][1]["weight"] > 0.9
    assert answer["leads"][-1]["poles"] == 2
    assert answer["structure"]["poles"] == 2
    assert answer["verdict"]["status"] == "trusted"
    run(log, "-p", "2", "--json")
    alone = json.loads(capsys.readouterr().out)
    for name in ("num", "den", "covariance", "fit", "samples", "rejected", "verdict"):
        assert answer[name] == alone[name], name
    assert rp.load_model(kept).structure.poles == 2


@pytest.mark.slow
def test_a_person_reads_the_weights_before_the_result(capsys: pytest.CaptureFixture[str], log: Path) -> None:
    run(log, "-p", "1:2")
    out = capsys.readouterr().out
    assert out.startswith("Weights: poles 1 zeros 0 0.000, poles 2 zeros 0 1.000\nServed: from sample ")
    assert "trusted" in out


@every(
    "arguments, words",
    [
        (("-p", "1:5", "--zeros", "0:4"), "at most 10 structures"),
        (("-p", "1:2", "--optimizer", "adam"), "--optimizer"),
        (("-p", "1:2", "--full-trace", "trace.parquet"), "--full-trace"),
        (("-p", "1:2", "--zeros", "5"), "fewer than --poles"),
        (("-p", "1:2", "--feedthrough"), "--feedthrough"),
        (("-p", "1,2"), "name the others"),
        (("-p", "1:30"), "poles must be at most 10, got 30"),
    ],
    ids=str,
)
def test_what_a_range_does_not_take_is_one_line(
    capsys: pytest.CaptureFixture[str], log: Path, arguments: tuple[str, ...], words: str
) -> None:
    with pytest.raises(SystemExit) as stop:
        run(log, *arguments)
    assert stop.value.code == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert words in err


@pytest.mark.slow
def test_run_in_python_takes_the_structures_of_a_range(capsys: pytest.CaptureFixture[str], log: Path) -> None:
    run(log, "-p", "1:3", "--json")
    typed = json.loads(capsys.readouterr().out)
    found = rp.run(rp.read_log(log, input="u", output="y", dt=DT), structure=[rp.Structure(n) for n in (1, 2, 3)])
    assert found.parameters.tolist() == [each["value"] for each in typed["parameters"].values()]
    assert [structure.poles for structure, _ in found.weights] == [1, 2, 3]
    assert [weight for _, weight in found.weights] == [each["weight"] for each in typed["structures"]]


@every(
    "asked, words",
    [
        ({"structure": [rp.Structure(1)]}, "a list of 2 to 10, got 1"),
        ({"structure": [1, 2]}, "structure must be a Structure, got 1"),
        ({"structure": [rp.Structure(1), 2]}, "structure must hold Structures, got 2"),
        ({"structure": [rp.Structure(1), rp.Structure(2)], "delay": 0.1}, "give either a structure, or poles"),
        ({"structure": [rp.Structure(1), rp.Structure(2)], "optimizer": "adam"}, "take no optimizer"),
    ],
)
def test_structures_that_cannot_learn_side_by_side_are_named(asked: dict[str, Any], words: str) -> None:
    u = prbs(90, hold=8)
    with pytest.raises(rp.ReplantError, match=words):
        rp.run(u, u, DT, **asked)


@every(
    "command",
    [
        ("live", "-", "-p", "1:3", "--dt", "0.1"),
        ("fleet", "LOG", "-i", "u", "-o", "y", "-p", "1:3", "--out", "fleet"),
        ("compare", "LOG", "-i", "u", "-o", "y", "-p", "1:3"),
    ],
)
def test_who_takes_one_structure_says_who_takes_a_range(
    capsys: pytest.CaptureFixture[str], log: Path, command: tuple[str, ...]
) -> None:
    with pytest.raises(SystemExit):
        main([str(log) if word == "LOG" else word for word in command])
    wanted = (
        "--poles must be one number here: a range learns side by side in `replant run`, and `replant fit` searches it"
    )
    assert capsys.readouterr().err == f"replant: {wanted}\n"
