"""Progress: how far a session has come, as its checkpoint remembers it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from replant.arguments import FloatArray
from replant.data.streams import Batch
from replant.errors import DamagedCheckpointError
from replant.live.session.clock import Clock

COUNTER = "counter "  # before a counter's name in a checkpoint
LATEST = 1e300
"""Time beyond which a stamp is no time; what is no number is not within it either [s]."""


@dataclass
class Progress:
    """How far a session has come.

    Attributes
    ----------
    taken : int
        Samples taken, rejected ones included.
    at : float
        Rig time of the newest in s: its stamp, or taken times dt.
    sequence : int or None
        Its number, where the device gives one.
    offset, candidate, alone
        Of the device's clock: see `Clock`.
    earlier : dict
        What the sources before this resumption counted.
    """

    taken: int = 0
    at: float = 0.0
    sequence: int | None = None
    offset: float = 0.0
    candidate: float | None = None
    alone: bool = False
    earlier: dict[str, int] = field(default_factory=dict)

    def advance(self, batch: Batch, t: FloatArray | None, dt: float) -> FloatArray:
        """Count the samples of a batch, not empty, with rig time ``t``; return that, or of a regular clock its own."""
        clock = np.asarray((self.taken + 1 + np.arange(batch.u.size)) * dt) if t is None else t
        self.taken += batch.u.size
        if t is None:
            self.at = float(clock[-1])
        if batch.sequence is not None:
            self.sequence = int(batch.sequence[-1])
        return clock

    def follow(self, clock: Clock) -> None:
        """Note how far the clock of the device's stamps has come."""
        if np.isfinite(clock.last):
            self.at = clock.last
        self.offset, self.candidate, self.alone = clock.offset, clock.candidate, clock.alone

    def clock(self, dt: float) -> Clock:
        """Return the clock that goes on from there."""
        last = self.at if self.taken else -np.inf
        return Clock(dt, last, self.offset, self.candidate, alone=self.alone)

    def counted(self, counters: Mapping[str, int]) -> dict[str, int]:
        """Return what was counted in all, ``counters`` being the source's of now.

        Examples
        --------
        >>> Progress(earlier={"lost": 2, "duplicate": 1}).counted({"lost": 3})
        {'lost': 5, 'duplicate': 1}
        """
        every = {**self.earlier, **counters}
        return {name: self.earlier.get(name, 0) + counters.get(name, 0) for name in every}

    def with_counters(self, counters: Mapping[str, int]) -> dict[str, int | float | str]:
        """Return what a checkpoint holds beside the identifier."""
        kept: dict[str, int | float | str] = {"taken": self.taken, "at": self.at, "offset": self.offset}
        if self.sequence is not None:
            kept["sequence"] = self.sequence
        if self.candidate is not None:
            kept["candidate"] = self.candidate
        if self.alone:
            kept["alone"] = 1
        return kept | {COUNTER + name: count for name, count in self.counted(counters).items()}

    @classmethod
    def of(cls, kept: Mapping[str, int | float | str]) -> Progress:
        """Return the progress that a checkpoint holds.

        Raises
        ------
        DamagedCheckpointError
            If an entry is not of the kind that a session writes.

        Examples
        --------
        >>> Progress.of(Progress(3, 0.5, 7).with_counters({"lost": 1}))
        Progress(taken=3, at=0.5, sequence=7, offset=0.0, candidate=None, alone=False, earlier={'lost': 1})
        """
        return cls(
            _whole(kept, "taken"),
            _number(kept, "at"),
            _whole(kept, "sequence", -(2**63)) if "sequence" in kept else None,
            _number(kept, "offset"),
            _number(kept, "candidate") if "candidate" in kept else None,
            bool(_whole(kept, "alone")),
            {name.removeprefix(COUNTER): _whole(kept, name) for name in kept if name.startswith(COUNTER)},
        )


def _whole(kept: Mapping[str, int | float | str], name: str, least: int = 0) -> int:
    value = kept.get(name, 0)
    if not isinstance(value, int) or not least <= value < 2**63:
        raise DamagedCheckpointError(f"its {name!r} is no count: {value!r:.30}")
    return value


def _number(kept: Mapping[str, int | float | str], name: str) -> float:
    value = kept.get(name, 0.0)
    if isinstance(value, str) or not -LATEST <= value <= LATEST:
        raise DamagedCheckpointError(f"its {name!r} is no time: {value!r:.30}")
    return float(value)
