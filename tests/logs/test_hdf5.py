"""HDF5 files and MATLAB files of version 7.3, as h5py and MATLAB write them."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from replant.errors import LogError, MissingDependencyError
from replant.logs import read_columns, read_log
from support.cases import every

pytestmark = pytest.mark.usefixtures("read_here")

h5py = pytest.importorskip("h5py")
K = 50
T = np.arange(K) * 0.1
U = np.column_stack([np.sin(T), np.cos(T)])


def save(path: Path, **datasets: Any) -> Path:
    with h5py.File(path, "w") as file:
        for name, value in datasets.items():
            file.create_dataset(name.replace("__", "/"), data=value)
    return path


def save_matlab(path: Path, **variables: Any) -> Path:
    """Write a file as MATLAB does: 512 bytes of text first, dimensions reversed, the class as an attribute."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            array = np.atleast_2d(np.asarray(value))
            dataset = file.create_dataset(name.replace("__", "/"), data=array.T)
            dataset.attrs["MATLAB_class"] = np.bytes_("double" if array.dtype == np.float64 else "char")
    content = bytearray(path.read_bytes())
    content[:116] = (
        b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Wed May  1 10:00:00 2024 HDF5 schema 1.00 .".ljust(116)
    )
    path.write_bytes(content)
    return path


@pytest.mark.parametrize("suffix", [".h5", ".hdf5"])
def test_data_sets_are_columns_by_their_path(tmp_path: Path, suffix: str) -> None:
    path = save(tmp_path / f"log{suffix}", rig__time=T, rig__u=U, rig__y=T.reshape(-1, 1).astype("f4"), note="rig 7")
    assert read_columns(path).names == ("rig/time", "rig/u[:,0]", "rig/u[:,1]", "rig/y")
    log = read_log(path, input="rig/u[:,1]", output="rig/y", time="rig/time")
    assert log.dt == 0.1
    np.testing.assert_array_equal(log.input, U[:, 1])


@every(
    ("name", "unit", "column", "dt"),
    [
        ("unit", "ms", "rig/time [ms]", 1e-4),
        ("Units", np.bytes_("[min]"), "rig/time [min]", 6.0),
        ("units", ["hours since 2024-05-01 00:00:00"], "rig/time [hours]", 360.0),
        ("units", "1", "rig/time", 0.1),
        ("units", 7, "rig/time", 0.1),
        ("units", "(see the note)", "rig/time", 0.1),
        (None, None, "rig/time", 0.1),
    ],
)
def test_the_time_is_found_by_the_end_of_its_path_and_its_unit_by_an_attribute(
    tmp_path: Path, name: str | None, unit: Any, column: str, dt: float
) -> None:
    path = save(tmp_path / "log.h5", rig__time=T, rig__u=T, rig__y=T)
    with h5py.File(path, "a") as file:
        if name is not None:
            file["rig/time"].attrs[name] = unit
    assert read_columns(path).names == (column, "rig/u", "rig/y")
    assert read_log(path, input="rig/u", output="rig/y").dt == pytest.approx(dt, rel=1e-12)


def test_a_compound_data_set_is_a_table(tmp_path: Path) -> None:
    rows = np.zeros(K, [("t", "f8"), ("u", "i4"), ("name", "S4"), ("xyz", "f4", 3)])
    rows["t"], rows["u"] = T, np.arange(K)
    path = save(tmp_path / "log.h5", table=rows)
    assert read_columns(path).names == ("table.t", "table.u")
    assert read_columns(path).column("table.u").tolist() == list(range(K))


@pytest.mark.parametrize("options", [{"compression": "gzip"}, {"chunks": (7,)}, {"compression": "lzf"}])
def test_filters_of_hdf5(tmp_path: Path, options: dict[str, Any]) -> None:
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file.create_dataset("u", data=U[:, 0], **options)
    np.testing.assert_array_equal(read_columns(tmp_path / "log.h5").column("u"), U[:, 0])


def test_a_number_called_ts_is_the_sampling_time(tmp_path: Path) -> None:
    path = save(tmp_path / "log.h5", rig__u=T, rig__y=T, rig__Ts=0.25)
    assert read_log(path, input="rig/u", output="rig/y").dt == 0.25
    assert read_log(path, input="rig/u", output="rig/y", dt=2.0).dt == 2.0


@pytest.mark.parametrize(("unit", "dt"), [("ms", 0.25), (b"[s]", 250.0), ("min", 15_000.0), ("Hz", None)])
def test_a_sampling_time_has_the_unit_of_its_attribute(tmp_path: Path, unit: str | bytes, dt: float | None) -> None:
    """It is left out if the unit is unknown."""
    path = save(tmp_path / "log.h5", rig__u=T, rig__y=T, rig__Ts=250)
    with h5py.File(path, "a") as file:
        file["rig/Ts"].attrs["units"] = unit
    assert read_columns(path).dt == dt


# --- MATLAB v7.3


@pytest.mark.parametrize("lies", [True, False])
def test_matlab_reverses_dimensions(tmp_path: Path, lies: bool) -> None:
    t = T.reshape(1, -1) if lies else T.reshape(-1, 1)
    path = save_matlab(tmp_path / "log.mat", data__time=t, data__u=U.T if lies else U, data__Ts=0.1)
    names = ("data.u[0,:]", "data.u[1,:]") if lies else ("data.u[:,0]", "data.u[:,1]")
    assert read_columns(path).names == ("data.time", *names)
    log = read_log(path, input=1, output=2)
    assert log.dt == 0.1
    np.testing.assert_array_equal(log.input, U[:, 0])
    np.testing.assert_array_equal(log.output, U[:, 1])


def test_text_of_matlab_is_no_signal(tmp_path: Path) -> None:
    path = save_matlab(tmp_path / "log.mat", u=T.reshape(-1, 1), name=np.frombuffer(b"r\0i\0g\0", np.uint16))
    assert read_columns(path).names == ("u",)


def test_a_file_that_matlab_wrote() -> None:
    folder = Path(scipy.io.__file__).parent / "matlab" / "tests" / "data"
    path = folder / "testhdf5_7.4_GLNX86.mat"
    if not path.is_file():
        pytest.skip("this SciPy is installed without the files of its tests")
    table = read_columns(path)
    assert table.names
    np.testing.assert_allclose(table.column("testdouble"), np.arange(9) * np.pi / 4)


def test_objects_say_what_to_do(tmp_path: Path) -> None:
    path = save_matlab(tmp_path / "log.mat", u=T.reshape(-1, 1))
    with h5py.File(path, "r+") as file:
        dataset = file.create_dataset("speed", data=np.zeros((1, 6), np.uint32))
        dataset.attrs["MATLAB_class"], dataset.attrs["MATLAB_object_decode"] = np.bytes_("timeseries"), np.int32(3)
    message = "speed is a MATLAB timeseries, which MATLAB alone can open; there: t = speed.Time; y = speed.Data"
    assert read_columns(path).names == ("u",)
    with pytest.raises(LogError, match=re.escape(message)):
        read_log(path, input="u", output="speed", dt=0.1)
    with h5py.File(path, "r+") as file:
        del file["u"]
    with pytest.raises(LogError, match=re.escape(message)):
        read_columns(path)


# --- what is refused


def test_a_file_without_a_signal_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no numeric array of two samples or more"):
        read_columns(
            save(tmp_path / "log.h5", note="rig 7", gain=1.0, z=np.zeros(3, complex), cube=np.zeros((2, 2, 2)))
        )


def test_without_h5py_the_message_names_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    paths = save(tmp_path / "log.h5", u=T), save_matlab(tmp_path / "log.mat", u=T)
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(MissingDependencyError, match=r"reading HDF5 needs h5py: pip install 'replant\[hdf5\]'$"):
        read_columns(paths[0])
    with pytest.raises(MissingDependencyError, match=r"save it again in MATLAB with save\(\.\.\., '-v7'\), or inst"):
        read_columns(paths[1])
