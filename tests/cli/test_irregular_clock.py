"""The commands on a log whose clock jitters and stops: the result says so, and the figures are drawn over real time."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from support.builders import DT, irregular_record, two_modes
from support.cases import every
from support.command import call

pytestmark = pytest.mark.usefixtures("unrendered")

PLANT = rp.TransferFunction([1.0, 4.0], two_modes(2.0, 0.5))
OPTIONS = ["--input", "u", "--output", "y", "--poles", "2", "--zeros", "1"]
GAP = 60.0, 100.0  # no samples between these times, in s


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    u, y, t = irregular_record(PLANT, 1, 4000, DT, jitter=0.3, hold=8)
    y = y + 0.03 * np.random.default_rng(0).standard_normal(y.size)
    kept = (t < GAP[0]) | (t > GAP[1])
    path = tmp_path_factory.mktemp("irregular") / "log.csv"
    rows = np.column_stack([1000.0 * t + 5000.0, u, y])[kept]
    np.savetxt(path, rows, fmt="%.17g", delimiter=",", header="t [ms],u,y", comments="")
    return path


@pytest.mark.slow
@every("command", ["run", "fit"], quick=1)
def test_the_result_says_that_the_clock_is_irregular(capsys, log: Path, tmp_path: Path, command: str) -> None:
    code, out, err = call(capsys, command, log, *OPTIONS, "--json", "--out", tmp_path)
    assert code == 0
    assert err.startswith(f"replant: note: {log}: line ")
    assert "column 't [ms]': irregular time stamps" in err
    answer = json.loads(out)
    assert answer["dt"] == pytest.approx(DT, rel=0.02)
    assert answer["clock"]["irregular"] is True
    assert answer["clock"]["longest"] == pytest.approx(GAP[1] - GAP[0], abs=1.0)
    assert answer["verdict"]["status"] == "trusted"
    for name, true in zip(("a1", "a0", "b1", "b0"), [*PLANT.den[1:], *PLANT.num], strict=True):
        found = answer["parameters"][name]
        assert abs(found["value"] - true) < 5.0 * found["std"]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "on an irregular clock, usually at 0.05 s" in page
    assert {"run": "log.stamps", "fit": "rp.fit(\n    log, structure="}[command] in page  # a log has its stamps
    _check_plots(page)


def _check_plots(page: str) -> None:
    """The plots over time end when the record does, and leave the gap empty."""
    found = re.search(r'<script[^>]*id="data"[^>]*>(.*?)</script>', page, re.DOTALL)
    assert found is not None
    sections = json.loads(found[1])
    for chart in sections["fit"]:
        times = np.frombuffer(base64.b64decode(chart["times"]), "<f8")
        assert times.size == chart["count"]
        assert (np.diff(times) > 0.0).all()
        assert times[-1] == pytest.approx(4000 * DT, abs=1.0)
        assert not ((times > GAP[0] + 1.0) & (times < GAP[1] - 1.0)).any()
        assert any(GAP[0] < gap < GAP[1] for gap in chart["gaps"])
    for chart in sections["excitation"] + sections.get("parameters", []):
        assert np.frombuffer(base64.b64decode(chart["times"]), "<f8").size == chart["count"]


@pytest.mark.slow
def test_a_person_reads_it(capsys, log: Path) -> None:
    _, out, _ = call(capsys, "run", log, *OPTIONS)
    assert re.search(r"Clock +irregular: 0\.0\d+ to 40\S* s between samples, usually 0\.05\S* s; 1 gap\b", out)


@pytest.mark.slow
def test_the_program_in_the_report_repeats_the_run(capsys, log: Path, tmp_path: Path) -> None:
    _, out, _ = call(capsys, "run", log, *OPTIONS, "--json")
    read = rp.read_log(log, input="u", output="y")
    offsets = rp.Preprocess("identity", "mean", "mean")
    ident = rp.Identifier(rp.Structure(2, 1), read.dt, startup=len(read) // 10, preprocess=offsets)
    ident.update_many(read.input, read.output, read.stamps)
    ident.finish()
    found = json.loads(out)["parameters"]
    assert [found[name]["value"] for name in ident.names] == ident.parameters.tolist()


@pytest.mark.slow
def test_compare_takes_the_stamps_and_says_which_method_does_not(capsys, log: Path, tmp_path: Path) -> None:
    methods = ["--optimizer", "default", "--optimizer", "srivc", "--optimizer", "least_squares"]
    code, out, _ = call(capsys, "compare", log, *OPTIONS, *methods, "--json", "--out", tmp_path)
    assert code == 0
    answer = json.loads(out)
    assert "needs a regular clock" in answer["least_squares"]["problem"]
    for name in ("default", "srivc"):
        assert answer[name]["clock"]["irregular"] is True
        assert answer[name]["fit"]["simulated"] > 90.0
    assert "on an irregular clock" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_least_squares_is_refused_in_one_line(capsys, log: Path) -> None:
    code, out, err = call(capsys, "fit", log, *OPTIONS, "--method", "least_squares")
    assert (code, out) == (2, "")
    assert "least_squares needs a regular clock" in err.splitlines()[-1]
    code, out, err = call(capsys, "fit", log, *OPTIONS, "--method", "least_squares", "--dt", DT, "--json")
    assert code == 0
    assert json.loads(out)["clock"]["irregular"] is False


@every(("stamp", "what"), [("10", "repeats the one before"), ("5", "goes back from the one before")])
@every("command", ["run", "fit", "compare"])
def test_a_stamp_that_does_not_advance_is_named(capsys, tmp_path: Path, command: str, stamp: str, what: str) -> None:
    rows = [f"{10 * k if k != 2 else stamp},{k % 5},{k % 3}" for k in range(50)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join(["t,u,y", *rows, ""]))
    code, out, err = call(capsys, command, path, *OPTIONS)
    assert (code, out) == (2, "")
    assert f"line 4, column 't': the time stamp {stamp} {what}" in err
    assert "drop that row" in err
    assert err.count("\n") == 1
