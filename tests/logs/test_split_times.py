"""Time stamps in two columns: whole seconds, and the rest of a second in a finer unit."""

from pathlib import Path

import numpy as np
import pytest

from replant.errors import LogError
from replant.fitting.log_inspection import inspect, options_of
from replant.logs import open_recording, read_log
from replant.logs.file_formats import read_columns
from replant.logs.recording import joined
from replant.report.log_as_text import looks_like

SECOND = 1_700_000_000
NAMES = [
    ("header.stamp.secs", "header.stamp.nsecs", 1_000_000_000),
    ("stamp.sec", "stamp.nanosec", 1_000_000_000),
    ("header_stamp_sec", "header_stamp_nanosec", 1_000_000_000),
    ("time_secs", "time_nsecs", 1_000_000_000),
    ("sec", "nsec", 1_000_000_000),
    ("tv_sec", "tv_usec", 1_000_000),
]


def _ticks(count: int = 300) -> list[int]:
    """Return stamps of an irregular clock, in ns since 1970."""
    steps = np.random.default_rng(5).integers(15_000_000, 25_000_000, count) // 1000 * 1000
    return [SECOND * 10**9 + 654_321_000 + int(step) for step in np.cumsum(steps)]


def _write(path: Path, names: tuple[str, str], per_second: int, ticks: list[int]) -> Path:
    rows = [f"{tick // 10**9},{tick % 10**9 * per_second // 10**9}" for tick in ticks]
    u = np.repeat(np.random.default_rng(6).normal(size=len(ticks)), 7)[: len(ticks)]
    y = np.convolve(u, 0.1 * 0.9 ** np.arange(60))[: len(ticks)]
    cells = [f"{row},{a:.6f},{b:.6f}" for row, a, b in zip(rows, u, y, strict=True)]
    path.write_text("\n".join([f"{','.join(names)},cmd,vel", *cells]) + "\n")
    return path


@pytest.mark.parametrize(("seconds", "rest", "per_second"), NAMES)
def test_seconds_and_their_rest_are_one_clock_to_the_nanosecond_and_are_called_so(
    tmp_path: Path, seconds: str, rest: str, per_second: int
) -> None:
    ticks = _ticks()
    file = _write(tmp_path / "log.csv", (seconds, rest), per_second, ticks)
    log = read_log(file, input="cmd", output="vel")
    assert log.time is not None
    exact = [(tick - SECOND * 10**9) / 1e9 for tick in ticks]
    np.testing.assert_allclose(log.time, exact, rtol=0.0, atol=1e-12)  # the spacing of float64 at 1.7e9 s is 2.4e-7 s
    found = inspect(file)
    assert found.clock is not None
    assert found.clock.column is not None
    assert found.clock.column.name == seconds
    assert not found.clock.problem
    assert options_of(found) == ("-i", "cmd", "-o", "vel", "-p", "2")
    roles = {column.name: (column.kind.value, looks_like(column, found)) for column in found.contents.columns}
    assert roles[seconds] == ("real", "time")
    assert roles[rest] == ("part", "part of a time")


def test_a_table_in_memory_has_the_same_clock(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    file = _write(tmp_path / "log.csv", ("stamp.sec", "stamp.nanosec"), 10**9, _ticks())
    log = read_log(pandas.read_csv(file), input="cmd", output="vel")
    assert log.time is not None
    np.testing.assert_array_equal(log.time, read_log(file, input="cmd", output="vel").time)
    assert "stamp.nanosec" not in log.others


def test_a_part_begins_at_its_time_and_joined_files_go_on(tmp_path: Path) -> None:
    ticks, names = _ticks(), ("stamp.sec", "stamp.nanosec")
    whole = read_log(_write(tmp_path / "log.csv", names, 10**9, ticks), input="cmd", output="vel").time
    part = read_log(tmp_path / "log.csv", input="cmd", output="vel", begin=1.0, end=2.0).time
    assert whole is not None
    assert part is not None
    np.testing.assert_array_equal(part, whole[(whole >= whole[0] + 1.0) & (whole < whole[0] + 2.0)])
    halves = [_write(tmp_path / f"{k}.csv", names, 10**9, ticks[k * 150 : k * 150 + 150]) for k in range(2)]
    table = joined([read_columns(half) for half in halves])
    again = open_recording(table, input="cmd", output="vel").held
    assert again is not None
    assert again.time is not None
    np.testing.assert_allclose(again.time, whole, rtol=0.0, atol=1e-12)


def test_the_rest_alone_is_no_clock(tmp_path: Path) -> None:
    file = _write(tmp_path / "log.csv", ("stamp.sec", "stamp.nanosec"), 10**9, _ticks())
    with pytest.raises(LogError, match=r"'stamp.nanosec' is the rest of the seconds in column 'stamp.sec'"):
        read_log(file, input="cmd", output="vel", time="stamp.nanosec")
    lines = [line.partition(",")[2] for line in file.read_text().splitlines()]
    alone = tmp_path / "alone.csv"
    alone.write_text("\n".join(lines) + "\n")
    found = inspect(alone)
    assert found.clock is None  # its stamps go back every second


def test_two_whole_clocks_in_different_units_stay_two_columns(tmp_path: Path) -> None:
    t = 0.02 * np.arange(300)
    rows = [f"{a:.2f},{1000 * a:.0f},{a % 1:.3f},{a:.3f}" for a in t]
    file = tmp_path / "log.csv"
    file.write_text("\n".join(["x_s,x_ms,u,y", *rows]) + "\n")
    table = read_columns(file)
    np.testing.assert_allclose(table.column("x_s"), t)
    np.testing.assert_allclose(table.column("x_ms"), 1000 * t)
    assert not table.parts


@pytest.mark.parametrize("rows", [150, 2000])  # the seconds begin anew within the rows that are looked at first
def test_seconds_of_a_minute_are_no_clock_and_this_is_said(tmp_path: Path, rows: int) -> None:
    ticks = [10**9 * 37 + 25_000_000 * rows + 200_000_000 * k for k in range(rows)]
    file = _write(tmp_path / "log.csv", ("sec", "nanosec"), 10**9, [tick % (60 * 10**9) for tick in ticks])
    with pytest.raises(LogError, match=r"line \d+, column 'sec': .* goes back from .* anew after one minute: .*\(dt"):
        read_log(file, input="cmd", output="vel")
    assert read_log(file, input="cmd", output="vel", dt=0.2).dt == 0.2
    found = inspect(file)
    assert found.clock is not None
    assert (found.clock.dt, "anew after one minute" in found.clock.problem) == (0.2, True)


def test_two_columns_that_stand_still_are_no_clock(tmp_path: Path) -> None:
    file = _write(tmp_path / "log.csv", ("sec", "nanosec"), 10**9, [5 * 10**9] * 50)
    assert not read_columns(file).in_seconds
