"""History: the estimate over a run of any length, in memory that does not grow."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.live.observer.view import Rows

MOST_ROWS = 1000
"""Rows of history kept [rows]."""


class History:
    """Rows of (t, parameters, std), one a view; when they get too many every second one goes.

    Parameters
    ----------
    size : int
        Number of parameters P.

    Examples
    --------
    >>> history = History(1)
    >>> for k in range(5000):
    ...     history.append(float(k), np.array([0.5]), np.array([0.1]))
    >>> rows = history.rows()
    >>> rows.t.size <= MOST_ROWS, rows.t[[0, -1]]
    (True, array([   0., 4999.]))
    """

    def __init__(self, size: int) -> None:
        self._kept = np.empty((MOST_ROWS, 1 + 2 * size))
        self._size = size
        self.clear()

    def clear(self) -> None:
        """Forget every row."""
        self._rows = self._taken = 0
        self._stride = 1
        self._newest_stays = True

    def restore(self, rows: Rows) -> None:
        """Begin with rows taken before."""
        for t, parameters, std in zip(rows.t.tolist(), rows.parameters, rows.std, strict=True):
            self.append(t, parameters, std)

    def append(self, t: float, parameters: FloatArray, std: FloatArray) -> None:
        """Take the newest row; it is shown in any case, and stays if it is a stride away from the last that did."""
        if self._rows and not self._newest_stays:
            self._rows -= 1
        if self._rows == MOST_ROWS:
            self._kept[: MOST_ROWS // 2] = self._kept[::2].copy()
            self._rows = MOST_ROWS // 2
            self._stride *= 2
        self._kept[self._rows] = np.concatenate([[t], parameters, std])
        self._rows += 1
        self._newest_stays = self._taken % self._stride == 0
        self._taken += 1

    def rows(self) -> Rows:
        """Return the rows kept, and the newest."""
        kept = self._kept[: self._rows].copy()
        return Rows(kept[:, 0], kept[:, 1 : 1 + self._size], kept[:, 1 + self._size :])
