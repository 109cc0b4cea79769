"""The history of the estimate: the whole run in bounded memory."""

from __future__ import annotations

import numpy as np

from replant.live.make_view import MOST_ROWS, EstimateHistory


def test_the_history_covers_the_whole_run_in_bounded_memory() -> None:
    history = EstimateHistory(1)
    for k in range(10_000):
        history.append(float(k), np.array([k + 0.5]), np.array([0.1]))
        rows = history.rows()
        assert rows.t.size <= MOST_ROWS
        assert rows.t[-1] == k
    assert rows.t[0] == 0.0
    apart = np.diff(rows.t)[:-1]  # the newest is shown wherever it stands
    assert set(apart) == {16.0}
    np.testing.assert_array_equal(rows.parameters[:, 0], rows.t + 0.5)
    np.testing.assert_array_equal(EstimateHistory.of(rows).rows().t, rows.t)
