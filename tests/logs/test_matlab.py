"""MATLAB files: variables, columns of matrices, fields of structs."""

from __future__ import annotations

import io
import struct
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from scipy.io.matlab import MatlabObject

from replant.errors import LogError
from replant.logs import read_columns, read_log
from replant.logs.hdf5 import _sizes, _unpacked_size
from support.cases import every

pytestmark = pytest.mark.usefixtures("read_here")

HDF5 = b"\x89HDF\r\n\x1a\n"
K = 50
T = np.arange(K) * 0.1
U = np.column_stack([np.sin(T), np.cos(T)])


def save(folder: Path, **variables: object) -> Path:
    path = folder / "log.mat"
    scipy.io.savemat(path, variables)
    return path


@pytest.mark.parametrize("shape", [(K, 1), (1, K)])
def test_row_and_column_vectors_are_signals(tmp_path: Path, shape: tuple[int, int]) -> None:
    path = save(tmp_path, time=T.reshape(shape), u=U[:, 0].reshape(shape), y=U[:, 1].reshape(shape))
    log = read_log(path, input="u", output="y")
    assert (log.input_name, log.output_name, log.dt) == ("u", "y", 0.1)
    np.testing.assert_array_equal(log.input, U[:, 0])
    np.testing.assert_array_equal(log.time, T)


def cells(*held: object) -> np.ndarray:
    """Return a cell array, as SciPy has it."""
    found = np.empty((1, len(held)), object)
    for number, each in enumerate(held):
        found[0, number] = each
    return found


def iddata(**fields: object) -> MatlabObject:
    """Return an object of the System Identification Toolbox, whose fields SciPy reads."""
    held = np.empty((1, 1), [(name, object) for name in fields])
    held[0, 0] = tuple(fields.values())
    return MatlabObject(held, "iddata")


SIGNALS = {
    "columns of a matrix": (
        {"rig_dat": np.column_stack([T, U])},
        ("rig_dat[:,0]", "rig_dat[:,1]", "rig_dat[:,2]"),
        {"time": "rig_dat[:,0]", "input": "rig_dat[:, 1]", "output": 2},
        0.1,
    ),
    "rows of a wide matrix": (
        {"d": U.T}, ("d[0,:]", "d[1,:]"), {"input": "d[0,:]", "output": "d[1,:]", "dt": 0.1}, 0.1,
    ),
    "fields of a struct": (
        {"data": {"time": T, "udat": U, "inner": {"deep": T}, "note": "rig 7", "Ts": 0.1}, "gain": 3.0},
        ("data.time", "data.udat[:,0]", "data.udat[:,1]"),
        {"input": "data.udat[:,0]", "output": "data.udat[:,1]"},
        0.1,  # from data.time
    ),
    # as a recorder writes them: one struct for the time, and one for each signal
    "structs within a struct": (
        {
            "rec": {
                "X": {"Data": T},
                "Y": np.array([(U[:, 0], "V"), (U[:, 1], "rpm")], dtype=[("Data", object), ("Unit", object)]),
                "Note": "a run",
            }
        },
        ("rec.X.Data", "rec.Y(1).Data", "rec.Y(2).Data"),
        {"time": "rec.X.Data", "input": "rec.Y(1).Data", "output": "rec.Y(2).Data"},
        0.1,
    ),
    "fields of an iddata object": (
        {
            "data": iddata(
                Domain="Time", OutputData=cells(U[:, 1:]), InputData=cells(U[:, :1]), InputName=cells("u1"),
                Ts=cells(0.25),
            ),
            "n": 3.0,
        },
        ("data.OutputData", "data.InputData"),
        {"input": "data.InputData", "output": "data.OutputData"},
        0.25,
    ),
}  # fmt: skip


@every(("variables", "names", "choice", "dt"), SIGNALS.values(), ids=SIGNALS)
def test_columns_of_matrices_and_fields_of_structs_are_signals(
    tmp_path: Path, variables: dict[str, Any], names: tuple[str, ...], choice: dict[str, Any], dt: float
) -> None:
    path = save(tmp_path, **variables)
    assert read_columns(path).names == names
    log = read_log(path, **choice)
    assert log.dt == dt
    np.testing.assert_array_equal(log.input, U[:, 0])
    np.testing.assert_array_equal(log.output, U[:, 1])
    assert log.input.flags.c_contiguous


@every(
    ("variables", "choice", "message"),
    [
        ({"other": T, "rig": U}, ("rig", "other"),
         r"no column 'rig' \(did .*\); there are: rig\[:,0\], rig\[:,1\], other$"),
        ({"u": T, "y": T[:-1]}, ("u", "y"), rf"log.mat: column 'u' has {K} samples but 'y' has {K - 1}"),
    ],
    ids=["the name of a matrix lists its columns", "signals of different lengths"],
)  # fmt: skip
def test_columns_that_make_no_log_are_refused(
    tmp_path: Path, variables: dict[str, object], choice: tuple[str, str], message: str
) -> None:
    path = save(tmp_path, **variables)
    with pytest.raises(LogError, match=message):
        read_log(path, input=choice[0], output=choice[1], dt=0.1)


def test_of_several_times_the_one_of_the_same_length_counts(tmp_path: Path) -> None:
    path = save(tmp_path, data={"time": T, "u": U}, step={"time": T[:9], "y": U[:9]})
    assert read_log(path, input="data.u[:,0]", output="data.u[:,1]").dt == 0.1
    path = save(tmp_path, data={"time": T, "u": U}, step={"time": T, "y": U})
    with pytest.raises(LogError, match=r"several columns could be the time: 'data\.time', 'step\.time'; name"):
        read_log(path, input="data.u[:,0]", output="data.u[:,1]")


def test_integers_and_logicals_become_float64(tmp_path: Path) -> None:
    path = save(tmp_path, u=np.arange(3, dtype=np.int16), y=np.array([True, False, True]), z=np.arange(3, dtype="f4"))
    for column in read_columns(path).columns(["u", "y", "z"]):
        assert column.dtype == np.float64
    assert read_columns(path).column("y").tolist() == [1.0, 0.0, 1.0]


def test_a_file_without_a_signal_is_refused(tmp_path: Path) -> None:
    path = save(tmp_path, name="rig", gain=1.0, cube=np.zeros((2, 2, 2)), z=np.zeros(3) + 1j)
    with pytest.raises(LogError, match=r"log.mat: no numeric array of two samples or more"):
        read_columns(path)


SAVE_AGAIN = r"v7\.3 \(HDF5\) file; save it again in MATLAB with save\(\.\.\., '-v7'\)"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"t,u,y\n0,1,2\n" * 20, r"log\.mat: "),
        (b"x", r"log\.mat: "),
        (bytes(200), r"log\.mat: "),
        (b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + HDF5, SAVE_AGAIN),
        (HDF5 + bytes(99), SAVE_AGAIN),
    ],
    ids=["text", "one byte", "zeros", "v7.3", "HDF5"],
)
def test_a_file_of_another_format_is_refused(write: Callable[..., Path], content: bytes, message: str) -> None:
    with pytest.raises(LogError, match=message) as caught:
        read_columns(write(content, "log.mat"))
    assert "\n" not in str(caught.value)


def test_every_kind_of_array_comes_back_to_the_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    kinds = ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "?"]
    arrays = {f"x{k}": (100 * rng.standard_normal((7, 3))).astype(kind) for k, kind in enumerate(kinds)}
    path = save(tmp_path, **arrays, empty=np.zeros((0, 3)), scalar=1.5)
    monkeypatch.setattr(sys, "frozen", False)
    table = read_columns(path)
    assert table.names == tuple(f"{name}[:,{column}]" for name in arrays for column in range(3))
    expected = np.hstack([array.astype(np.float64) for array in arrays.values()]).T
    np.testing.assert_array_equal(table.columns(list(table.names)), expected)
    monkeypatch.setattr(sys, "frozen", True)  # where there is no interpreter to start
    np.testing.assert_array_equal(read_columns(path).columns(list(table.names)), expected)


# --- what Simulink logs, sampling times, objects


def test_a_number_called_ts_is_the_sampling_time(tmp_path: Path) -> None:
    path = save(tmp_path, data={"u": T, "y": T, "Ts": 0.25})
    assert read_log(path, input="data.u", output="data.y").dt == 0.25
    assert read_log(path, input="data.u", output="data.y", dt=2.0).dt == 2.0
    assert read_log(save(tmp_path, u=T, y=T, t=T, Ts=0.25), input="u", output="y").dt == 0.1


def test_sampling_times_that_differ_or_are_none(tmp_path: Path) -> None:
    path = save(tmp_path, a={"u": T, "y": T, "Ts": 0.25}, b={"u": T, "y": T, "Ts": 0.5})
    with pytest.raises(LogError, match="no column is called t, time or timestamp; name the time column"):
        read_log(path, input="a.u", output="a.y")
    with pytest.raises(LogError, match=r"Ts is the sampling time, and must be finite and positive; it is -1\.0"):
        read_columns(save(tmp_path, u=T, y=T, Ts=-1.0))


@pytest.mark.parametrize("flat", [True, False])
def test_a_structure_with_time_of_simulink(tmp_path: Path, flat: bool) -> None:
    """A scalar signal lies in a vector, or along the third dimension."""
    shape = (K, 1) if flat else (1, 1, K)
    signals = [{"values": U[:, k].reshape(shape), "label": f"signal {k}", "dimensions": 1.0} for k in range(2)]
    both = np.empty((1, 2), [(name, object) for name in signals[0]])
    for k, signal in enumerate(signals):
        both[0, k] = tuple(signal.values())
    path = save(tmp_path, scope={"time": T, "signals": both, "blockName": "rig/Scope"})
    assert read_columns(path).names == ("scope.time", "scope.signals(1).values", "scope.signals(2).values")
    log = read_log(path, input=1, output=2)
    assert log.dt == 0.1
    np.testing.assert_array_equal(log.output, U[:, 1])
    path = save(tmp_path, scope={"time": T, "signals": signals[0]})
    assert read_columns(path).names == ("scope.time", "scope.signals.values")


def element(kind: int, content: bytes) -> bytes:
    """Return an element of a MATLAB file of version 5, with its tag and its padding."""
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def matlab_object(name: str, kind: str) -> bytes:
    """Return a variable that holds an object, as MATLAB writes it: name, class, number among all objects."""
    int8, int32, uint32, matrix = 1, 5, 6, 14
    numbers = element(uint32, struct.pack("<II", 13, 0)) + element(int32, struct.pack("<ii", 6, 1)) + element(int8, b"")
    numbers += element(uint32, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1))
    strings = b"".join(element(int8, text.encode()) for text in (name, "MCOS", kind))
    return element(matrix, element(uint32, struct.pack("<II", 17, 0)) + strings + element(matrix, numbers))


@pytest.mark.parametrize("frozen", [True, False])
def test_an_object_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, frozen: bool) -> None:
    monkeypatch.setattr(sys, "frozen", frozen, raising=False)
    path = save(tmp_path, u=T)
    alone = path.read_bytes()[:128] + matlab_object("speed", "timeseries")
    path.write_bytes(path.read_bytes() + matlab_object("speed", "timeseries"))
    message = r"speed is a MATLAB timeseries, which MATLAB alone can open; there: t = speed\.Time; y = speed\.Data"
    assert read_columns(path).names == ("u",)
    with pytest.raises(LogError, match=message):
        read_log(path, input="u", output="speed", dt=0.1)
    path.write_bytes(alone)
    with pytest.raises(LogError, match=message):
        read_columns(path)


def test_each_experiment_of_an_iddata_object_has_its_columns(tmp_path: Path) -> None:
    data = iddata(OutputData=cells(U[:, :1], U[:9, 1:]), InputData=cells(U, U[:9]), Ts=cells(0.25, 0.25))
    path = save(tmp_path, data=data)
    assert read_columns(path).names == (
        "data.OutputData{1}", "data.OutputData{2}", "data.InputData{1}[:,0]", "data.InputData{1}[:,1]",
        "data.InputData{2}[:,0]", "data.InputData{2}[:,1]",
    )  # fmt: skip
    log = read_log(path, input="data.InputData{2}[:,0]", output="data.OutputData{2}")
    assert (log.dt, len(log)) == (0.25, 9)


@pytest.mark.parametrize(
    ("unit", "dt"), [("milliseconds", 0.02), ("minutes", 1200.0), ("", 20.0), ("days", 1_728_000.0), ("years", None)]
)
def test_the_sampling_time_of_an_iddata_object_has_its_unit(tmp_path: Path, unit: str, dt: float | None) -> None:
    data = iddata(OutputData=cells(U[:, :1]), InputData=cells(U[:, 1:]), Ts=cells(20.0), TimeUnit=unit)
    assert read_columns(save(tmp_path, data=data)).dt == (None if dt is None else pytest.approx(dt))


def test_a_packed_element_is_as_long_as_what_it_holds_and_no_byte_behind_it_counts() -> None:
    content = np.random.default_rng(0).integers(0, 4, 700_000, np.uint8).tobytes()
    packed = zlib.compress(content)
    assert _unpacked_size(io.BytesIO(packed + packed), len(packed)) == len(content)
    assert _unpacked_size(io.BytesIO(packed[:1000]), len(packed)) < len(content)  # the file ends before
    assert _unpacked_size(io.BytesIO(packed), 0) == 0


@pytest.mark.parametrize("packed", [False, True])
def test_the_lengths_of_the_variables_are_those_of_the_file_unpacked(tmp_path: Path, packed: bool) -> None:
    """The lengths of a compressed file are found without reading it into memory."""
    path = tmp_path / "log.mat"
    scipy.io.savemat(path, {"u": T, "cube": np.zeros((20, 30, 40))}, do_compression=packed)
    lengths = list(_sizes(path, path.read_bytes()[:128]))
    assert len(lengths) == 2
    for length, held in zip(lengths, (8 * T.size, 8 * 20 * 30 * 40), strict=True):
        assert held <= length < held + 128
