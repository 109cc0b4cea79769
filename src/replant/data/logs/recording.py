"""Recording: a recorded log of any length, whose samples are read block by block, as often as needed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from replant.data.logs.log import Log
from replant.data.logs.table import Table

MOST_HELD = 1 << 20
"""Length up to which a log is held in memory: 24 MB [samples]."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A log of one input and one output at a fixed sampling time, checked from its first row to its last.

    Parameters
    ----------
    table : Table
        The file.
    columns : (int, int)
        Indices of the columns of input and output.
    dt : float
        Sampling time in seconds.
    stamped : bool
        Whether the sampling time comes from the file's time stamps.
    samples : int
        Number of samples.
    complete : bool
        Whether every sample is finite.
    held : Log or None
        The whole log, if it is short enough to be held in memory.
    """

    table: Table
    columns: tuple[int, int]
    dt: float
    stamped: bool
    samples: int
    complete: bool
    held: Log | None

    @property
    def path(self) -> Path:
        """The file."""
        return self.table.path

    def batches(self) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Yield input and output, block by block, from the first sample on."""
        if self.held is not None:
            yield self.held.input, self.held.output
            return
        yield from ((u, y) for u, y in self.table.stream(self.columns))

    def newest(self, u: NDArray[np.float64], y: NDArray[np.float64]) -> Log:
        """Return the whole log if it is held in memory, else a log of its newest samples ``u`` and ``y`` (K,)."""
        if self.held is not None:
            return self.held
        earlier, (of_input, of_output) = self.samples - u.size, self.columns
        time = np.asarray(self.dt * np.arange(earlier, self.samples), np.float64) if self.stamped else None
        return Log(u, y, self.dt, time, self.table.names[of_input], self.table.names[of_output], self.path, earlier)
