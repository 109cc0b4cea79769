"""Parts of files, and files that are parts of one record: row groups with a key, files joined, channels together."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from replant.errors import LogError
from replant.logs import Table, open_recording, read_columns
from replant.logs.merged_channels import Signal, channel_table, side_by_side
from replant.logs.recording import joined
from replant.logs.table import at_most

Write = Callable[..., Path]


def of_arrays(name: str, **columns: np.ndarray) -> Table:
    arrays = list(columns.values())
    return Table(Path(name), tuple(columns), lambda numbers: iter([[arrays[n] for n in numbers]]))


def test_of_a_file_of_many_rigs_the_rows_with_a_key_are_read(tmp_path: Path) -> None:
    pa, pq = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    from replant.logs.arrow import RowGroups, first_stamp, read_row_groups

    rigs = pa.array(["a", "b", "a", None]).dictionary_encode()
    one, other = tmp_path / "one.parquet", tmp_path / "other.parquet"
    pq.write_table(pa.table({"rig": rigs, "u": [1.0, 2.0, 3.0, 4.0]}), one, row_group_size=2)
    pq.write_table(pa.table({"rig": rigs, "u": [5.0, 6.0, 7.0, 8.0]}), other)
    of_a = read_row_groups([RowGroups(one, None, "rig", "a"), RowGroups(other, None, "rig", "a")])
    np.testing.assert_array_equal(of_a.column("u"), [1.0, 3.0, 5.0, 7.0])
    assert of_a.describe_row(2) == "row 3 of the 2 files joined in the order of time with rig a"
    np.testing.assert_array_equal(read_row_groups([RowGroups(one, None, "rig", None)]).column("u"), [4.0])
    of_group = read_row_groups([RowGroups(one, (1,))])
    np.testing.assert_array_equal(of_group.column("u"), [3.0, 4.0])
    assert (of_group.approximate_rows, of_group.describe_row(0)) == (2, "row 1 of one.parquet")
    assert first_stamp(RowGroups(one, (1,)), 1) == 3.0
    with pytest.raises(LogError, match="the file has changed since it was looked at"):
        first_stamp(RowGroups(one, (2,)), 1)


def test_files_with_equal_columns_are_one_table_in_any_order_of_their_columns() -> None:
    t, u = np.array([0.0, 1.0]), np.array([5.0, 6.0])
    both = joined([of_arrays("a.csv", t=t, u=u), of_arrays("b.csv", u=u + 2.0, t=t + 2.0)])
    np.testing.assert_array_equal(both.column("t"), [0.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(both.column("u"), [5.0, 6.0, 7.0, 8.0])
    assert both.describe_row(2) == "row 3 of the 2 files joined in the order of time"
    with pytest.raises(LogError, match=r"b\.csv: other columns than in a\.csv"):
        joined([of_arrays("a.csv", t=t), of_arrays("b.csv", v=t)])


def test_stamps_of_files_that_count_from_their_own_dates_go_on_from_the_first() -> None:
    t = np.array([0.0, 1.0])
    one = Table(Path("a.csv"), ("t",), lambda numbers: iter([[t]]), in_seconds=frozenset({0}), origins={0: 10**9})
    other = Table(Path("b.csv"), ("t",), lambda numbers: iter([[t]]), in_seconds=frozenset({0}), origins={0: 5 * 10**9})
    np.testing.assert_array_equal(joined([one, other]).column("t"), [0.0, 1.0, 4.0, 5.0])
    undated = Table(Path("c.csv"), ("t",), lambda numbers: iter([[t]]), in_seconds=frozenset({0}))
    with pytest.raises(LogError, match="its dates or time stamps are counted from its own first row"):
        joined([one, undated])


def test_json_lines_with_whole_dates_go_on_from_the_first_file(write: Write) -> None:
    rows = [f'{{"t": "2024-05-01T10:00:0{k}", "u": {k}}}\n' for k in range(4)]
    one, other = write("".join(rows[:2]), "a.jsonl"), write("".join(rows[2:]), "b.jsonl")
    assert joined([read_columns(one), read_columns(other)]).column("t").tolist() == [0.0, 1.0, 2.0, 3.0]


def test_channels_are_looked_at_side_by_side_at_the_stamps_of_the_finest() -> None:
    u = ("u", lambda: Signal(np.array([0.5, 2.0]), np.array([1.0, 2.0])))
    y = ("y", lambda: Signal(np.arange(4.0) + 10.0, np.zeros(4)))
    late = ("late", lambda: Signal(np.array([12.0, 13.0]), np.array([7.0, 8.0])))
    table = side_by_side(channel_table(Path("log.mf4"), [u, y, late]))
    assert table.names == ("u", "y", "late", "time")
    np.testing.assert_array_equal(table.column("u"), [2.0, 2.0, 2.0, 2.0])
    np.testing.assert_array_equal(table.column("late"), [np.nan, np.nan, 7.0, 8.0])
    np.testing.assert_array_equal(table.column("time"), [0.0, 1.0, 2.0, 3.0])


def test_a_unit_of_time_that_is_guessed_is_said(write: Write) -> None:
    rows = "0,1,0\n20,1,0.5\n40,1,0.75\n"
    taken = "its name states no unit; its steps of 20 are taken as seconds, and may be milliseconds or less"
    for name in "ta":
        doubt = open_recording(write(f"{name},u,y\n{rows}"), input="u", output="y", time=name).doubt
        assert doubt.startswith(f"column {name!r}: {taken}; if they are, name the column {name}_ms")
    for name, clock in (("t [ms]", {}), ("a", {"dt": 1.0}), ("t", {"dt": 20.0})):
        assert open_recording(write(f"{name},u,y\n{rows}"), input="u", output="y", **clock).doubt == ""


def test_more_parts_of_a_file_than_a_log_has_are_refused() -> None:
    assert list(at_most(Path("log.h5"), "ab", "data sets", most=2)) == ["a", "b"]
    with pytest.raises(LogError, match=r"log\.h5: more than 2 data sets; write the log's signals into a file of their"):
        list(at_most(Path("log.h5"), "abc", "data sets", most=2))
