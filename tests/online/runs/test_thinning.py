"""Thinning loses no peak, keeps the order of time, and leaves gaps where nothing was measured."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as some

from replant.plotting.over_time import Thinner, thin

signals = some.lists(
    some.one_of(some.floats(-1e3, 1e3), some.just(np.nan), some.just(np.inf)), min_size=1, max_size=400
).map(lambda values: np.array(values, np.float64))


@given(signals, some.integers(2, 100))
def test_every_stretch_keeps_its_extremes(signal: np.ndarray, points: int) -> None:
    drawn = thin(signal, points)
    assert drawn.values.size <= max(points, 2)
    known = np.where(np.isfinite(signal), signal, np.nan)
    if drawn.step == 1.0:
        np.testing.assert_array_equal(drawn.values, known)
        return
    width = round(2 * drawn.step)
    for column, pair in enumerate(drawn.values.reshape(-1, 2)):
        stretch = known[column * width : (column + 1) * width]
        finite = stretch[np.isfinite(stretch)]
        if finite.size == 0:
            assert np.isnan(pair).all()
        else:
            assert {np.nanmin(pair), np.nanmax(pair)} == {finite.min(), finite.max()}


def test_a_signal_that_comes_in_parts_is_thinned_alike() -> None:
    signal, thinner = np.array([0.0, 0.0, 9.0, 0.0, 0.0, -7.0, 0.0, 0.0]), Thinner(length=8, points=4)
    thinner.take(signal[:3])
    thinner.take(signal[3:])
    assert thinner.thinned.values.tolist() == thin(signal, points=4).values.tolist() == [0.0, 9.0, 0.0, -7.0]


def test_extremes_come_in_the_order_of_time() -> None:
    rising = thin(np.arange(1000.0), 20)
    falling = thin(-np.arange(1000.0), 20)
    assert (np.diff(rising.values) > 0).all()
    assert (np.diff(falling.values) < 0).all()


def test_a_spike_of_one_sample_in_a_million_is_drawn_where_it_was() -> None:
    signal = np.zeros(1_000_000)
    signal[123_456] = 7.0
    drawn = thin(signal, 3000)
    assert 0.5 * drawn.places[drawn.values.argmax()] == pytest.approx(123_456 * 0.5, abs=0.5 * 2 * drawn.step)


def test_a_hole_stays_a_hole() -> None:
    signal = np.ones(100_000)
    signal[20_000:60_000] = np.nan
    drawn = thin(signal, 1000)
    at = drawn.places
    inside = (at > 20_500) & (at < 59_500)
    assert np.isnan(drawn.values[inside]).all()
    assert (drawn.values[(at < 19_500) | (at > 60_500)] == 1.0).all()
