"""The layout: every number has a place of its own."""

from __future__ import annotations

import numpy as np
import pytest

from replant.kernels import layout as at


def test_slots_of_ints_are_distinct() -> None:
    slots = [value for name, value in vars(at).items() if name.isupper() and isinstance(value, int)]
    scalars = [at.INPUT_OFFSET, at.OUTPUT_OFFSET, at.OUTPUT_SCALE, at.LAST_OUTPUT, at.SCALARS]
    assert scalars == list(range(5))
    for value in scalars:
        slots.remove(value)
    assert sorted(slots) == list(range(at.ROWS + 1))


@pytest.mark.parametrize("order", [1, 2, 10])
@pytest.mark.parametrize("lag", [0, 4])
@pytest.mark.parametrize("memory", [0, 7, 300])
def test_blocks_fill_reals_without_overlap(order: int, lag: int, memory: int) -> None:
    entries = 2 * order
    ints, reals = at.plan(order, entries, order, lag, memory, settings=3, batch=5)
    sizes = {
        at.AT_TRANSITION: order**2,
        at.AT_OUTPUT_TAPS: 2 * order,
        at.AT_INPUT_TAPS: 3 * order,
        at.AT_CHARACTERISTIC: order,
        at.AT_GAIN: entries,
        at.AT_UNIT: entries,
        at.AT_OUTPUT_STATE: order,
        at.AT_INPUT_STATE: order,
        at.AT_PAST: lag + 3,
        at.AT_PHI: entries,
        at.AT_THETA: entries,
        at.AT_MEMORY: memory,
        at.AT_SETTINGS: 3,
        at.AT_BACKUP: max(entries + memory, 2 * order),
    }
    uses = np.zeros(reals.size, int)
    uses[: at.SCALARS] = 1
    for slot, size in sizes.items():
        block = at.block(ints, uses, slot, size)
        assert block.size == size
        block += 1
    assert (uses == 1).all()
    assert ints.size == at.ROWS + 5
