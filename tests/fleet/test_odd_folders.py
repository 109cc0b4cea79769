"""Odd folders: cyclic links, pipes, unreadable folders, results, odd names."""

from __future__ import annotations

import os
from pathlib import Path

import pyarrow
import pytest
from pyarrow import parquet

import replant as rp
from replant.errors import ArgumentTypeError, InvalidArgumentError, LogError
from replant.fleet.catalogue import find_rigs
from replant.fleet.job import Job, report_path
from replant.fleet.page import write_reports
from replant.fleet.store import Store
from replant.numerics.operating_system import ENDING
from support.cases import every
from support.command import call
from support.fleets import as_csv, as_parquet, as_table, recorded, small_fleet


def fitted(logs: Path, out: Path, by: str = "file", **more: object) -> rp.fleet.Fleet:
    return rp.fleet.fit(logs, by=by, input="u", output="y", out=out, **{"poles": 2, "method": "fit", **more})


def names(logs: Path, by: str = "file") -> list[str]:
    return [rig.name for rig in find_rigs(logs, by)]


def rows_of(fleet: rp.fleet.Fleet) -> dict[str, dict]:
    return {row["rig"]: row for row in fleet.table().to_pylist()}


# --- what is in the folder


def test_links_that_lead_round_are_not_followed(tmp_path: Path) -> None:
    for name in ("a/1.csv", "b/2.csv"):
        as_csv(tmp_path / "logs" / name, recorded(0, 20))
    logs = tmp_path / "logs"
    for where, to in (
        ("self", logs),
        ("again", logs),
        ("up", tmp_path),
        ("a/other", logs / "b"),
        ("b/other", logs / "a"),
    ):
        (logs / where).symlink_to(to)
    assert set(names(logs)) == {"a/1.csv", "a/other/2.csv", "b/2.csv", "b/other/1.csv"}


PROSE = (
    "Notes of the campaign\nRig a was warm; rig b was cold.\nDo not use c.\n",
    "Readme\n\nRecorded 2024-05-01, by Anna, with 2 sensors.\n1. start the pump\n2. stop it\n",
)
MAY_BE_LOGS = (
    "",
    "t,u,y\n",
    "time,volt,speed\n0,1,2\n1,2,3\n",
    "when;u;y\n2024-05-01 00:00:00;1,5;\n2024-05-01 00:00:01;;2,5\n",
    "a rig\nits log\n0 1 2\n1 2 3\n",
)


@pytest.mark.parametrize("by", ["file", "folder"])
def test_a_text_without_rows_of_numbers_is_left_out(tmp_path: Path, by: str) -> None:
    logs = small_fleet(tmp_path / "logs", 2)
    for number, text in enumerate(PROSE):
        (logs / f"notes{number}.txt").write_text(text)
    left_out: list[str] = []
    assert len(find_rigs(logs, by, no_log=left_out.append)) == (2 if by == "file" else 1)
    assert left_out == ["notes0.txt", "notes1.txt"]
    assert [rig.name for rig in find_rigs(logs / "notes0.txt", "file")] == ["notes0.txt"]  # named, it is read


def test_what_may_be_a_log_is_a_rig(tmp_path: Path) -> None:
    for number, text in enumerate(MAY_BE_LOGS):
        (tmp_path / f"{number}.txt").write_text(text)
    (tmp_path / "hex.csv").write_text("t,u,y\nff,a0,b1\nfe,a1,b2\n")
    left_out: list[str] = []
    assert len(find_rigs(tmp_path, "file", no_log=left_out.append)) == len(MAY_BE_LOGS) + 1
    assert not left_out


def test_texts_that_were_left_out_are_named(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    logs, out = small_fleet(tmp_path / "logs", 2), tmp_path / "out"
    (logs / "notes.txt").write_text(PROSE[0])
    options = ("-i", "u", "-o", "y", "-p", 2, "--method", "fit", "--on", "threads:1", "--out", out)
    code, said, err = call(capsys, "fleet", logs, *options)
    assert (code, "2 rigs: 2 trusted" in said) == (0, True)
    assert "left out, as it holds no rows of numbers: notes.txt" in err
    assert rp.fleet.load(out).left_out == ("notes.txt",)
    assert "texts left out: notes.txt" in (out / "report.html").read_text("utf-8")


def test_a_link_to_itself_is_a_rig_that_fails(tmp_path: Path) -> None:
    logs = small_fleet(tmp_path / "logs", 1)
    (logs / "round.csv").symlink_to(logs / "round.csv")
    found = rows_of(fitted(logs, logs / "out"))
    assert "symbolic links" in found["round.csv"]["reasons"]
    assert found["rig0.csv"]["verdict"] == "trusted"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes are those of POSIX")
@pytest.mark.parametrize("by", ["file", "folder"])
def test_a_pipe_is_not_waited_for(tmp_path: Path, by: str) -> None:
    (tmp_path / "logs" / "r").mkdir(parents=True)
    os.mkfifo(tmp_path / "logs" / "r" / "x.csv")
    (row,) = fitted(tmp_path / "logs", tmp_path / "out", by).table().to_pylist()
    assert "a pipe" in row["reasons"]


@pytest.mark.parametrize("by", ["file", "folder"])
def test_a_folder_that_cannot_be_searched_is_a_rig_that_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, by: str
) -> None:
    small_fleet(tmp_path / "logs" / "fine", 1)
    small_fleet(tmp_path / "logs" / "closed", 1)
    scandir = os.scandir

    def refusing(path: str) -> object:
        if Path(path).name == "closed":
            raise PermissionError(13, "Permission denied", os.fspath(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refusing)
    found = find_rigs(tmp_path / "logs", by)
    assert len(found) == 2
    assert [("cannot be searched (Permission denied)" in rig.problem) for rig in found].count(True) == 1


def test_the_folder_of_all_logs_is_no_rig_with_one_in_it(tmp_path: Path) -> None:
    for name in ("c.csv", "logs/a.csv"):
        as_csv(tmp_path / "logs" / name, recorded(0, 20))
    assert names(tmp_path / "logs", "folder") == [".", "logs"]


# --- names


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="names that are no text are those of POSIX")
def test_a_name_that_is_no_text_is_written_out(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    source = as_csv(tmp_path / "a.csv", recorded(0))
    for kind, content in ((b"good", source.read_bytes()), (b"bad", b"no log")):
        try:
            Path(os.fsdecode(os.fsencode(tmp_path / "logs") + b"/" + kind + b"\xff.csv")).write_bytes(content)
        except OSError:
            pytest.skip("this file system takes UTF-8 alone")
    (tmp_path / "logs").rename(logs := Path(os.fsdecode(os.fsencode(tmp_path) + b"/logs\xff")))
    found = fitted(logs, tmp_path / "out")
    rp.fleet.write_page(found)
    assert write_reports(found, 2) == 1
    assert {name: row["verdict"] for name, row in rows_of(found).items()} == {
        r"good\udcff.csv": "trusted", r"bad\udcff.csv": "failed"
    }  # fmt: skip
    assert found.model(r"good\udcff.csv").structure == rp.Structure(2)


def test_odd_names_are_rigs_of_their_own_and_kept(tmp_path: Path) -> None:
    odd = [
        "ünï 東京😀",
        "a'b\"c",
        "<b>&amp;</b>",
        "r" * 300 + "a",
        "r" * 300 + "b",
        "-x",
        "../up",
        "a\nb",
        "7",
        "$t",
        "\\",
    ]
    tables = [as_table(recorded(k, 200), rig=[name] * 200) for k, name in enumerate(odd)]
    (tmp_path / "logs").mkdir()
    parquet.write_table(pyarrow.concat_tables(tables), tmp_path / "logs" / "a.parquet", row_group_size=300)
    found = fitted(tmp_path / "logs", tmp_path / "out", "rig")
    assert found.table().column("rig").to_pylist() == sorted(odd)
    assert all(found.model(name).structure == rp.Structure(2) for name in odd)
    assert len({report_path(name) for name in odd}) == len(odd)
    assert all(Path(report_path(name)).parent == Path("reports") for name in odd)


@pytest.mark.parametrize("value", ["", "__HIVE_DEFAULT_PARTITION__"])
def test_a_hive_folder_without_a_value_is_a_rig_that_fails(tmp_path: Path, value: str) -> None:
    as_parquet(tmp_path / f"rig={value}" / "a.parquet", recorded(0, 20))
    (rig,) = find_rigs(tmp_path, "rig")
    assert "has no value" in rig.problem


HALLS = pyarrow.array([{"hall": "h", "row": "never"}] * 40)  # the footer counts each field of a structure as a column


@every(
    ("samples", "more", "found"),
    [
        (4, {"rig": ["a", "a", "", " "]}, ["(no name)", "a"]),
        (40, {"place": HALLS, "rig": ["x"] * 20 + ["y"] * 20}, ["x", "y"]),
    ],
    ids=["rows with an empty name are no rig", "the name is found behind a column of structures"],
)
def test_rigs_are_told_by_the_names_in_their_rows(
    tmp_path: Path, samples: int, more: dict[str, object], found: list[str]
) -> None:
    record = recorded(0, samples)
    table = pyarrow.table({**more, "t": record.t, "u": record.u, "y": record.y})
    parquet.write_table(table, tmp_path / "all.parquet", row_group_size=20)
    assert names(tmp_path, "rig") == found


# --- results


def test_results_of_any_fleet_are_no_logs(tmp_path: Path) -> None:
    logs = small_fleet(tmp_path / "logs", 2)
    first = fitted(logs, logs / "one")
    assert fitted(logs, logs / "two").table().equals(first.table())
    assert names(logs / "**" / "*.*") == ["rig0.csv", "rig1.csv"]
    (logs / "one" / "fleet.json").unlink()  # a run that was killed
    assert names(logs) == ["rig0.csv", "rig1.csv"]
    with pytest.raises(LogError, match="holds the results of a fleet"):
        find_rigs(logs / "one", "file")


def test_results_among_the_logs_are_refused(tmp_path: Path) -> None:
    logs = small_fleet(tmp_path / "logs", 1)
    for given in (logs, logs / "*.csv"):
        with pytest.raises(InvalidArgumentError, match="is the folder of the logs; name another one"):
            fitted(given, logs)
    assert rows_of(fitted(logs, tmp_path))["rig0.csv"]["verdict"] == "trusted"  # the folder that holds that of the logs


@every("theirs", ["rigs.parquet", "timing.parquet", "models.jsonl", "reports/mine.html"])
def test_files_of_others_are_neither_overwritten_nor_removed(tmp_path: Path, theirs: str) -> None:
    file = tmp_path / "out" / theirs
    file.parent.mkdir(parents=True)
    file.write_text("mine")
    with pytest.raises(InvalidArgumentError, match="would be overwritten, but do not belong to a fleet"):
        fitted(small_fleet(tmp_path / "logs", 1), tmp_path / "out")
    assert file.read_text() == "mine"


def test_a_second_run_does_not_remove_what_the_first_one_is_writing(tmp_path: Path) -> None:
    job = Job("u", "y", rp.Structure(2), "fit")
    writing = tmp_path / "out" / f".part{ENDING}"
    with Store(tmp_path / "out", job).alone():
        writing.touch()
        Store(tmp_path / "out", job)
        assert writing.exists()
    with Store(tmp_path / "out", job).alone():
        assert not writing.exists()


def test_a_wrong_option_does_not_cost_what_is_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    logs, out = small_fleet(tmp_path / "logs", 2), tmp_path / "out"
    first = fitted(logs, out).table()
    failed = rp.fleet.fit(logs, by="file", input="x", output="y", poles=2, method="fit", out=out)
    assert failed.verdicts == {"failed": 2}
    monkeypatch.setattr("replant.fleet.worker.identify", None)
    assert fitted(logs, out).table().equals(first)


def test_reports_of_models_that_are_made_anew_go(tmp_path: Path) -> None:
    logs, out = small_fleet(tmp_path / "logs", 2), tmp_path / "out"
    fitted(logs, out)
    reports = [out / report_path(f"rig{k}.csv") for k in range(2)]
    reports[0].parent.mkdir()
    for report in reports:
        report.touch()
    as_csv(logs / "rig0.csv", recorded(9))
    fitted(logs, out)
    assert [report.exists() for report in reports] == [False, True]


# --- arguments


@every(
    ("logs", "by", "says"),
    [
        ("", "file", "logs is empty"),
        ("x" * 5000, "file", "no such file or folder .File name too long"),
        ("a**", "file", "not a valid pattern"),
        (".", "", "by is empty"),
        (".", 3, "by must be a str, got 3"),
        (3, "file", "logs must be a str or a PathLike, got int 3"),
    ],
)
def test_arguments_that_name_nothing_are_refused(logs: object, by: object, says: str) -> None:
    with pytest.raises((LogError, InvalidArgumentError, ArgumentTypeError), match=says) as refused:
        find_rigs(logs, by)
    assert len(str(refused.value)) < 400
