"""Parquet files, and what happens without pyarrow."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.errors import LogError
from replant.live.outputs.message import DiskWriter, Notices, ParquetRecorder
from replant.live.streams import Batch
from replant.logs import arrow, read_columns, read_log
from replant.online.runs.full_trace import FullTrace
from support.cases import every

pytestmark = pytest.mark.usefixtures("read_here")


@pytest.fixture
def save(tmp_path: Path) -> Callable[[Any], Path]:
    arrow = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed: pip install 'replant[parquet]'")

    def save(table: Any) -> Path:
        path = tmp_path / "log.parquet"
        arrow.write_table(table, path)
        return path

    return save


def test_columns_are_found_by_name_and_number(save: Callable[[Any], Path]) -> None:
    import pyarrow as pa

    path = save(pa.table({"time": [0.0, 0.1, 0.2], "note": ["a", "b", "c"], "u.1": [1, 2, 3], "y": [0.5, None, 1.5]}))
    assert read_columns(path).names == ("time", "note", "u.1", "y")
    log = read_log(path, input="u.1", output=3)
    assert log.dt == 0.1
    assert log.input.tolist() == [1.0, 2.0, 3.0]
    np.testing.assert_array_equal(log.output, [0.5, np.nan, 1.5])


def test_every_kind_of_number_becomes_float64(save: Callable[[Any], Path]) -> None:
    import pyarrow as pa

    kinds = [pa.int8(), pa.uint16(), pa.int64(), pa.float16(), pa.float32(), pa.float64(), pa.bool_()]
    columns = {str(kind): pa.array(np.array([1, 0, 1]), pa.int64()).cast(kind) for kind in kinds}
    columns["decimal"] = pa.array([Decimal("1.00"), Decimal("0.00"), Decimal("1.00")])
    table = read_columns(save(pa.table(columns)))
    for column in table.columns(table.names):
        assert column.dtype == np.float64
        assert column.tolist() == [1.0, 0.0, 1.0]


def test_time_stamps_come_in_seconds(save: Callable[[Any], Path]) -> None:
    import pyarrow as pa

    nanoseconds = 1_700_000_000_000_000_000 + 1_000_000 * np.arange(5)
    stamps = pa.array(nanoseconds, pa.timestamp("ns"))
    log = read_log(save(pa.table({"time_ms": stamps, "u": np.ones(5), "y": np.ones(5)})), input="u", output="y")
    assert log.dt == 1e-3  # the type says nanoseconds, whatever the name says
    np.testing.assert_allclose(log.time, np.arange(5) * 1e-3, rtol=1e-15)


REFUSED: dict[str, tuple[Callable[[Any], dict[str, Any]], str]] = {
    "a missing time stamp": (
        lambda pa: {"t": pa.array([0, None, 2], pa.timestamp("s")), "u": np.ones(3), "y": np.ones(3)},
        "row 2, column 't': the time stamp is nan",
    ),
    "text that is asked for": (
        lambda _: {"t": [0.0, 1.0], "u": ["1", "2"], "y": [1.0, 2.0]},
        r"log\.parquet: column 'u' holds string, not numbers",
    ),
    "no rows": (
        lambda pa: {"t": pa.array([], pa.float64()), "u": pa.array([], pa.int8()), "y": pa.array([], pa.int8())},
        "0 rows of data, at least 2 are needed",
    ),
}


@every(("columns", "message"), REFUSED.values(), ids=REFUSED)
def test_columns_that_make_no_log_are_refused(
    save: Callable[[Any], Path], columns: Callable[[Any], dict[str, Any]], message: str
) -> None:
    import pyarrow as pa

    path = save(pa.table(columns(pa)))
    with pytest.raises(LogError, match=message):
        read_log(path, input="u", output="y")


def test_twin_names_are_told_apart_by_number(save: Callable[[Any], Path]) -> None:
    import pyarrow as pa

    path = save(pa.table([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]], names=["u", "y", "u"]))
    table = read_columns(path)
    assert [column.tolist() for column in table.columns([2, 0])] == [[5.0, 6.0], [1.0, 2.0]]
    with pytest.raises(LogError, match=r"column 'u' could be any of 0 \('u'\), 2 \('u'\); choose it by its number"):
        table.column("u")


def test_a_file_of_another_format_is_refused(write: Callable[..., Path]) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install 'replant[parquet]'")
    with pytest.raises(LogError, match=r"log\.pq: not a readable Parquet file"):
        read_columns(write("u,y\n1,2\n", "log.pq"))


def flips(content: bytes, tries: int) -> Iterator[bytes]:
    """The content with one bit flipped, at seeded places."""
    for bit in np.random.default_rng(0).integers(0, 8 * len(content), tries).tolist():
        yield content[: bit // 8] + bytes([content[bit // 8] ^ (1 << bit % 8)]) + content[bit // 8 + 1 :]


def full_trace(folder: Path) -> Path:
    rng = np.random.default_rng(0)
    with FullTrace(folder / "trace.parquet", dt=0.1) as file:
        file.take(rp.Trace(("a0", "b0"), np.zeros(2), rng.standard_normal((60, 2)), rng.standard_normal(60)))
    return folder / "trace.parquet"


def recorded_part(folder: Path) -> Path:
    rng, disk_writer = np.random.default_rng(0), DiskWriter(Notices(print))
    recorder = ParquetRecorder(folder, disk_writer)
    u, y = rng.standard_normal((2, 60))
    recorder.add_samples(Batch(u, y, sequence=np.arange(60)), np.arange(60) * 0.1)
    recorder.flush()
    disk_writer.close()
    return folder / "samples" / "part-00000001.parquet"


@pytest.mark.parametrize("make", [full_trace, recorded_part])
def test_a_flipped_bit_in_what_we_write_is_noticed_or_harmless(tmp_path: Path, make: Callable[[Path], Path]) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install 'replant[parquet]'")
    path = make(tmp_path)
    table = read_columns(path)
    expected, refused = table.columns(list(table.names)), 0
    for damaged in flips(path.read_bytes(), 700):
        path.write_bytes(damaged)
        try:
            found = arrow.read_parquet(path).columns(list(table.names))  # no process for each
        except LogError as error:
            refused += 1
            message = str(error)
        else:
            np.testing.assert_array_equal(found, expected)
            continue
        assert message.startswith(f"{path}: ")
        assert "\n" not in message
    assert refused > 200


def test_a_part_that_is_damaged_is_said_when_the_record_goes_on(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install 'replant[parquet]'")
    path = recorded_part(tmp_path)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(
        LogError, match=r"part-00000001\.parquet: not a readable Parquet file .*; write it again, or move"
    ):
        ParquetRecorder(tmp_path, DiskWriter(Notices(print)), go_on=True)


def test_what_has_no_checksums_is_read(save: Callable[[Any], Path]) -> None:
    import pyarrow as pa

    log = read_log(save(pa.table({"u": [1.0, 2.0], "y": [3.0, 4.0]})), input="u", output="y", dt=0.1)
    assert log.output.tolist() == [3.0, 4.0]
