"""Notices: one message a minute about each subject."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from replant.live.outputs import message as module
from replant.live.outputs.message import AGAIN, Notices


def test_the_same_thing_is_said_once_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [1000.0]
    # the module's clock alone: a server in another thread of this process would sleep for hours by it
    monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: now[0]))
    said: list[str] = []
    notices = Notices(said.append)
    notices.say("disk", "full")
    notices.say("disk", "still full")
    notices.say("wire", "cut")
    now[0] += AGAIN
    notices.say("disk", "full again")
    assert said == ["full", "cut", "full again"]
