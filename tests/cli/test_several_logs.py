"""One model of several logs at the command line: five step tests that begin at other levels."""

import json
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from support.command import call

pytestmark = pytest.mark.usefixtures("unrendered")

PLANT = rp.TransferFunction([2 / 12], [1.0, 1 / 12], delay=3.0)


@pytest.fixture
def steps(tmp_path: Path) -> list[Path]:
    """Five step tests of 120 s, each from another level of input and output."""
    files = []
    for k, size in enumerate([1.0, 0.5, -1.0, 2.0, -0.5]):
        u = np.where(np.arange(120) >= 20, size, 0.0)
        y = PLANT.simulate(u, 1.0) + 0.03 * np.random.default_rng(k).standard_normal(120)
        rows = [f"{i},{u[i] + 5 * k:g},{y[i] + 20 + 3 * k:.5f}" for i in range(120)]
        files.append(tmp_path / f"step{k}.csv")
        files[-1].write_text("t_s,u,y\n" + "\n".join(rows) + "\n")
    return files


def test_five_step_tests_give_one_model(capsys, steps: list[Path], tmp_path: Path) -> None:
    out, saved = tmp_path / "out", tmp_path / "model.json"
    arguments = ("-i", "u", "-o", "y", "-p", 1, "--delay", 3, "--json", "--out", out, "--save", saved)
    code, said, err = call(capsys, "fit", *steps, *arguments)
    assert (code, err) == (0, "")
    found = json.loads(said)
    np.testing.assert_allclose(found["den"][1], 1 / 12, rtol=0.03)
    assert (found["samples"], found["fit"]["simulated"] > 95.0, found["verdict"]["status"]) == (600, True, "trusted")
    assert rp.load_model(saved).provenance.source == "step0.csv, step1.csv, step2.csv, step3.csv, step4.csv"
    program = (out / "report.html").read_text("utf-8")
    assert all(f"{file}" in program for file in steps)


def test_python_and_the_command_line_make_the_same_model(capsys, steps: list[Path]) -> None:
    _, said, _ = call(capsys, "fit", *steps, "-i", "u", "-o", "y", "-p", 1, "--delay", 3, "--json")
    fitted = rp.fit([rp.read_log(file, input="u", output="y") for file in steps], poles=1, delay=3.0)
    found = json.loads(said)
    np.testing.assert_allclose([*found["den"][1:], *found["num"]], fitted.parameters, rtol=1e-12)


@pytest.mark.slow
def test_a_search_finds_poles_and_dead_time_from_all_of_them(capsys, steps: list[Path]) -> None:
    _, said, _ = call(capsys, "fit", *steps, "-i", "u", "-o", "y", "-p", "1:2", "--delay", "2:4:1", "--json")
    (chosen,) = [each for each in json.loads(said)["candidates"] if each["chosen"]]
    assert (chosen["poles"], chosen["zeros"], chosen["delay"]) == (1, 0, 3.0)


def test_what_does_not_fit_together_is_one_line(capsys, steps: list[Path], tmp_path: Path) -> None:
    slow = tmp_path / "slow.csv"
    slow.write_text("t_s,u,y\n" + "\n".join(f"{2 * k},{k % 3},{k % 5}" for k in range(50)) + "\n")
    for files, words in (((steps[0], slow), "sampling time"), ((steps[0], tmp_path / "no.csv"), "no.csv")):
        code, out, err = call(capsys, "fit", *files, "-i", "u", "-o", "y", "-p", 1)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert words in err
    for command in ("run", "compare"):
        code, _, err = call(capsys, command, *steps[:2], "-i", "u", "-o", "y", "-p", 1)
        assert (code, err.count("\n")) == (2, 1)
        assert "one log" in err


def test_a_copy_of_a_log_is_noted(capsys, steps: list[Path], tmp_path: Path) -> None:
    copy = tmp_path / "copy.csv"
    copy.write_bytes(steps[0].read_bytes())
    code, _, err = call(capsys, "fit", *steps, copy, "-i", "u", "-o", "y", "-p", 1, "--delay", 3)
    assert code == 0
    assert err.startswith(f"replant: note: {copy}: the same samples as in {steps[0]}: they count twice")
    assert err.count("\n") == 1


def test_the_time_between_two_logs_is_no_part_of_their_record(capsys, steps: list[Path]) -> None:
    arguments = ("-i", "u", "-o", "y", "-p", 1, "--delay", 3, "--quiet")
    _, said, _ = call(capsys, "fit", *steps[:2], *arguments)
    assert "Record   240 samples of 2 logs, dt 1 s, 240 s" in said
    assert "Clock" not in said
    lines = steps[1].read_text().splitlines()
    steps[1].write_text("\n".join([*lines[:40], *lines[43:]]) + "\n")  # three rows are lost
    _, said, _ = call(capsys, "fit", *steps[:2], *arguments)
    assert "Clock    irregular: 1 to 4 s between samples, usually 1 s" in said


def test_neither_json_nor_report_speak_of_a_clock_across_logs(capsys, steps: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ("-i", "u", "-o", "y", "-p", 1, "--delay", 3, "--json", "--out", out)
    _, said, _ = call(capsys, "fit", *steps[:2], *arguments)
    assert json.loads(said)["clock"] == {"irregular": False, "shortest": None, "longest": None}
    page = (out / "report.html").read_text("utf-8")
    assert "240 samples, 240 s of 2 logs at 1 s" in page
    assert "clock is irregular" not in page
    assert "up to sample " in page
