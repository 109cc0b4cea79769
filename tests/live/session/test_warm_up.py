"""What a session needs is compiled before the first sample."""

from __future__ import annotations

import sys

import numpy as np
import pytest

import replant as rp
from replant.live.session.warm_up import warm_up
from support.live_fakes import DT, REQUEST, record


def compiled() -> int:
    """How many versions of kernels there are in this process."""
    modules = [module for name, module in sys.modules.items() if name.startswith("replant.kernels")]
    found = {id(value): value for module in modules for value in vars(module).values() if hasattr(value, "signatures")}
    return sum(len(dispatcher.signatures) for dispatcher in found.values())


@pytest.mark.parametrize("stamped", [False, True])
@pytest.mark.parametrize("optimizer", ["auto", "amsgrad"])
def test_nothing_is_compiled_while_samples_come(optimizer: str, stamped: bool) -> None:
    request = type(REQUEST)(**{**vars(REQUEST), "optimizer": optimizer})
    warm_up(request, print)
    before = compiled()
    assert before > 0
    u, y = record()
    identifier = rp.Identifier(**vars(request))
    t = DT * np.arange(u.size)
    for at in range(0, u.size, 7):
        part = slice(at, at + 7)
        identifier.update_many(u[part], y[part], t[part] if stamped else None)
    assert identifier.status == "running"
    assert compiled() == before
