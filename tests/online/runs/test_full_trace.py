"""The whole trace as a file."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from replant.errors import LogError, MissingDependencyError
from replant.logs import read_columns
from replant.online.runs import full_trace
from replant.online.runs.full_trace import FullTrace
from support.cases import every
from support.full_disk import full_disk

pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install 'replant[parquet]'")


def trace(rows: int) -> rp.Trace:
    rng = np.random.default_rng(0)
    return rp.Trace(("a0", "b0"), np.zeros(2), rng.standard_normal((rows, 2)), rng.standard_normal(rows))


@every("group_rows", [1, 70, 1000], quick=2)
@every("chunk", [1, 33, 200], quick=2)
def test_it_is_the_trace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chunk: int, group_rows: int) -> None:
    monkeypatch.setattr(full_trace, "GROUP_ROWS", group_rows)
    whole, path = trace(200), tmp_path / "new" / "trace.parquet"
    with FullTrace(path, dt=0.25) as file:
        for begin in range(0, 200, chunk):
            part = slice(begin, begin + chunk)
            file.take(rp.Trace(whole.names, whole.start, whole.parameters[part], whole.errors[part]))
    table = read_columns(path)
    assert table.names == ("time [s]", "a0", "b0", "error")
    t, *parameters, errors = table.columns(list(table.names))
    np.testing.assert_array_equal(t, 0.25 * np.arange(200))
    np.testing.assert_array_equal(np.transpose(parameters), whole.parameters)
    np.testing.assert_array_equal(errors, whole.errors)
    assert [entry.name for entry in path.parent.iterdir()] == ["trace.parquet"]


def test_after_an_error_no_file_is_left(tmp_path: Path) -> None:
    def fail() -> None:
        with FullTrace(tmp_path / "trace.parquet", dt=1.0) as file:
            file.take(trace(5))
            raise ValueError("something else")

    with pytest.raises(ValueError, match="something else"):
        fail()
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(sys.platform == "win32", reason="no limit to a file's size")
@every("room", [0, 3, 100, 2000, 4000])
@every("group_rows", [100, 1000])
def test_on_a_full_disk_no_file_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int, group_rows: int
) -> None:
    """Whichever write fails: of a group, of the end, or none before the end."""
    monkeypatch.setattr(full_trace, "GROUP_ROWS", group_rows)

    def write() -> None:
        with FullTrace(tmp_path / "trace.parquet", dt=1.0) as file:
            file.take(trace(100))
            file.take(trace(100))

    with (
        full_disk(room),
        pytest.raises(LogError, match=r"trace\.parquet: cannot be written \(.*\); choose another file"),
    ):
        write()
    assert not list(tmp_path.iterdir())
    write()
    assert [entry.name for entry in tmp_path.iterdir()] == ["trace.parquet"]


def test_a_mistake_is_said_before_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(LogError, match=r"trace\.csv: the full trace is a Parquet file"):
        FullTrace(tmp_path / "trace.csv", dt=1.0)
    (tmp_path / "file").touch()
    with pytest.raises(LogError, match=r"trace\.parquet: cannot be written"):
        FullTrace(tmp_path / "file" / "trace.parquet", dt=1.0).__enter__()
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'replant\[parquet\]'"):
        FullTrace(tmp_path / "trace.parquet", dt=1.0)
