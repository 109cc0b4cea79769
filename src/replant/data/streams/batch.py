"""Batch: the samples that arrived together; every source yields them in this form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.arguments import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Batch:
    """Samples that arrived together; empty while the source is idle.

    Attributes
    ----------
    u, y : (K,) arrays
        Input and output in the device's units; NaN where the device sent none.
    t : (K,) array or None
        The device's time stamps in s.  None: the device sends no stamps; the clock is regular, and each sample is one
        sampling time after the one before.
    sequence : (K,) array of int or None
        The device's sequence numbers, strictly increasing; a gap means lost samples.
    arrived : float
        `time.monotonic()` when the newest sample arrived.
    r : (K,) array or None
        The reference; NaN where the device sent none.  None: there is no reference.

    Examples
    --------
    >>> batch = Batch(np.array([1.0, 2.0]), np.array([0.0, 0.1]), None, None, arrived=0.0)
    >>> len(batch), batch.select(slice(1, 2)).u
    (2, array([2.]))
    """

    u: FloatArray
    y: FloatArray
    t: FloatArray | None
    sequence: IntArray | None
    arrived: float
    r: FloatArray | None = None

    def __len__(self) -> int:
        return int(self.u.size)

    def select(self, rows: slice | BoolArray | IntArray) -> Batch:
        """Return the samples that ``rows`` selects: a slice, a mask (K,) or indices."""
        return Batch(
            self.u[rows],
            self.y[rows],
            None if self.t is None else self.t[rows],
            None if self.sequence is None else self.sequence[rows],
            self.arrived,
            None if self.r is None else self.r[rows],
        )

    def followed_by(self, other: Batch) -> Batch:
        """Return the samples of this batch and then those of ``other``, which has the same fields.

        The result arrived when ``other`` did.
        """
        return Batch(
            np.concatenate([self.u, other.u]),
            np.concatenate([self.y, other.y]),
            None if self.t is None or other.t is None else np.concatenate([self.t, other.t]),
            None
            if self.sequence is None or other.sequence is None
            else np.concatenate([self.sequence, other.sequence]),
            other.arrived,
            None if self.r is None or other.r is None else np.concatenate([self.r, other.r]),
        )
