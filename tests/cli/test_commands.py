"""The command line as a person and a script meet it."""

import hashlib
import html
import itertools
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from replant.cli.demo import SAMPLES
from replant.model.transfer_function import TransferFunction
from replant.rigs import DEAP, Rig
from replant.signals import prbs
from support.cases import every
from support.command import call, log_of_a_lag


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return log_of_a_lag(tmp_path)


COLUMNS = ("--input", "u", "--output", "y", "--poles", "1")


@pytest.mark.parametrize("command", ["run", "fit"])
def test_json_holds_the_contract(capsys, log: Path, command: str) -> None:
    code, out, err = call(capsys, command, log, *COLUMNS, "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert set(answer) >= {
        "num", "den", "delay", "parameters", "poles", "zeros", "dc_gain", "fit", "samples", "rejected", "verdict",
        "elapsed_seconds", "schema_version", "dt", "clock",
    }  # fmt: skip
    model = rp.Model.from_json(out)
    assert (model.input_name, model.output_name, model.provenance.source) == ("u", "y", "log.csv")
    assert model.provenance.sha256 == hashlib.sha256(log.read_bytes()).hexdigest()
    assert answer["dt"] == 0.05
    assert answer["clock"] == {"irregular": False, "shortest": None, "longest": None}
    assert set(answer["fit"]) == {"one_step", "simulated"}
    assert set(answer["verdict"]) == {"status", "excited", "reasons"}
    assert answer["verdict"]["excited"] is True
    assert list(answer["parameters"]) == ["a0", "b0"]
    assert set(answer["parameters"]["a0"]) == {"value", "std"}
    assert answer["samples"] == 2000
    assert sum(answer["rejected"].values()) == 0
    # the true plant, up to what removing the record's mean from a short record costs
    assert answer["parameters"]["a0"]["value"] == pytest.approx(0.5, rel=0.02)
    assert answer["parameters"]["b0"]["value"] == pytest.approx(2.0, rel=0.02)
    assert answer["den"] == [1.0, answer["parameters"]["a0"]["value"]]
    assert answer["dc_gain"] == pytest.approx(answer["num"][0] / answer["den"][1])
    assert answer["poles"][0]["real"] == pytest.approx(-answer["den"][1])


@pytest.mark.parametrize("command", ["run", "fit"])
def test_person_reads_the_model_and_how_to_trust_it(capsys, log: Path, command: str) -> None:
    code, out, err = call(capsys, command, log, *COLUMNS)
    assert (code, err) == (0, "")
    for words in ("G(s) = ", "time constant [s]", "DC gain", "simulated from the input alone", "Verdict"):
        assert words in out
    assert ("ident = rp.Identifier(" in out) == (command == "run")


def test_settings_printed_by_run_repeat_it(capsys, log: Path) -> None:
    import replant as rp

    _, out, _ = call(capsys, "run", log, *COLUMNS)
    _, as_json, _ = call(capsys, "run", log, *COLUMNS, "--json")
    code = out[out.index("ident = ") : out.index("Next: ")].replace("ident = ", "", 1)
    identifier = eval(code, {"rp": rp})
    data = np.loadtxt(log, delimiter=",", skiprows=1)
    identifier.update_many(data[:, 1], data[:, 2])
    printed = [entry["value"] for entry in json.loads(as_json)["parameters"].values()]
    # six digits are printed, so the repetition is good to about that
    assert identifier.parameters == pytest.approx(printed, rel=1e-3)


@pytest.mark.parametrize("command", ["run", pytest.param("fit", marks=pytest.mark.slow)])
def test_out_writes_plots(capsys, log: Path, tmp_path: Path, command: str) -> None:
    code, out, _ = call(capsys, command, log, *COLUMNS, "--out", tmp_path / "plots")
    assert code == 0
    plots = {"run": {"fit.png", "parameters.png"}, "fit": {"fit.png"}}[command]
    assert {path.name for path in (tmp_path / "plots").iterdir()} == {*plots, "report.html"}
    for name in plots:
        drawn = (tmp_path / "plots" / name).read_bytes()
        assert drawn.startswith(b"\x89PNG")
        assert len(drawn) > 10_000
    assert all(name in out.replace("\n", "") for name in (*plots, "report.html"))


def test_options_reach_the_identifier(capsys, tmp_path: Path) -> None:
    """Squared input, dead time, bias and a chosen optimizer, from a log without a time column."""
    rig = Rig(TransferFunction([2.0], [1.0, 0.5], delay=0.23), dt=0.05, input_map="square", input_rest=2.0)
    u = 2.0 + prbs(4000, hold=12)
    np.savez(tmp_path / "log.npz", u=u, y=rig.measure(u))
    code, out, err = call(
        capsys, "run", tmp_path / "log.npz", *COLUMNS, "--dt", 0.05, "--delay", 0.23, "--bias",
        "--input-map", "square", "--optimizer", "adam", "--json",
    )  # fmt: skip
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert answer["delay"] == 0.23
    assert list(answer["parameters"]) == ["a0", "b0", "bias"]
    assert answer["parameters"]["a0"]["value"] == pytest.approx(0.5, rel=0.05)
    assert answer["parameters"]["b0"]["value"] == pytest.approx(2.0, rel=0.05)


@every("command", ["run", "fit"])
@every(
    ("lines", "arguments", "words"),
    [
        ([], COLUMNS, ["empty"]),
        (["t,u,y"], COLUMNS, ["bad.csv"]),
        (["t,u,y", "0,1,2"], COLUMNS, ["bad.csv"]),
        (["t,u,y", *[f"{k},{k % 5},{k % 3}" for k in range(4998)], "4998,oops,1", "4999,1,1"], COLUMNS,
         ["bad.csv", "u", "5000", "oops"]),
        (["t,u,y", "0,1,2", "1,2,3", "1,1,2"], COLUMNS, ["bad.csv", "line 4", "'t'", "repeats", "--dt"]),
        (["t,u,y", *[f"{k},{k % 5},{k % 3}" for k in range(50)]], (*COLUMNS[:2], "--output", "u", "--poles", "1"),
         ["u"]),
        (["t,u,y", *[f"{k},{k % 5},{k % 3}" for k in range(50)]], ("--input", "uu", *COLUMNS[2:]), ["uu", "u, t, y"]),
        (["u,y", *[f"{k % 5},{k % 3}" for k in range(50)]], COLUMNS, ["--dt"]),
        *[(["u,y", *[f"{k % 5},{k % 3}" for k in range(50)]], (*COLUMNS, "--dt", dt), ["dt"])
          for dt in ("0", "-1", "nan", "inf")],
        (["t,u,y", *[f"{k},{k % 5},{k % 3}" for k in range(50)]], (*COLUMNS, "--zeros", "1"), ["zeros", "poles"]),
        (["t,u,y", *[f"{k},{k % 5},{k % 3}" for k in range(50)]], (*COLUMNS[:4], "--poles", "0"), ["poles"]),
        (["t,u,y", *[f"{k},{k % 5},{k % 3}" for k in range(50)]], (*COLUMNS, "--delay", "-1"), ["delay"]),
        (["t,u,y", *[f"{k},{k % 5},{k % 3}" for k in range(50)]], (*COLUMNS, "--delay", "nan"), ["delay"]),
    ],
)  # fmt: skip
def test_a_mistake_is_one_line_and_exit_code_2(capsys, tmp_path, command, lines, arguments, words) -> None:
    path = tmp_path / "bad.csv"
    path.write_text("".join(line + "\n" for line in lines))
    code, out, err = call(capsys, command, path, *arguments, "--json")
    assert (code, out) == (2, "")
    assert err.startswith("replant: ")
    assert err.count("\n") == 1
    assert all(word in err for word in words), err


@every(
    ("arguments", "words"),
    [
        (("run", "missing.csv", *COLUMNS), ["missing.csv"]),
        (("run",), ["LOG", " See replant run --help\n"]),
        (("fit", "x.csv", "--inptu"), [" See replant fit --help\n"]),
        (("foo",), [" See replant --help\n"]),
        (("run", "x.csv"), ["--input"]),
        (("jump",), ["jump"]),
        (("fit", "x.csv", "--optimizer", "adam"), ["No such option '--optimizer'; replant run takes it."]),
        (("run", "x.csv", "--method", "srivc"), ["No such option '--method'; replant fit takes it."]),
        (("run", "x.csv", *COLUMNS, "--optimizer", "magic"), ["magic", "amsgrad"]),
        (("run", "x.csv", *COLUMNS[:4], "--poles", "two"), ["two", "--poles"]),
    ],
)
def test_a_wrong_call_is_one_line_and_exit_code_2(capsys, arguments, words) -> None:
    code, out, err = call(capsys, *arguments)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert all(word in err for word in words), err


@every("command", ["run", "fit", "compare", "demo"])
@every("blocked", ["", "report.html"], quick=1)
def test_a_place_that_cannot_be_written_is_one_line(capsys, log: Path, tmp_path, monkeypatch, command, blocked) -> None:
    """A file where the folder should be, or a folder where the report should be."""
    monkeypatch.setattr("replant.cli.demo.SAMPLES", 5_000)
    out = tmp_path / "out"
    if blocked:
        (out / blocked).mkdir(parents=True)
    else:
        out.write_text("")
    arguments = () if command == "demo" else (log, *COLUMNS, "--json")
    code, _, err = call(capsys, command, *arguments, "--out", out)
    assert code == 2
    assert err.startswith("replant: ")
    assert err.count("\n") == 1
    assert str(out / blocked) in err


@pytest.mark.parametrize(
    ("command", "samples", "missing"), [("run", 999, {"no output": 2}), ("fit", 997, {"not finite": 2})]
)
def test_bad_samples_are_counted_not_fatal(
    capsys, tmp_path: Path, command: str, samples: int, missing: dict[str, int]
) -> None:
    """Of a sample without an output the online pass uses the input."""
    u = prbs(1000, hold=10)
    y = TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.1)
    cells = [f"{value:.17g}" for value in y]
    cells[100], cells[200], cells[300] = "nan", "", "1e308"
    path = tmp_path / "log.csv"
    path.write_text("u,y\n" + "".join(f"{a},{b}\n" for a, b in zip(u, cells, strict=True)))
    code, out, err = call(capsys, command, path, *COLUMNS, "--dt", 0.1, "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert answer["samples"] == samples
    assert {reason: count for reason, count in answer["rejected"].items() if count} == {**missing, "too large": 1}
    assert answer["parameters"]["a0"]["value"] == pytest.approx(0.5, rel=0.1)


@pytest.mark.parametrize("command", ["run", "fit"])
def test_constant_input_is_called_not_excited(capsys, tmp_path: Path, command: str) -> None:
    path = tmp_path / "log.csv"
    noise = np.random.default_rng(1).standard_normal(300)
    path.write_text("u,y\n" + "".join(f"1.5,{3 + 0.01 * e}\n" for e in noise))
    code, out, err = call(capsys, command, path, *COLUMNS, "--dt", 0.1, "--json")
    assert (code, err) == (0, "")
    verdict = json.loads(out)["verdict"]
    assert (verdict["status"], verdict["excited"]) == ("not excited", False)
    _, out, _ = call(capsys, command, path, *COLUMNS, "--dt", 0.1)
    assert "nan" not in out
    assert "No model yet" in out
    assert "G(s)" not in out


@pytest.mark.usefixtures("unrendered")
def test_a_model_is_trusted_while_the_input_rests_and_both_are_said(capsys, tmp_path: Path) -> None:
    """On the screen and in the report once, in the reasons."""
    u = 3.0 + np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 200), 10)
    u = np.concatenate([u, np.full(4000, 3.0)])
    y = (
        7.0
        + TransferFunction([2.0], [1.0, 0.5]).simulate(u - 3.0, dt=0.05)
        + 0.02 * np.random.default_rng(1).standard_normal(u.size)
    )
    path = tmp_path / "log.csv"
    path.write_text("u,y\n" + "".join(f"{a},{b}\n" for a, b in zip(u, y, strict=True)))
    _, out, _ = call(capsys, "run", path, *COLUMNS, "--dt", 0.05, "--json")
    verdict = json.loads(out)["verdict"]
    assert (verdict["status"], verdict["excited"]) == ("trusted", False)
    rest = " ".join(verdict["reasons"][-1].split()[:5])
    _, out, _ = call(capsys, "run", path, *COLUMNS, "--dt", 0.05, "--out", tmp_path)
    assert " ".join(out.split()).count(rest) == 1
    page = html.unescape((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert page.lower().count(rest) == 1


LIMITS = {
    # column names as they are in each log; bounds on gain, time constant and simulated fit
    "un_dcmotor/DCmotor_prbs_open_exp.csv": ((1550, 1850), (0.42, 0.55), 77.0),
    "un_thermal/Thermal_prbs_open_exp.csv": ((1.02, 1.06), (29.0, 34.0), 91.5),
    "ayala_ballhoop/randomStepSequence.mat": ((11.0, 12.3), (1.4, 2.6), 83.0),
}


@every(("name", "command"), list(itertools.product(LIMITS, ["fit", "run"])), quick=1)
def test_defaults_identify_real_rigs(capsys, datasets: Path, name: str, command: str) -> None:
    gain, time_constant, fit = LIMITS[name]
    code, out, err = call(capsys, command, datasets / name, *COLUMNS, "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert gain[0] <= answer["dc_gain"] <= gain[1]
    assert time_constant[0] <= answer["poles"][0]["time_constant"] <= time_constant[1]
    assert answer["fit"]["simulated"] >= fit


@pytest.mark.usefixtures("unrendered")
@pytest.mark.parametrize("samples", [140_000, pytest.param(SAMPLES, marks=pytest.mark.slow)])
def test_demo_finds_the_actuator(capsys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, samples: int) -> None:
    monkeypatch.setattr("replant.cli.demo.SAMPLES", samples)
    code, out, err = call(capsys, "demo", "--out", tmp_path)
    assert (code, err) == (0, "")
    assert {path.name for path in tmp_path.iterdir()} == {"fit.png", "parameters.png", "report.html"}
    rows = re.findall(r"^\s*([ab]\d)\s+(\S+)\s+(\S+)\s+(\S+)\s+([+-]\S+) %$", out, re.MULTILINE)
    assert [row[0] for row in rows] == ["a2", "a1", "a0", "b1", "b0"]
    true = dict(zip([row[0] for row in rows], [*DEAP.den[1:], *DEAP.num], strict=True))
    for name, identified, std, printed_truth, off in rows:
        assert float(printed_truth) == pytest.approx(true[name], rel=1e-3)
        assert abs(float(off)) < 0.1
        assert abs(float(off)) / 100 * true[name] < 4 * float(std)
        assert float(off) == pytest.approx((float(identified) / true[name] - 1) * 100, abs=0.06)
    beside = re.findall(r"^([ab]\d)\s+([+-]\S+) %\s+([+-]\S+) %$", out, re.MULTILINE)
    assert [name for name, *_ in beside] == [row[0] for row in rows]
    assert [ours for _, ours, _ in beside] == [row[-1] for row in rows]
    assert all(abs(float(ours)) < 0.1 * abs(float(theirs)) < 0.5 for _, ours, theirs in beside)
    assert re.search(r"^verdict\s+trusted\s+inconsistent$", out, re.MULTILINE)


@pytest.mark.parametrize("arguments", [["-c", "import replant"], ["-m", "replant", "--help"]])
def test_start_imports_nothing_heavy(arguments: list[str]) -> None:
    script = (
        "import runpy, sys; sys.argv = ['replant', '--help']\n"
        "try: runpy.run_module('replant', run_name='__main__')\n"
        "except SystemExit: pass\n"
        if arguments[0] == "-m"
        else arguments[1]
    )
    script += "\nimport sys; print([m for m in ('scipy', 'matplotlib', 'pyarrow', 'control') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_without_a_command_the_help_comes_as_it_is(capsys) -> None:
    code, out, err = call(capsys)
    _, asked, _ = call(capsys, "--help")
    assert (code, out, err) == (2, "", asked)
    assert err.startswith("Usage: replant [OPTIONS] COMMAND [ARGS]...\n")


def test_help_speaks_of_ranges_where_they_are_taken(capsys) -> None:
    for command in ("run", "compare", "fit"):
        _, out, _ = call(capsys, command, "--help")
        assert ("range such as 1:4" in " ".join(out.split())) == (command != "compare")


@pytest.mark.slow
def test_reasons_fit_the_terminal_and_keep_figures_with_their_units(
    capsys, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, as_json, _ = call(capsys, "run", log, *COLUMNS, "--json")
    for columns in (40, 80, 200):
        monkeypatch.setenv("COLUMNS", str(columns))
        _, out, _ = call(capsys, "run", log, *COLUMNS)
        told = out[out.index("Verdict") : out.index("Settings chosen from")].rstrip().splitlines()
        answer = json.loads(as_json)["verdict"]
        verdict, _, reasons = " ".join(line.strip() for line in told).partition(f" {answer['reasons'][0]}")
        assert verdict.startswith(f"Verdict  {answer['status']}: ")  # with what to do, also broken into lines
        assert answer["reasons"][0] + reasons == " ".join(answer["reasons"])
        for line in told:
            assert len(line) <= columns
            assert line == line.rstrip()
            assert not line.strip().startswith("%")


@pytest.mark.parametrize("command", [pytest.param("run", marks=pytest.mark.slow), "fit"])
def test_a_sampling_time_that_the_stamps_contradict_is_said(capsys, log: Path, command: str) -> None:
    code, out, err = call(capsys, command, log, *COLUMNS, "--dt", 50, "--json")
    assert code == 0
    assert json.loads(out)["samples"] == 2000
    assert err == f"replant: note: {log}: column 't' steps by 0.05 s, but --dt is 50 s; --dt is used\n"
    for dt in (0.05, 0.052):  # the very one; the mean interval where samples were lost
        assert call(capsys, command, log, *COLUMNS, "--dt", dt, "--json")[2] == ""


def test_stamps_that_are_no_numbers_say_nothing_of_the_sampling_time(capsys, log: Path) -> None:
    header, *rows = log.read_text().splitlines()
    dated = [f"2024-01-01 00:00:{row}" for row in rows]
    log.write_text("\n".join([header, *dated]) + "\n")
    code, _, err = call(capsys, "run", log, *COLUMNS, "--dt", 50, "--json")
    assert (code, err) == (0, "")


@pytest.mark.parametrize(
    ("command", "work"), [("run", "run_and_fit.run_source"), ("fit", "run_and_fit.fit"), ("compare", "look.compare")]
)
def test_a_folder_that_cannot_be_is_refused_before_the_work(
    capsys, log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str, work: str
) -> None:
    monkeypatch.setattr(f"replant.cli.{work}", None)  # is not called
    taken = tmp_path / "taken"
    taken.touch()
    code, out, err = call(capsys, command, log, *COLUMNS, "--out", taken)
    assert (code, out) == (2, "")
    assert err == f"replant: Invalid value for --out: {taken} is a file; name a folder\n"


def test_a_name_of_a_file_is_no_folder(capsys, log: Path, tmp_path: Path) -> None:
    code, _, err = call(capsys, "fit", log, *COLUMNS, "--out", tmp_path / "rep.pdf")
    assert (code, list(tmp_path.glob("*.pdf"))) == (2, [])
    assert err.endswith("rep.pdf is the name of a file; report.html comes into a folder\n")


@pytest.mark.parametrize("command", ["run", "fit"])
def test_as_many_zeros_as_poles_where_they_are_allowed(capsys, tmp_path: Path, command: str) -> None:
    u = prbs(2000, hold=8)
    y = TransferFunction([3.0, 2.0], [1.0, 0.5]).simulate(u, 0.05)
    path = tmp_path / "log.csv"
    np.savetxt(path, np.column_stack([u, y]), delimiter=",", header="u,y", comments="")
    arguments = (command, path, *COLUMNS, "--zeros", "1", "--dt", "0.05")
    code, _, err = call(capsys, *arguments)
    assert code == 2
    assert "feedthrough" in err
    code, out, _ = call(capsys, *arguments, "--feedthrough", "--json")
    assert code == 0
    assert json.loads(out)["num"] == pytest.approx([3.0, 2.0], rel=1e-3)
