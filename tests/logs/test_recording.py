"""A log of any length: checked as a whole, read in blocks, and never held in memory."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from replant.errors import LogError
from replant.logs import arrow, open_recording, read_log
from replant.logs import csv as csv_logs
from replant.logs import sampling_time as clock
from replant.logs.recording import _cut
from support.cases import every

pytestmark = pytest.mark.usefixtures("read_here")

ROWS = 500
Write = Callable[..., Path]


def signals() -> dict[str, np.ndarray]:
    u, y = np.random.default_rng(0).standard_normal((2, ROWS))
    y[100] = np.nan
    return {"t": np.round(np.arange(ROWS) / 30, 3), "u": u, "y": y}


def as_text(columns: dict[str, np.ndarray], delimiter: str = ",") -> str:
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return "\n".join([delimiter.join(columns), *(delimiter.join(map(repr, row)) for row in rows), ""])


def save(path: Path, columns: dict[str, np.ndarray]) -> Path:
    """Write the columns in the format that the suffix names."""
    if path.suffix == ".csv":
        path.write_text(as_text(columns))
    elif path.suffix == ".txt":
        path.write_text(as_text(columns, "  "))
    elif path.suffix == ".npz":
        np.savez(path, **columns)
    elif path.suffix == ".mat":
        scipy.io.savemat(path, columns)
    else:
        pyarrow = pytest.importorskip("pyarrow", reason="pip install 'replant[parquet]'")
        pytest.importorskip("pyarrow.parquet").write_table(pyarrow.table(columns), path, row_group_size=77)
    return path


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv_logs, "BLOCK_BYTES", 700)
    monkeypatch.setattr(arrow, "BLOCK_ROWS", 60)
    monkeypatch.setattr(clock, "CHECKED", 64)


@pytest.mark.usefixtures("small_blocks")
@every("most_held", [0, ROWS - 1, ROWS], quick=2)
@every("timing", [{}, {"dt": 0.5}], ids=["time stamps", "dt"], quick=1)
@every("suffix", [".csv", ".txt", ".parquet", ".npz", ".mat"], quick=3)
def test_its_batches_are_the_log(tmp_path: Path, suffix: str, timing: dict[str, float], most_held: int) -> None:
    columns = signals()
    path = save(tmp_path / f"log{suffix}", columns)
    log = read_log(path, input="u", output="y", **timing)
    recording = open_recording(path, input="u", output="y", **timing, most_held=most_held)
    assert (recording.samples, recording.dt, recording.stamped) == (ROWS, log.dt, log.time is not None)
    assert (recording.held is None) == (most_held < ROWS)
    for _ in range(2):
        u, y = (np.concatenate(parts) for parts in zip(*recording.batches(), strict=True))
        np.testing.assert_array_equal(u, log.input)
        np.testing.assert_array_equal(y, log.output)
    newest = recording.newest(u[-50:], y[-50:])
    assert (len(newest), newest.dt, newest.input_name, newest.path) == (ROWS, log.dt, "u", path)
    if recording.held is None:
        assert (newest.earlier, newest.input.size) == (ROWS - 50, 50)
        if newest.time is not None:
            np.testing.assert_allclose(newest.time, columns["t"][-50:], atol=1e-3)


@pytest.mark.usefixtures("small_blocks")
@every("most_held", [0, ROWS], quick=1)
@every("row", [1, 63, 64, 65, 300, ROWS - 1], quick=2)
@every(
    ("kind", "message"),
    [("missing", "time stamp is nan"), ("repeats", "repeats the one before")],
)
def test_a_bad_stamp_is_named_wherever_it_is(tmp_path: Path, most_held: int, row: int, kind: str, message: str) -> None:
    columns = signals()
    if kind == "missing":
        columns["t"][row] = np.nan
    else:
        columns["t"][row] = columns["t"][row - 1]
    for suffix, place in ((".csv", f"line {row + 2}"), (".parquet", f"row {row + 1}")):
        path = save(tmp_path / f"log{suffix}", columns)
        with pytest.raises(LogError, match=rf"{place}, column 't': .*{message}"):
            open_recording(path, input="u", output="y", most_held=most_held)


@pytest.mark.usefixtures("small_blocks")
@every("most_held", [0, ROWS], quick=1)
@every("row", [1, 63, 64, 65, 300, ROWS - 1], quick=2)
def test_an_irregular_stamp_is_named_wherever_it_is_and_all_come(tmp_path: Path, most_held: int, row: int) -> None:
    columns = signals()
    regular = save(tmp_path / "regular.csv", columns)
    dt = open_recording(regular, input="u", output="y").dt
    columns["t"][row:] += 0.5
    for suffix, place in ((".csv", f"line {row + 2}"), (".parquet", f"row {row + 1}")):
        recording = open_recording(save(tmp_path / f"log{suffix}", columns), input="u", output="y", most_held=most_held)
        assert recording.irregular
        assert f"{place}, column 't': irregular time stamps" in recording.irregularity
        assert recording.dt == pytest.approx(dt, rel=0.05)  # the stamps of this log are rounded
        u, y, t = (np.concatenate(parts) for parts in zip(*recording.batches(), strict=True))
        for found, name in ((u, "u"), (y, "y"), (t, "t")):
            np.testing.assert_array_equal(found, columns[name])
        newest = recording.newest(u[-50:], y[-50:], t[-50:] - t[0])
        assert newest.stamps is not None
        assert newest.duration == pytest.approx(t[-1] - t[0] + recording.dt)


@pytest.mark.usefixtures("small_blocks")
def test_a_bad_cell_anywhere_is_found_before_the_first_batch(tmp_path: Path) -> None:
    lines = as_text(signals()).split("\n")
    lines[400] = "1,?,2"
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines))
    with pytest.raises(LogError, match=r"line 401, column 'u': '\?' is not a number"):
        open_recording(path, input="u", output="y", dt=0.1, most_held=0)


@pytest.mark.usefixtures("small_blocks")
def test_progress_goes_on_to_the_last_row(tmp_path: Path) -> None:
    path, seen = save(tmp_path / "log.csv", signals()), []
    open_recording(path, input="u", output="y", most_held=0, progress=lambda rows, about: seen.append((rows, about)))
    assert seen[-1][0] == ROWS
    assert all(before < after for (before, _), (after, _) in pairwise(seen))
    assert abs(seen[0][1] - ROWS) < 0.1 * ROWS


@pytest.mark.usefixtures("small_blocks")
def test_a_folder_of_parquet_parts_is_one_log(tmp_path: Path) -> None:
    columns, folder = signals(), tmp_path / "parts"
    folder.mkdir()
    for number, begin in enumerate(range(0, ROWS, 180)):
        part = {name: column[begin : begin + 180] for name, column in columns.items()}
        save(folder / f"part-{number:03}.parquet", part)
    for unfinished in ("part-004.parquet.part", ".part-004.parquet", "_part-004.parquet"):
        (folder / unfinished).write_bytes(b"not yet")
    whole = read_log(save(tmp_path / "log.parquet", columns), input="u", output="y")
    for most_held in (0, ROWS):
        if most_held:  # what records live samples calls their folder so
            folder.rename(tmp_path / "samples")
            folder = tmp_path
        recording = open_recording(folder, input="u", output="y", most_held=most_held)
        assert recording.dt == whole.dt
        u, y = (np.concatenate(parts) for parts in zip(*recording.batches(), strict=True))
        np.testing.assert_array_equal(u, whole.input)
        np.testing.assert_array_equal(y, whole.output)
    save(folder / "samples" / "part-001.parquet", {"t": columns["t"][180:360], "x": columns["u"][180:360]})
    with pytest.raises(LogError, match=r"part-001\.parquet: other columns than in part-000\.parquet"):
        open_recording(folder, input="u", output="y")


def test_a_bad_stamp_in_a_folder_is_named_by_its_part(tmp_path: Path) -> None:
    columns = signals()
    columns["t"][200] = columns["t"][199]
    for number, begin in enumerate(range(0, ROWS, 180)):
        save(tmp_path / f"{number}.parquet", {name: column[begin : begin + 180] for name, column in columns.items()})
    with pytest.raises(LogError, match=r"1\.parquet, row 21, column 't': .* repeats"):
        open_recording(tmp_path, input="u", output="y")


def test_dates_of_parts_count_from_the_first_of_all(tmp_path: Path) -> None:
    pyarrow = pytest.importorskip("pyarrow", reason="pip install 'replant[parquet]'")
    stamps = np.datetime64("2024-05-01T12:00:00.000") + np.arange(20) * np.timedelta64(20, "ms")
    for number in range(2):
        part = slice(10 * number, 10 * number + 10)
        columns = {"when": pyarrow.array(stamps[part]), "u": np.ones(10), "y": np.ones(10)}
        save(tmp_path / f"{number}.parquet", columns)
    log = read_log(tmp_path, input="u", output="y", time="when")
    np.testing.assert_allclose(log.time, 0.02 * np.arange(20), atol=1e-12)


def test_no_space_for_a_long_log_is_an_error_with_a_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = save(tmp_path / "log.csv", signals())
    monkeypatch.setenv("TMPDIR", str(tmp_path / "none"))
    with pytest.raises(
        LogError, match=r"temporary file in .*none, which cannot be written \(No such file or directory\); free some"
    ):
        open_recording(path, input="u", output="y", most_held=0)
    if Path("/dev/full").exists():
        with Path("/dev/full").open("rb+", buffering=0) as full:
            monkeypatch.setattr(tempfile, "TemporaryFile", lambda **_: full)
            with pytest.raises(
                LogError, match=r"log\.csv: a long log needs a temporary file in .*\(No space left on device\)"
            ):
                open_recording(path, input="u", output="y", most_held=0)


def test_a_part_that_begins_and_ends_between_two_blocks_has_no_empty_one() -> None:
    blocks = [[np.arange(3.0 * k, 3.0 * k + 3.0)] for k in range(4)]
    assert [part[0].tolist() for part in _cut(lambda _: iter(blocks), [0], 3, 9)] == [[3.0, 4.0, 5.0], [6.0, 7.0, 8.0]]
