"""Recorded folders: readable at every moment, whole, and read back to the bit."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pandas
import pyarrow.parquet
import pytest

import replant as rp
from replant.errors import LogError
from replant.live.outputs import message as recording
from replant.live.outputs.message import DiskWriter, EstimateMessage, Notices, ParquetRecorder
from replant.live.streams import Batch
from support.cases import every
from support.full_disk import full_disk
from support.live_fakes import DT, record

U, Y = record(1000)
T, N = DT * np.arange(1000), np.arange(1000)


def recorded(folder: Path, parts: list[slice], *, numbered: bool = True, go_on: bool = False) -> list[str]:
    """Record parts of the record, each flushed; return what was said."""
    said: list[str] = []
    disk_writer = DiskWriter(Notices(said.append))
    recorder = ParquetRecorder(folder, disk_writer, go_on=go_on)
    for part in parts:
        recorder.add_samples(Batch(U[part], Y[part], sequence=N[part] if numbered else None), T[part])
        recorder.flush()
    disk_writer.close()
    return said


@pytest.mark.parametrize("numbered", [False, True])
def test_what_was_recorded_is_read_back_to_the_bit(tmp_path: Path, numbered: bool) -> None:
    assert recorded(tmp_path, [slice(0, 1), slice(1, 700), slice(700, 1000)], numbered=numbered) == []
    log = rp.read_log(tmp_path, input="u", output="y")
    np.testing.assert_array_equal(log.input, U)
    np.testing.assert_array_equal(log.output, Y)
    np.testing.assert_array_equal(log.time, T)
    assert log.dt == pytest.approx(DT)
    frame = pandas.read_parquet(tmp_path / "samples")
    assert list(frame) == ["n", "t", "u", "y"]
    np.testing.assert_array_equal(frame["y"], Y)
    assert frame["n"].isna().all() != numbered


def test_estimates_are_recorded_beside_them(tmp_path: Path) -> None:
    disk_writer = DiskWriter(Notices(print))
    recorder = ParquetRecorder(tmp_path, disk_writer)
    for k in range(3):
        values = np.array([k + 0.5, np.nan]), np.array([0.1, np.nan])
        recorder.send(EstimateMessage(k * DT, k, k + 1, ("a0", "b0"), *values, "running", "trusted", excited=k > 0))
    recorder.flush()
    disk_writer.close()
    frame = pandas.read_parquet(tmp_path / "estimates")
    assert list(frame) == ["t", "n", "samples", "a0", "b0", "std_a0", "std_b0", "status", "verdict", "excited"]
    np.testing.assert_array_equal(frame["a0"], [0.5, 1.5, 2.5])
    assert frame["b0"].isna().all()
    assert set(frame["verdict"]) == {"trusted"}
    assert frame["excited"].tolist() == [False, True, True]


def test_a_crash_while_a_part_is_written_loses_only_that_part(tmp_path: Path) -> None:
    recorded(tmp_path, [slice(0, 300)])
    (tmp_path / "samples" / ".part-00000002.parquet").write_bytes(b"PAR1 and half of a page")  # what a crash leaves
    assert len(rp.read_log(tmp_path, input="u", output="y")) == 300
    assert len(pandas.read_parquet(tmp_path / "samples")) == 300

    recorded(tmp_path, [slice(300, 600)], go_on=True)
    assert not any(path.name.startswith(".") for path in (tmp_path / "samples").iterdir())
    assert len(rp.read_log(tmp_path, input="u", output="y")) == 600


@pytest.mark.parametrize("call", ["open", "fsync", "replace"])
def test_a_call_that_fails_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str) -> None:
    recorded(tmp_path, [slice(0, 300)])
    with monkeypatch.context() as disk:
        disk.setattr(
            os if call == "fsync" else Path,
            call,
            lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")),
        )
        said = recorded(tmp_path, [slice(300, 600)], go_on=True)
    assert ["No space left" in line for line in said] == [True]
    assert [path.name for path in (tmp_path / "samples").iterdir()] == ["part-00000001.parquet"]
    assert len(rp.read_log(tmp_path, input="u", output="y")) == 300


@pytest.mark.skipif(sys.platform == "win32", reason="no limit to a file's size")
@every("room", [0, 3, 500, 4000])
def test_a_full_disk_leaves_nothing_behind(tmp_path: Path, room: int) -> None:
    """Wherever in the part the disk becomes full; later samples are recorded when there is space again."""
    with full_disk(room):
        assert len(recorded(tmp_path, [slice(0, 300)])) == 1
    assert not list((tmp_path / "samples").iterdir())
    assert recorded(tmp_path, [slice(300, 600)], go_on=True) == []
    np.testing.assert_array_equal(rp.read_log(tmp_path, input="u", output="y").input, U[300:600])


def test_samples_that_are_sent_again_are_recorded_once(tmp_path: Path) -> None:
    """After a crash a peer repeats the samples since the checkpoint, some of which are already recorded."""
    recorded(tmp_path, [slice(0, 400)])
    recorded(tmp_path, [slice(200, 350), slice(350, 500), slice(500, 1000)], go_on=True)
    log = rp.read_log(tmp_path, input="u", output="y")
    np.testing.assert_array_equal(log.input, U)
    np.testing.assert_array_equal(log.time, T)


def test_parts_are_written_by_themselves_when_they_are_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "ROWS", 100)
    disk_writer = DiskWriter(Notices(print))
    recorder = ParquetRecorder(tmp_path, disk_writer)
    for at in range(0, 600, 50):
        part = slice(at, at + 50)
        recorder.add_samples(Batch(U[part], Y[part]), T[part])
    disk_writer.close()
    parts = sorted((tmp_path / "samples").iterdir())
    assert [pyarrow.parquet.ParquetFile(path).metadata.num_rows for path in parts] == [100] * 6


def test_a_used_folder_is_not_mixed_with_another_record(tmp_path: Path) -> None:
    recorded(tmp_path, [slice(0, 10)])
    with pytest.raises(rp.InvalidArgumentError, match="already holds a record; choose another folder"):
        recorded(tmp_path, [slice(10, 20)])


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(rp.InvalidArgumentError, match="choose a folder that can be written"):
        recorded(tmp_path / "file", [slice(0, 10)])


# --- folders as logs


def test_a_folder_without_parquet_files_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="a directory; give the log file inside it"):
        rp.read_log(tmp_path, input="u", output="y")


def test_files_with_other_columns_are_refused(tmp_path: Path) -> None:
    recorded(tmp_path, [slice(0, 10)])
    pandas.DataFrame({"t": [1.0], "u": [1.0]}).to_parquet(tmp_path / "samples" / "part-00000002.parquet")
    with pytest.raises(LogError, match=r"part-00000002.parquet: other columns than in part-00000001.parquet"):
        rp.read_log(tmp_path, input="u", output="y")


def test_dates_in_a_folder_count_from_its_first_row(tmp_path: Path) -> None:
    stamps = pandas.date_range("2024-01-01", periods=6, freq="s")
    for k in range(2):
        part = pandas.DataFrame({"time": stamps[3 * k : 3 * k + 3], "u": 1.0, "y": 2.0})
        part.to_parquet(tmp_path / f"{k}.parquet")
    log = rp.read_log(tmp_path, input="u", output="y", time="time")
    assert log.dt == 1.0
    assert log.time is not None
    assert log.time.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    (tmp_path / "1.parquet").write_bytes((tmp_path / "0.parquet").read_bytes())
    with pytest.raises(LogError, match=r"1.parquet, row 1, column 'time': the time stamp 0 goes back"):
        rp.read_log(tmp_path, input="u", output="y", time="time")
