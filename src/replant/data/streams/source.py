"""Source: the interface of every stream of live samples."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from replant.data.streams.batch import Batch

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
