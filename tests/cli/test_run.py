"""`replant run` on logs of any length: what a person sees meanwhile, and what is left afterwards."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from replant.cli import main, run_fit_compare_options
from replant.cli import run_and_fit as run_command
from replant.logs import open_recording, read_columns
from replant.online.runs import run as online_run
from support.command import call

DT = 0.05
PLANT = rp.TransferFunction([2.0], [1.0, 0.5])
OPTIONS = ("--input", "u", "--output", "y", "--poles", "1")


@pytest.fixture
def log(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice([-1.0, 1.0], 500), 10)
    y = PLANT.simulate(u, DT) + 3.0 + 0.01 * rng.standard_normal(u.size)
    path = tmp_path / "log.csv"
    rows = (f"{DT * k:.2f},{u[k]},{y[k].item()!r}\n" for k in range(u.size))
    path.write_text("t,u,y\n" + "".join(rows))
    return path


@pytest.fixture
def short_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if the log were too long to be held."""
    monkeypatch.setattr(run_fit_compare_options, "open_recording", partial(open_recording, most_held=1000))
    monkeypatch.setattr(online_run, "FITTED", 800)
    monkeypatch.setattr(run_command, "FITTED", 800)


def run(*arguments: object) -> None:
    main(["run", *map(str, arguments), *OPTIONS])


def answer_to(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, object]:
    run(*arguments, "--json")
    answer: dict[str, object] = json.loads(capsys.readouterr().out)
    del answer["elapsed_seconds"]
    return answer


def test_a_log_that_is_not_held_gives_the_same_answer(
    capsys: pytest.CaptureFixture[str], log: Path, request: pytest.FixtureRequest
) -> None:
    """But for the fits and the output's level, whose initial state is that of the first samples."""
    held = answer_to(capsys, log)
    request.getfixturevalue("short_memory")
    streamed = answer_to(capsys, log)
    fits, others = streamed.pop("fit"), held.pop("fit")
    levels = [answer["output"].pop("level") for answer in (streamed, held)]
    assert levels[0] == pytest.approx(levels[1], abs=1e-3)
    assert {**streamed, "provenance": None} == {**held, "provenance": None}
    assert fits == pytest.approx(others, abs=0.01)


@pytest.mark.usefixtures("short_memory")
def test_the_full_trace_is_that_of_update_many(capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pip install 'replant[parquet]'")
    path = tmp_path / "trace.parquet"
    run(log, "--full-trace", path)
    assert f"wrote {path}" in capsys.readouterr().out.replace("\n", "")
    t, a0, b0, error = read_columns(path).columns(["time [s]", "a0", "b0", "error"])
    u, y = read_columns(log).columns(["u", "y"])
    preprocess = rp.Preprocess("identity", "mean", "mean")
    expected = rp.Identifier(rp.Structure(poles=1), DT, startup=500, preprocess=preprocess).update_many(u, y)
    np.testing.assert_allclose(t, DT * np.arange(u.size), rtol=1e-12)
    np.testing.assert_array_equal(np.column_stack([a0, b0]), expected.parameters)
    np.testing.assert_array_equal(error, expected.errors)


@pytest.mark.usefixtures("short_memory", "unrendered")
def test_plots_and_report_show_the_whole_of_a_log_that_is_not_held(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path
) -> None:
    pytest.importorskip("matplotlib", reason="pip install 'replant[report]'")
    pytest.importorskip("pyarrow", reason="pip install 'replant[parquet]'")
    run(log, "--out", tmp_path / "out", "--full-trace", tmp_path / "trace.pq")
    capsys.readouterr()
    assert (tmp_path / "out" / "fit.png").exists()
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "5,000 samples" in page
    assert "of the newest 800 samples" in page
    assert "--full-trace" not in page  # what repeats the result needs no second copy of it
    charts = json.loads(re.search(r'<script[^>]*type="application/json"[^>]*>(.*?)</script>', page, re.DOTALL)[1])
    for chart in charts["fit"]:
        assert chart["start"] + chart["step"] * chart["count"] == pytest.approx(5000 * DT, rel=0.01)
    ends = [chart["start"] + chart["step"] * (chart["count"] - 1) for chart in charts["excitation"]]
    assert ends == pytest.approx([5000 * DT] * 2, rel=0.01)
    assert all(chart["start"] > 4000 * DT for chart in charts["excitation"])


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.usefixtures("short_memory")
def test_a_person_sees_how_far_it_is(
    capsys: pytest.CaptureFixture[str], log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = Terminal()
    monkeypatch.setattr(online_run, "CHUNK", 10)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.setattr(sys, "stderr", terminal)
    run(log, "--json")
    text = terminal.getvalue()
    assert all(word in text for word in ("checking", "identifying", "%", "left"))
    assert re.search(r"\d [kM]? ?samples/s", text)
    assert json.loads(capsys.readouterr().out)["samples"] == 5000


def test_nothing_is_drawn_where_nobody_looks(capsys: pytest.CaptureFixture[str], log: Path) -> None:
    run(log, "--json")
    assert capsys.readouterr().err == ""


def test_mistakes_are_said_in_one_line(capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path) -> None:
    with pytest.raises(SystemExit) as stop:
        run(log, "--full-trace", tmp_path / "trace.csv")
    assert stop.value.code == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "the full trace is a Parquet file; give it the suffix .parquet" in message
    other = tmp_path / "log.parquet"
    other.write_bytes(b"a log")
    with pytest.raises(SystemExit):
        run(log, "--full-trace", other)
    assert "log.parquet: it exists and is no full trace; give another name" in capsys.readouterr().err
    assert other.read_bytes() == b"a log"


def test_a_start_up_that_is_longer_than_the_log_is_noted(capsys: pytest.CaptureFixture[str], log: Path) -> None:
    said = "replant: note: --startup 100,000 is more than the log's "
    run(log, "--startup", "100000")
    assert capsys.readouterr().err.startswith(said)
    run(log, "--startup", "500")
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("kept", [False, True])
def test_a_command_that_fails_leaves_no_folder_of_its_own(tmp_path: Path, kept: bool) -> None:
    path, out = tmp_path / "still.csv", tmp_path / "new" / "out"
    path.write_text("t,u,y\n" + "".join(f"{0.1 * k:.1f},1,{k % 7}\n" for k in range(100)))
    if kept:
        out.mkdir(parents=True)
    with pytest.raises(SystemExit) as stop:
        main(["fit", str(path), "-i", "u", "-o", "y", "-p", "2", "--method", "srivc", "--out", str(out)])
    assert stop.value.code == 2
    assert out.exists() == out.parent.exists() == kept


@pytest.mark.parametrize("option", ["--dt", "--from", "--to", "--resample"])
def test_a_comma_for_the_decimal_point_is_answered(capsys: pytest.CaptureFixture[str], log: Path, option: str) -> None:
    with pytest.raises(SystemExit) as stop:
        run(log, option, "0,1")
    assert stop.value.code == 2
    said = f"Invalid value for '{option}': '0,1' is no number; write one with a decimal point, such as 0.1\n"
    assert capsys.readouterr().err.replace(f"for {option}:", f"for '{option}':").endswith(said)


PEAK = """
import sys
from pathlib import Path
from replant.logs import open_recording
from replant.online.runs.run import run_source
from replant.estimation.settings import Request
import replant as rp

QUICK = {"filter": rp.StateVariableFilter(2.0), "optimizer": rp.Gradient(0.1), "scaling": None, "replay": None}
recording = open_recording(sys.argv[1], input="u", output="y", most_held=0)
run_source(Request(rp.Structure(poles=1), recording.dt, **QUICK), recording, newest=1000)
status = Path("/proc/self/status").read_text()
print(next(line for line in status.splitlines() if line.startswith("VmHWM")).split()[1])
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="no /proc to read a process's peak memory from")
@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_memory_does_not_grow_with_the_log(tmp_path: Path, suffix: str) -> None:
    """Past a few batches the peak stays: a log held in memory would add three numbers a row, and its text more."""
    pyarrow = pytest.importorskip("pyarrow", reason="pip install 'replant[parquet]'")
    from pyarrow import csv, parquet

    peaks, lengths = [], (500_000, 3_000_000)  # a reader that is ahead holds some 20 MB, however long the log
    for rows in lengths:
        u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], rows // 20), 20)
        columns = {"t": np.round(DT * np.arange(rows), 2), "u": u, "y": np.round(PLANT.simulate(u, DT), 4)}
        path = tmp_path / f"{rows}.{suffix}"
        (csv.write_csv if suffix == "csv" else parquet.write_table)(pyarrow.table(columns), path)
        found = subprocess.run([sys.executable, "-c", PEAK, path], capture_output=True, text=True)
        assert found.returncode == 0, found.stderr
        peaks.append(1024 * int(found.stdout))
    assert peaks[1] - peaks[0] < 0.5 * 24 * (lengths[1] - lengths[0])
    assert peaks[1] < 500e6, peaks


def test_the_samples_that_were_used_are_counted_as_fit_counts_them(capsys, tmp_path: Path) -> None:
    u = np.random.default_rng(1).choice([-1.0, 1.0], 80).repeat(10)
    y = rp.TransferFunction([2.0], [1.0, 1.0]).simulate(u, 0.05) + 0.02 * np.random.default_rng(2).standard_normal(800)
    y[500:640] = y[500]
    log = tmp_path / "stuck.csv"
    log.write_text("t,u,y\n" + "".join(f"{0.05 * k:.2f},{u[k]:g},{y[k]:.6f}\n" for k in range(800)))
    said = [call(capsys, name, log, "-i", "u", "-o", "y", "-p", 1)[1].splitlines() for name in ("run", "fit")]
    for lines in said:  # online the first value that stays is left out, too
        (line,) = [line for line in lines if line.startswith("Samples")]
        used, stuck = map(int, re.findall(r"\d+", line))
        assert (used + stuck, 139 <= stuck <= 140) == (800, True)
