"""`replant look`, and commands that lack their columns: the way into an unknown log."""

from __future__ import annotations

import json
import shlex
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from replant.model.transfer_function import TransferFunction
from replant.signals import prbs
from support.cases import every
from support.command import call

pytestmark = pytest.mark.usefixtures("unrendered")


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Return a log of 2/(s + 0.5) under a PRBS, whose name needs quotes in a shell."""
    u = prbs(2000, hold=10)
    y = TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.05)
    path = tmp_path / "my log.csv"
    rows = [f"{0.05 * k:.2f},{u[k]:.17g},{y[k]:.17g}" for k in range(u.size)]
    path.write_text("t,voltage [V],speed\n" + "\n".join(rows) + "\n")
    return path


def test_what_is_left_out_of_a_log_is_said(capsys, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("# time,u,y,P,I\n" + "".join(f"{k},{k % 7},{k % 5}\n" for k in range(50)), encoding="utf-8")
    _, _, err = call(capsys, "look", path)
    why = "line 1 has 5 names for 3 columns, and is left out; the columns are called 0, 1, 2"
    assert err == f"replant: note: {path}: {why}\n"


def test_two_columns_that_are_one_signal_are_named(capsys, tmp_path: Path) -> None:
    path, u = tmp_path / "log.csv", prbs(500, hold=10)
    path.write_text("t,u,y\n" + "".join(f"{0.1 * k:.1f},{each:g},{2.0 * each:g}\n" for k, each in enumerate(u)))
    _, out, _ = call(capsys, "look", path)
    assert "of y to changes of u: none, the output is a copy of the input" in " ".join(out.split())


def test_the_last_line_is_a_command_that_runs(capsys, log: Path) -> None:
    code, out, err = call(capsys, "look", log)
    assert (code, err) == (0, "")
    words = shlex.split(out.splitlines()[-1])
    assert words[:3] == ["replant", "fit", str(log)]
    code, out, err = call(capsys, *words[1:], "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["verdict"]["status"] != "not excited"


def test_a_person_reads_columns_clock_and_guesses(capsys, log: Path) -> None:
    _, out, _ = call(capsys, "look", log)
    lines = out.splitlines()
    assert lines[0] == f"{log}: 2,000 rows, 3 columns"
    assert lines[2].split() == ["column", "type", "min", "max", "missing", "smallest", "step", "looks", "like"]
    roles = [line.split()[-1] for line in lines[3:6]]
    assert roles == ["time", "input", "output"]
    text = " ".join(out.split())
    assert "Clock t: dt 50 ms, 99.95 s, regular" in text
    assert "Input voltage [V] (a guess, from: its name, 'speed' follows it" in text
    assert all(line == line.rstrip() for line in lines)


def test_of_a_long_log_the_beginning_is_looked_at_and_that_is_said(
    capsys, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("replant.logs.columns.MOST_ROWS", 500)
    _, out, _ = call(capsys, "look", log)
    assert out.startswith(f"{log}: the first 500 of about ")
    assert json.loads(call(capsys, "look", log, "--json")[1])["complete"] is False


def test_json_holds_the_same(capsys, log: Path) -> None:
    code, out, err = call(capsys, "look", log, "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert [column["looks_like"] for column in answer["columns"]] == ["time", "input", "output"]
    assert answer["clock"]["dt"] == 0.05
    assert answer["guess"]["output"]["column"] == "speed"
    assert answer["guess"]["reference"] is None
    assert answer["command"] == shlex.join(["replant", "fit", str(log), "-i", "voltage [V]", "-o", "speed", "-p", "2"])


def test_columns_that_are_given_are_no_guesses(capsys, log: Path) -> None:
    _, out, _ = call(capsys, "look", log, "-i", "speed", "-o", "1")
    assert "Input      speed (as given)" in out
    assert "Output     voltage [V] (as given)" in out
    assert out.splitlines()[-1].endswith("-i speed -o 'voltage [V]' -p 2")


def test_out_draws_the_columns(capsys, log: Path, tmp_path: Path) -> None:
    code, out, _ = call(capsys, "look", log, "--out", tmp_path / "plots")
    assert code == 0
    assert (tmp_path / "plots" / "columns.png").read_bytes().startswith(b"\x89PNG")
    assert "columns.png" in out.splitlines()[-1]


def test_a_folder_that_cannot_be_is_refused(capsys, log: Path) -> None:
    code, out, err = call(capsys, "look", log, "--out", log)
    assert (code, out) == (2, "")
    assert err == f"replant: Invalid value for --out: {log} is a file; name a folder\n"


@every(
    ("text", "words"),
    [
        ("", "empty"),
        ("t,u,y\n", "only a header"),
        ("who\nanna\nbert\n", "not a number"),
        ("t,u,y\n0,1,2\n1,2\n", "line 3"),
    ],
)
def test_a_file_without_numbers_is_one_line_and_exit_code_2(capsys, tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    code, out, err = call(capsys, "look", path)
    assert (code, out) == (2, "")
    assert err.startswith(f"replant: {path}")
    assert words in err
    assert err.count("\n") == 1


NAME_TWO = "name two columns of changing numbers with --input and --output."


@every(
    ("text", "options", "words"),
    [
        ("u\n1\n2\n1\n", (), NAME_TWO),
        ("u,y\n1,1\n1,1\n1,1\n", (), NAME_TWO),
        ("u,y\n1,1\n1,1\n1,1\n", ("-i", "u", "-o", "y"), NAME_TWO),
        ("a,b\nx,1\ny,2\nx,3\n", (), NAME_TWO),
        ("t,u\n,\n,\n,\n", (), NAME_TWO),
        ("t,u,y\n0,1,2\n", ("-i", "u", "-o", "y"), "1 row of data, at least 2 are needed; record more samples."),
        ("t,u,y\n0,1,2\n0.1,2,3\n", (), "2 rows of data, a first fit needs 4; record more samples."),
    ],
    ids=["one column", "constant", "constant, named", "text beside numbers", "empty cells", "one row", "two rows"],
)
def test_where_nothing_can_be_suggested_that_is_said(
    capsys, tmp_path: Path, text: str, options: tuple[str, ...], words: str
) -> None:
    path = tmp_path / "odd.csv"
    path.write_text(text)
    code, out, err = call(capsys, "look", path, *options)
    assert (code, err) == (0, "")
    assert out.splitlines()[-1] == f"No command to suggest: {words}"
    assert "nan" not in out
    assert json.loads(call(capsys, "look", path, "--json")[1])["command"] is None
    assert call(capsys, "look", path, "--out", tmp_path / "plots")[0] == 0


def test_dates_that_are_no_numbers_are_no_clock_and_that_is_said(capsys, tmp_path: Path) -> None:
    rows = [f"2024-01-01T00:00:{k:02d}x,{k // 5 % 2},{k % 5}" for k in range(60)]
    path = tmp_path / "log.csv"
    path.write_text("time,u,y\n" + "\n".join(rows) + "\n")
    code, out, _ = call(capsys, "look", path)
    assert code == 0
    assert "Clock column 'time' holds no numbers" in " ".join(out.split())
    assert "line 2, column 'time'" in out


def test_without_a_time_column_the_sampling_time_is_asked_for(capsys, tmp_path: Path) -> None:
    u = prbs(1000, hold=10)
    np.savez(tmp_path / "log.npz", u=u, y=TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.05))
    _, out, _ = call(capsys, "look", tmp_path / "log.npz")
    assert out.splitlines()[-1].endswith("--dt S")
    assert "put the sampling time in s in place of S in --dt S" in " ".join(out.split())
    code, _, err = call(capsys, *shlex.split(out.splitlines()[-1])[1:])
    assert code == 2  # no number stands for a sampling time that nothing tells
    assert "'S' is no number" in err


@every(
    ("stamps", "words"),
    [
        (range(60, 0, -1), "goes back from the one before (60); the file runs backwards: sort its rows by time"),
        ([7] * 60, "repeats the one before (7); all stamps are equal: give the sampling time"),
    ],
)
def test_of_stamps_that_never_rise_it_is_said_what_they_do(capsys, tmp_path: Path, stamps: range, words: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,u,y\n" + "".join(f"{t},{k // 5 % 2},{k % 7}\n" for k, t in enumerate(stamps)))
    _, out, _ = call(capsys, "look", path, "-i", "u", "-o", "y")
    said = " ".join(out.split())
    assert words in said
    assert "put the sampling time in s in place of S in --dt S" in said
    assert out.splitlines()[-1].endswith("--dt S")


@every("command", ["run", "fit", "compare"])
@every("typed", [(), ("-i", "voltage [V]"), ("--bias", "--out", "my plots"), ("-p", "1")])
def test_missing_columns_end_in_the_table_and_a_command(capsys, log: Path, command: str, typed: tuple[str]) -> None:
    code, out, err = call(capsys, command, log, *typed)
    assert (code, out) == (2, "")
    assert err.startswith(f"{log}: 2,000 rows, 3 columns\n")
    last = err.splitlines()[-1]
    assert last.startswith("replant: missing ")
    words = shlex.split(last.partition("; try: ")[2])
    assert words[:3] == ["replant", command, str(log)]
    given = dict(pairwise(words))
    assert given.get("-i", given.get("--input")) == "voltage [V]"
    assert given["-o"] == "speed"
    assert given.get("-p", given.get("--poles")) == ("1" if "-p" in typed else "2")
    assert all(word in words for word in typed if word not in ("-i", "-p"))


def test_the_completed_command_runs(capsys, log: Path) -> None:
    _, _, err = call(capsys, "fit", log, "--json")
    words = shlex.split(err.splitlines()[-1].partition("; try: ")[2])
    code, out, err = call(capsys, *words[1:])
    assert (code, err) == (0, "")
    assert json.loads(out)["samples"] == 2000


@pytest.mark.parametrize("command", ["run", "fit", "compare"])
def test_missing_poles_end_in_a_command(capsys, log: Path, command: str) -> None:
    code, out, err = call(capsys, command, log, "-i", 1, "-o", 2)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith("replant: missing --poles, the number of poles of G(s)")
    assert "1:4" in err
    assert err.endswith(f"; try: {shlex.join(['replant', command, str(log)])} --input 1 --output 2 -p 2\n")


def test_a_log_that_cannot_be_read_is_named_beside_what_is_missing(capsys, tmp_path: Path) -> None:
    code, out, err = call(capsys, "fit", tmp_path / "no.csv", "-p", 2)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "--input and --output" in err
    assert f"{tmp_path / 'no.csv'}: no such file" in err


@every("command", ["run", "fit"], quick=1)
@every("name", ["timestamp", "time [ms]"], quick=1)
def test_stamps_beyond_the_calendar_are_refused(capsys, tmp_path: Path, command: str, name: str) -> None:
    """Milliseconds since 1970 of the year 2508, taken as seconds, or microseconds that the name calls milliseconds."""
    u = prbs(500, hold=10)
    stamps = np.rint((1.7e13 if name == "timestamp" else 1.7e15) + 20.0 * np.arange(u.size))
    path = tmp_path / "log.csv"
    path.write_text(f"{name},u,y\n" + "".join(f"{t:.0f},{a},{a}\n" for t, a in zip(stamps, u, strict=True)))
    code, out, err = call(capsys, command, path, "-i", "u", "-o", "y", "-p", 1)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "since 1970" in err
    assert "--dt" in err
    dt = 0.02 if name == "timestamp" else 2e-5
    code, _, err = call(capsys, command, path, "-i", "u", "-o", "y", "-p", 1, "--dt", dt)
    assert (code, err) == (0, "")  # the remedy works, and the unit told from the stamps agrees with it


@pytest.mark.parametrize(
    ("per_second", "unit"), [(10**9, "nanoseconds"), (10**6, "microseconds"), (1000, "milliseconds")]
)
def test_stamps_since_1970_without_a_unit_are_read_by_their_size(
    capsys, tmp_path: Path, per_second: int, unit: str
) -> None:
    """With their gap, which a sampling time in place of the stamps would lose."""
    u = prbs(600, hold=10)
    y = TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.02)
    kept = [k for k in range(u.size) if not 200 <= k < 300]
    path, told = tmp_path / "log.csv", []
    for name, scale in (("timestamp", per_second), ("t [s]", 1)):
        begin = 1_700_000_000 * scale if scale > 1 else 0
        rows = [f"{begin + 20 * k * scale // 1000 if scale > 1 else 0.02 * k},{u[k]},{y[k]:.9g}" for k in kept]
        path.write_text("\n".join([f"{name},u,y", *rows]) + "\n")
        code, out, err = call(capsys, "fit", path, "-i", "u", "-o", "y", "-p", 1, "--from", 1, "--json")
        assert code == 0
        told.append((json.loads(out), err))
    (read, note), (stated, _) = told
    assert (
        f"'timestamp': its name states no unit; by their size its stamps are {unit} since 1970, from 2023-11-14" in note
    )
    assert read["samples"] == stated["samples"] == 450
    assert read["dc_gain"] == pytest.approx(stated["dc_gain"], rel=1e-4)
    assert read["dc_gain"] == pytest.approx(4.0, rel=1e-3)


@pytest.mark.parametrize("command", ["run", "fit"])
def test_counts_that_may_be_milliseconds_are_said(capsys, tmp_path: Path, command: str) -> None:
    u = prbs(500, hold=10)
    y = TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.02)
    path = tmp_path / "log.csv"
    rows = "".join(f"{20 * k},{u[k]},{y[k]:.9g}\n" for k in range(u.size))
    for name, notes in (("t", 1), ("t_ms", 0), ("t [s]", 0)):
        path.write_text(f"{name},u,y\n{rows}")
        code, _, err = call(capsys, command, path, "-i", "u", "-o", "y", "-p", 1)
        assert code == 0
        assert err.count("may be milliseconds") == err.count("\n") == notes


def test_a_time_column_in_an_unknown_unit_is_refused(capsys, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("angle [rev],u,y\n" + "".join(f"{k},{k % 3},{k % 5}\n" for k in range(50)))
    code, _, err = call(capsys, "fit", path, "-i", "u", "-o", "y", "-p", 1, "--time", "angle [rev]")
    assert (code, err.count("\n")) == (2, 1)
    assert "the unit 'rev' in its name is not one of s, ms, us, ns, min, h" in err


@pytest.mark.parametrize("command", ["run", "fit", "compare"])
def test_a_part_of_the_log_is_identified(capsys, tmp_path: Path, command: str) -> None:
    """Its second half has another gain, which the estimate from the first half does not show."""
    u = prbs(2000, hold=10)
    y = TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.05)
    path = tmp_path / "log.csv"
    gains = np.where(np.arange(u.size) < 1000, 1.0, 3.0)
    rows = [f"{0.05 * k:.2f},{u[k]},{gains[k] * y[k]:.17g}" for k in range(u.size)]
    path.write_text("t,u,y\n" + "\n".join(rows) + "\n")
    columns = ("-i", "u", "-o", "y", "-p", 1, "--json")
    _, out, err = call(capsys, command, path, *columns, "--to", 50)
    assert err == ""
    answer = json.loads(out)
    answer = answer["default"] if command == "compare" else answer
    assert answer["samples"] == 1000
    assert answer["dc_gain"] == pytest.approx(4.0, rel=0.02)
    code, _, err = call(capsys, command, path, *columns, "--from", 50, "--to", 40)
    assert (code, err.count("\n")) == (2, 1)
    assert "--from" in err


def test_the_program_in_the_report_reads_the_same_part(capsys, log: Path, tmp_path: Path) -> None:
    columns = ("-i", "voltage [V]", "-o", "speed", "-p", 1, "--from", 10, "--to", 60.5)
    assert call(capsys, "fit", log, *columns, "--out", tmp_path / "plots")[0] == 0
    page = (tmp_path / "plots" / "report.html").read_text(encoding="utf-8")
    assert "begin=10.0, end=60.5" in page
    assert "--from 10 --to 60.5" in page


@pytest.mark.parametrize("command", ["run", "fit", pytest.param("compare", marks=pytest.mark.slow)])
def test_quiet_leaves_out_the_notes_and_keeps_result_and_errors(capsys, log: Path, command: str) -> None:
    columns = ("-i", "voltage [V]", "-o", "speed", "-p", 1, "--dt", 5, "--json")
    _, loud, note = call(capsys, command, log, *columns)
    code, quiet, err = call(capsys, command, log, *columns, "--quiet")
    assert note.startswith("replant: note: ")
    assert (code, err) == (0, "")
    assert json.loads(quiet).keys() == json.loads(loud).keys()
    code, out, err = call(capsys, command, log, "-i", "nothing", *columns[2:], "--quiet")
    assert (code, out, err.count("\n")) == (2, "", 1)


def test_the_response_of_a_step_test_is_seen(capsys, tmp_path: Path) -> None:
    """One move of the input makes no correlation beyond chance: a model of one pole tells the dead time."""
    u = np.where(np.arange(300) < 50, 40.0, 41.0)
    y = TransferFunction([2 / 12], [1.0, 1 / 12], 3.0).simulate(u - 40.0, 0.5)
    y += 0.02 * np.random.default_rng(2).standard_normal(300)
    log = tmp_path / "step.csv"
    log.write_text("t,valve,level\n" + "".join(f"{0.5 * k:.1f},{u[k]:g},{y[k]:.5f}\n" for k in range(300)))
    code, out, _ = call(capsys, "look", log, "--json")
    assert code == 0
    found = json.loads(out)
    assert found["response"] is None
    assert abs(found["first_model"]["delay"] - 3.0) < 1.0
    words = shlex.split(found["command"])
    assert words[words.index("-p") + 1] == "1"
    first, last, _ = map(float, words[words.index("--delay") + 1].split(":"))
    assert first <= 3.0 <= last


def test_of_a_step_that_moves_nothing_no_response_is_seen(capsys, tmp_path: Path) -> None:
    y = np.random.default_rng(2).standard_normal(300)
    log = tmp_path / "step.csv"
    log.write_text("t,valve,level\n" + "".join(f"{k},{k // 50 > 0:d},{y[k]:.5f}\n" for k in range(300)))
    code, out, _ = call(capsys, "look", log, "-i", "valve", "-o", "level", "--json")
    assert code == 0
    assert (json.loads(out)["first_model"], json.loads(out)["response"]) == (None, None)


def test_of_rows_that_are_not_in_order_no_command_is_suggested(capsys, tmp_path: Path) -> None:
    u = prbs(600, hold=10)
    y = TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.1)
    rows = [f"{0.1 * k:.1f},{a},{b}" for k, (a, b) in enumerate(zip(u, y, strict=True))]
    path = tmp_path / "log.csv"
    mixed = np.random.default_rng(1).permutation(600)
    path.write_text("\n".join(["t,u,y", *(rows[k] for k in mixed)]))
    _, out, _ = call(capsys, "look", path)
    back = int((np.diff(mixed) < 0).sum())
    assert f"the time goes back in {back} of 600 rows: sort the rows by time" in " ".join(out.split())
    assert out.splitlines()[-1] == "No command to suggest: sort the rows by time first."
    found = json.loads(call(capsys, "look", path, "--json")[1])
    assert (found["command"], found["clock"]["dt"], found["clock"]["not_rising"]) == (None, 0.1, back)
    path.write_text("\n".join(["t,u,y", *rows]))
    in_order = json.loads(call(capsys, "look", path, "--json")[1])
    assert found["response"] == in_order["response"]
    assert call(capsys, "fit", path)[2].splitlines()[-1].endswith("-p 2")


def test_a_clock_that_begins_anew_and_single_wrong_stamps_are_no_reason_to_sort(capsys, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    anew = [0.1 * (k % 20) for k in range(200)]
    wrong = [0.1 * k if k % 50 else 0.1 * k - 0.25 for k in range(200)]
    for stamps in (anew, wrong):
        path.write_text("t,u,y\n" + "".join(f"{t:.2f},{k // 5 % 2},{k % 7}\n" for k, t in enumerate(stamps)))
        _, out, _ = call(capsys, "look", path)
        assert "sort" not in out
        assert out.splitlines()[-1].endswith("--dt 0.1")
