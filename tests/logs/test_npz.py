"""NumPy archives."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from replant.errors import LogError
from replant.logs import read_columns, read_log
from support.cases import every


def test_vectors_and_columns_of_matrices_are_columns(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    signals = np.arange(12.0).reshape(6, 2)
    np.savez(path, t=np.arange(6) * 0.5, signals=signals, rate=2.0, names=np.array(["a", "b"]))
    assert read_columns(path).names == ("t", "signals[:,0]", "signals[:,1]")
    log = read_log(path, input="signals[:,0]", output=2)
    np.testing.assert_array_equal(log.input, signals[:, 0])
    np.testing.assert_array_equal(log.output, signals[:, 1])
    assert log.dt == 0.5


def test_a_compressed_archive_is_read(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez_compressed(path, u=np.arange(5, dtype=np.int32), y=np.ones(5, dtype=bool))
    u, y = read_columns(path).columns(["u", "y"])
    assert u.dtype == y.dtype == np.float64
    assert (u.sum(), y.sum()) == (10.0, 5.0)


def test_python_objects_are_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, u=np.arange(5.0), thing=np.array([{}, []], dtype=object))
    assert read_columns(path).names == ("u",)


def test_a_column_does_not_alias_the_table(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, u=np.arange(5.0))
    table = read_columns(path)
    table.column("u")[:] = -1.0
    assert table.column("u").tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


@every(
    ("sizes", "given", "message"),
    [
        ({"u": 5, "y": 7}, {"dt": 0.1}, r"log\.npz: column 'u' has 5 samples but 'y' has 7"),
        ({"u": 5, "y": 5, "t": 4}, {}, "column 'u' has 5 samples but 't' has 4"),
        ({"gain": 1}, {}, "no numeric array of two samples or more"),
    ],
    ids=["signals", "time", "no signal"],
)
def test_arrays_that_are_not_samples_of_one_clock_are_refused(
    tmp_path: Path, sizes: dict[str, int], given: dict[str, float], message: str
) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, **{name: np.arange(float(size)) if size > 1 else 1.0 for name, size in sizes.items()})
    with pytest.raises(LogError, match=message):
        read_log(path, input="u", output="y", **given)


@pytest.mark.parametrize("content", [b"u,y\n1,2\n", b"PK\x03\x04broken"])
def test_a_file_that_is_not_an_archive_is_refused(write: Callable[..., Path], content: bytes) -> None:
    with pytest.raises(LogError, match=r"log\.npz: not a readable \.npz archive .*; save it with numpy\.savez"):
        read_columns(write(content, "log.npz"))


def test_a_number_called_ts_is_the_sampling_time(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, u=np.arange(9.0), y=np.ones(9), Ts=0.25)
    assert read_log(path, input="u", output="y").dt == 0.25


def test_a_wide_matrix_has_its_signals_in_rows(tmp_path: Path) -> None:
    signals = np.arange(12.0).reshape(2, 6)
    np.savez(tmp_path / "log.npz", signals=signals, cube=np.ones((1, 1, 6)))
    table = read_columns(tmp_path / "log.npz")
    assert table.names == ("signals[0,:]", "signals[1,:]", "cube")
    np.testing.assert_array_equal(table.column(1), signals[1])
