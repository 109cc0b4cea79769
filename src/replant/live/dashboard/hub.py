"""Hub: passes the newest view to every browser, and commands and requests for reports to the identification."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
from collections.abc import AsyncGenerator, Callable
from dataclasses import dataclass
from typing import Any

from replant.errors import ReplantError

#: The commands that a page may send to the identification.
COMMANDS = ("freeze", "adapt", "reset")
DIGITS = 7  # digits of a number that is only drawn: a screen shows four [count]
_SLOW = ("bode", "step", "truth")  # they change slowly: they are sent with the history
_DRAWN = ("window", *_SLOW, "history")


@dataclass(frozen=True)
class Frame:
    """A view as it is sent, serialized once for all browsers."""

    number: int  # counts up from 1
    # view, history: JSON objects: the view without what changes slowly; the history and the responses, which do
    view: str
    history: str


class Hub:
    """Holds the newest view, which the identification publishes and browsers fetch.

    Views are not queued: a slow browser gets the newest view and misses those in between.
    """

    def __init__(
        self,
        *,
        command: Callable[[str], None] = lambda name: None,
        report: Callable[[], bytes] = bytes,
        notice: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._command = command
        self._report = report
        self.notice = notice
        self.ended = False
        self.browsers = 0  # number of browsers with an open websocket
        self._newest: tuple[int, dict[str, Any] | None] = (0, None)
        self._frame: Frame | None = None
        self._waiting: set[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = set()
        self._reporting = threading.Lock()

    @property
    def newest(self) -> dict[str, Any] | None:
        """The view published last, None before the first."""
        return self._newest[1]

    def publish(self, view: dict[str, Any]) -> None:
        """Replace the newest view; from any thread.  Without browsers this takes a few microseconds."""
        self._newest = (self._newest[0] + 1, view)
        self._wake()

    def end(self) -> None:
        """Mark that no view follows the newest one; browsers that have it are then disconnected.  From any thread."""
        self.ended = True
        self._wake()

    def _wake(self) -> None:
        for loop, event in tuple(self._waiting):
            with contextlib.suppress(RuntimeError):  # the event loop has just been closed
                loop.call_soon_threadsafe(event.set)

    async def subscribe(self) -> AsyncGenerator[Frame, None]:
        """Yield the newest frame at once, then each newer one, until the end; no frame twice."""
        entry = (asyncio.get_running_loop(), asyncio.Event())
        self._waiting.add(entry)
        seen = 0
        try:
            while True:
                entry[1].clear()
                frame = self._written()
                if frame is None or frame.number == seen:
                    if self.ended:
                        return
                    await entry[1].wait()
                    continue
                seen = frame.number
                yield frame
        finally:
            self._waiting.discard(entry)

    def _written(self) -> Frame | None:
        """Return the newest view as a frame, which is serialized when the first browser asks for it."""
        number, view = self._newest
        if view is not None and (self._frame is None or self._frame.number != number):
            shown = {key: _rounded(value) if key in _DRAWN else value for key, value in view.items()}
            history = shown.pop("history", None)
            shown.pop("model", None)  # only for whoever downloads it
            slow = {key: shown.pop(key) for key in _SLOW if key in shown}
            self._frame = Frame(
                number, _text({"view": shown}), _text({"history": history, **({"slow": slow} if slow else {})})
            )
        return self._frame

    @property
    def watching(self) -> int:
        """Number of browsers that are subscribed to views."""
        return len(self._waiting)

    def command(self, name: str) -> None:
        """Send a command to the identification."""
        if name not in COMMANDS:
            raise ValueError(f"command must be one of {', '.join(COMMANDS)}, got {name!r}")
        self._command(name)

    def model(self) -> dict[str, Any]:
        """Return the newest model with all its digits; empty before there is one."""
        model: dict[str, Any] = (self.newest or {}).get("model", {})
        return model

    async def report(self) -> bytes:
        """Return a report of the identification as HTML; takes seconds, in a thread."""
        if not self._reporting.acquire(blocking=False):
            raise ReplantError("a report is being made already: try again when it is finished")
        try:
            return await asyncio.to_thread(self._report)
        finally:
            self._reporting.release()


def _rounded(value: Any) -> Any:
    """Return ``value`` with its numbers rounded to the visible digits, which halves the number of bytes."""
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    if isinstance(value, list | tuple):
        return [_rounded(entry) for entry in value]
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    return value


def _text(message: dict[str, Any]) -> str:
    return json.dumps(message, allow_nan=False, separators=(",", ":"))
