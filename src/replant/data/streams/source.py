"""Source: the interface of every stream of live samples, and the batches that it yields."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from replant.arguments import BoolArray, FloatArray, IntArray

#: The values of `Source.state`.
STATES = ("connecting", "connected", "waiting", "ended")


class Source(Protocol):
    """A stream of live samples.

    Attributes
    ----------
    name : str
        The URL of the source without password, for messages.
    trouble : str
        Why the source is not connected, for messages; empty while it is.
    """

    name: str
    trouble: str

    def batches(self) -> Iterator[Batch]:
        """Yield samples as they arrive; while none arrive, yield an empty batch at least every 0.1 s.

        The iterator ends at the end of the stream, or after `close` once every complete sample has been yielded.
        """
        ...

    def seek(self, sequence: int) -> None:
        """Continue after this sequence number; called before `batches`.

        A source that can send samples again does so: a TCP peer is asked to, a log skips rows.  Any other source
        continues with the samples that arrive.  `seek` raises no error.
        """
        ...

    def close(self) -> None:
        """Stop reading; may be called from any thread and from a signal handler."""
        ...

    @property
    def counters(self) -> dict[str, int]:
        """How often each fault has occurred; faults that never occurred are not listed.

        Malformed lines by reason ("not a number", "too long", ...); samples "duplicate", "lost" on the way, "dropped"
        from a full queue; "reconnects" and "restarts" of the device.
        """
        ...

    @property
    def state(self) -> str:
        """One of "connecting", "connected", "waiting" (before connecting again) and "ended"."""
        ...


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
