"""Excel workbooks, as openpyxl writes them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from replant.errors import LogError
from replant.logs import read_columns, read_log
from support.cases import every

openpyxl = pytest.importorskip("openpyxl")

pytestmark = pytest.mark.usefixtures("read_here")
ROWS = [[k / 10, k % 3, k * 1.5] for k in range(20)]


def save(folder: Path, *sheets: Sequence[Sequence[Any]]) -> Path:
    book = openpyxl.Workbook()
    book.remove(book.active)
    for rows in sheets:
        sheet = book.create_sheet()
        for row in rows:
            sheet.append(row)
    path = folder / "log.xlsx"
    book.save(path)
    return path


@pytest.mark.parametrize(
    "above",
    [
        [],
        [["Motor test"], []],
        [["Operator", "Smith"], ["Gain", 3.5], [None, None], ["Date", datetime(2024, 5, 1)]],
    ],
)
def test_rows_above_the_names_are_skipped(tmp_path: Path, above: list[list[Any]]) -> None:
    log = read_log(save(tmp_path, [*above, ["t", "u", "y"], *ROWS]), input="u", output="y")
    assert (log.dt, log.input_name) == (0.1, "u")
    assert log.output.tolist() == [row[2] for row in ROWS]


def test_the_first_sheet_with_a_table_counts(tmp_path: Path) -> None:
    path = save(tmp_path, [["read me"], ["please"]], [["t", "u", "y"], *ROWS], [["t", "x", "z"], *ROWS])
    assert read_columns(path).names == ("t", "u", "y")


def test_other_sheets_with_a_table_are_named(tmp_path: Path) -> None:
    run = [["t", "u", "y"], *ROWS]
    (note,) = read_columns(save(tmp_path, [["read me"]], run, [["remarks"], ["none"]], run, run)).notes
    assert note.endswith("sheet 'Sheet1' is read, the first with a table; left out: 'Sheet3', 'Sheet4'")
    assert read_columns(save(tmp_path, [["read me"]], run, [["remarks"], ["none"]])).notes == ()


def test_empty_columns_are_skipped_and_a_row_of_units_is_read(tmp_path: Path) -> None:
    rows = [[None, "t", None, "u", "y"], [None, "ms", None, "V", "mm"], *([None, 20 * k, None, k, k] for k in range(9))]
    path = save(tmp_path, [*rows, [], []])
    assert read_columns(path).names == ("t [ms]", "u [V]", "y [mm]")
    log = read_log(path, input="u", output="y")
    assert (log.dt, len(log)) == (0.02, 9)


STAMPS: dict[str, list[Any]] = {
    "dates and times": [datetime(2024, 5, 1, 23, 59, 59) + timedelta(seconds=k / 2) for k in range(9)],
    "days": [date(2024, 2, 27) + timedelta(days=k) for k in range(9)],
    "times": [time(10, 0, k) for k in range(9)],
    "elapsed": [timedelta(hours=23, minutes=59 + k) for k in range(9)],
    "text": [f"2024-05-01T10:00:0{k}" for k in range(9)],
    "both": [datetime(2024, 5, 1, 10, 0, k) if k % 2 else f"2024-05-01T10:00:0{k}" for k in range(9)],
    "before a trigger": [timedelta(seconds=k - 4) for k in range(9)],
}


@every(("kind", "dt"), [*zip(STAMPS, [0.5, 86400.0, 1.0, 60.0, 1.0, 1.0, 1.0], strict=True)])
def test_cells_of_dates_and_times_become_seconds(tmp_path: Path, kind: str, dt: float) -> None:
    stamps = STAMPS[kind]
    path = save(tmp_path, [["when", "u", "y"], *([stamp, k, k] for k, stamp in enumerate(stamps))])
    log = read_log(path, input="u", output="y")
    assert log.dt == dt
    assert log.time is not None
    assert log.time.tolist() == [dt * k for k in range(9)]


def test_a_shift_of_the_clock_is_an_error(tmp_path: Path) -> None:
    begin = datetime(2024, 10, 27, 2, 59, 55)
    stamps = [begin + timedelta(seconds=k - 3600 * (k > 4)) for k in range(9)]
    path = save(tmp_path, [["t", "u", "y"], *([stamp, 1, 2] for stamp in stamps)])
    with pytest.raises(LogError, match="sheet 'Sheet', row 7, column 't': the clock goes back by 3599 s"):
        read_log(path, input="u", output="y")


def test_empty_cells_are_missing(tmp_path: Path) -> None:
    path = save(tmp_path, [["u", "y"], [1, None], [None, 2], ["#N/A", "nan"], [4, True]])
    u, y = read_columns(path).columns(["u", "y"])
    np.testing.assert_array_equal(u, [1.0, np.nan, np.nan, 4.0])
    np.testing.assert_array_equal(y, [np.nan, 2.0, np.nan, 1.0])


BAD = {
    "text": ([["u", "y"], [1, 2], ["1,5", 2]], "sheet 'Sheet', row 3, column 'u': '1,5' is not a number; correct it"),
    "error": ([["u", "y"], [1, 2], ["#DIV/0!", 2]], "sheet 'Sheet', row 3, column 'u': '#DIV/0!' is not a number"),
    "no table": ([["u", "y"], ["a", "b"]], "no sheet has a row of names above columns of numbers"),
    "no names": ([[1, 2], [3, 4]], "no sheet has a row of names above columns of numbers"),
    "no row": ([["u", "y"]], "no sheet has a row of names"),
}


@every(("rows", "message"), BAD.values(), ids=BAD)
def test_a_bad_workbook_is_refused_in_one_line(tmp_path: Path, rows: list[list[Any]], message: str) -> None:
    path = save(tmp_path, rows)
    with pytest.raises(LogError, match=re.escape(message)) as caught:
        read_log(path, input="u", output="y", dt=1.0)
    assert str(caught.value).startswith(f"{path}: ")
