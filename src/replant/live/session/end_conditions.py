"""End conditions: limits of time and samples, or a verdict, that end a session."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """The conditions under which a session ends by itself.

    Attributes
    ----------
    seconds : float or None
        The session ends after this real time.
    samples : int or None
        The session ends when this many samples have been taken; rejected samples and those before a resumption count.
    until_trusted : bool
        The session ends when the verdict is "trusted".

    Examples
    --------
    >>> limits = Limits(samples=1000)
    >>> limits.left(900), limits.reached(seconds=1.5, samples=900, trusted=True)
    (100, False)
    """

    seconds: float | None = None
    samples: int | None = None
    until_trusted: bool = False

    def left(self, samples: int) -> int | None:
        """Return how many samples may still be taken after ``samples``; None without a limit."""
        return None if self.samples is None else max(self.samples - samples, 0)

    def reached(self, *, seconds: float, samples: int, trusted: bool) -> bool:
        """Return whether the session has to end."""
        return (
            (self.seconds is not None and seconds >= self.seconds)
            or (self.samples is not None and samples >= self.samples)
            or (self.until_trusted and trusted)
        )
