"""The options that condition a log, give an optimizer its settings, and show progress."""

from __future__ import annotations

import dataclasses
import html
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.cli import main
from replant.cli.conditioning_options import conditioned, conditioning_as_python, input_hold_of
from replant.signals import prbs
from support.cases import every

pytestmark = pytest.mark.usefixtures("unrendered")

PLANT = rp.TransferFunction([4.0], [1.0, 2.0])
DT = 0.01
OPTIONS = ("-i", "u", "-o", "y", "-p", "1", "--json")


@pytest.fixture
def log(tmp_path: Path) -> Path:
    u = prbs(6000, hold=20, bits=9)
    y = PLANT.simulate(u, DT)
    path = tmp_path / "log.csv"
    rows = (f"{DT * k:.2f},{u[k]},{y[k].item()!r}\n" for k in range(u.size))
    path.write_text("t,u,y\n" + "".join(rows))
    return path


def model_of(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[dict[str, object], str]:
    main([*map(str, words), *OPTIONS])
    said = capsys.readouterr()
    answer: dict[str, object] = json.loads(said.out)
    return answer, said.err


def values_of(answer: dict[str, object]) -> list[float]:
    parameters = answer["parameters"]
    assert isinstance(parameters, dict)
    return [entry["value"] for entry in parameters.values()]


@pytest.mark.parametrize("command", ["run", "fit"])
def test_a_decimated_log_gives_the_same_plant_and_the_filter_is_said(
    capsys: pytest.CaptureFixture[str], log: Path, command: str
) -> None:
    answer, notes = model_of(capsys, command, log, "--decimate", 5)
    assert (answer["dt"], answer["input_hold"]) == (0.05, "foh")
    assert "filtered against aliasing" in notes
    np.testing.assert_allclose(values_of(answer), [2.0, 4.0], rtol=0.01)


@pytest.mark.slow
def test_a_log_is_resampled_and_detrended_as_in_python(capsys: pytest.CaptureFixture[str], log: Path) -> None:
    answer, notes = model_of(capsys, "fit", log, "--resample", 0.015, "--detrend")
    whole = rp.read_log(log, input="u", output="y")
    expected = rp.fit(rp.detrend(rp.resample(whole, 0.015)), poles=1)
    assert values_of(answer) == expected.parameters.tolist()
    assert "resampled" in notes
    assert "detrended" in notes


@every(
    ("words", "problem"),
    [
        (("--decimate", 1), "--decimate"),
        (("--decimate", 400), "--decimate 400: the log has 6000 samples"),
        (("--resample", 0.5), "--resample 0.5: the new sampling time"),
        (("--decimate", 5, "--resample", 0.5), "--resample 0.5, taken before --decimate 5: the new sampling time"),
        (("--resample", 1e-9), "--resample 1e-09: the new sampling time"),
        (("--resample", "nan"), "--resample nan: dt must be"),
        (("--input-hold", "spline"), "'spline' is not one of"),
    ],
)
def test_what_cannot_be_done_names_the_option(
    capsys: pytest.CaptureFixture[str], log: Path, words: tuple[object, ...], problem: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        model_of(capsys, "fit", log, *words)
    assert ended.value.code == 2
    assert problem in capsys.readouterr().err


def test_an_optimizer_takes_its_settings(capsys: pytest.CaptureFixture[str], log: Path) -> None:
    main(["run", str(log), "-i", "u", "-o", "y", "-p", "1", "--optimizer", "AMSGrad:step-size=0.003, beta1=0.8"])
    assert "AMSGrad(step_size=0.003, beta1=0.8" in capsys.readouterr().out


@every(
    ("typed", "problem"),
    [
        ("amsgrad:stepsize=1", "did you mean 'step_size'?"),
        ("amsgrad:beta1=0.8", "amsgrad needs step_size too"),
        ("amsgrad:step_size", "write a number behind step_size="),
        ("amsgrad:step_size=fast", "write a number behind step_size="),
        ("amsgrad:step_size=-1", "step_size must be"),
        ("amsgrad:step_size=1,step_size=2", "step_size is given twice"),
        ("auto:gain=1", "auto takes no settings"),
        ("adan:gain=1", "did you mean"),
    ],
)
def test_settings_that_cannot_be_are_named(
    capsys: pytest.CaptureFixture[str], log: Path, typed: str, problem: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        model_of(capsys, "run", log, "--optimizer", typed)
    assert ended.value.code == 2
    assert problem in " ".join(capsys.readouterr().err.split())


@pytest.mark.slow
def test_progress_is_printed_in_lines_where_it_is_asked_for(capsys: pytest.CaptureFixture[str], log: Path) -> None:
    _, said = model_of(capsys, "run", log, "--progress")
    lines = [line for line in said.splitlines() if line.startswith("replant: identifying ")]
    assert lines[-1] == "replant: identifying 100 %"
    assert 2 <= len(lines) <= 11
    assert "identifying" not in model_of(capsys, "run", log)[1]
    with pytest.raises(SystemExit):
        model_of(capsys, "run", log, "--progress", "--quiet")


@pytest.mark.parametrize("command", ["run", "fit"])
def test_a_band_of_frequencies_is_as_in_python(capsys: pytest.CaptureFixture[str], log: Path, command: str) -> None:
    answer, notes = model_of(capsys, command, log, "--band", "0.2:20Hz")
    assert "0.2 to 20 Hz count" in notes
    np.testing.assert_allclose(values_of(answer), [2.0, 4.0], rtol=0.01)
    if command == "fit":
        expected = rp.fit(rp.bandpass(rp.read_log(log, input="u", output="y"), 0.2, 20.0), poles=1)
        assert values_of(answer) == expected.parameters.tolist()


@every(
    ("band", "words"),
    [
        ("0.1", "write 0.1:10"),
        (":", "write 0.1:10"),
        ("a:b", "write 0.1:10"),
        ("5:1", "--band 5:1"),
        (":60", "half the"),
    ],
)
def test_a_band_that_is_none_is_refused_in_a_line(
    capsys: pytest.CaptureFixture[str], log: Path, band: str, words: str
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["fit", str(log), *OPTIONS, "--band", band])
    assert stop.value.code == 2
    assert words in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("command", ["run", "fit"])
def test_the_rest_put_before_a_log_is_counted_nowhere(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, command: str
) -> None:
    u = prbs(3000, hold=20, bits=9)
    y = PLANT.simulate(u - u[0], DT) + 0.01 * np.random.default_rng(0).standard_normal(u.size)
    log = tmp_path / "log.csv"
    log.write_text("t,u,y\n" + "".join(f"{DT * k:.2f},{u[k]},{y[k]:.6f}\n" for k in range(u.size)))
    answer, notes = model_of(capsys, command, log, "--x0", "rest")
    rejected = answer["rejected"]
    assert isinstance(rejected, dict)
    assert (answer["samples"], sum(rejected.values())) == (3000, 0)
    assert "from rest: 3,000 samples at the first input are put before the record\n" in notes
    main([command, str(log), *OPTIONS[:-1], "--x0", "rest"])
    said = capsys.readouterr().out
    assert "Record   3,000 samples, dt 10 ms, 30 s\nSamples  3,000\n" in said


CONDITIONS = [
    {"decimate": 3, "detrend": True, "leave_out": ((12.0, 20.0),), "validate_on": ((30.0, None),)},
    {"resample": 0.015, "x0": "rest"},
    {"band": (None, 20.0), "use": ((0.0, 40.0),)},
    {"band": (0.2, None)},
    {"decimate": 2, "input_hold": "zoh"},
    {"input_hold": "foh"},
    {},
]


@every("options", CONDITIONS)
def test_python_conditions_a_log_as_the_options_do(log: Path, options: dict[str, Any]) -> None:
    read = rp.read_log(log, input="u", output="y")
    expected = dataclasses.replace(conditioned(read, options), input_hold=input_hold_of(options))
    found = read
    for call in conditioning_as_python(options):
        found = eval(call.format("log"), {"rp": rp, "dataclasses": dataclasses, "log": found})
    for name in ("input", "output"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    for name in ("dt", "input_hold", "rest", "withheld"):
        assert getattr(found, name) == getattr(expected, name)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("command", "more"),
    [
        ("fit", ("--decimate", 5, "--leave-out", "12s:20s", "--time", "t")),
        ("run", ("--decimate", 5, "--from", 3)),
        ("fit", ("--input-hold", "foh", "--dt", DT)),
        ("compare", ("--detrend", "--optimizer", "srivc")),
    ],
)
def test_python_in_the_report_repeats_what_the_options_do(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path, command: str, more: tuple[object, ...]
) -> None:
    answer, _ = model_of(capsys, command, log, "--out", tmp_path / "out", *more)
    (answer,) = answer.values() if command == "compare" else [answer]  # type: ignore[assignment]
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    (program,) = re.findall(r'<pre class="python"[^>]*><code>(.*?)</code>', page, re.DOTALL)
    names: dict[str, Any] = {}
    exec(html.unescape(program).replace("print(", "repr("), names)
    found = names["fitted"] if "fitted" in names else names["ident"]
    np.testing.assert_allclose(found.parameters, values_of(answer), rtol=1e-5)
