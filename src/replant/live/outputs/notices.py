"""Notices: messages of the session to the user, at most one a minute about each subject."""

from __future__ import annotations

import time
from collections.abc import Callable

AGAIN = 60.0  # time until the next message about the same subject [s]


class Notices:
    """Passes messages on to ``show``, at most one a minute about each subject.

    >>> notices = Notices(print)
    >>> notices.say("checkpoint", "no room on the disk")
    no room on the disk
    >>> notices.say("checkpoint", "no room on the disk")
    """

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._said: dict[str, float] = {}

    def say(self, subject: str, message: str) -> None:
        """Show a message, unless one about the same subject was shown within the last minute."""
        now = time.monotonic()
        if now - self._said.get(subject, -AGAIN) >= AGAIN:
            self._said[subject] = now
            self._show(message)
