"""The clock of a record: the time of a sample, however the stamps come."""

from __future__ import annotations

import numpy as np
import pytest

from replant.online.runs.result import Clock, ClockRecorder
from support.cases import every

STAMPS = np.array([5.0, 6.0, 7.2, 8.0, 40.0, 41.0, 42.0])


def test_on_a_regular_clock_a_sample_is_its_number_times_the_sampling_time() -> None:
    clock = Clock.of(0.1, None)
    assert not clock.irregular
    np.testing.assert_array_equal(clock.at(np.arange(5)), 0.1 * np.arange(5))
    np.testing.assert_array_equal(clock.after(np.arange(1, 5)), 0.1 * np.arange(1, 5))
    assert clock.duration(30) == 30 * 0.1
    assert clock.gaps.shape == (0, 2)


def test_on_an_irregular_clock_it_is_its_stamp() -> None:
    clock = Clock.of(1.0, STAMPS)
    assert clock.irregular
    np.testing.assert_allclose(clock.at(np.arange(7)), STAMPS - 5.0)
    np.testing.assert_allclose(clock.at(np.array([1.5, 8.0])), [1.6, 39.0])  # between two samples, and beyond the last
    np.testing.assert_allclose(clock.after(np.array([1, 7])), [1.0, 38.0])
    assert (clock.shortest, clock.longest) == (pytest.approx(0.8), 32.0)
    np.testing.assert_allclose(clock.gaps, [[3.0, 35.0]])
    np.testing.assert_allclose(clock.at(np.array([3.0, 3.5, 4.0, 4.5])), [3.0, 3.5, 35.0, 35.5])  # none within the gap
    assert float(clock.at(3.5)) == 3.5


@every("size", [1, 3, 50, 1000])
def test_the_batches_do_not_matter(size: int) -> None:
    stamps = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 1000))
    whole, parts = Clock.of(1.0, stamps), ClockRecorder(1.0, 1000, 1000)
    for begin in range(0, 1000, size):
        parts.take(stamps[begin : begin + size])
    np.testing.assert_array_equal(parts.clock.times, whole.times)
    assert (parts.clock.shortest, parts.clock.longest) == (whole.shortest, whole.longest)


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_of_a_long_record_few_stamps_are_kept_and_tell_the_time_nearly(size: int) -> None:
    stamps = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 1000))
    recorder = ClockRecorder(1.0, 1000, 50)
    for begin in range(0, 1000, size):
        recorder.take(stamps[begin : begin + size])
    clock = recorder.clock
    assert clock.times is not None
    assert clock.times.size <= 51
    assert clock.duration(1000) == pytest.approx(stamps[-1] - stamps[0] + 1.0)
    np.testing.assert_allclose(clock.at(np.arange(1000)), stamps - stamps[0], atol=10.0)


def test_without_a_sample_there_is_no_irregular_clock() -> None:
    assert not Clock.of(1.0, np.empty(0)).irregular
    assert not ClockRecorder(1.0, 0, 0).clock.irregular
    assert Clock(1.0).duration(0) == 0.0
