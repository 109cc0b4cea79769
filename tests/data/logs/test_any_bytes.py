"""Whatever a file holds, it is read or refused in one line."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from replant.data.logs import read_log
from replant.data.logs.read import FORMATS
from replant.errors import LogError

CELLS = st.sampled_from(["0", "1.5", "2,5", "-3e2", "", "nan", "x", '"', "#", "%", "'", "\ufeff", "\x1a", "°", "1.2.3"])
MARKS = st.sampled_from([",", ";", "\t", " ", "|", "\n", "\r\n", "\r", "\x0b", "\u2028"])


def read_or_refuse(content: bytes, suffix: str) -> None:
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
    else:
        assert log.input.dtype == log.output.dtype == np.float64
        assert log.input.shape == log.output.shape == (len(log),)
        assert len(log) >= 2


def mat_file() -> bytes:
    file = io.BytesIO()
    scipy.io.savemat(file, {"u": np.arange(9.0), "data": {"y": np.ones((9, 2))}}, do_compression=False)
    return file.getvalue()


def npz_file() -> bytes:
    file = io.BytesIO()
    np.savez(file, u=np.arange(9.0), y=np.ones((9, 2)))
    return file.getvalue()


def parquet_file() -> bytes:
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    file = io.BytesIO()
    parquet.write_table(pa.table({"u": np.arange(9.0), "y": np.ones(9)}), file)
    return file.getvalue()


@settings(derandomize=True, max_examples=300, deadline=None)
@given(st.lists(CELLS | MARKS, max_size=60).map("".join))
def test_any_text(text: str) -> None:
    read_or_refuse(text.encode(), ".csv")


@pytest.mark.parametrize("suffix", FORMATS)
@settings(derandomize=True, max_examples=30, deadline=None)
@given(content=st.binary(max_size=300))
def test_any_bytes(suffix: str, content: bytes) -> None:
    if suffix in {".parquet", ".pq"}:
        pytest.importorskip("pyarrow")
    read_or_refuse(content, suffix)


MAKERS = [(mat_file, ".mat"), (npz_file, ".npz"), (parquet_file, ".parquet")]


@pytest.mark.parametrize(("make", "suffix"), MAKERS)
@settings(derandomize=True, max_examples=50, deadline=None)
@given(share=st.floats(0.0, 1.0))
def test_a_cut_file(make: Callable[[], bytes], suffix: str, share: float) -> None:
    content = make()
    read_or_refuse(content[: int(share * len(content))], suffix)


@pytest.mark.parametrize(("make", "suffix"), MAKERS[1:])  # SciPy's compiled parser of .mat crashes on changed bytes
@settings(derandomize=True, max_examples=100, deadline=None)
@given(data=st.data())
def test_a_damaged_file(make: Callable[[], bytes], suffix: str, data: st.DataObject) -> None:
    content = bytearray(make())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    read_or_refuse(bytes(content), suffix)
