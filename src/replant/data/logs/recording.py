"""Recording: a recorded log of any length, whose samples are read block by block, as often as needed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from replant.data.logs.table import Table
from replant.log import Log

MOST_HELD = 1 << 20  # length up to which a log is held in memory: 24 MB [samples]


@dataclass(frozen=True, eq=False)
class Recording:
    """A log of input, output and perhaps a reference, checked from its first row to its last."""

    table: Table
    columns: tuple[int, ...]
    dt: float
    stamped: bool
    samples: int
    complete: bool
    held: Log | None
    begin: float | None = None
    end: float | None = None
    irregularity: str = ""
    unit: float = 1.0

    def of_log(self, log: Log) -> Recording:
        """Return a recording whose samples are those of a log, which is held in memory."""
        irregularity = self.irregularity if log.stamps is not None else ""
        complete = bool(np.isfinite(log.input).all() and np.isfinite(log.output).all())
        return replace(self, dt=log.dt, samples=len(log), complete=complete, held=log, irregularity=irregularity)

    @property
    def irregular(self) -> bool:
        """Whether the clock is irregular, so that the batches hold its time stamps."""
        return bool(self.irregularity)

    @property
    def path(self) -> Path:
        """The file."""
        return self.table.path

    def batches(self) -> Iterator[tuple[NDArray[np.float64], ...]]:
        """Yield input, output, the reference if there is one, and stamps in s of an irregular clock, block by block."""
        if self.held is not None:
            log = self.held
            every = log.input, log.output, log.reference, log.stamps
            yield tuple(signal for signal in every if signal is not None)
            return
        for *signals, last in self.table.stream(self.columns):
            yield *signals, last * self.unit if self.irregular else last

    def newest(
        self, u: NDArray[np.float64], y: NDArray[np.float64], since_begin: NDArray[np.float64] | None = None
    ) -> Log:
        """Return the whole log if it is held in memory, else a log of its newest samples, without its reference."""
        if self.held is not None:
            return self.held
        earlier = self.samples - u.size
        time = np.asarray(self.dt * np.arange(earlier, self.samples), np.float64) if self.stamped else None
        if self.irregular:
            time = since_begin
        of_input, of_output, *others = (self.table.names[column] for column in self.columns)
        reference = "".join(others[: len(others) - self.irregular])
        return Log(
            u, y, self.dt, time, of_input, of_output, self.path, earlier, None, reference,
            self.begin, self.end, irregular=self.irregular,
        )  # fmt: skip
