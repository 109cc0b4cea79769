"""``replant fit`` over a range of structures."""

import json
from pathlib import Path

import pytest

from replant.cli import main
from replant.model.transfer_function import TransferFunction
from replant.signals import prbs, white_noise
from support.cases import every

pytestmark = pytest.mark.usefixtures("unrendered")


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Return a log of a second-order plant with a dead time of 0.2 s."""
    u = prbs(2000, hold=8)
    y = TransferFunction([2.0], [1.0, 4.0, 3.0], 0.2).simulate(u, 0.05) + white_noise(2000, 0.03, seed=1)
    path = tmp_path / "log.csv"
    path.write_text("u,y\n" + "".join(f"{a},{b:.17g}\n" for a, b in zip(u, y, strict=True)))
    return path


def fit(capsys, *arguments: object) -> tuple[int, str, str]:
    try:
        main(["fit", *(str(argument) for argument in arguments)])
        code = 0
    except SystemExit as stop:
        code = int(stop.code or 0)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


COLUMNS = ("--input", "u", "--output", "y", "--dt", "0.05")


def test_a_range_is_searched_and_the_table_names_the_choice(capsys, log: Path) -> None:
    code, out, err = fit(capsys, log, *COLUMNS, "--poles", "1:3", "--zeros", "0", "--delay", "0:0.4:0.1")
    assert (code, err) == (0, "")
    (chosen,) = [line.split() for line in out.splitlines() if line.rstrip().endswith("chosen")]
    assert chosen[:3] == ["2", "0", "0.2"]
    rows = [line.split() for line in out.partition("G(s)")[0].splitlines() if " s " in line and "%" in line]
    assert {row[0] for row in rows} == {"1", "2", "3"}  # the best of each order
    evidence = [float(next(cell for cell in reversed(row) if cell != "chosen")) for row in rows]
    assert evidence == sorted(evidence, reverse=True)
    assert f"{3 * 5 - len(rows)} more explain less" in out


def test_json_is_the_chosen_model_and_the_candidates(capsys, log: Path) -> None:
    code, out, err = fit(capsys, log, *COLUMNS, "--poles", "1:2", "--delay", "0.2", "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert answer["delay"] == 0.2
    assert len(answer["den"]) == 3
    for name, true in {"a1": 4.0, "a0": 3.0, "b0": 2.0}.items():
        estimate = answer["parameters"][name]
        assert abs(estimate["value"] - true) < 4 * estimate["std"]
    tried = [(each["poles"], each["zeros"], each["delay"]) for each in answer["candidates"]]
    assert tried == [(1, 0, 0.2), (2, 0, 0.2), (2, 1, 0.2)]
    assert [each["chosen"] for each in answer["candidates"]] == [False, True, False]


def test_a_dead_time_is_found_between_the_points_and_the_report_lists_what_was_tried(
    capsys, log: Path, tmp_path: Path
) -> None:
    options = ("--poles", "1:2", "--zeros", "0", "--delay", "0:0.6:0.15", "--out", tmp_path / "out")
    code, out, err = fit(capsys, log, *COLUMNS, *options)
    assert (code, err) == (0, "")
    (said,) = [line for line in out.splitlines() if line.startswith("The dead time between the points")]
    assert float(said.split(":")[1].split()[0]) == pytest.approx(0.2, abs=0.01)
    (row,) = [line for line in out.splitlines() if line.endswith(" chosen")]
    assert float(row.split()[2]) == pytest.approx(0.2, abs=0.01)
    assert row.split()[-2] == "0.0"  # nothing has more evidence
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Structures tried" in page
    assert page.count(">chosen<") == 1


@every(
    ("arguments", "words"),
    [
        (("--poles", "two"), ["--poles", "'two'", "1:4"]),
        (("--poles", "3:1"), ["--poles", "'3:1'"]),
        (("--poles", "1:2:3:4"), ["--poles"]),
        (("--poles", "1", "--delay", "0:1:0"), ["--delay"]),
        (("--poles", "1", "--delay", "0:1e9:1e-9"), ["--delay", "larger step"]),
        (("--poles", "0:2"), ["poles"]),
        (("--poles", "1:2", "--method", "least_squares"), ["srivc"]),
        (("--poles", "1:2", "--zeros", "5"), ["zeros"]),
    ],
)
def test_a_bad_range_is_one_line_and_exit_code_2(capsys, log: Path, arguments, words) -> None:
    code, out, err = fit(capsys, log, *COLUMNS, *arguments, "--json")
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert all(word in err for word in words), err


def test_how_many_dead_times_a_range_without_a_step_has_is_said(capsys, log: Path) -> None:
    _, _, err = fit(capsys, log, *COLUMNS, "--poles", "1", "--delay", "0:0.5")
    assert err == "replant: note: --delay 0:0.5: in steps of 1 s, 1 in all; give another step as in 0:0.5:0.05\n"
    assert fit(capsys, log, *COLUMNS, "--poles", "1", "--delay", "0:0.5:0.25")[2] == ""


def test_compare_takes_no_range(capsys, log: Path) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["compare", str(log), *COLUMNS, "--poles", "1:2"])
    assert stop.value.code == 2
    assert "replant fit" in capsys.readouterr().err
