"""Notices: what the session has to say, the same thing at most once a minute."""

from __future__ import annotations

import time
from collections.abc import Callable

AGAIN = 60.0
"""Time until the same thing may be said again [s]."""


class Notices:
    """Pass messages on to ``show``, none twice within a minute.

    Parameters
    ----------
    show : callable
        Gets a line of text; called from any thread.

    Examples
    --------
    >>> notices = Notices(print)
    >>> notices.say("checkpoint", "no room on the disk")
    no room on the disk
    >>> notices.say("checkpoint", "no room on the disk")
    """

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._said: dict[str, float] = {}

    def say(self, subject: str, message: str) -> None:
        """Say something about a subject, unless something was said of it within the last minute."""
        now = time.monotonic()
        if now - self._said.get(subject, -AGAIN) >= AGAIN:
            self._said[subject] = now
            self._show(message)
