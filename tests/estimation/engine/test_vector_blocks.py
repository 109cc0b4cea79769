"""Blocks: the arrays of several identifiers side by side."""

from __future__ import annotations

import numpy as np

import replant as rp
from replant.estimation.engine.state import State
from replant.estimation.engine.vector_blocks import (
    Block,
    aligned,
    is_under_way,
    kind_of_block,
    order,
)
from replant.kernels.lanes import LANES
from replant.kernels.schema import LINE
from support.builders import identifier


def states(count: int) -> list[State]:
    members = [identifier(replay=rp.Replay(capacity=20, batch_size=3, warmup=2, seed=n)) for n in range(count)]
    for number, member in enumerate(members):
        member.update_many(np.linspace(0.0, 1.0, 30 + number), np.linspace(0.0, number, 30 + number))
    return [member._state for member in members]


def test_a_block_gives_back_what_was_put_in() -> None:
    put_in = states(3)
    block = Block.of_states([4, 5, 7], put_in)
    assert block.members == 3
    assert block.numbers.tolist() == [4, 5, 7] + [4] * (LANES - 3)
    for lane, expected in enumerate([*put_in, *[put_in[0]] * (LANES - 3)]):
        state = block.state(lane)
        for own, other in zip(state.arrays, expected.arrays, strict=True):
            np.testing.assert_array_equal(own, other)
            assert not np.shares_memory(own, other)


def test_a_members_arrays_follow_the_block() -> None:
    block = Block.of_states([0, 1], states(2))
    block.arrays[1][:, 1] = 7.0
    assert (block.state(1).reals == 7.0).all()
    assert (block.state(1).theta == 7.0).all()


def test_every_vector_begins_on_a_line_of_the_cache() -> None:
    for rows in range(1, 40):
        array = aligned((rows, LANES))
        assert array.ctypes.data % LINE == 0
        assert array.shape == (rows, LANES)
        assert not array.any()


def test_what_members_of_a_block_have_in_common() -> None:
    one, other_seed, *_ = states(2)
    assert kind_of_block(one) == kind_of_block(other_seed)
    assert order(one) != order(other_seed)
    different = [
        identifier(rp.Adam(0.01)),
        identifier(normalize=False),
        identifier(structure=rp.Structure(poles=1)),
        identifier(replay=rp.Replay(capacity=20, batch_size=4, warmup=2)),
        identifier(replay=rp.Replay(capacity=21, batch_size=3, warmup=2)),
        identifier(preprocess=rp.Preprocess("square")),
    ]
    assert kind_of_block(one) not in {kind_of_block(member._state) for member in different}
    frozen = identifier()
    frozen.freeze()
    assert kind_of_block(frozen._state) != kind_of_block(identifier()._state)


def test_under_way_from_the_second_sample_on() -> None:
    for which in (rp.StateVariableFilter(cutoff=5.0), rp.StateVariableFilter(cutoff=5.0, method="gbt")):
        member, seen = identifier(filter=which), []
        for _ in range(3):
            seen.append(is_under_way(member._state))
            member.update(1.0, 1.0)
        assert not seen[0]
        assert seen[2]
