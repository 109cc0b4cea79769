"""Measurement data files, as asammdf writes them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from replant.errors import LogError
from replant.logs import read_columns, read_log
from support.damage import is_read_or_refused

asammdf = pytest.importorskip("asammdf", reason="asammdf is in no extra")
K = 40
T = np.arange(K) * 0.01
U, Y = np.random.default_rng(0).standard_normal((2, K))


def signal(name: str, values: Any, t: Any = T, unit: str = "", **more: Any) -> Any:
    return asammdf.Signal(np.asarray(values), np.asarray(t), name=name, unit=unit, **more)


def save(folder: Path, *groups: list[Any], version: str = "4.10") -> Path:
    path = folder / ("log.mf4" if version[0] == "4" else "log.mdf")
    with asammdf.MDF(version=version) as file:
        for number, group in enumerate(groups):
            file.append(group, acq_name=f"raster {number}", common_timebase=True)
        file.save(path, overwrite=True)
    return path


@pytest.mark.parametrize("version", ["4.10", "3.30"])
def test_channels_of_one_group(tmp_path: Path, version: str) -> None:
    path = save(tmp_path, [signal("u", U, unit="V"), signal("y", Y)], version=version)
    assert read_columns(path).names == ("u [V]", "y")
    log = read_log(path, input="u", output="y")
    assert log.dt == 0.01
    np.testing.assert_array_equal(log.input, U)
    np.testing.assert_array_equal(log.output, Y)


def test_groups_of_different_rasters_are_merged(tmp_path: Path) -> None:
    path = save(tmp_path, [signal("y", Y)], [signal("u", U[:4], T[::10])])
    log = read_log(path, input="u", output="y")
    assert (log.dt, len(log)) == (0.01, K)
    np.testing.assert_array_equal(log.input, np.repeat(U[:4], 10))
    assert len(read_columns(path).column("u")) == 4


def test_names_that_several_groups_have(tmp_path: Path) -> None:
    path = save(tmp_path, [signal("speed", Y)], [signal("speed", U), signal("u", U)])
    assert read_columns(path).names == ("raster 0/speed", "raster 1/speed", "u")
    np.testing.assert_array_equal(read_columns(path).column("raster 1/speed"), U)


def test_values_that_the_logger_marked_as_invalid_are_missing(tmp_path: Path) -> None:
    invalid = np.arange(K) % 5 == 0
    path = save(tmp_path, [signal("u", U), signal("y", Y, invalidation_bits=invalid)])
    np.testing.assert_array_equal(read_columns(path).column("y"), np.where(invalid, np.nan, Y))


def test_numbers_with_a_conversion_are_physical(tmp_path: Path) -> None:
    linear = {"a": 0.5, "b": 3.0}
    raw = np.arange(K, dtype=np.uint8)
    path = save(tmp_path, [signal("u", raw, conversion=linear), signal("y", Y)])
    np.testing.assert_array_equal(read_columns(path).column("u"), 0.5 * raw + 3.0)


def test_text_is_no_signal(tmp_path: Path) -> None:
    path = save(tmp_path, [signal("state", np.array([b"RUN", b"STOP"] * (K // 2)), encoding="utf-8"), signal("y", Y)])
    with pytest.raises(LogError, match="column 'state' holds no numbers; choose another column"):
        read_log(path, input="state", output="y")


@pytest.mark.parametrize("content", [slice(700), slice(64, None), b"t,u,y\n0,1,2\n"])
def test_damaged_files_are_refused(tmp_path: Path, content: bytes | slice) -> None:
    path = save(tmp_path, [signal("u", U), signal("y", Y)])
    path.write_bytes(content if isinstance(content, bytes) else path.read_bytes()[content])
    assert not is_read_or_refused(path, read_columns)


def test_a_frozen_program_reads_the_file_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = save(tmp_path, [signal("u", U), signal("y", Y)])
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    np.testing.assert_array_equal(read_log(path, input="u", output="y").output, Y)
