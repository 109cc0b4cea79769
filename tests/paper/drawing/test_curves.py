"""Thinning for drawing: nothing invented, no peak lost."""

import numpy as np

from replant import Trace
from replant.paper.tables import curve, thin, transients
from support.cases import every


@every("size", [1, 2, 10, 99, 100, 101, 250, 1000, 1001, 7919])
def test_every_point_is_the_signals_own_and_no_peak_is_lost(size):
    signal = np.random.default_rng(size).standard_normal(size)
    kept = thin(signal, points=100)
    assert (np.diff(kept) > 0).all()
    assert kept[0] == 0
    assert kept[-1] == size - 1
    assert kept.size <= 102
    stretch = -(-size // 50)
    for start in range(0, size, stretch):
        part = signal[start : start + stretch]
        drawn = signal[kept[(kept >= start) & (kept < start + stretch)]]
        assert (drawn.min(), drawn.max()) == (part.min(), part.max())


def test_a_short_signal_is_drawn_whole():
    np.testing.assert_array_equal(thin(np.zeros(50), points=50), np.arange(50))


def test_time_is_that_of_the_samples():
    signal = np.zeros(1000)
    signal[617] = 1.0
    drawn = curve(signal, dt=0.5, points=10)
    assert drawn.values[drawn.t == 617 * 0.5] == [1.0]


def test_transients_begin_at_the_start_not_after_the_first_update():
    trace = Trace(("a0", "b0"), np.array([1.0, 2.0]), np.array([[3.0, 4.0], [5.0, 6.0]]), np.zeros(2))
    drawn = transients(trace, dt=0.1)
    assert list(drawn) == ["a0", "b0"]
    assert drawn["b0"].t.tolist() == [0.0, 0.1]
    assert drawn["b0"].values.tolist() == [2.0, 4.0]
