"""TDMS files, as npTDMS writes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from replant.errors import LogError
from replant.logs import read_columns, read_log

nptdms = pytest.importorskip("nptdms", reason="npTDMS is in no extra")
K = 40
U, Y = np.random.default_rng(0).standard_normal((2, K))
START = np.datetime64("2024-05-01T10:00:00.000000")


def channel(name: str, values: Any, group: str = "rig", **properties: Any) -> Any:
    return nptdms.ChannelObject(group, name, np.asarray(values), properties={**properties})


def wave(dt: float, offset: float = 0.0, start: Any = START, **more: Any) -> dict[str, Any]:
    return {"wf_start_time": start, "wf_start_offset": offset, "wf_increment": dt, **more}


def save(folder: Path, *segments: list[Any]) -> Path:
    path = folder / "log.tdms"
    with nptdms.TdmsWriter(str(path)) as writer:
        for objects in segments:
            writer.write_segment(objects)
    return path


def test_waveforms_have_their_own_clock(tmp_path: Path) -> None:
    path = save(tmp_path, [channel("u", U, **wave(0.1, unit_string="V")), channel("y", Y, **wave(0.1))])
    assert read_columns(path).names == ("rig/u [V]", "rig/y")
    log = read_log(path, input="rig/u", output="rig/y")
    assert (log.dt, log.input_name) == (0.1, "rig/u [V]")
    np.testing.assert_array_equal(log.output, Y)


def test_several_segments_are_one_channel(tmp_path: Path) -> None:
    parts = [[channel("u", U[a:b], **wave(0.1)), channel("y", Y[a:b], **wave(0.1))] for a, b in ((0, 7), (7, K))]
    np.testing.assert_array_equal(read_log(save(tmp_path, *parts), input=0, output=1).input, U)


@pytest.mark.parametrize("by", ["start", "offset"])
def test_an_input_that_begins_earlier_on_a_coarser_raster(tmp_path: Path, by: str) -> None:
    earlier = np.timedelta64(200_000, "us")
    of_input = wave(0.2, start=START - earlier) if by == "start" else wave(0.2, offset=-0.2)
    path = save(tmp_path, [channel("u", U[: K // 2], "slow", **of_input), channel("y", Y, "fast", **wave(0.1))])
    log = read_log(path, input="slow/u", output="fast/y")
    assert log.dt == 0.1
    np.testing.assert_array_equal(log.output, Y[: len(log)])
    np.testing.assert_array_equal(log.input, np.repeat(U, 2)[2 : 2 + len(log)])


def test_without_waveforms_the_time_is_a_column(tmp_path: Path) -> None:
    stamps = START + np.arange(K) * np.timedelta64(50_000, "us")
    path = save(tmp_path, [channel("t", stamps), channel("u", U), channel("y", Y), channel("note", ["a"] * K)])
    assert read_columns(path).names == ("rig/t", "rig/u", "rig/y")
    assert read_log(path, input="rig/u", output="rig/y").dt == 0.05
    assert read_log(path, input="rig/u", output="rig/y", dt=2.0).dt == 2.0


def test_a_file_without_numbers_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no channel of numbers in the file; choose another file"):
        read_columns(save(tmp_path, [channel("note", ["a", "b"])]))
