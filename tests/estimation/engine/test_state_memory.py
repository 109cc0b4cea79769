"""A state for which the system grants no memory."""

from __future__ import annotations

import numpy as np
import pytest

import replant as rp
from support.builders import identifier


def test_a_buffer_that_the_system_does_not_grant_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    zeros = np.zeros

    def granted(shape: object, *rest: object) -> np.ndarray:
        if isinstance(shape, tuple) and shape[0] == 2**31 - 1:
            raise MemoryError
        return zeros(shape, *rest)

    monkeypatch.setattr(np, "zeros", granted)
    with pytest.raises(rp.SystemRefusedError, match=r"replay buffer of 2,147,483,647 rows .*: ask for a smaller"):
        identifier(replay=rp.Replay(capacity=2**31 - 1, batch_size=4, warmup=4))
