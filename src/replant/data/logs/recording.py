"""Recording: a recorded log of any length, whose samples are read block by block, as often as needed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from replant.data.logs.table import Table
from replant.log import Log

MOST_HELD = 1 << 20
"""Length up to which a log is held in memory: 24 MB [samples]."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A log of input, output and perhaps a reference at a fixed sampling time, checked from its first row to its last.

    Parameters
    ----------
    table : Table
        The file.
    columns : tuple of int
        Indices of the columns of input, output and, if there is one, reference.
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
    begin, end : float or None
        The part of the file that is read, in s from its first row; None: from the first, or to the last.
    """

    table: Table
    columns: tuple[int, ...]
    dt: float
    stamped: bool
    samples: int
    complete: bool
    held: Log | None
    begin: float | None = None
    end: float | None = None

    @property
    def path(self) -> Path:
        """The file."""
        return self.table.path

    def batches(self) -> Iterator[tuple[NDArray[np.float64], ...]]:
        """Yield input, output and, if there is one, reference, block by block, from the first sample on."""
        if self.held is not None:
            signals = self.held.input, self.held.output
            yield signals if self.held.reference is None else (*signals, self.held.reference)
            return
        yield from map(tuple, self.table.stream(self.columns))

    def newest(self, u: NDArray[np.float64], y: NDArray[np.float64]) -> Log:
        """Return the whole log if it is held in memory, else a log of its newest samples ``u`` and ``y`` (K,).

        The latter is without its reference.
        """
        if self.held is not None:
            return self.held
        earlier, (of_input, of_output, *of_reference) = self.samples - u.size, self.columns
        time = np.asarray(self.dt * np.arange(earlier, self.samples), np.float64) if self.stamped else None
        names = self.table.names
        reference = "".join(names[column] for column in of_reference)
        return Log(u, y, self.dt, time, names[of_input], names[of_output], self.path, earlier, None, reference,
                   self.begin, self.end)  # fmt: skip
