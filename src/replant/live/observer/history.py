"""History: the estimate over a run of any length, in bounded memory."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.live.observer.view import Rows

MOST_ROWS = 1000  # rows of history kept [rows]


class EstimateHistory:
    """Rows of (t, parameters, std), one for each view; when there are too many, every second row is dropped.

    >>> history = EstimateHistory(1)
    >>> for k in range(5000):
    ...     history.append(float(k), np.array([0.5]), np.array([0.1]))
    >>> rows = history.rows()
    >>> rows.t.size <= MOST_ROWS, rows.t[[0, -1]]
    (True, array([   0., 4999.]))
    """

    def __init__(self, size: int) -> None:
        self._table = np.empty((MOST_ROWS, 1 + 2 * size))
        self._size = size
        self.clear()

    def clear(self) -> None:
        """Drop every row."""
        self._rows = self._appended = 0
        self._stride = 1  # of the rows appended, one in so many stays
        self._newest_stays = True

    def restore(self, rows: Rows) -> None:
        """Append the rows of an earlier history."""
        for t, parameters, std in zip(rows.t.tolist(), rows.parameters, rows.std, strict=True):
            self.append(t, parameters, std)

    def append(self, t: float, parameters: FloatArray, std: FloatArray) -> None:
        """Append the newest row.  It stays if its number is a multiple of the stride; else the next row replaces it."""
        if self._rows and not self._newest_stays:
            self._rows -= 1
        if self._rows == MOST_ROWS:
            self._table[: MOST_ROWS // 2] = self._table[::2].copy()
            self._rows = MOST_ROWS // 2
            self._stride *= 2
        self._table[self._rows] = np.concatenate([[t], parameters, std])
        self._rows += 1
        self._newest_stays = self._appended % self._stride == 0
        self._appended += 1

    def rows(self) -> Rows:
        """Return the rows, the newest among them."""
        rows = self._table[: self._rows].copy()
        return Rows(rows[:, 0], rows[:, 1 : 1 + self._size], rows[:, 1 + self._size :])
