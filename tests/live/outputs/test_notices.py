"""Notices: one message a minute about each subject."""

from __future__ import annotations

import pytest

from replant.live.outputs.notices import AGAIN, Notices


def test_the_same_thing_is_said_once_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [1000.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    said: list[str] = []
    notices = Notices(said.append)
    notices.say("disk", "full")
    notices.say("disk", "still full")
    notices.say("wire", "cut")
    now[0] += AGAIN
    notices.say("disk", "full again")
    assert said == ["full", "cut", "full again"]
