"""Memory: blocks lie one after the other, and a loop finds each where they say."""

from __future__ import annotations

import numpy as np
import pytest

from replant.kernels.optimizers import covariance, gradient
from replant.kernels.optimizers.memory import MATRIX, ONE, VECTOR, Memory, Size, block
from support.cases import every

EVERY = {**gradient.MEMORY, **covariance.MEMORY}
LAID = Memory(first=MATRIX, second=ONE, third=Size(2, 3, 1), last=VECTOR)
AT_LAST = LAID.begins["last"]


@every("P", [1, 2, 5])
@every("memory", EVERY.values(), ids=map(str, EVERY))
def test_blocks_fill_the_memory_without_overlap(memory: Memory, P: int) -> None:
    uses = np.zeros(memory.size(P))
    for name in memory.sizes:
        memory.of(uses, name, P)[:] += 1.0
    assert (uses == 1.0).all()


@pytest.mark.parametrize("P", [1, 2, 7])
def test_a_loop_finds_a_block_where_it_lies(P: int) -> None:
    memory = LAID.filled(P, last=np.arange(P) + 5.0)
    assert block(memory, AT_LAST, P)[0] == LAID.of(memory, "last", P)[0] == 5.0


def test_a_block_that_is_not_declared_is_refused() -> None:
    with pytest.raises(KeyError, match="unknown"):
        LAID.filled(2, unknown=1.0)
