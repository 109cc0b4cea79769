"""Dates and clock times in text logs: exact seconds, and clocks that jump."""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from replant.errors import LogError
from replant.logs import csv as csv_module
from replant.logs import read_columns, read_log, stamped_interval
from replant.logs.read import open_recording
from replant.logs.text_times import find_format, parse_stamp
from support.cases import every

Write = Callable[..., Path]

FORMS = {
    "ISO": "2024-05-01T23:59:{:06.3f}",
    "ISO, blank": "2024-05-01 23:59:{:06.3f}",
    "ISO, UTC": "2024-05-01T23:59:{:06.3f}Z",
    "ISO, offset": "2024-05-01T23:59:{:06.3f}+05:30",
    "ISO, short offset": "2024-05-01 23:59:{:06.3f}-08",
    "basic": "20240501T23:59:{:06.3f}",
    "year, slashes": "2024/05/01 23:59:{:06.3f}",
    "points": "01.05.2024 23:59:{:06.3f}",
    "points, no zeros": "1.5.2024 23:59:{:06.3f}",
    "slashes": "05/01/2024 23:59:{:06.3f}",
    "slashes, comma": "05/01/2024, 11:59:{:06.3f} PM",
    "dashes": "13-05-2024 23:59:{:06.3f}",
    "MATLAB": "01-May-2024 23:59:{:06.3f}",
    "digits": "202405012359{:06.3f}",
    "digits in two parts": "20240501 2359{:06.3f}",
    "stopwatch": "59:{:06.3f}",
    "historian": "01-May-24 23:59:{:06.3f}",
    "points, two digits": "01.05.24 23:59:{:06.3f}",
    "clock": "23:59:{:06.3f}",
    "elapsed": "123:59:{:06.3f}",
}


@every("form", FORMS.values(), ids=FORMS)
@every("mark", [".", ","])
def test_stamps_become_exact_seconds(write: Write, form: str, mark: str) -> None:
    cells = [form.format(0.001 * k) for k in range(1, 40)]
    rows = [f"{cell[:-4] + cell[-4:].replace('.', mark)};1;2" for cell in cells]
    log = read_log(write("time;u;y\n" + "\n".join(rows) + "\n"), input="u", output="y")
    assert log.dt == 0.001
    assert log.time is not None
    assert log.time.tolist() == [k / 1000 for k in range(39)]  # the closest float64 of each


@every("clock", ["%H%M%S", "%H:%M:%S:000"], ids=["digits", "colon"])
def test_a_clock_of_digits_beside_a_date_of_digits_goes_on_over_midnight(write: Write, clock: str) -> None:
    stamps = [datetime(2024, 5, 1, 23, 58) + timedelta(seconds=k) for k in range(400)]
    path = write("day;time;u;y\n" + "".join(f"{stamp:%Y%m%d;{clock}};1;2\n" for stamp in stamps))
    assert read_columns(path).column("time").tolist() == list(range(400))


@every("size", [1, 40, 1 << 20])
def test_a_clock_without_a_date_goes_on_over_midnight(write: Write, monkeypatch: pytest.MonkeyPatch, size: int) -> None:
    monkeypatch.setattr(csv_module, "BLOCK_BYTES", size)
    stamps = [datetime(2024, 2, 28, 23, 50) + timedelta(minutes=k) for k in range(3000)]  # over two of them
    path = write("time,u,y\n" + "".join(f"{stamp:%H:%M:%S},1,2\n" for stamp in stamps))
    log = read_log(path, input="u", output="y")
    assert log.time is not None
    np.testing.assert_array_equal(log.time, 60.0 * np.arange(3000))


@every(
    ("name", "dt", "is_doubtful"),
    [
        ("time [mm:ss]", 1.0, False),
        ("elapsed (m:ss)", 1.0, False),
        ("time", 60.0, True),
        ("time [hh:mm:ss]", 60.0, True),
        ("time [hh:mm]", 60.0, False),
    ],
)
def test_two_numbers_are_hours_and_minutes_unless_the_name_says_otherwise(
    write: Write, name: str, dt: float, is_doubtful: bool
) -> None:
    path = write(f"{name},u,y\n" + "".join(f"{k // 60:02}:{k % 60:02},1,2\n" for k in range(150)))
    recording = open_recording(path, input="u", output="y")
    assert recording.dt == dt
    assert ("minutes and seconds; if they are, name the column" in recording.doubt) == is_doubtful


WRAPPED = [f"{k // 60 % 60}:{k % 60:02}" for k in range(7300)]
OVER_THE_HOUR = {
    "begun anew": ("time [mm:ss]", WRAPPED),
    "counted on": ("time [mm:ss]", [f"{k // 60}:{k % 60:02}" for k in range(7300)]),
    "with hours": ("time [mm:ss]", [cell if k < 3600 else f"{k // 3600}:{cell:>05}" for k, cell in enumerate(WRAPPED)]),
    "a fraction": ("time [mm:ss]", [f"{cell}.5" for cell in WRAPPED]),
    "a fraction tells the unit": ("time", [f"{cell}.5" for cell in WRAPPED]),
}


@every(("name", "cells"), OVER_THE_HOUR.values(), ids=OVER_THE_HOUR)
def test_minutes_and_seconds_go_on_over_the_hour(write: Write, name: str, cells: list[str]) -> None:
    path = write(f"{name},u,y\n" + "".join(f"{cell},1,2\n" for cell in cells))
    assert read_columns(path).column(0).tolist() == list(range(7300))


TWO_DAYS = "01.05.2024;23:59:58;1;2\n01.05.2024;23:59:59;1;2\n02.05.2024;00:00:00;1;2\n"
CLOCKS = {
    "over midnight, months and leap days": (
        "when,u,y\n"
        + "".join(f"{datetime(2024, 2, 28, 23) + timedelta(minutes=10 * k):%d.%m.%Y %H:%M},1,2\n" for k in range(400)),
        600.0,
        400,
    ),
    "offsets at the end of daylight saving time": (
        "time,u,y\n2024-10-27T02:59:59+02:00,1,2\n2024-10-27T02:00:00+01:00,1,2\n2024-10-27T02:00:01+01:00,1,2\n",
        1.0,
        3,
    ),
    "date and clock time in two columns": (f"Date;Time;u;y\n{TWO_DAYS}", 1.0, 3),
    "the same in German": (f"Datum;Uhrzeit;u;y\n{TWO_DAYS}", 1.0, 3),
    "the limits of the query in each row, as InfluxDB writes them": (
        "_start,_stop,_time,u,y\n"
        + "".join(f"2024-05-01T00:00:00Z,2024-05-02T00:00:00Z,2024-05-01T10:00:{k:02}Z,1,2\n" for k in range(60)),
        1.0,
        60,
    ),
}


@every(("text", "dt", "rows"), CLOCKS.values(), ids=CLOCKS)
def test_dates_are_one_clock_however_they_are_written(write: Write, text: str, dt: float, rows: int) -> None:
    log = read_log(write(text), input="u", output="y")
    assert log.dt == dt
    assert log.time is not None
    assert log.time.tolist() == [dt * k for k in range(rows)]


@given(
    st.datetimes(datetime(1900, 1, 1), datetime(2200, 1, 1)),
    st.integers(-23 * 60, 23 * 60),
)
def test_any_instant_is_read_as_python_reads_it(instant: datetime, minutes: int) -> None:
    aware = instant.replace(tzinfo=timezone(timedelta(minutes=minutes)))
    epoch = datetime(1970, 1, 1, tzinfo=UTC)
    assert parse_stamp(aware.isoformat(), False).nanoseconds == (aware - epoch) // timedelta(microseconds=1) * 1000


@pytest.mark.parametrize(("written", "year"), [("68", 2068), ("69", 1969), ("99", 1999), ("00", 2000)])
def test_a_year_of_two_digits_lies_within_1969_and_2068(written: str, year: int) -> None:
    found = parse_stamp(f"29-Jan-{written} 01:00", False)
    assert found.nanoseconds == (datetime(year, 1, 29, 1) - datetime(1970, 1, 1)) // timedelta(microseconds=1) * 1000


@pytest.mark.parametrize("cell", ["10.05.07", "10/05/07 10:00", "10-05-07 10:00"])
def test_two_digits_that_may_be_anything_else_are_no_year(cell: str) -> None:
    with pytest.raises(ValueError, match="10"):
        parse_stamp(cell, False)


def test_nanoseconds_stay_exact() -> None:
    cells = ["2024-05-01T10:00:00.000000001Z", "2024-05-01T10:00:00.000000004Z"]
    found = find_format(cells)
    assert found is not None
    assert found.seconds(cells).tolist() == [0.0, 3e-9]


def test_stamps_are_read_in_a_file_without_names(write: Write) -> None:
    path = write("2024-05-01T10:00:00,1,2\n2024-05-01T10:00:02,1,2\n")
    assert read_log(path, input=1, output=2).dt == 2.0
    assert stamped_interval(read_columns(path)) == ("0", 2.0)


def test_a_missing_stamp_is_nan(write: Write) -> None:
    table = read_columns(write("time,u\n2024-05-01T10:00:00,1\n,2\n2024-05-01T10:00:02,3\n"))
    np.testing.assert_array_equal(table.column("time"), [0.0, np.nan, 2.0])
    assert table.in_seconds == {0}


@pytest.mark.parametrize("size", [1, 40, 1009])
def test_blocks_count_from_the_same_stamp(write: Write, monkeypatch: pytest.MonkeyPatch, size: int) -> None:
    monkeypatch.setattr(csv_module, "BLOCK_BYTES", size)
    rows = [f"2024-05-01T10:{k // 60:02}:{k % 60:02},{k}" for k in range(300)]
    path = write("time,u\n" + "\n".join(rows) + "\n")
    np.testing.assert_array_equal(read_columns(path).column("time"), np.arange(300.0))


def test_a_column_of_dates_is_no_input(write: Write) -> None:
    path = write("start,u,y\n2024-05-01T10:00:00,1,2\n2024-05-01T10:00:02,1,2\n")
    with pytest.raises(
        LogError, match="column 'start' holds dates or times, not samples; choose another column as the"
    ):
        read_log(path, input="start", output="y", dt=1.0)


REFUSED = {
    "end of daylight saving time": (
        ["2024-10-27 02:59:{:02}", "2024-10-27 02:00:{:02}"],
        "line 62, column 'time': the clock goes back by 3599 s, as at the end of daylight saving time; write",
    ),
    "beginning of daylight saving time": (
        ["2024-03-31 01:59:{:02}", "2024-03-31 03:00:{:02}"],
        "line 62, column 'time': the clock goes on by 3601 s, as at the beginning of daylight saving time",
    ),
    "clock without date set back": (
        ["23:59:{:02}", "00:05:{:02}"],
        "line 62, column 'time': the time stamp -86040 goes back from the one before (59)",
    ),
    "clock set back": (
        ["2024-05-01 10:05:{:02}", "2024-05-01 10:00:{:02}"],
        "line 62, column 'time': the time stamp -300 goes back from the one before (59)",
    ),
    "day or month first": (
        ["03/04/2024 23:59:{:02}", "04/04/2024 00:00:{:02}"],
        "line 62, column 'time': '04/04/2024 00:00:00': day and month may be in either order; write dates as",
    ),
    "zone lost": (
        ["2024-05-01 10:05:{:02}Z", "2024-05-01 10:06:{:02}"],
        "line 62, column 'time': '2024-05-01 10:06:00' has not the form of the first time stamp",
    ),
    "no such day": (
        ["2024-02-29 23:59:{:02}", "2024-02-30 00:00:{:02}"],
        "line 62, column 'time': '2024-02-30 00:00:00' is no date or clock time; 2024-05-01T10:00:00.5, with Z",
    ),
}


@every(("forms", "message"), REFUSED.values(), ids=REFUSED)
@every("size", [100, 1 << 20])
@every("sampled", [50, 100])
def test_a_clock_that_jumps_is_an_error(
    write: Write, monkeypatch: pytest.MonkeyPatch, forms: list[str], message: str, size: int, sampled: int
) -> None:
    monkeypatch.setattr(csv_module, "BLOCK_BYTES", size)
    # the second form comes after the rows that the layout is told from, or within them
    rows = [f"{form.format(s)},{s % 7},2\n" for form in forms for s in range(60)]
    path = write("time,u,y\n" + "".join(rows))
    monkeypatch.setattr("replant.logs.text_layout._SAMPLE_ROWS", sampled)
    with pytest.raises(LogError, match=re.escape(message)) as caught:
        read_log(path, input="u", output="y")
    assert "\n" not in str(caught.value)
    assert len(read_log(path, input="u", output="y", dt=1.0)) == 120


@every(
    "cell",
    ["12.5", "1.2.3", "10:5", "10:60:00", "10:00:60", "2024-13-01", "24-05-01", "10:00:00+01:00", "13:00 PM", "", "x"],
)
def test_cells_that_are_not_stamps_have_no_format(cell: str) -> None:
    assert find_format([cell]) is None
