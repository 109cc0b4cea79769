"""Signals are thinned to least and greatest values, at every zoom, and no peak is lost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from replant.workbench.choices import Setup
from replant.workbench.drawn_samples import (
    BUCKET,
    CancelledError,
    Clock,
    Column,
    Samples,
    buckets_of,
    doubts,
    thinned,
)
from replant.workbench.tasks import Excerpt, conditioned, look
from support.cases import every


def column(values: np.ndarray) -> Column:
    return Column(values, buckets_of(values))


@every("rows", [0, 1, BUCKET - 1, BUCKET, 5 * BUCKET + 3, 200_003])
def test_every_peak_is_within_what_is_drawn(rows: int) -> None:
    values = np.random.default_rng(1).standard_normal(rows)
    values[rows // 2 : rows // 2 + 1] = 1e6
    values[rows // 3 : rows // 3 + 2] = np.nan
    drawn = column(values)
    for points in (16, 100, 1000):
        for first, last in ((0, rows), (rows // 4, 3 * rows // 4), (rows // 2, rows // 2 + 9)):
            last = min(last, rows)
            places, low, high = drawn.between(first, last, points)
            seen = values[first:last]
            assert places.size == low.size == high.size <= max(points, 1)
            if np.isfinite(seen).any():
                assert np.nanmax(high) >= np.nanmax(seen)
                assert np.nanmin(low) <= np.nanmin(seen)
            assert (np.diff(places) > 0).all()


def test_as_one_zooms_in_each_sample_is_shown() -> None:
    values = np.arange(100_000.0)
    places, low, high = column(values).between(500, 900, 1000)
    assert low is high
    np.testing.assert_array_equal(low, values[500:900])
    np.testing.assert_array_equal(places, np.arange(500, 900))


def test_an_irregular_clock_keeps_its_times() -> None:
    times = column(np.array([10.0, 11.0, 14.0, 15.0]))
    clock = Clock(0, 0.001, 1.0)
    np.testing.assert_allclose(clock.at(times, np.array([0.0, 1.5, 3.0])), [0.0, 0.0025, 0.005])
    assert clock.rows(times, 4, (0.0035, 0.0045)) == (1, 4)
    assert clock.ends(times, 4) == pytest.approx([0.0, 0.005])


def test_columns_come_from_the_file_and_reading_can_be_stopped(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text("t,u,y\n" + "".join(f"{k / 10},{k % 3},{k}\n" for k in range(1000)))
    samples = Samples(path)
    with pytest.raises(CancelledError):
        samples.read([0, 1], lambda rows, about: False)
    assert samples.columns == {}
    samples.read([0, 1, 2], lambda rows, about: True)
    drawn = samples.drawn([1, 2], Clock(0, 1.0, 0.1), (10.0, 20.0), 400)
    assert drawn["columns"]["2"][0] == list(range(99, 202))
    assert drawn["t"][0] == pytest.approx(9.9)
    samples.close()


def test_a_thinned_curve_keeps_its_extremes() -> None:
    t = np.arange(10_000.0)
    signal = np.where(t == 5_003, 7.0, 0.0)
    found = thinned(t, signal, slice(0, 10_000), 100)
    assert max(found["high"]) == 7.0
    assert len(found["t"]) == 100
    assert thinned(t, signal, slice(5_000, 5_010), 100)["high"] is None


def test_doubts_name_gaps_missing_outputs_and_stuck_sensors_but_no_rest() -> None:
    t = np.concatenate([np.arange(300.0), 400.0 + np.arange(300.0)])
    rng = np.random.default_rng(2)
    u, y = rng.standard_normal(600), rng.standard_normal(600)
    y[100:150], y[200:220] = 3.5, np.nan
    found = doubts(t, u, y)
    assert [(each.begin, each.end) for each in found] == [(100.0, 150.0), (200.0, 220.0), (299.0, 400.0)]
    assert "stays at 3.5" in found[0].what
    u[90:160] = 0.0  # the input rests as well: the output may
    assert [each.begin for each in doubts(t, u, y)] == [200.0, 299.0]
    assert doubts(np.zeros(0), None, None) == []


def test_what_is_left_out_of_a_file_is_said(motor: Path) -> None:
    motor.write_text("Motor of rig 7\n" + motor.read_text())
    assert ["Note", "line 1 is above the names, and left out"] in look(str(motor), ("", "", ""))["findings"]


@pytest.mark.parametrize("stamped", [False, True])
def test_a_decimated_log_is_drawn_at_its_times_in_the_file(tmp_path: Path, stamped: bool) -> None:
    """The output is the time in the file, which filter and decimation keep."""
    path = tmp_path / "log.csv"
    path.write_text("t,u,y\n" + "".join(f"{0.1 * k:.1f},{k % 7},{0.1 * k:.1f}\n" for k in range(500)))
    clock = {"time": "t"} if stamped else {"dt": 0.1}
    shown = Excerpt(str(path), 0.0, Setup("u", "y", decimate=4, **clock), None, None, 1000)
    drawn = conditioned(shown)["signals"]["output"]
    np.testing.assert_allclose(drawn["t"], drawn["low"], atol=1e-3)
