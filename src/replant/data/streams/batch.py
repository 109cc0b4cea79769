"""Batch: the samples that came in together, as every source hands them over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from replant.arguments import FloatArray

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Batch:
    """Samples that came in together; may be empty (the source is idle).

    Attributes
    ----------
    u, y : (K,) arrays
        Input and output in the device's units; NaN where the device sent none.
    t : (K,) array or None
        The device's time stamps in s; None where it sends none: the clock is regular then, and each sample is one
        sampling time after the one before.
    sequence : (K,) array of int or None
        The device's sequence numbers, strictly increasing; a gap is a sample lost.
    arrived : float
        `time.monotonic()` when the newest of them came in.

    Examples
    --------
    >>> len(Batch(np.array([1.0, 1.0]), np.array([0.0, 0.1]), None, None, arrived=0.0))
    2
    """

    u: FloatArray
    y: FloatArray
    t: FloatArray | None
    sequence: IntArray | None
    arrived: float

    def __len__(self) -> int:
        return int(self.u.size)
