"""Waiting for what happens elsewhere: for an event, never for a time, so that no test depends on a machine's speed."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

#: s; only keeps a broken test from hanging, on a machine that is busy.
PATIENCE = 600.0


def wait_until(condition: Callable[[], T], what: str = "it came") -> T:
    """Wait until something holds or is there, and return it."""
    deadline = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < deadline, f"waited in vain until {what}"
        time.sleep(0.005)
    return found
