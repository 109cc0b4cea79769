"""`replant fleet` at the command line: its table, its page, its refusals."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import replant as rp
from replant.cli import main
from support.cases import every
from support.fleets import as_csv, recorded, small_fleet, two_inputs

pytestmark = pytest.mark.usefixtures("unrendered")

COLUMNS = ("-i", "u", "-o", "y", "-p", "2", "--method", "fit", "--on", "threads:1")


def call(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = 0
    try:
        main(["fleet", *map(str, arguments)])
    except SystemExit as stop:
        code = int(stop.code or 0)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_fleet(tmp_path_factory.mktemp("fleet") / "logs", 3)


def test_a_fleet_is_identified_reported_and_compared(
    capsys: pytest.CaptureFixture[str], logs: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    code, said, errors = call(capsys, logs, "--by", "file", *COLUMNS, "--out", out, "--reports", "2")
    assert (code, errors) == (0, "")
    assert said.splitlines()[0] == "3 rigs: 3 trusted"
    assert f"wrote {out / 'report.html'}" in said
    assert len(list((out / "reports").glob("*.html"))) == 2
    page = (out / "report.html").read_text()
    assert page.count('"reports/') == 2
    code, _, errors = call(capsys, logs, "--by", "file", *COLUMNS, "--out", out, "--reports", "1")  # beside those
    assert (code, errors) == (0, "")
    code, _, _ = call(capsys, logs, "--by", "file", *COLUMNS, "--out", tmp_path / "new", "--compare", out)
    assert code == 0
    assert "3 rigs were trusted in" in (tmp_path / "new" / "report.html").read_text()


def test_json_is_one_object_and_failures_are_noted(
    capsys: pytest.CaptureFixture[str], logs: Path, tmp_path: Path
) -> None:
    for file in logs.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "bad.csv").write_text("t,v\n0,1\n")
    options = ("--by", "file", *COLUMNS, "--out", tmp_path / "out")
    code, said, _ = call(capsys, tmp_path, *options, "--json")
    assert (code, json.loads(said)["verdicts"]) == (0, {"trusted": 3, "failed": 1})
    code, _, errors = call(capsys, tmp_path, *options)
    assert "1 rig failed, bad.csv:" in errors


def test_of_many_failures_the_most_frequent_reason_is_named(
    capsys: pytest.CaptureFixture[str], logs: Path, tmp_path: Path
) -> None:
    (tmp_path / "a.csv").write_text("t,v\n0,1\n")
    for file in logs.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    named = f"the first: {tmp_path / 'rig0.csv'}: no column 'w'"
    code, said, errors = call(capsys, tmp_path, "-i", "w", *COLUMNS[2:], "--out", tmp_path / "out")
    assert (code, said) == (2, "")
    assert f"none of 4 rigs could be identified; 3 of them for one reason, {named}" in errors
    (tmp_path / "z.csv").write_text("")
    (tmp_path / "b.csv").write_text("")
    code, _, errors = call(capsys, tmp_path, *COLUMNS, "--out", tmp_path / "out")
    assert code == 0
    assert f"3 rigs failed, 2 of them for one reason, the first of them b.csv: {tmp_path / 'b.csv'}: " in errors


def test_the_options_of_run_and_fit_are_taken(capsys: pytest.CaptureFixture[str], logs: Path, tmp_path: Path) -> None:
    options = ("--by", "file", *COLUMNS, "--zeros", "1", "--bias", "--from", "1", "--to", "25", "--time", "t")
    code, _, _ = call(capsys, logs, *options, "--out", tmp_path / "out")
    row = rp.fleet.load(tmp_path / "out").table().to_pylist()[0]
    log = rp.read_log(logs / "rig0.csv", input="u", output="y", time="t", begin=1.0, end=25.0)
    alone = rp.fit(log, structure=rp.Structure(2, 1, bias=True))
    assert code == 0
    assert [row[name] for name in alone.names] == alone.parameters.tolist()


@every(
    ("arguments", "says"),
    [
        ((), "missing --input, --output and --poles; see what is in one of the logs"),
        (("-i", "u", "-o", "y", "-p", "1:3"), "--poles must be one number here"),
        ((*COLUMNS[:-1], "mpi:3"), "'mpi:3' is not an executor; give threads:N, processes:N or dask://HOST:PORT"),
        (("-i", "w", *COLUMNS[2:]), "none of 3 rigs could be identified; the first: "),
        ((*COLUMNS, "--compare", "nowhere"), "nowhere: no results of `replant fleet` there"),
        ((*COLUMNS, "--by", "rig"), "only Parquet files can name rigs in a column"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(
    capsys: pytest.CaptureFixture[str], logs: Path, tmp_path: Path, arguments: tuple, says: str
) -> None:
    by = () if "--by" in arguments else ("--by", "file")
    code, said, errors = call(capsys, logs, *by, *arguments, "--out", tmp_path / "out")
    assert (code, said) == (2, "")
    assert says in errors
    assert len(errors.splitlines()) == 1


def test_what_cannot_be_compared_is_refused_before_the_run(
    capsys: pytest.CaptureFixture[str], logs: Path, tmp_path: Path
) -> None:
    old, new = tmp_path / "old", tmp_path / "new"
    assert call(capsys, logs, "--by", "file", *COLUMNS, "--out", old)[0] == 0
    for more, out, says in (
        (("--zeros", "1"), new, "identify both with the same options"),
        ((), old, "would replace those that they are compared with"),
    ):
        code, said, errors = call(capsys, logs, "--by", "file", *COLUMNS, *more, "--out", out, "--compare", old)
        assert (code, said, len(errors.splitlines())) == (2, "", 1)
        assert says in errors
    assert not new.exists()


def test_the_page_of_a_fleet_that_failed_is_not_that_of_the_run_before(
    capsys: pytest.CaptureFixture[str], logs: Path, tmp_path: Path
) -> None:
    call(capsys, logs, "--by", "file", *COLUMNS, "--out", tmp_path)
    code, _, _ = call(capsys, logs, "--by", "file", "-i", "w", *COLUMNS[2:], "--out", tmp_path)
    assert code == 2
    assert "failed" in (tmp_path / "report.html").read_text()


def test_results_of_other_options_are_not_replaced_without_a_note(
    capsys: pytest.CaptureFixture[str], logs: Path, tmp_path: Path
) -> None:
    again = [call(capsys, logs, *COLUMNS, *more, "--out", tmp_path)[2] for more in ((), (), ("--zeros", "1"))]
    assert again[:2] == ["", ""]
    assert again[2].startswith(f"replant: note: {tmp_path}: held the results of other options, which these replace")


def test_progress_is_in_lines_of_tenths(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    small_fleet(tmp_path / "logs", 12)
    code, _, errors = call(capsys, tmp_path / "logs", "--by", "file", *COLUMNS, "--out", tmp_path / "out", "--progress")
    lines = errors.splitlines()
    assert code == 0
    assert lines[-1] == "replant: 12 of 12 rigs 100 %"
    assert len(lines) <= 11


def test_a_name_with_signs_for_the_terminal_is_one_plain_line(
    capsys: pytest.CaptureFixture[str], logs: Path, tmp_path: Path
) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "fine.csv").write_bytes((logs / "rig0.csv").read_bytes())
    (tmp_path / "logs" / "a\n\x1b[31mb.csv").write_text("")
    code, _, errors = call(capsys, tmp_path / "logs", "--by", "file", *COLUMNS, "--out", tmp_path / "out")
    assert (code, len(errors.splitlines())) == (0, 1)
    assert "\x1b" not in errors


def test_an_empty_folder_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    code, _, errors = call(capsys, tmp_path / "logs", "--by", "file", *COLUMNS, "--out", tmp_path / "out")
    assert code == 2
    assert "no log in it" in errors


def test_a_file_is_no_folder_for_results(capsys: pytest.CaptureFixture[str], logs: Path, tmp_path: Path) -> None:
    file = as_csv(tmp_path / "file.csv", recorded(0, 10))
    code, _, errors = call(capsys, logs, "--by", "file", *COLUMNS, "--out", file)
    assert code == 2
    assert "is a file; name a folder" in errors


def test_the_terminal_names_the_odd_rigs(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Of twelve alike rigs and one of half the gain."""
    folder = tmp_path / "logs"
    for k in range(13):
        as_csv(folder / f"rig{k:02d}.csv", recorded(k, gain=1.0 if k == 7 else 2.0 + 0.01 * k))
    options = ("--by", "file", *COLUMNS, "--out", tmp_path / "out")
    code, said, _ = call(capsys, folder, *options)
    assert code == 0
    assert said.splitlines()[1] == "1 is odd, farther from the fleet than chance explains:"
    assert said.splitlines()[2].startswith("  rig07.csv: ")
    _, said, _ = call(capsys, folder, *options, "--json")
    (odd,) = json.loads(said)["odd"]
    assert odd["rig"] == "rig07.csv"
    assert odd["why"]


def test_several_inputs_are_named_as_for_run_and_fit(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """With a report of each rig, its G(s) from each input."""
    for k in range(2):
        two_inputs(tmp_path / "logs" / f"rig{k}.csv", k)
    given = (tmp_path / "logs", "-i", "Q1", "-i", "Q2", "-o", "T1", "--method", "fit", "--on", "threads:1")
    asked = (*given, "-p", "1,1", "--delay", "0,0.3")
    code, said, errors = call(capsys, *asked, "--out", tmp_path / "out", "--reports", 1)
    assert (code, errors) == (0, "")
    assert said.splitlines()[0] == "2 rigs: 2 trusted"
    (report,) = (tmp_path / "out" / "reports").glob("*.html")
    assert "Q2 → T1" in report.read_text()
    code, _, errors = call(capsys, *asked, "--zeros", "0,0", "--out", tmp_path / "new", "--compare", tmp_path / "out")
    assert (code, errors) == (0, "")
    for words, more in (
        ("--poles must have a number for each of 2 inputs (Q1, Q2), as in 1,1: got one", (*given, "-p", "1")),
        ("a range is searched by replant fit", (*given, "-p", "1:2,1")),
        ("several inputs take no --bias yet", (*asked, "--bias")),
        ("column 'T1' is the output and an input", (*asked[:4], "T1", *asked[5:])),
        ("-i Q1 is given twice", (*asked, "-i", "Q1")),
    ):
        code, said, errors = call(capsys, *more, "--out", tmp_path / "refused")
        assert (code, said, errors.count("\n")) == (2, "", 1), errors
        assert words in errors
