"""Choice of columns and files, whatever the format."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import FrozenInstanceError
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replant as rp
import replant.logs
from replant.errors import ArgumentTypeError, LogError
from replant.logs import read_columns, read_log
from support.cases import every

Write = Callable[..., Path]
TEXT = "t,u,y\n0,1,2\n0.1,2,3\n0.2,3,5\n"


@every(("one", "other"), [("u", "y"), (1, 2), ("1", "2"), (" U ", "Y"), (np.int64(1), "y")])
def test_columns_by_name_or_number(write: Write, one: str | int, other: str | int) -> None:
    path = write(TEXT)
    log = read_log(path, input=one, output=other, time="t")
    assert log.input.tolist() == [1.0, 2.0, 3.0]
    assert log.output.tolist() == [2.0, 3.0, 5.0]
    assert (len(log), log.dt, log.input_name, log.output_name, log.path) == (3, 0.1, "u", "y", path)


def test_a_path_may_be_a_string(write: Write) -> None:
    assert len(read_log(str(write(TEXT)), input="u", output="y", dt=1)) == 3


def test_the_exact_name_comes_first(write: Write) -> None:
    table = read_columns(write("u,U,y\n1,2,3\n4,5,6\n"))
    assert (table.find("u"), table.find("U"), table.find("Y")) == (0, 1, 2)


@every(
    ("names", "key", "message"),
    [
        (["Speed", "SPEED", "y"], "speed", r"column 'speed' could be any of 0 \('Speed'\), 1 \('SPEED'\)"),
        ([f"c{k}" for k in range(30)], "c299", r"there are: c29, .*, \.\.\. \(18 more\)$"),
    ],
    ids=["in another case it must be unique", "a long list is cut"],
)
def test_a_name_that_is_none_or_of_several_columns_is_refused(
    write: Write, names: list[str], key: str, message: str
) -> None:
    path = write("".join(",".join(row) + "\n" for row in (names, ["1"] * len(names), ["4"] * len(names))))
    with pytest.raises(LogError, match=message):
        read_columns(path).find(key)


def test_a_wrong_name_lists_the_names_closest_first(write: Write) -> None:
    path = write("temperature,speed,voltage\n1,2,3\n4,5,6\n")
    with pytest.raises(LogError) as caught:
        read_log(path, input="volts", output="speed", dt=1.0)
    assert (
        str(caught.value)
        == f"{path}: no column 'volts' (did you mean 'voltage'?); there are: voltage, speed, temperature"
    )


@every("key", [1.0, None, True, ["u"]])
def test_a_column_is_a_name_or_a_number(write: Write, key: object) -> None:
    with pytest.raises(ArgumentTypeError, match="a column is chosen by name"):
        read_columns(write(TEXT)).find(key)  # type: ignore[arg-type]


@every(
    ("choice", "message"),
    [
        ({"input": "u", "output": "u"}, "input and output are the same column 'u'; choose two different columns"),
        ({"input": "u", "output": 1}, "input and output are the same column 'u'; choose two different columns"),
        (
            {"input": "u", "output": "y", "time": "y"},
            "output and time are the same column 'y'; choose two different columns",
        ),
        (
            {"input": "t", "output": "y", "time": "t"},
            "input and time are the same column 't'; choose two different columns",
        ),
        *(({"input": k, "output": "y"}, f"no column {k}; columns 0 to 2 are: t, u, y") for k in (3, -1, "3")),
        ({"input": "uu", "output": "y"}, r"no column 'uu' \(did you mean 'u'\?\); there are: u, t, y"),
        ({"input": "force", "output": "y"}, "no column 'force'; there are: "),
    ],
)
def test_a_column_that_is_not_there_or_chosen_twice_is_refused(
    write: Write, choice: dict[str, Any], message: str
) -> None:
    with pytest.raises(LogError, match=message):
        read_log(write(TEXT), **choice)


@every("suffix", [".csv", ".parquet", ".mat", ".npz"])
def test_files_that_are_not_there(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"none{suffix}"
    with pytest.raises(LogError, match=f"none{suffix}: no such file; check the path"):
        read_log(path, input="u", output="y")
    path.mkdir()
    with pytest.raises(LogError, match=f"none{suffix}: a directory; give the log file inside it"):
        read_log(path, input="u", output="y")
    path.rmdir()
    path.touch()
    with pytest.raises(LogError, match=f"none{suffix}: the file is empty"):
        read_log(path, input="u", output="y")


def test_a_file_that_vanishes_after_it_was_opened(write: Write) -> None:
    path = write(TEXT)
    table = read_columns(path)
    path.unlink()
    with pytest.raises(LogError, match=r"log\.csv: cannot be read \(No such file or directory\)"):
        table.column("u")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="file permissions do not bind this user")
def test_a_file_without_permission(write: Write) -> None:
    path = write(TEXT)
    path.chmod(0)
    with pytest.raises(LogError, match=r"log\.csv: cannot be read \(Permission denied\)"):
        read_columns(path)


@pytest.mark.parametrize("name", ["log.ods", "log", "log.xls"])
def test_unknown_file_types_are_refused(write: Write, name: str) -> None:
    with pytest.raises(
        LogError,
        match=r"unknown file type '.*'; a log is one of \.csv \.txt .* \.mat \.npz.* rename a log of text to \.txt",
    ):
        read_columns(write(TEXT, name))


def test_a_log_is_frozen(write: Write) -> None:
    log = read_log(write(TEXT), input="u", output="y")
    with pytest.raises(FrozenInstanceError):
        log.dt = 1.0  # type: ignore[misc]


def test_public_names_are_sorted_and_there() -> None:
    assert replant.logs.__all__ == sorted(replant.logs.__all__)
    assert all(hasattr(replant.logs, name) for name in replant.logs.__all__)


def test_reading_text_imports_no_heavy_library(write: Write) -> None:
    code = f"""
import sys
from replant.logs import read_log
read_log({str(write(TEXT))!r}, input="u", output="y")
assert not {{"scipy", "pyarrow", "pandas", "matplotlib"}} & set(sys.modules), sys.modules.keys()
"""
    paths = os.pathsep.join(sys.path)
    subprocess.run([sys.executable, "-c", code], check=True, env={**os.environ, "PYTHONPATH": paths})


def test_a_model_knows_the_digest_of_the_log_it_is_made_of(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    u = np.repeat([0.0, 1.0, -1.0, 1.0], 50)
    y = rp.TransferFunction([2.0], [1.0, 1.0]).simulate(u, 0.1)
    path.write_text("u,y\n" + "".join(f"{a:g},{b:.9g}\n" for a, b in zip(u, y, strict=True)))
    log = rp.read_log(path, input="u", output="y", dt=0.1)
    expected = hashlib.sha256(path.read_bytes()).hexdigest()
    assert log.sha256 == rp.fit(log, poles=1).model.provenance.sha256 == expected
    assert rp.run(log, poles=1).model.provenance.sha256 == expected


@pytest.mark.parametrize(("column", "role"), [(1, "input"), (2, "output"), (3, "reference")])
def test_a_column_without_a_number_is_named(tmp_path: Path, column: int, role: str) -> None:
    rows = [["t", "u", "y", "r"], *([f"{k}", "1", "2", "3"] for k in range(5))]
    for row in rows[1:]:
        row[column] = "nan"
    log = tmp_path / "log.csv"
    log.write_text("".join(",".join(row) + "\n" for row in rows))
    name = rows[0][column]
    with pytest.raises(LogError, match=f"log.csv: column '{name}' has no number in 5 rows; .*another .* the {role}"):
        rp.read_log(log, input="u", output="y", reference="r")
