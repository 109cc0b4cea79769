"""Feather and Arrow files, as pyarrow writes them."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from replant.errors import LogError
from replant.logs import read_columns, read_log
from support.cases import every

pa = pytest.importorskip("pyarrow")
feather = pytest.importorskip("pyarrow.feather")

pytestmark = pytest.mark.usefixtures("read_here")
U = np.arange(30.0) % 4


def table() -> Any:
    stamps = [datetime(2024, 5, 1, 10, 0, k) for k in range(30)]
    columns = {"when": pa.array(stamps, pa.timestamp("ns")), "u": U, "y": [None, *range(29)], "s": ["RUN"] * 30}
    return pa.table(columns)


def save(folder: Path, form: str) -> Path:
    path = folder / ("log.feather" if form in {"lz4", "zstd", "uncompressed"} else "log.arrow")
    if path.suffix == ".feather":
        feather.write_feather(table(), path, compression=form)
        return path
    writer = pa.ipc.new_file if form == "file" else pa.ipc.new_stream
    with writer(path, table().schema) as sink:
        sink.write_table(table(), max_chunksize=7)
    return path


FORMS = every("form", ["lz4", "zstd", "uncompressed", "file", "stream"])


@FORMS
def test_every_form_is_read(tmp_path: Path, form: str) -> None:
    path = save(tmp_path, form)
    log = read_log(path, input="u", output="y")
    assert log.dt == 1.0
    np.testing.assert_array_equal(log.input, U)
    np.testing.assert_array_equal(log.output, [np.nan, *range(29)])
    with pytest.raises(LogError, match="column 's' holds string, not numbers"):
        read_columns(path).column("s")


@pytest.mark.parametrize("content", [b"x", b"ARROW1", b"t,u,y\n0,1,2\n"])
def test_files_of_other_formats_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "log.arrow"
    path.write_bytes(content)
    with pytest.raises(LogError, match="not a readable Feather or Arrow file"):
        read_columns(path)
    path.write_bytes(b"FEA1" + content)
    with pytest.raises(LogError, match="a Feather file of version 1; write it again with a newer pyarrow"):
        read_columns(path)
