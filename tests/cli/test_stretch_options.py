"""Stretches of a log that are used, left out, or kept to validate on; the input acts all the same."""

import html
import json
import re
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from support.builders import binary
from support.command import call

pytestmark = pytest.mark.usefixtures("unrendered")

COLUMNS = ("-i", "u", "-o", "y", "-p", 1)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A log of 600 s of 2 / (s + 0.5), whose output is wrong from 200 to 300 s."""
    u = binary(3, 1200, 12)
    y = rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u, 0.5) + 0.02 * np.random.default_rng(0).standard_normal(1200)
    y[400:600] += np.linspace(0.0, 40.0, 200)
    path = tmp_path / "log.csv"
    path.write_text("t_s,u,y\n" + "\n".join(f"{0.5 * k:g},{u[k]:g},{y[k]:.6f}" for k in range(1200)) + "\n")
    return path


def model_of(capsys, command: str, log: Path, *more: object) -> dict:
    code, out, err = call(capsys, command, log, *COLUMNS, "--json", *more)
    assert code == 0, err
    return json.loads(out)


@pytest.mark.parametrize("command", ["fit", "run"])
@pytest.mark.parametrize(
    "more",
    [
        ("--leave-out", "200s:300s"),
        ("--leave-out", "200:250", "--leave-out", "4min:5min"),
        ("--use", "0s:200s", "--use", "300:"),
        ("--use", ":200"),
        ("--from", 100, "--leave-out", "200s:300s"),
    ],
)
def test_what_is_left_out_does_not_spoil_the_model(capsys, log: Path, command: str, more: tuple[object, ...]) -> None:
    np.testing.assert_allclose(model_of(capsys, command, log, *more)["den"], [1.0, 0.5], rtol=0.03)


@pytest.mark.slow
def test_with_it_the_model_is_spoilt(capsys, log: Path) -> None:
    assert model_of(capsys, "fit", log)["fit"]["simulated"] < 80.0


def test_the_model_is_validated_on_a_stretch_that_it_has_not_seen(capsys, log: Path) -> None:
    found = model_of(
        capsys, "fit", log, "--leave-out", "200s:300s", "--validate-on", "400s:500s", "--validate-on", "500:"
    )
    first, second = found["validations"]
    assert (first["source"], first["samples"], second["samples"]) == ("log.csv, 400 s to 500 s", 200, 200)
    assert first["fit"]["simulated"] > 90.0
    assert found["samples"] == 1200 - 200 - 400


@pytest.mark.parametrize("more", [("--validate-on", "200:"), ("--leave-out", "200s:"), ("--use", "0:200")])
def test_an_end_that_is_left_out_is_no_sensor_that_has_failed(capsys, log: Path, more: tuple[str, ...]) -> None:
    verdict = model_of(capsys, "run", log, *more)["verdict"]
    assert (verdict["status"], [each for each in verdict["reasons"] if "arrived" in each]) == ("trusted", [])


def test_several_logs_are_cut_alike(capsys, log: Path) -> None:
    code, out, _ = call(capsys, "fit", log, log, *COLUMNS, "--leave-out", "200s:300s", "--json")
    assert (code, json.loads(out)["samples"]) == (0, 2000)


def test_the_report_gives_no_program_that_forgets_them(capsys, log: Path, tmp_path: Path) -> None:
    code, _, _ = call(capsys, "fit", log, *COLUMNS, "--leave-out", "200s:300s", "--out", tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert code == 0
    assert "--leave-out 200s:300s" in page
    (program,) = re.findall(r'<pre class="python"[^>]*><code>(.*?)</code>', page, re.DOTALL)
    lines = html.unescape(program).splitlines()
    assert lines[lines.index("log = rp.leave_out(log, [(200.0, 300.0)])") - 1].startswith("log = rp.read_log(")


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--leave-out", "12"), "write 12s:32s"),
        (("--use", "30:20"), "write 12s:32s"),
        (("--leave-out", "900:1000"), "no sample lies there; the log has 0 to 599.5 s"),
        (("--leave-out", "0:"), "no output is left"),
    ],
)
def test_what_cannot_be_is_one_line(capsys, log: Path, more: tuple[str, ...], words: str) -> None:
    code, out, err = call(capsys, "fit", log, *COLUMNS, *more)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert words in err


@pytest.mark.parametrize("command", ["fit", "run"])
def test_what_the_user_leaves_out_is_not_rejected(capsys, log: Path, tmp_path: Path, command: str) -> None:
    more = ("--leave-out", "200s:300s", "--validate-on", "400s:500s")
    found = model_of(capsys, command, log, *more, "--save", tmp_path / "m.json", "--out", tmp_path / "out")
    assert (found["samples"], set(found["rejected"].values())) == (800, {0})
    assert set(dict(rp.load_model(tmp_path / "m.json").rejected).values()) == {0}
    assert "Rejected samples" not in (tmp_path / "out" / "report.html").read_text("utf-8")


def test_what_the_log_lacks_is_still_rejected(capsys, log: Path, tmp_path: Path) -> None:
    rows = log.read_text().splitlines()
    rows[101:141] = [row.rpartition(",")[0] + "," for row in rows[101:141]]
    log.write_text("\n".join(rows) + "\n")
    found = model_of(capsys, "fit", log, "--leave-out", "200s:300s", "--out", tmp_path / "out")
    assert (found["samples"], found["rejected"]["not finite"]) == (1200 - 200 - 40, 40)
    assert "Rejected samples" in (tmp_path / "out" / "report.html").read_text("utf-8")
