"""The layout: every number has a place of its own."""

from __future__ import annotations

import numpy as np
import pytest

from replant.kernels import schema as at


def slots() -> tuple[dict[str, int], dict[str, int]]:
    """Those of ``ints``, and the scalars of ``reals``; the module lists the scalars after ROWS, up to SCALARS."""
    names = [name for name, value in vars(at).items() if name.isupper() and isinstance(value, int)]
    cut, end = names.index("ROWS") + 1, names.index("SCALARS") + 1
    return {name: getattr(at, name) for name in names[:cut]}, {name: getattr(at, name) for name in names[cut:end]}


def test_slots_of_ints_are_distinct_and_end_with_the_drawn_rows() -> None:
    ints, _ = slots()
    assert len(set(ints.values())) == len(ints)
    assert max(ints.values()) == at.ROWS


def test_scalars_of_reals_fill_their_room() -> None:
    _, reals = slots()
    assert reals.pop("SCALARS") == at.SCALARS
    assert sorted(reals.values()) == list(range(at.SCALARS))


@pytest.mark.parametrize("order", [1, 2, 10])
@pytest.mark.parametrize("ring", [8, 40])
@pytest.mark.parametrize("memory", [0, 7, 300])
def test_blocks_fill_reals_without_overlap(order: int, ring: int, memory: int) -> None:
    entries = 2 * order + 2
    ints, reals = at.plan(
        order=order, entries=entries, ring=ring, memory=memory, settings=3, batch=5, colour=17, path=19
    )
    sizes = {
        "AT_INPUTS": ring,
        "AT_INTERVALS": ring,
        "AT_HELD": ring,
        "AT_SIGMA": entries,
        "AT_UNIT": entries,
        "AT_PHI": entries,
        "AT_ZETA": entries,
        "AT_THETA": entries,
        "AT_MEMORY": memory,
        "AT_SETTINGS": 3,
        "AT_BACKUP": entries + memory,
        "AT_PAST": at.PAST * (1 + entries),
        "AT_WORK": 4 * (order + 2) ** 2,
        "AT_COLOUR": 17,
        "AT_PATH": 19,
        "AT_PRIOR": 2 * entries,
    }
    assert set(sizes) == {name for name in slots()[0] if name.startswith("AT_")}
    uses = np.zeros(reals.size, int)
    uses[: at.SCALARS] = 1
    for name, size in sizes.items():
        block = at.block(ints, uses, getattr(at, name), size)
        assert block.size == size
        block += 1
    assert (uses == 1).all()
    assert ints.size == at.ROWS + 5
