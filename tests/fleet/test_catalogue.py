"""The rigs in a folder of logs, from names, sizes and footers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow
import pytest
from pyarrow import parquet

from replant.errors import LogError
from replant.fleet.catalogue import find_rigs
from replant.fleet.job import planned, work_of
from replant.logs import arrow as reader
from support.fleets import as_csv, as_parquet, as_table, recorded


def names(rigs: list) -> list[str]:
    return [rig.name for rig in rigs]


def test_each_file_is_a_rig_and_what_is_no_log_is_none(tmp_path: Path) -> None:
    as_csv(tmp_path / "b" / "log.csv", recorded(0))
    as_parquet(tmp_path / "a.parquet", recorded(1))
    for other in ("README.md", ".hidden.csv", "_tmp/x.csv", "b/_SUCCESS"):
        (tmp_path / other).parent.mkdir(exist_ok=True)
        (tmp_path / other).write_text("t,u,y\n")
    assert names(find_rigs(tmp_path, "file")) == ["a.parquet", "b/log.csv"]
    assert names(find_rigs(tmp_path / "*" / "*.csv", "file")) == ["b/log.csv"]
    assert names(find_rigs(f"{tmp_path}/**/*.csv", "file")) == ["b/log.csv"]
    assert names(find_rigs(tmp_path / "a.parquet", "file")) == ["a.parquet"]


def test_a_pattern_without_a_root_may_match_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    as_csv(tmp_path / "logs" / "one" / "a.csv", recorded(0, 20))
    monkeypatch.chdir(tmp_path)
    assert names(find_rigs("logs/*", "file")) == names(find_rigs(f"{tmp_path}/logs/*", "file")) == ["one/a.csv"]


def test_each_folder_is_a_rig_with_all_its_files(tmp_path: Path) -> None:
    for name in ("one/a.csv", "one/b.csv", "two/a.csv", "c.csv"):
        as_csv(tmp_path / "logs" / name, recorded(0, 20))
    found = find_rigs(tmp_path / "logs", "folder")
    assert {rig.name: len(rig.pieces) for rig in found} == {"logs": 1, "one": 2, "two": 1}


def test_the_results_are_no_logs(tmp_path: Path) -> None:
    as_csv(tmp_path / "a.csv", recorded(0, 20))
    as_parquet(tmp_path / "out" / "rigs.parquet", recorded(0, 20))
    assert names(find_rigs(tmp_path, "file", leave_out=tmp_path / "out")) == ["a.csv"]


@pytest.mark.parametrize(
    ("logs", "says"), [("", "no log in it"), ("missing", "no such file or folder"), ("*.csv", "no log in it")]
)
def test_a_fleet_without_a_log_is_refused(tmp_path: Path, logs: str, says: str) -> None:
    with pytest.raises(LogError, match=says):
        find_rigs(tmp_path / logs, "file")


def test_hive_folders_name_the_rig_anywhere_in_the_path(tmp_path: Path) -> None:
    for name in ("rig=7/year=2026/a.parquet", "year=2025/rig=7/a.parquet", "rig=pump%201/a.csv"):
        (as_csv if name.endswith("csv") else as_parquet)(tmp_path / name, recorded(0, 20))
    assert {rig.name: len(rig.pieces) for rig in find_rigs(tmp_path, "rig")} == {"7": 2, "pump 1": 1}


@pytest.fixture
def several(tmp_path: Path) -> Path:
    """Three rigs of 100, 200 and 300 rows in one file, in groups of 100 rows."""
    tables = [
        as_table(recorded(k, 100 * (k + 1)), rig=pyarrow.array([k] * 100 * (k + 1), pyarrow.int32())) for k in range(3)
    ]
    parquet.write_table(pyarrow.concat_tables(tables), tmp_path / "all.parquet", row_group_size=100)
    return tmp_path


def test_statistics_give_a_rig_its_row_groups_without_a_sample_read(
    several: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parquet.ParquetFile, "read_row_group", None)
    monkeypatch.setattr(parquet.ParquetFile, "iter_batches", None)
    found = find_rigs(several, "rig")
    assert [(rig.name, rig.pieces[0].groups, rig.pieces[0].rows) for rig in found] == [
        ("0", (0,), 100), ("1", (1, 2), 200), ("2", (3, 4, 5), 300)
    ]  # fmt: skip
    assert all(piece.column == "" for rig in found for piece in rig.pieces)


@pytest.mark.parametrize("statistics", [True, False])
def test_rigs_that_share_a_row_group_are_told_apart_by_its_column(tmp_path: Path, statistics: bool) -> None:
    tables = [as_table(recorded(k, 70), rig=[f"r{k}"] * 70) for k in range(3)]
    path = tmp_path / "all.parquet"
    parquet.write_table(pyarrow.concat_tables(tables), path, row_group_size=100, write_statistics=statistics)
    found = find_rigs(tmp_path, "rig")
    assert [(rig.name, rig.pieces[0].groups, rig.pieces[0].rows, rig.pieces[0].key) for rig in found] == [
        ("r0", (0,), 70, "r0"), ("r1", (0, 1), 70, "r1"), ("r2", (1, 2), 70, "r2")
    ]  # fmt: skip


def test_rows_without_a_name_are_a_rig_that_fails(tmp_path: Path) -> None:
    parquet.write_table(as_table(recorded(0, 4), rig=["a", "a", None, None]), tmp_path / "all.parquet")
    found = find_rigs(tmp_path, "rig")
    assert [rig.name for rig in found if rig.problem] == ["(no name)"]
    assert "2 rows have no value in column 'rig'" in found[0].problem


def test_a_column_that_is_not_there_or_no_name_is_refused(tmp_path: Path) -> None:
    as_parquet(tmp_path / "a.parquet", recorded(0, 20))
    with pytest.raises(LogError, match=r"a.parquet: no column 'rig', nor a folder rig=.*there are: t, u, y"):
        find_rigs(tmp_path, "rig")
    with pytest.raises(LogError, match="named by text or a whole number"):
        find_rigs(tmp_path, "u")
    as_csv(tmp_path / "b.csv", recorded(0, 20))
    with pytest.raises(LogError, match="only Parquet files can name rigs in a column"):
        find_rigs(tmp_path, "rig")


def test_a_file_that_is_no_parquet_is_a_rig_that_fails(several: Path) -> None:
    (several / "bad.parquet").write_bytes(b"PAR1 nothing")
    found = {rig.name: rig for rig in find_rigs(several, "rig")}
    assert "not a" in found["bad.parquet"].problem or "damaged" in found["bad.parquet"].problem
    assert not found["0"].problem


def test_the_order_of_files_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from replant.fleet import catalogue

    for k in range(20):
        as_csv(tmp_path / f"{k % 4}" / f"{k}.csv", recorded(0, 20))
    walk = catalogue.os.walk
    monkeypatch.setattr(catalogue.os, "walk", lambda top, **how: reversed(list(walk(top, **how))))
    turned = find_rigs(tmp_path, "folder")
    monkeypatch.undo()
    assert turned == find_rigs(tmp_path, "folder")


def test_a_changed_file_changes_the_fingerprint(tmp_path: Path) -> None:
    file = as_csv(tmp_path / "a.csv", recorded(0, 20))
    (before,) = find_rigs(tmp_path, "file")
    file.write_text(file.read_text() + "1.0,1.0,1.0\n")
    (after,) = find_rigs(tmp_path, "file")
    assert before.fingerprint != after.fingerprint


def test_tasks_are_of_about_equal_work_and_each_rig_is_in_one(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    for k in range(300):
        (tmp_path / f"{k}.csv").write_bytes(b"x" * int(rng.integers(1, 2_000_000)))
    rigs = find_rigs(tmp_path, "file")
    tasks = planned(rigs)
    assert sorted(rig.name for task in tasks for rig in task) == names(rigs)
    works = [sum(map(work_of, task)) for task in tasks]
    assert len(tasks) >= 60
    assert max(works) < 2 * sum(works) / len(tasks)
    assert works == sorted(works, reverse=True)


@pytest.mark.slow
def test_ten_thousand_files_are_planned_without_opening_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader, "open_parquet", None)
    monkeypatch.setattr("builtins.open", None)
    for k in range(10_000):
        (tmp_path / f"{k}.parquet").touch()
    tasks = planned(find_rigs(tmp_path, "file"))
    assert sum(len(task) for task in tasks) == 10_000
    assert len(tasks) < 200
