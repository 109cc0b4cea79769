"""A file with any content is read, or refused in one line."""

from __future__ import annotations

import importlib.util
import io
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from fuzz.files import finding
from replant.errors import LogError
from replant.logs import csv, read_log
from replant.logs.parser_process import FORMATS
from support.cases import every, examples
from support.damage import damaged
from support.forks import Forks

pytestmark = pytest.mark.filterwarnings("ignore:.* cut off .* left out:UserWarning")  # it is read, and that is said

CELLS = st.sampled_from(["0", "1.5", "2,5", "-3e2", "", "nan", "x", '"', "#", "%", "'", "\ufeff", "\x1a", "°", "1.2.3"])
MARKS = st.sampled_from([",", ";", "\t", " ", "|", "\n", "\r\n", "\r", "\x0b", "\u2028"])


def read_or_refuse(content: bytes, suffix: str) -> bool:
    """Return whether it was read."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "log" + suffix)
        path.write_bytes(content)
        log, message = None, ""
        try:
            log = read_log(path, input=0, output=1, dt=0.1)
        except LogError as error:
            message = str(error)
    if log is None:
        assert message.startswith(f"{path}: ")
        assert len(message.splitlines()) == 1
        assert len(message) < 2000
    else:
        assert log.input.dtype == log.output.dtype == np.float64
        assert log.input.shape == log.output.shape == (len(log),)
        assert len(log) >= 2
    return log is not None


def mat_file(*, compressed: bool) -> bytes:
    file = io.BytesIO()
    signals = {"u": np.arange(9.0), "y": np.ones(9), "data": {"y": np.ones((9, 2)), "note": "rig 7"}}
    scipy.io.savemat(file, signals | {"cells": np.array(["a", 1.0], object)}, do_compression=compressed)
    return file.getvalue()


def npz_file(save: Callable[..., None]) -> bytes:
    file = io.BytesIO()
    save(file, u=np.arange(9.0), y=np.ones((9, 2)), names=np.array(["a", "b"]))
    return file.getvalue()


def parquet_file(**options: Any) -> bytes:
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    file = io.BytesIO()
    stamps = pa.array(range(30), pa.timestamp("ms"))
    parquet.write_table(pa.table({"u": np.arange(30.0) % 4, "y": np.ones(30), "t": stamps}), file, **options)
    return file.getvalue()


def csv_file() -> bytes:
    rows = [f"{k / 10},{k % 3},{k / 7!r}" for k in range(40)]
    return "\r\n".join(["# rig", 't,u,"y [mm]"', *rows, '4.0,"1",""', ""]).encode()


MAKERS = [
    (partial(mat_file, compressed=False), ".mat"),
    (partial(mat_file, compressed=True), ".mat"),
    (partial(npz_file, np.savez), ".npz"),
    (partial(npz_file, np.savez_compressed), ".npz"),
    (parquet_file, ".parquet"),
    (partial(parquet_file, write_page_checksum=True), ".parquet"),
    (partial(parquet_file, compression="none", use_dictionary=False), ".parquet"),
    (partial(parquet_file, compression="zstd", data_page_version="2.0", row_group_size=10), ".parquet"),
    (csv_file, ".csv"),
    (lambda: csv_file().decode().encode("utf-16"), ".csv"),
]
TRIES = 3  # of each; 12 in `make slow`


@pytest.fixture(scope="module")
def forks() -> Iterator[Forks]:
    with Forks("scipy.io") as process:
        yield process


@pytest.mark.slow
@pytest.mark.parametrize("tries", [TRIES, pytest.param(12, marks=pytest.mark.slow)])
@every(("make", "suffix"), MAKERS)
def test_a_damaged_file(make: Callable[[], bytes], suffix: str, tries: int, tmp_path: Path, forks: Forks) -> None:
    """In forks, as a parser may crash; `test_fuzz` tries the fuzzer's mutants of every format."""
    content, path = make(), tmp_path / f"log{suffix}"
    path.write_bytes(content)
    assert forks.read(path).kind == "read"
    for seed in range(tries):
        path.write_bytes(damaged(content, seed))
        outcome = forks.read(path)
        assert not finding(path, outcome), (seed, outcome)


@settings(derandomize=True, max_examples=examples(150), deadline=None)
@given(st.lists(CELLS | MARKS, max_size=60).map("".join))
def test_any_text(text: str) -> None:
    read_or_refuse(text.encode(), ".csv")


ODD = [
    '"1"0.13',
    '"',
    '""',
    '"a',
    "1,5",
    "1.5",
    "1e999",
    "nan(1)",
    "\0",
    "1\0",
    "\ufeff",
    "#",
    "sep=",
    "°",
    "é",
    "0" * 999,
]
ODD += ["x" * 70_000, '"' + "x" * 140_000 + '"', '"' * 70_001, " " * 70_000, "[" * 9_000 + " ["]
BLOCKS = st.sampled_from([1, 50, 100_000])


@settings(derandomize=True, max_examples=examples(150), deadline=None)
@given(data=st.data(), block=BLOCKS)
def test_any_table_in_text(data: st.DataObject, block: int) -> None:
    """Rows of cells that are nearly all numbers, under every delimiter, decimal mark, line end and encoding."""
    draw = data.draw
    delimiter, end = (
        draw(st.sampled_from([",", ";", "\t", "|", " ", ", "])),
        draw(st.sampled_from(["\n", "\r\n", "\r"])),
    )
    point, quote = draw(st.sampled_from([".", ","])), draw(st.sampled_from(["", "", '"']))
    encoding = draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "cp1252"]))
    rows = [[f"{quote}{r + c}{point}5{quote}" for c in range(3)] for r in range(30)]
    if draw(st.booleans()):
        rows.insert(0, ["t", "u", "y"])
    for _ in range(draw(st.integers(0, 4))):
        row = rows[draw(st.integers(0, len(rows) - 1))]
        column = draw(st.integers(0, 2))
        match draw(st.sampled_from(["odd", "longer", "shorter"])):
            case "odd":
                row[column : column + 1] = [draw(st.sampled_from(ODD))]
            case "longer":
                row.insert(column, draw(st.sampled_from(["", "1"])))
            case "shorter":
                del row[column : column + 1]
    text = end.join(delimiter.join(row) for row in rows) + draw(st.sampled_from(["", end]))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(csv, "BLOCK_BYTES", block)
        read_or_refuse(text.encode(encoding, errors="replace"), ".csv")


NEEDED = {".parquet": ["pyarrow"], ".pq": ["pyarrow"], ".tdms": ["nptdms"], ".mf4": ["asammdf"], ".mdf": ["asammdf"]}


@settings(
    derandomize=True,
    max_examples=examples(30),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(suffix=st.sampled_from(sorted(FORMATS)), content=st.binary(max_size=300))
def test_any_bytes(suffix: str, content: bytes, tmp_path: Path, forks: Forks) -> None:
    assume(all(importlib.util.find_spec(package) for package in NEEDED.get(suffix, ())))
    path = tmp_path / f"log{suffix}"
    path.write_bytes(content)
    assert not finding(path, forks.read(path))
