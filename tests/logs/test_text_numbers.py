"""Decimal commas, thousands separators, and marks that may be either."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from replant.errors import LogError
from replant.logs import csv as csv_module
from replant.logs import read_columns
from support.cases import every

Write = Callable[..., Path]

READ = {
    "points in groups": (["3.000,00", "-1.234.567,5", "0,5", "12", "1.234"], [3000.0, -1234567.5, 0.5, 12.0, 1234.0]),
    "commas in groups": (["3,000.00", "-1,234,567.5", "0.5", "12", "1,234"], [3000.0, -1234567.5, 0.5, 12.0, 1234.0]),
    "groups alone": (["1.234.567", "1.234.568", "1.234"], [1234567.0, 1234568.0, 1234.0]),
    "exponents": (["1.000,5e3", "2,5E-3"], [1000500.0, 2.5e-3]),
    "exponents of Fortran": (["0.15D+01", "-2.5d0", "3.D-1", "1."], [1.5, -2.5, 0.3, 1.0]),
    "minus signs of Unicode": (["−0,5", "−1.234,5", "2,5"], [-0.5, -1234.5, 2.5]),
    "three decimals": (["1.234", "2.345", "3.456"], [1.234, 2.345, 3.456]),
    "three decimals after a comma": (["1,234", "2,345", "3,456"], [1.234, 2.345, 3.456]),
}


@every(("cells", "values"), READ.values(), ids=READ)
@every("size", [10, 1 << 20])
@every("order", [1, -1])
def test_thousands_are_read(
    write: Write, monkeypatch: pytest.MonkeyPatch, cells: list[str], values: list[float], size: int, order: int
) -> None:
    """In any order, and with any size of blocks."""
    monkeypatch.setattr(csv_module, "BLOCK_BYTES", size)
    path = write("t;u\n" + "".join(f"{k};{cell}\n" for k, cell in enumerate(cells[::order])))
    assert read_columns(path).column("u").tolist() == values[::order]


@every("head", ["t;true;y\n", ""])
@every("mark", [".", ","])
def test_true_and_false_are_one_and_zero(write: Write, head: str, mark: str) -> None:
    """Also where a column is called so."""
    table = read_columns(write(f"{head}0{mark}5;TRUE;1\n1{mark}5;false;2\n2{mark}5; True ;FALSE\n3{mark}5;;3\n"))
    assert table.names == tuple(head.strip().split(";") if head else "012")
    np.testing.assert_array_equal(table.column(1), [1.0, 0.0, 1.0, np.nan])
    assert table.column(2).tolist() == [1.0, 2.0, 0.0, 3.0]


def rows_of(*columns: list[str]) -> str:
    return "t;u;y\n" + "".join(f"{';'.join(row)}\n" for row in zip(*columns, strict=True))


COUNT = [f"{k}" for k in range(300)]
U, Y = [100 + 1600 * (k // 120 % 2) for k in range(300)], [40_000 + 37 * k for k in range(300)]


OF_COLUMNS = {
    "quoted thousands between commas": ('t,u\n0,"1,234.5"\n1,0.5\n', {"u": [1234.5, 0.5]}),
    "quoted decimal commas between commas": ('"t","u"\n"0,0","1,5"\n"0,5","2,25"\n', {"u": [1.5, 2.25]}),
    # such as a time that a program wrote, beside values that follow the locale
    "a mark of its own": ("t;u;y\n0.1;1,5;2,5\n0.2;2,5;3,5\n", {"t": [0.1, 0.2], "u": [1.5, 2.5]}),
    # two thirds of the cells are then numbers at a semicolon alone
    "thousands beside a clock": (
        "time;valve;flow\n" + "".join(f"10:00:{k:02};{k % 2};1.2{k:02},50\n" for k in range(60)),
        {"time": [*range(60)], "valve": [k % 2 for k in range(60)], "flow": [1200.5 + k for k in range(60)]},
    ),
    "two marks, one of which separates thousands": (
        rows_of(COUNT, [f"{u:,}".replace(",", ".") for u in U], [f"{y / 1000:.3f}".replace(".", ",") for y in Y]),
        {"u": U, "y": [y / 1000 for y in Y]},
    ),
    "a mark that first shows far below": (
        "t;u;y\n" + "".join(f"{k};{k};7\n" for k in range(500)) + "500;1.234,5;7\n501;0,25;7\n",
        {"u": [*range(500), 1234.5, 0.25]},
    ),
}


@every(("text", "columns"), OF_COLUMNS.values(), ids=OF_COLUMNS)
@every("size", [100, 1 << 20])
def test_the_marks_of_a_column_are_found(
    write: Write, monkeypatch: pytest.MonkeyPatch, text: str, columns: dict[str, list[float]], size: int
) -> None:
    monkeypatch.setattr(csv_module, "BLOCK_BYTES", size)
    table = read_columns(write(text))
    for name, values in columns.items():
        assert table.column(name).tolist() == values


WORDS = {"WAHR": 1.0, "falsch": 0.0, "-1.#IND": np.nan, "1.#QNAN": np.nan, "#NV": np.nan}


@every("mark", [".", ","])
def test_words_of_other_programs_are_numbers_or_missing(write: Write, mark: str) -> None:
    path = write("t;u\n" + "".join(f"{k}{mark}5;{word}\n" for k, word in enumerate(WORDS)))
    np.testing.assert_array_equal(read_columns(path).column("u"), [*WORDS.values()])


@every("size", [100, 1 << 20])
@every(("mark", "word"), [(".", "decimal point"), (",", "comma")])
def test_a_mark_before_three_digits_beside_whole_numbers_is_ambiguous(
    write: Write, monkeypatch: pytest.MonkeyPatch, size: int, mark: str, word: str
) -> None:
    """1.700 beside 100, below the rows that show the layout, had been 1.7: the gain had the wrong sign."""
    monkeypatch.setattr(csv_module, "BLOCK_BYTES", size)
    table = read_columns(write(rows_of(COUNT, [f"{u:,}".replace(",", mark) for u in U], [f"{y}" for y in Y])))
    assert table.column("y").tolist() == Y
    with pytest.raises(LogError, match=f"column 'u' has '1{mark}700' in line 122 beside whole numbers: its {word} may"):
        table.column("u")


@every("u", ["{:.3f}", "{:.0f}", "{:.1f}"])
def test_numbers_that_a_program_prints_alike_are_no_thousands(write: Write, u: str) -> None:
    """Three decimals in all rows, whole numbers, or a whole number of four digits, which no separator splits."""
    for further in ("0.5", "1000", "1.000"):
        cells = [u.format(k / 4 + 1) for k in range(299)] + [further if u != "{:.0f}" else "1000"]
        table = read_columns(write(rows_of(COUNT, cells, [f"{y / 1000:.3f}" for y in Y])))
        assert table.column("u").tolist() == [float(cell) for cell in cells]


def test_a_number_with_its_unit_is_named(write: Write) -> None:
    rows = "".join(f"{k} s,{k}.5 %,7\n" for k in range(9))
    with pytest.raises(LogError, match="line 2, column 't': '0 s' is not a number"):
        read_columns(write("t,u,y\n" + rows)).column("t")


AMBIGUOUS = {
    "in one column": (
        "t;u\n0;0,5\n1;1.234\n",
        "column 'u' has a decimal point in line 3 ('1.234') and the log a comma",
    ),
    "in another": ("t;u\n0,5;3.000\n1,5;4.000\n", "column 'u' has a decimal point in line 2 ('3.000') and the log a"),
    "decimals": ("t;u\n0;0,5\n1;0.25\n", "column 'u' has a decimal point in line 3 ('0.25') and the log a comma in"),
    "comma": ("t;u\n0;0.5\n1;1,234\n", "column 'u' has a comma in line 3 ('1,234') and the log a decimal point"),
}


@every(("text", "message"), AMBIGUOUS.values(), ids=AMBIGUOUS)
@every("size", [1, 1 << 20])
def test_an_ambiguous_decimal_mark_is_refused(
    write: Write, monkeypatch: pytest.MonkeyPatch, text: str, message: str, size: int
) -> None:
    monkeypatch.setattr(csv_module, "BLOCK_BYTES", size)
    with pytest.raises(LogError, match=re.escape(message)) as caught:
        read_columns(write(text)).column("u")
    assert str(caught.value).endswith("write all numbers one way, without thousands separators")
