"""What the commands say of the other columns of a file."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from support.builders import binary
from support.cases import every
from support.command import call

pytestmark = pytest.mark.usefixtures("unrendered")

SAID = "column pump explains"


@pytest.fixture
def heated(tmp_path: Path) -> Path:
    """A log with text, a heater, a pump and the temperature that both move."""
    u, p = binary(3, 1500, 25), binary(4, 1500, 40)
    y = rp.TransferFunction([2 / 12], [1.0, 1 / 12]).simulate(u, 1.0)
    y += rp.TransferFunction([-0.06], [1.0, 0.05]).simulate(p, 1.0)
    y += 0.05 * np.random.default_rng(0).standard_normal(1500)
    path = tmp_path / "heated.csv"
    rows = [f"{k},shift A,{u[k]:g},{p[k]:g},{y[k]:.5f}" for k in range(1500)]
    path.write_text("t_s,who,heater,pump,temp\n" + "\n".join(rows) + "\n")
    return path


@every("command", ["fit", "run"], quick=1)
@every("more", [("--detrend",), ("--decimate", 2), ("--from", 100)])
def test_fit_and_run_name_the_other_column(capsys, heated: Path, command: str, more: tuple[object, ...]) -> None:
    code, out, _ = call(capsys, command, heated, "-i", "heater", "-o", "temp", "-p", 1, "--json", *more)
    assert code == 0
    verdict = json.loads(out)["verdict"]
    assert any(reason.startswith(SAID) for reason in verdict["reasons"]), verdict


@pytest.mark.slow
def test_the_report_and_the_saved_model_name_it_too(capsys, heated: Path, tmp_path: Path) -> None:
    saved = tmp_path / "model.json"
    arguments = ("-i", "heater", "-o", "temp", "-p", 1, "--out", tmp_path / "out", "--save", saved)
    assert call(capsys, "run", heated, *arguments)[0] == 0
    assert SAID.capitalize() in (tmp_path / "out" / "report.html").read_text("utf-8")
    assert any(reason.startswith(SAID) for reason in rp.load_model(saved).verdict.reasons)


def test_look_names_it_before_anything_is_fitted(capsys, heated: Path) -> None:
    _, out, _ = call(capsys, "look", heated, "-i", "heater")
    assert re.search(rf"{SAID} \S+ % of the residual of a model with one pole", " ".join(out.split()))
    _, out, _ = call(capsys, "look", heated, "-i", "heater", "--json")
    (other,) = json.loads(out)["others"]
    assert (other["column"], other["explains"] > 0.8) == ("pump", True)
    assert shlex.split(json.loads(out)["command"])[-1] == "2"


def test_without_other_columns_nothing_is_said(capsys, heated: Path, tmp_path: Path) -> None:
    rows = [line.split(",") for line in heated.read_text().splitlines()]
    alone = tmp_path / "alone.csv"
    alone.write_text("\n".join(",".join((t, u, y)) for t, _, u, _, y in rows) + "\n")
    _, out, _ = call(capsys, "fit", alone, "-i", "heater", "-o", "temp", "-p", 1, "--json")
    assert not any("column" in reason for reason in json.loads(out)["verdict"]["reasons"])
    _, out, _ = call(capsys, "look", alone)
    assert "Others" not in out


def test_the_verdict_leads_with_it(capsys, heated: Path) -> None:
    for command in ("fit", "run"):
        _, out, _ = call(capsys, command, heated, "-i", "heater", "-o", "temp", "-p", 1)
        (verdict,) = [line for line in out.splitlines() if line.startswith("Verdict")]
        assert "column pump" in verdict, command
