"""Text logs: detection of the layout, and errors of bad files."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from replant.errors import LogError
from replant.logs import csv as csv_module
from replant.logs import read_columns, read_log
from replant.logs import text_layout as layout_module
from replant.logs.text_layout import sniff
from support.cases import every

Write = Callable[..., Path]

WELL_FORMED = {
    "comma": "t,u,y\n0,1.5,2\n1,-2.5e-3,4\n",
    "semicolon": "t;u;y\n0;1.5;2\n1;-2.5e-3;4\n",
    "tab": "t\tu\ty\n0\t1.5\t2\n1\t-2.5e-3\t4\n",
    "bar": "t | u | y\n0 | 1.5 | 2\n1 | -2.5e-3 | 4\n",
    "blanks": "  t   u  y\n  0   1.5  2\n  1  -2.5e-3  4  \n",
    "decimal comma": "t;u;y\n0;1,5;2,0\n1;-2,5e-3;4,0\n",
    "decimal comma, blanks": "t u y\n0 1,5 2,0\n1 -2,5e-3 4,0\n",
    "decimal comma, tab": "t\tu\ty\n0\t1,5\t2\n1\t-2,5E-3\t4\n",
    "CRLF": "t,u,y\r\n0,1.5,2\r\n1,-2.5e-3,4\r\n",
    "byte order mark": "\ufefft,u,y\n0,1.5,2\n1,-2.5e-3,4\n",
    "no newline at the end": "t,u,y\n0,1.5,2\n1,-2.5e-3,4",
    "blank lines": "\n\nt,u,y\n\n0,1.5,2\n   \n1,-2.5e-3,4\n\n",
    "comments": "# rig 7\n% 3 May\nt,u,y\n0,1.5,2\n# pause, 2, 3\n1,-2.5e-3,4\n",
    "header in a comment": "# rig 7\n# t,u,y\n0,1.5,2\n1,-2.5e-3,4\n",
    "delimiter at the end": "t,u,y,\n0,1.5,2,\n1,-2.5e-3,4,\n",
    "delimiter at the end of data": "t,u,y\n0,1.5,2,\n1,-2.5e-3,4,\n",
    "delimiter at the end of the header": "t,u,y,\n0,1.5,2\n1,-2.5e-3,4\n",
    "hint for Excel": "sep=;\nt;u;y\n0;1,5;2\n1;-2,5e-3;4\n",
    "quoted names": '"t","u","y"\n0,1.5,2\n1,-2.5e-3,4\n',
    "quoted cells": 't,u,y\n"0","1.5","2"\n"1","-2.5e-3","4"\n',
    "quoted, decimal comma": '"t";"u";"y"\n"0";"1,5";"2"\n"1";"-2,5e-3";"4"\n',
    "blanks around cells": "t , u , y\n 0 , 1.5 , 2 \n 1 , -2.5e-3 , 4 \n",
}


@every("text", WELL_FORMED.values(), ids=WELL_FORMED.keys())
def test_layout_does_not_change_the_samples(write: Write, text: str) -> None:
    table = read_columns(write(text))
    assert table.names == ("t", "u", "y")
    t, u, y = table.columns(["t", "u", "y"])
    assert t.dtype == u.dtype == y.dtype == np.float64
    assert t.tolist() == [0.0, 1.0]
    assert u.tolist() == [1.5, -2.5e-3]
    assert y.tolist() == [2.0, 4.0]


@every("name", ["log.csv", "log.txt", "log.tsv", "log.dat", "log.lvm", "LOG.CSV"])
def test_every_suffix_of_text_is_read(write: Write, name: str) -> None:
    assert read_columns(write("u,y\n1,2\n3,4\n", name)).column("y").tolist() == [2.0, 4.0]


@every("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_every_encoding_is_recognized(write: Write, encoding: str) -> None:
    table = read_columns(write("time [s];T [°C]\n0;20,5\n1;21,5\n".encode(encoding)))
    assert table.names == ("time [s]", "T [°C]")
    assert table.column("t [°c]").tolist() == [20.5, 21.5]


NAN = np.nan
TABBED = {0: [0.0, 1.0, 2.0], 1: [1.0, NAN, 5.0], 2: [2.0, 4.0, 6.0]}
COLUMNS: dict[str, tuple[str, tuple[str, ...], dict[str | int, list[float]]]] = {
    "units, quoted delimiter": ('time [s],"force, raw [N]"\n0,1\n1,2\n', ("time [s]", "force, raw [N]"), {}),
    "units, blanks": ("time [s]  u (V) y\n0 1 2\n1 2 3\n", ("time [s]", "u (V)", "y"), {}),
    "no header": ("0.0,1.5,2\n0.1,2.5,4\n", ("0", "1", "2"), {1: [1.5, 2.5], "1": [1.5, 2.5]}),
    "no header, text": ("0.0,RUN,1.5\n0.1,RUN,2.5\n", ("0", "1", "2"), {2: [1.5, 2.5]}),
    "a name comes before a number": ("t,2,1\n0.0,1.5,2\n0.1,2.5,4\n", ("t", "2", "1"),
                                     {"2": [1.5, 2.5], 2: [2.0, 4.0]}),
    "quoted": ('t,"the ""raw"" u",5" pipe\n0,"1","2" \n1, "2",""\n', ("t", 'the "raw" u', '5" pipe'),
               {1: [1.0, 2.0], 2: [2.0, NAN]}),
    "text beside": ("date;u;state\n01.02.2024 10:00;1,5;RUN\n01.02.2024 10:01;2,5;STOP\n", ("date", "u", "state"),
                    {"u": [1.5, 2.5]}),
    "missing and infinite": ("t,u,y\n0,,1\n1,nan,inf\n2,NA,-inf\n3,NaN,Infinity\n4,n/a,1e400\n5,7,\n", ("t", "u", "y"),
                             {"u": [NAN] * 5 + [7.0], "y": [1.0, np.inf, -np.inf, np.inf, np.inf, NAN]}),
    "lines of tabs": ("t\tu\ty\n0\t1\t2\n\t\t\n1\t\t4\n2\t5\t6\n\t\t\n \t\t ", ("t", "u", "y"), TABBED),
    "lines of tabs beside a comment": ("t\tu\ty\n0\t1\t2\n\t\t\n# a comment\n1\t\t4\n2\t5\t6\n\t\t\n \t\t ",
                                       ("t", "u", "y"), TABBED),  # NumPy reads a block without comments
    "names that are numbers": ("time,101,102,205\n0,20,21,22\n1,20,21,22\n", ("time", "101", "102", "205"), {}),
    "a name that is a number": ("t,u,y,2\n0,1,2,3\n1,2,3,4\n", ("t", "u", "y", "2"), {}),
    "no first name": (",u,y\n0,1,2\n1,2,3\n", ("0", "u", "y"), {}),
    "names that begin as numbers": ("3.3V,5V,t\n1,2,3\n2,3,4\n", ("3.3V", "5V", "t"), {}),
    "no last names": ("u,y,,\n1,2,,\n2,3,,\n", ("u", "y", "2"), {}),
    "LabVIEW": ("LabVIEW Measurement\t\nDecimal_Separator\t,\n***End_of_Header***\t\t\n\t\t\nChannels\t2\t\t\n"
                "Samples\t2\t2\t\nDelta_X\t1,0\t1,0\t\n***End_of_Header***\t\t\t\nX_Value\tu\ty\tComment\n"
                "0,000000\t1,500000\t2,000000\t\n1,000000\t-2,5e-3\t4,000000\t\n",
                ("X_Value", "u", "y", "Comment"), {"X_Value": [0.0, 1.0], "u": [1.5, -2.5e-3], "y": [2.0, 4.0]}),
    "no header, words": ("u,1\na,2\nb,3\n", ("0", "1"), {}),
}  # fmt: skip


@every(("text", "names", "columns"), COLUMNS.values(), ids=COLUMNS)
def test_columns_have_their_names_and_numbers(
    write: Write, text: str, names: tuple[str, ...], columns: dict[str | int, list[float]]
) -> None:
    table = read_columns(write(text))
    assert table.names == names
    for key, values in columns.items():
        np.testing.assert_array_equal(table.column(key), values)


#: Bytes of a block: less than a line, some lines, and an odd number that cuts lines anywhere.
block_sizes = every("size", [1, 7, 64, 1009])


@block_sizes
@every("end", ["\n", "\r\n", "\r"])
@every("encoding", ["utf-8", "utf-8-sig", "utf-16"], quick=2)
def test_blocks_join_without_a_seam(
    write: Write, monkeypatch: pytest.MonkeyPatch, size: int, end: str, encoding: str
) -> None:
    """For any content at the seam; NumPy parses clean blocks, and reads every number as Python does."""
    monkeypatch.setattr(csv_module, "BLOCK_BYTES", size)
    values = np.random.default_rng(0).standard_normal(200) * 10.0 ** np.arange(-100, 100)
    lines = [f"{index},{value!r}" for index, value in enumerate(values.tolist())]
    lines[50:50] = ["# a comment", "", "  "]
    lines[120] = lines[120].replace(",", ',"') + '"'
    index, read = read_columns(write(end.join(["k,u", *lines]).encode(encoding))).columns(["k", "u"])
    np.testing.assert_array_equal(index, np.arange(200))
    np.testing.assert_array_equal(read, values)


@every("form", WELL_FORMED)
def test_every_form_reads_alike_in_small_blocks(write: Write, monkeypatch: pytest.MonkeyPatch, form: str) -> None:
    text = WELL_FORMED[form].rstrip("\n") + "\n"
    path = write(text + 40 * text.splitlines(keepends=True)[-1])
    whole = read_columns(path).columns([1, 2])
    monkeypatch.setattr(csv_module, "BLOCK_BYTES", 50)
    blocks = list(read_columns(path).stream([1, 2]))
    assert len(blocks) > 10
    np.testing.assert_array_equal(np.hstack([np.array(block) for block in blocks]), whole)


@every(
    "cell",
    ["+1.5", " 1.5 ", "1e400", "1e-400", "-nan", "INF", "NA", "null", "none", "", "1.", ".5", "4.9e-324", "1" * 40],
)
def test_a_cell_is_the_same_number_in_a_long_file(write: Write, monkeypatch: pytest.MonkeyPatch, cell: str) -> None:
    """To NumPy as to Python."""
    path = write("u;y\n" + f"{cell};1\n" * 30)
    expected = read_columns(path).column("u")
    monkeypatch.setattr(csv_module, "BLOCK_BYTES", 20)
    np.testing.assert_array_equal(read_columns(path).column("u"), expected)


@every("cell", ["nan(1)", "1_0", "0x1p3", "1,5,5", "1.2.3", "--1", "1 2", "١"])
def test_a_cell_that_is_not_a_number_is_refused_in_a_long_file(
    write: Write, monkeypatch: pytest.MonkeyPatch, cell: str
) -> None:
    monkeypatch.setattr(csv_module, "BLOCK_BYTES", 20)
    path = write("u;y\n" + "1;1\n" * 30 + f"{cell};1\n" + "1;1\n" * 30)
    with pytest.raises(LogError, match="line 32, column 'u'"):
        read_columns(path).column("u")


def test_a_commented_line_with_every_cell_is_no_row(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv_module, "BLOCK_BYTES", 20)
    path = write("t,u\n" + "1,2\n" * 30 + "#1,3\n" + "1,2\n" * 30)
    np.testing.assert_array_equal(read_columns(path).column("u"), np.full(60, 2.0))


@every("delimiter", [",", ";", "\t", "|"])
@every("word", ["", "  ", "NA", " n/a ", "Null"])
def test_missing_cells_anywhere_are_missing(write: Write, delimiter: str, word: str) -> None:
    rows = [("1", word, "3"), (word, word, "3"), ("1", "2", word), (word, "2", word), ("4", "5", "6")]
    path = write("\n".join(delimiter.join(row) for row in [("a", "b", "c"), *rows, *rows]) + "\n")
    expected = np.array([[float(cell) if cell.isdigit() else np.nan for cell in row] for row in [*rows, *rows]])
    np.testing.assert_array_equal(np.column_stack(read_columns(path).columns(["a", "b", "c"])), expected)
    np.testing.assert_array_equal(read_columns(path).column("b"), expected[:, 1])


@every("row", ["1,2", "1,2,3,4", "1,2,3\n1,2,3,4\n1,2"])
def test_a_row_of_another_length_is_found_where_some_columns_are_read(write: Write, row: str) -> None:
    path = write("a,b,c\n" + 5 * "1,2,3\n" + row + "\n" + 5 * "1,2,3\n")
    for columns in (["a"], ["a", "b", "c"]):
        with pytest.raises(LogError, match=r"line [78] has [24] cells where line 1 has 3"):
            read_columns(path).columns(columns)


def test_text_in_other_columns_does_not_matter(write: Write) -> None:
    path = write("t,state,u\n" + "".join(f"{k},run ü,{k / 7!r}\n" for k in range(100)))
    np.testing.assert_array_equal(read_columns(path).column("u"), np.arange(100) / 7)
    with pytest.raises(LogError, match="line 2, column 'state': 'run ü' is not a number"):
        read_columns(path).column("state")


def test_the_lines_of_names_and_data_are_found(write: Write) -> None:
    layout = sniff(write("# rig\n\nt;u\n# start\n0;1,5\n1;2,5\n"))
    assert (layout.delimiter, layout.names_line, layout.data_line) == (";", 3, 5)


BAD = {
    "text cell": ("t,u,y\n0,1,2\n1,x7,3\n", "line 3, column 'u': 'x7' is not a number; correct it"),
    "text cell after comments": ("# a\n\nt,u,y\n0,1,2\n# b\n1,x7,3\n", "line 6, column 'u': 'x7' is not a number"),
    "underscore": ("t,u,y\n0,1,2\n1,1_000,3\n", "line 3, column 'u': '1_000' is not a number"),
    "foreign digits": ("t,u,y\n0,1,2\n1,٣,3\n", "line 3, column 'u': '٣' is not a number"),
    "two points": ("t,u,y\n0,1,2\n1,1.2.3x,3\n", "line 3, column 'u': '1.2.3x' is not a number"),
    "thousands in groups of two": ("t;u;y\n0;1,5;2\n1;12.34,5;3\n", "line 3, column 'u': '12.34,5' is not a number"),
    "thousands after the decimals": ("t;u;y\n0;1,5;2\n1;1,234.5;3\n", "line 3, column 'u': '1,234.5' is not a number"),
    "two decimal marks": ("t;u;y\n0;0,5;2\n1;1.234;3\n", "column 'u' has a decimal point in line 3 ('1.234') and"),
    "row of text that is none of units": ("t,u,y\na,low,high\n0,1,2\n1,2,3\n", "line 2, column 'u': 'low' is not a"),
    "row of units without data": ("t,u,y\ns,V,mm\n", "line 2, column 'u': 'V' is not a number"),
    "second row of units": ("t,u,y\ns,V,mm\ns,V,mm\n0,1,2\n", "line 3, column 'u [V]': 'V' is not a number"),
    "row too short": ("t,u,y\n0,1,2\n1,2\n", "line 3 has 2 cells where line 1 has 3; complete the line"),
    "row too long": ("t,u,y\n0,1,2\n1,2,3,4\n", "line 3 has 4 cells where line 1 has 3"),
    "one word": ("t,u,y\n0,1,2\nend\n", "line 3 has 1 cell where line 1 has 3"),
    "row too short, no header": ("0,1,2\n0.1,2,3\n1,2\n", "line 3 has 2 cells where line 1 has 3"),
    "row too short, blanks": ("t u y\n0 1 2\n1 2\n", "line 3 has 2 cells where line 1 has 3"),
    "empty": ("", "the file is empty"),
    "only blank lines and comments": ("\n# t,u,y\n\n", "the file is empty"),
    "header only": ("# rig\nt,u,y\n", "only a header (line 2) and no row of data"),
    "one row": ("t,u,y\n0,1,2\n", "1 row of data, at least 2 are needed"),
    "one row, no header": ("0,1,2\n", "1 row of data, at least 2 are needed"),
    "binary": (b"t,u,y\n\x00\x01\x02\n", "not a text file; export the log as CSV"),
    "control character": (b"t,u,y\n0,1,2\n1,\x00\x00,2\n", "or .npz (line 3 holds the control character 0x00)"),
    "UTF-16 without its mark": ("t,u,y\n0,1,2\n".encode("utf-16-le"), "a text in UTF-16 without a byte-order mark"),
    "UTF-16, the other way": ("t,u,y\n0,1,ö\n".encode("utf-16-be"), "a text in UTF-16 without a byte-order mark"),
    "names again": ("t [s],u,y\n0,1,2\nt,u,y\n1,2,3\n", "line 3, column 'u': the names again; put # before each such"),
    "names over two lines": ('t,"u\n[V]",y\n0,1,2\n', "no closing quotation mark; correct it, write each row and its"),
    "date": ("t,u,y\n0,2024-05-01,2\n1,2024-05-02,3\n", "'2024-05-01' is not a number; convert dates"),
    "text after a quote": (
        't,u,y\n0,1,2\n1,"1"0.13,3\n',
        "line 3, column 'u': '\"1\"0.13' goes on after its closing quotation mark; correct it",
    ),
    "text after a quote, blanks": (
        't u y\n0 1 2\n1 "1"0.13\n',
        "line 3, column 'u': '\"1\"0.13' goes on after its closing quotation mark",
    ),
    "text after a quote in a column that is not read": (
        't,u,y\n0,1,2\n"1"5,1,3\n',
        "line 3, column 't': '\"1\"5' goes",
    ),
    "text after a quote in the header": ('t,"u"x,y\n0,1,2\n', "line 1, column 1: '\"u\"x' goes on after its closing"),
    "quote without end": ('t,u,y\n0,1,2\n1,"2,3\n2,3,4\n', "line 3, column 'u': '\"2,3' has no closing quotation mark"),
    "endless name": (
        f't,"{"x" * 140_000}",y\n0,1,2\n1,2,3\n',
        "line 1, column 1: '" + "x" * 40 + "...' is a name of 140",
    ),
    "text cell in row 5000": (
        "t,u,y\n" + "".join(f"{k * 0.1:.1f},{'stuck' if k == 4998 else k % 7},{k % 5}\n" for k in range(6000)),
        "line 5000, column 'u': 'stuck' is not a number",
    ),
    "name or damaged number": (
        "0,1.5x,2\n0.1,2.5,4\n",
        "line 1, column 1: '1.5x' is a name or a damaged number; correct it, or put #",
    ),
    "long text": ("t,u,y\n0,1,2\n1," + "x" * 999 + ",3\n", "'" + "x" * 40 + "...' is not a number"),
    # comments alone are told from the beginning of the file, or from all of it
    "a comment as long as the beginning": ("# a line\n".ljust((1 << 16) - 1, "#") + "\n", "the file is empty"),
    "a comment longer than the beginning": ("# a line\n".ljust(1 << 16, "#") + "\n", "no row of data"),
}


@every(("content", "message"), BAD.values(), ids=BAD.keys())
def test_a_bad_file_is_refused_in_one_line(write: Write, content: str | bytes, message: str) -> None:
    path = write(content)
    with pytest.raises(LogError, match=re.escape(message)) as caught:
        read_log(path, input=1, output=2, dt=0.1)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


HEADERLESS = {
    "rest at first": "0,1,0\n1,1,0.5\n2,0,0.7\n",
    "two columns": "1,0\n1,0.5\n0,0.7\n",
    "decimal comma": "0;0,5;1\n1;1,5;2\n2;2,5;3\n",
    "blanks": "0 0.5 1\n1 1.5 2\n2 2.5 3\n",
    "missing": "0,1,\n1,1,0.5\n2,0,0.7\n",
    "missing, two columns": "1,\n1,0.5\n0,0.7\n",
    "not a number": "0,1,nan\n1,1,0.5\n2,0,0.7\n",
    "quoted": '"0","1","0"\n"1","1","0.5"\n"2","0","0.7"\n',
    "all alike": "1,2,3,4,5\n2,3,4,5,6\n3,4,5,6,7\n",
}


@every("text", HEADERLESS.values(), ids=HEADERLESS.keys())
@every("how", ["replaced", "inserted", "removed"])
def test_a_damaged_first_row_is_never_taken_for_names(write: Write, text: str, how: str) -> None:
    """Each of its characters is damaged in turn: the row is read as data, or the file is refused."""
    for at in range(text.index("\n")):
        for mark in "xqp?*'$Z~\xb0" if how != "removed" else " ":
            path = write(text[:at] + (mark if how != "removed" else "") + text[at + (how != "inserted") :])
            refused, layout = "", None
            try:
                layout = sniff(path)
            except LogError as error:
                refused = str(error)
            if layout is None:
                assert refused.startswith(f"{path}: line 1, column ")
            else:
                assert layout.names_line is None, path.read_text()


@pytest.mark.slow
@every("header", ["{}", '"{}"', "c{}", None], ids=["numbers", "quoted", "names", "none"], quick=2)
def test_a_hundred_thousand_columns_are_opened(write: Write, header: str | None) -> None:
    """benchmarks/wide_logs.py measures that the time is proportional to the number of columns."""
    names = "" if header is None else "t," + ",".join(header.format(k) for k in range(1, 100_000)) + "\n"
    path = write(names + (",".join(["1.5"] * 100_000) + "\n") * 3)
    assert len(read_columns(path).names) == 100_000


@block_sizes
def test_a_line_without_end_is_refused(write: Write, monkeypatch: pytest.MonkeyPatch, size: int) -> None:
    monkeypatch.setattr(layout_module, "LONGEST_LINE", 2000)
    monkeypatch.setattr(csv_module, "LONGEST_LINE", 2000)
    monkeypatch.setattr(csv_module, "BLOCK_BYTES", size)
    for number, text in ((1, "1," * 2000), (2, "u,y\n" + "1," * 2000), (202, "u,y\n" + "1,2\n" * 200 + "1," * 2000)):
        with pytest.raises(LogError, match=r"is longer than .* characters; write one line for each sample") as caught:
            read_columns(write(text)).column(0)
        assert f"log.csv: line {number} " in str(caught.value)


@block_sizes
@every("end", ["\n", "\r\n", "\r"], quick=2)
def test_an_error_beyond_the_first_block_has_its_line(
    write: Write, monkeypatch: pytest.MonkeyPatch, size: int, end: str
) -> None:
    monkeypatch.setattr(csv_module, "BLOCK_BYTES", size)
    rows = [f"{k},1,2" for k in range(300)]
    rows[250] = "0,?,2"
    rows[20:20] = ["# a comment", ""]
    with pytest.raises(LogError, match=r"line 254, column 'u': '\?'"):
        read_columns(write(end.join(["t,u,y", *rows]).encode())).column("u")
    rows[252] = "1,2"
    with pytest.raises(LogError, match="line 254 has 2 cells where line 1 has 3"):
        read_columns(write(end.join(["t,u,y", *rows]).encode())).column("u")


NUMBERED = ("0", "1", "2")
ABOVE_DATA = "lines 1 to 2 are above the data, and left out; the columns are called 0, 1, 2"
ABOVE = {
    # each line of an export has as many cells as the widest one
    "a title that a spreadsheet filled up": (
        "Oven 3;12.11.2026;;\nt;u;pump;y\n[s];[%];[%];[degC]\n0;1,5;;20,1\n1;1,5;0;20,2\n2;1,5;0;\n",
        ("t [s]", "u [%]", "pump [%]", "y [degC]"),
        ("line 1 is above the names, and left out",),
        {"y [degC]": [20.1, 20.2, NAN]},
    ),
    "a title": (
        "Motor test\n\nOperator;Smith\nt;u;y\ns;V;mm\n0;1;2\n1;3;4\n2;5;6\n3;7;8\n",
        ("t [s]", "u [V]", "y [mm]"),
        ("lines 1 to 3 are above the names, and left out",),
        {"y": [2.0, 4.0, 6.0, 8.0]},
    ),
    **{
        f"a comment that is no header, {comment}": (f"{comment}\n{row}\n{row}\n", NUMBERED, (), {})
        for comment, row in (
            ("# rig 7, 3 May, 12 V, no load", "0,1,2"), ("# a, b", "0,1,2"), ("# what we did on the day", "0 1 2"),
        )
    },
    **{
        f"text above rows of numbers, {above.partition(' ')[0]}": (
            above + "".join(f"{mark.join(row)}\n" for row in (("0.0", "0.1", "2.5"), ("0.1", "3.1", "4.5"),
                                                              ("0.2", "5.1", "6.5"))),
            NUMBERED, (ABOVE_DATA,), {1: [0.1, 3.1, 5.1]},
        )
        for above, mark in (
            ("HSVA, the experimental data\nZ20/10 starting to starboard\n", "   "),  # as model basins write it
            ("Zig-zag manoeuvring: 20 / -20\n\n", "\t"),
            ("t [s] || speed [rot. s^-1] || duty cycle [%] ||\nposition [deg]\n", "\t"),
        )
    },
}  # fmt: skip


@every(("text", "names", "notes", "columns"), ABOVE.values(), ids=ABOVE)
@every("name", ["log.csv", "log.txt"])
def test_what_is_above_the_names_or_the_data_is_left_out_and_said(
    write: Write,
    text: str,
    names: tuple[str, ...],
    notes: tuple[str, ...],
    columns: dict[str | int, list[float]],
    name: str,
) -> None:
    path = write(text, name)
    table = read_columns(path)
    assert table.names == names
    assert table.notes == tuple(f"{path}: {note}" for note in notes)
    for key, values in columns.items():
        np.testing.assert_array_equal(table.column(key), values)


def test_a_header_with_more_names_than_columns_is_left_out_and_said(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("# rig 7\n# time,control output,temp,P,I\n0,1,2\n1,3,4\n2,5,6\n")
    table = read_columns(path)
    assert table.names == ("0", "1", "2")
    why = "line 2 has 5 names for 3 columns, and is left out"
    assert table.notes == (f"{path}: {why}; the columns are called 0, 1, 2",)
    for key in ("control output", "Control Output"):
        with pytest.raises(LogError, match=rf"no column 'control output': {why}; there are: 0, 1, 2$"):
            table.column(key)


OF_ANOTHER_LENGTH = {
    **{
        f"above numbers, {above!r}": (above + "0,1,2\n1,3,4\n2,5,6\n", [0], "line 2")  # it is no title
        for above in ("t,u\n", "0,1\n", "t u y\n", "t;u;y\n", "Motor test\n0,1\n")
    },
    # a pattern that tries each way to divide blanks would take hours
    "a million empty cells": (
        "t\tu\n0\t1\n1\t2\n" + 1_000_000 * "\t" + "5\n",
        [0, 1],
        r"log\.csv: line 4 has .* where line 1 has 2",
    ),
}


@every(("text", "columns", "message"), OF_ANOTHER_LENGTH.values(), ids=OF_ANOTHER_LENGTH)
def test_a_line_of_another_length_is_refused(write: Write, text: str, columns: list[int], message: str) -> None:
    path = write(text)
    with pytest.raises(LogError, match=message):
        read_columns(path).columns(columns)
