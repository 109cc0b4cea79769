"""What stands behind the axes of a matplotlib figure."""

import numpy as np


def lines(axis):
    """Return the drawn curves by label."""
    return {line.get_label(): line for line in axis.get_lines()}


def points(line):
    """Return time and value of each drawn point."""
    return np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)


def assert_drawn(line, signal, dt, begin=0):
    """Check that every drawn point is one of the signal's, and that none of its extremes is missing."""
    t, values = points(line)
    k = np.rint(t / dt).astype(int)
    np.testing.assert_allclose(t, k * dt, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(values, signal[k])
    shown = signal[begin : k[-1] + 1]
    assert k[0] == begin
    assert (values.min(), values.max()) == (shown.min(), shown.max())
