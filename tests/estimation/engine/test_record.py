"""Records made ready: of those that were joined each has a level of its own."""

from __future__ import annotations

import numpy as np

from replant.estimation.engine.record import Record


def test_levels_are_taken_off_each_of_the_records_that_were_joined() -> None:
    """Of the outputs the mean of those that were measured; where none was, and in the original, all stays."""
    rng = np.random.default_rng(0)
    u, y = rng.standard_normal((2, 90)) + np.repeat([[5.0, -3.0, 8.0], [100.0, 7.0, -20.0]], 30, axis=1)
    measured = rng.random(90) < 0.8
    measured[60:] = False
    record = Record(u, y, np.array([0.1]), measured=measured, begins=(30, 60))
    before, levelled = u.copy(), record.levelled
    for rows in (slice(0, 30), slice(30, 60), slice(60, 90)):
        np.testing.assert_allclose(levelled.u[rows], u[rows] - u[rows].mean(), atol=1e-13)
        told = measured[rows]
        level = y[rows][told].mean() if told.any() else 0.0
        np.testing.assert_allclose(levelled.y[rows], np.where(told, y[rows] - level, y[rows]), atol=1e-13)
    np.testing.assert_array_equal(u, before)
