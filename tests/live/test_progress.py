"""What a checkpoint holds of a session: entries that no session writes are refused by name."""

from __future__ import annotations

import math
from typing import Any

import pytest

import replant as rp
from replant.live.progress import Progress, RigClock
from support.cases import every


@every("name", ["taken", "at", "sequence", "offset", "counter lost"])
@every("value", ["many", "", math.nan, math.inf, -1e301, 10**400, -1.5], ids=lambda v: str(v)[:30])
def test_progress_that_no_session_writes_is_refused_by_name(name: str, value: Any) -> None:
    kept = Progress(3, 7, RigClock(0.5), earlier={"lost": 1}).with_counters({})
    assert Progress.of(kept).with_counters({}) == kept
    if name in ("at", "offset") and value == -1.5:  # a clock that begins before zero
        assert Progress.of({**kept, name: value})
        return
    with pytest.raises(rp.DamagedCheckpointError, match=name) as caught:
        Progress.of({**kept, name: value})
    assert "\n" not in str(caught.value)
