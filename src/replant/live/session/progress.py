"""Progress: how many samples a session has taken, and its clock, as stored in a checkpoint."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from replant.arguments import FloatArray
from replant.data.streams import Batch
from replant.errors import DamagedCheckpointError
from replant.live.session.rig_clock import RigClock

COUNTER = "counter "  # prefix of a counter's name in a checkpoint
LATEST = 1e300  # bound of every time in a checkpoint [s]


@dataclass
class Progress:
    """How many samples a session has taken, and the state of its clock.

    Attributes
    ----------
    taken : int
        Samples taken, rejected ones included.
    at : float
        Rig time of the newest sample in s: its stamp, or taken times dt.
    sequence : int or None
        Number of the newest sample, where the device gives one.
    offset, candidate, alone
        State of the device's clock, see `RigClock`.
    earlier : dict
        Counters of the sources before this resumption.
    """

    taken: int = 0
    at: float = 0.0
    sequence: int | None = None
    offset: float = 0.0
    candidate: float | None = None
    alone: bool = False
    earlier: dict[str, int] = field(default_factory=dict)

    def advance(self, batch: Batch, t: FloatArray | None, dt: float) -> FloatArray:
        """Count the samples of a batch and return their rig time (K,) in s."""
        clock = np.asarray((self.taken + 1 + np.arange(batch.u.size)) * dt) if t is None else t
        self.taken += batch.u.size
        if t is None:
            self.at = float(clock[-1])
        if batch.sequence is not None:
            self.sequence = int(batch.sequence[-1])
        return clock

    def follow(self, clock: RigClock) -> None:
        """Store the state of the clock."""
        if np.isfinite(clock.last):
            self.at = clock.last
        self.offset, self.candidate, self.alone = clock.offset, clock.candidate, clock.alone

    def clock(self, dt: float) -> RigClock:
        """Return a clock that continues from the stored state."""
        last = self.at if self.taken else -np.inf
        return RigClock(dt, last, self.offset, self.candidate, alone=self.alone)

    def counted(self, counters: Mapping[str, int]) -> dict[str, int]:
        """Return all counters: those of earlier sources plus ``counters`` of the present one.

        Examples
        --------
        >>> Progress(earlier={"lost": 2, "duplicate": 1}).counted({"lost": 3})
        {'lost': 5, 'duplicate': 1}
        """
        every = {**self.earlier, **counters}
        return {name: self.earlier.get(name, 0) + counters.get(name, 0) for name in every}

    def with_counters(self, counters: Mapping[str, int]) -> dict[str, int | float | str]:
        """Return the entries that a checkpoint stores besides the identifier."""
        entries: dict[str, int | float | str] = {"taken": self.taken, "at": self.at, "offset": self.offset}
        if self.sequence is not None:
            entries["sequence"] = self.sequence
        if self.candidate is not None:
            entries["candidate"] = self.candidate
        if self.alone:
            entries["alone"] = 1
        return entries | {COUNTER + name: count for name, count in self.counted(counters).items()}

    @classmethod
    def of(cls, entries: Mapping[str, int | float | str]) -> Progress:
        """Return the progress with the entries of a checkpoint, see `with_counters`.

        >>> Progress.of(Progress(3, 0.5, 7).with_counters({"lost": 1}))
        Progress(taken=3, at=0.5, sequence=7, offset=0.0, candidate=None, alone=False, earlier={'lost': 1})
        """
        return cls(
            _whole(entries, "taken"),
            _number(entries, "at"),
            _whole(entries, "sequence", -(2**63)) if "sequence" in entries else None,
            _number(entries, "offset"),
            _number(entries, "candidate") if "candidate" in entries else None,
            bool(_whole(entries, "alone")),
            {name.removeprefix(COUNTER): _whole(entries, name) for name in entries if name.startswith(COUNTER)},
        )


def _whole(entries: Mapping[str, int | float | str], name: str, least: int = 0) -> int:
    value = entries.get(name, 0)
    if not isinstance(value, int) or not least <= value < 2**63:
        raise DamagedCheckpointError(f"its {name!r} is no count: {value!r:.30}")
    return value


def _number(entries: Mapping[str, int | float | str], name: str) -> float:
    value = entries.get(name, 0.0)
    if isinstance(value, str) or not -LATEST <= value <= LATEST:
        raise DamagedCheckpointError(f"its {name!r} is no time: {value!r:.30}")
    return float(value)


class Throughput:
    """Measures rate and lag of the samples that a session learns.

    Examples
    --------
    >>> throughput = Throughput()
    >>> throughput.count(10, arrived=time.monotonic() - 0.5)
    >>> rate, lag = throughput.read()
    >>> rate, round(lag, 1)
    (0.0, 0.5)
    """

    def __init__(self) -> None:
        self._since: float | None = None  # beginning of the current second; None before the first sample
        self._samples, self._rate, self._lag = 0, 0.0, 0.0

    def count(self, samples: int, arrived: float) -> None:
        """Count samples that were learned just now; ``arrived`` is the time at which the newest arrived."""
        now = time.monotonic()
        self._since = now if self._since is None else self._since
        self._samples += samples
        self._lag = max(self._lag, now - arrived)

    def read(self) -> tuple[float, float]:
        """Return samples a second, over about one second, and the longest lag in s since `reset_lag`."""
        now = time.monotonic()
        if self._since is not None and now - self._since >= 1.0:
            self._rate, self._samples, self._since = self._samples / (now - self._since), 0, now
        return self._rate, self._lag

    def reset_lag(self) -> None:
        """Forget the longest lag."""
        self._lag = 0.0
