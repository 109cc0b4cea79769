"""Source: what every stream of live samples can do, wherever it comes from."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from replant.data.streams.batch import Batch

#: What `Source.state` says.
STATES = ("connecting", "connected", "waiting", "ended")


class Source(Protocol):
    """A stream of live samples.

    Attributes
    ----------
    name : str
        The URL it was opened by, without password: for people.
    trouble : str
        Why it is not connected, for people; empty where it is.
    """

    name: str
    trouble: str

    def batches(self) -> Iterator[Batch]:
        """Yield samples as they come, an empty batch at least every 0.1 s when none do.

        It ends at the end of the stream, or after `close` once all that was complete has been yielded.
        """
        ...

    def seek(self, sequence: int) -> None:
        """Go on after this sequence number; called before `batches`.

        A source that can replay does (a TCP peer is asked, a log skips); one that cannot goes on with what comes.
        Never an error.
        """
        ...

    def close(self) -> None:
        """Stop reading; from any thread, or from a signal handler."""
        ...

    @property
    def counters(self) -> dict[str, int]:
        """What went wrong how often.

        Malformed lines by reason ("not a number", "too long", ...); samples "duplicate", "lost" on the way, "dropped"
        from a full queue; "reconnects" and "restarts" of the device.  What never happened is not listed.
        """
        ...

    @property
    def state(self) -> str:
        """One of "connecting", "connected", "waiting" (to connect again) and "ended"."""
        ...
