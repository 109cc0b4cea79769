"""The column of the reference in logs: by name or number, of every format, held in memory or not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
import scipy.io

import replant as rp
from replant.errors import LogError
from replant.logs import open_recording
from support.cases import every

pytestmark = pytest.mark.usefixtures("read_here")

T, U, Y = np.array([[0.0, 0.1, 0.2, 0.3], [1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0]])
R = np.array([9.0, 10.0, np.nan, 12.0])


@pytest.fixture(params=["csv", "parquet", "npz", "mat"])
def log(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path, columns = tmp_path / f"log.{request.param}", {"t": T, "u": U, "set point [V]": R, "y": Y}
    if request.param == "csv":
        rows = [f"{t},{u},{'' if np.isnan(r) else r},{y}\n" for t, u, r, y in zip(T, U, R, Y, strict=True)]
        path.write_text("t,u,set point [V],y\n" + "".join(rows))
    elif request.param == "parquet":
        pyarrow.parquet.write_table(pyarrow.table(columns), path)
    elif request.param == "npz":
        np.savez(path, **columns)  # type: ignore[arg-type]
    else:
        scipy.io.savemat(path, {"t": T, "u": U, "set_point": R, "y": Y})
    return path


@every("most_held", [0, 4])
def test_it_is_read_beside_the_others(log: Path, most_held: int) -> None:
    name = "set_point" if log.suffix == ".mat" else "set point [V]"
    recording = open_recording(log, input="u", output="y", reference=name, most_held=most_held)
    batches = list(recording.batches())
    for column, expected in zip(zip(*batches, strict=True), (U, Y, R), strict=True):
        np.testing.assert_array_equal(np.concatenate(column), expected)
    assert not recording.complete
    assert recording.dt == pytest.approx(0.1)
    whole = rp.read_log(log, input="u", output="y", reference=name)
    assert whole.reference is not None
    np.testing.assert_array_equal(whole.reference, R)
    np.testing.assert_allclose(whole.time, T)
    assert recording.newest(U[-2:], Y[-2:]).reference_name == whole.reference_name == name


def test_by_number_and_without_a_clock(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("1,2,3\n4,5,6\n")
    log = rp.read_log(path, input=0, output=1, reference=2, dt=0.5)
    assert log.reference is not None
    assert (log.reference.tolist(), log.reference_name, log.time) == ([3.0, 6.0], "2", None)
    assert rp.read_log(path, input=0, output=1, dt=0.5).reference is None


@every(
    ("reference", "words"),
    [
        ("r", "no column 'r'; there are"),
        (7, "no column 7; columns 0 to 3"),
        ("u", "input and reference are the same column 'u'"),
        ("w", "line 3, column 'w'"),
    ],
)
def test_what_is_wrong_is_said_with_file_column_and_row(tmp_path: Path, reference: str | int, words: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,u,y,w\n0,1,2,3\n1,1,2,red\n2,1,2,3\n")
    with pytest.raises(LogError, match=words) as caught:
        rp.read_log(path, input="u", output="y", reference=reference)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_columns_of_one_length(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, t=T, u=U, y=Y, r=R[:3])
    with pytest.raises(LogError, match="column 'u' has 4 samples but 'r' has 3"):
        rp.read_log(path, input="u", output="y", reference="r")


def test_frames_have_it(log: Path) -> None:
    name = "set_point" if log.suffix == ".mat" else "set point [V]"
    read = rp.read_log(log, input="u", output="y", reference=name)
    frame = read.to_pandas()
    assert (list(frame), frame.attrs["reference"]) == (["u", "y", name], name)
    np.testing.assert_array_equal(read.to_xarray()["reference"], R)


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path, of_second = tmp_path / "rig.csv", [4.5, 5.5, 6.5, 7.5]
    rows = zip(T, U, -U, Y, R, of_second, ["09:00:00", "09:00:01", "09:00:02", "09:00:03"], strict=True)
    path.write_text("t,u1,u2,y,r1,r2,at\n" + "".join(",".join(map(str, row)) + "\n" for row in rows))
    return path


def test_several_inputs_have_several(rig: Path) -> None:
    log = rp.read_log(rig, input=["u1", "u2"], output="y", reference=["r1", 5])
    assert (log.reference_names, log.more_references, log.reference_name) == (("r1", "r2"), ("r2",), "r1")
    np.testing.assert_array_equal(log.references, np.column_stack([R, [4.5, 5.5, 6.5, 7.5]]))
    assert list(log.to_pandas()) == ["u1", "y", "u2", "r1", "r2"]
    np.testing.assert_array_equal(log.to_xarray()["reference_2"], [4.5, 5.5, 6.5, 7.5])
    assert rp.detrend(log).reference_names == ("r1", "r2")
    one = rp.read_log(rig, input=["u1", "u2"], output="y", reference=["r1"])
    assert (one.reference_names, one.more_references) == (("r1",), ())
    np.testing.assert_array_equal(one.references, R[:, None])
    none = rp.read_log(rig, input=["u1", "u2"], output="y")
    assert (none.reference_names, none.references) == ((), None)


@every(
    ("references", "words"),
    [
        (["r1", "r1"], "column 'r1' is a reference twice: name each column once"),
        (["r1", "u1"], "column 'u1' is an input and a reference"),
        (["r1", "u2"], "column 'u2' is an input and a reference"),
        (["u2", "r1"], "column 'u2' is a reference and an input"),
        (["r1", "y"], "column 'y' is the output and a reference"),
        (["r1", "r3"], "no column 'r3'"),
    ],
)
def test_what_is_wrong_with_one_of_several_is_said(rig: Path, references: list[str], words: str) -> None:
    with pytest.raises(LogError, match=words) as caught:
        rp.read_log(rig, input=["u1", "u2"], output="y", reference=references, time="t")
    assert "\n" not in str(caught.value)


def test_a_log_in_memory_has_them_by_name() -> None:
    with pytest.raises(rp.InvalidArgumentError, match="more_inputs must be different names of others, got 'u2'"):
        rp.Log(U, Y, 0.1, others={"u2": U}, reference=R, more_inputs=("u2",), more_references=("u2",))
    with pytest.raises(rp.InvalidArgumentError, match="more_references need a reference"):
        rp.Log(U, Y, 0.1, others={"r2": R}, more_references=("r2",))
    with pytest.raises(rp.InvalidArgumentError, match="reference must name a column, got an empty list"):
        rp.read_log("log.csv", input="u", output="y", reference=[])
