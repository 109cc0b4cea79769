"""The end of a session: limits of time and samples, a verdict, or a signal."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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


@contextmanager
def stop_on_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Call ``stop`` on the first SIGINT or SIGTERM within the ``with`` block; the second one has its usual effect.

    Only the main thread receives signals: in another thread this has no effect.

    Examples
    --------
    >>> stops = []
    >>> with stop_on_signals(lambda: stops.append(True)):
    ...     signal.raise_signal(signal.SIGINT)
    >>> stops
    [True]
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def restore_handlers() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def stop_once(*_: object) -> None:
        restore_handlers()
        stop()

    for number in before:
        signal.signal(number, stop_once)
    try:
        yield
    finally:
        restore_handlers()
