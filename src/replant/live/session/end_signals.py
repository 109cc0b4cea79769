"""End signals: SIGINT and SIGTERM ask a session to end; the second one ends the process at once."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


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
