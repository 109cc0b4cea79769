"""Rig time: stamps that only advance are kept, late ones stay late, and a clock set back continues after a gap."""

from __future__ import annotations

import numpy as np
import pytest

from replant.live.progress import RigClock
from support.cases import every
from support.live_fakes import DT


def test_a_clock_that_only_goes_on_is_left_alone() -> None:
    clock = RigClock()
    stamps = np.array([1e9, 1e9 + DT, 1e9 + 86400.0])  # and one that jumps ahead by a day is a gap by itself
    assert clock.follow(stamps, DT) is stamps


@every(
    ("before", "stamps"),
    [([10.0, 10.05], [9.9, 9.95, 10.1, np.nan, 10.15]), ([1000.0], [3.0, 1000.05])],
    ids=["late samples", "a single stamp far back"],
)
def test_late_samples_stay_late_and_a_single_stamp_far_back_is_no_restart(
    before: list[float], stamps: list[float]
) -> None:
    clock = RigClock()
    clock.follow(np.array(before), DT)
    np.testing.assert_array_equal(clock.follow(np.array(stamps), DT), stamps)
    assert clock.offset == 0.0


def test_a_clock_set_back_by_a_day_goes_on_after_a_gap() -> None:
    clock = RigClock()
    clock.follow(1e6 + DT * np.arange(10), DT)
    last = clock.last
    rig = clock.follow(1e6 - 86400.0 + DT * np.arange(5), DT)
    assert rig[0] < last  # this one is rejected
    assert (np.diff(rig[1:]) > 0).all()
    assert rig[1] - last > 20 * DT
    again = RigClock(clock.last, clock.offset)  # as after a resumption
    assert again.follow(np.array([1e6 - 86400.0 + 5 * DT]), DT)[0] == pytest.approx(rig[-1] + DT)


@pytest.mark.parametrize(("later", "last"), [(6.25, 106.25), (6.375, 100.0)])
def test_a_leap_is_confirmed_within_fifty_sampling_times(later: float, last: float) -> None:
    """Beyond, the rig is one whose stamps all leap, of which the stamp before counts."""
    clock = RigClock()
    clock.follow(np.array([0.0, 0.125, 100.0, 100.0 + later]), 0.125)
    assert clock.last == last
