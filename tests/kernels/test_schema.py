"""The schema: every number of a state has a place of its own, a meaning, and the property of its name."""

from __future__ import annotations

import numpy as np
import pytest

from replant.estimation.engine.dimensions import Dimensions
from replant.estimation.engine.state import State
from replant.kernels import schema as at
from replant.kernels.slot_tables import Block, Choice, Flag, Integer, Nested, Numbers, Part, Real, Table, sizes
from support.cases import every

TABLES = (at.StateSlots, at.ColourSlots, at.PathSlots)
SLOTS = [(table, slot) for table in TABLES for slot in (*table.integers, *table.scalars, *table.blocks)]
every_slot = every(("table", "slot"), SLOTS, ids=[f"{t.__name__}.{s.name}" for t, s in SLOTS])
INSTRUMENTED = Dimensions(
    order=2, entries=6, ring_size=8, memory_size=48, settings_size=2, instruments=True, examines_output=True
)


@pytest.fixture
def state() -> State:
    return State.empty(Dimensions(2, 6, 8, 60, 2, recent_size=7, instruments=True, examines_output=True))


@every_slot
def test_every_slot_says_what_it_is(table: type[Table], slot: Integer) -> None:
    assert slot.meaning
    assert "\n" not in slot.meaning


def test_kernels_have_every_slot_by_its_name(state: State) -> None:
    s = state.fields
    for block in at.StateSlots.blocks:
        one, other = getattr(s, block.name), getattr(state, block.name)
        assert isinstance(block, Nested) or other.size == 0 or np.shares_memory(one, other)
    for slot in (*at.StateSlots.integers, *at.StateSlots.scalars):
        setattr(s, slot.name, 1)
        assert getattr(s, slot.name) == getattr(state, slot.name) == 1
    with pytest.raises(AttributeError, match="no slot is called alarms"):
        _ = s.alarms


def test_integers_and_beginnings_of_blocks_fill_ints_before_the_drawn_rows() -> None:
    slots = (*at.StateSlots.integers, *at.StateSlots.blocks)
    assert [slot.index for slot in slots] == list(range(at.ROWS))


@every("order", [1, 2, 10])
@every("ring", [8, 40])
@every("memory", [0, 7, 300])
def test_scalars_and_blocks_fill_reals_without_overlap(order: int, ring: int, memory: int) -> None:
    sizes = Dimensions(
        order=order, entries=2 * order + 2, ring_size=ring, memory_size=memory, settings_size=3, batch_size=5
    )
    uses = np.zeros(sizes.shapes["reals"], int)
    for slot in at.StateSlots.scalars:
        uses[slot.index] += 1
    for block, begin in sizes.begins.items():
        uses[begin : begin + block.size(sizes.numbers)] += 1
    assert (uses == 1).all()
    assert sizes.shapes["ints"] == (at.ROWS + 5,)


def test_sizes_are_sums_of_products_of_the_dimensions() -> None:
    numbers = Numbers(T=3, M=4, N=5)
    assert sizes("2, T", numbers) == (2, 3)
    assert sizes("T + M", numbers) == (7,)
    assert Block("4 * N * N", "").size(numbers) == 100


@every("slot", at.StateSlots.integers, ids=lambda slot: slot.name)
def test_a_property_of_ints_reads_and_writes_its_own_number_alone(slot: Integer, state: State) -> None:
    before = state.ints.copy()
    value = slot.kind(1) if isinstance(slot, Choice) else not before[slot.index] if isinstance(slot, Flag) else 12345
    setattr(state, slot.name, value)
    assert getattr(state, slot.name) == value
    assert np.flatnonzero(state.ints != before).tolist() == [slot.index]


@every("slot", at.StateSlots.scalars, ids=lambda slot: slot.name)
def test_a_property_of_reals_reads_and_writes_its_own_number_alone(slot: Real, state: State) -> None:
    before = state.reals.copy()
    setattr(state, slot.name, 0.123)
    assert getattr(state, slot.name) == 0.123
    assert np.flatnonzero(state.reals != before).tolist() == [slot.index]


@every("block", at.StateSlots.blocks, ids=lambda block: block.name)
def test_a_block_is_a_view_of_its_shape(block: Block, state: State) -> None:
    if isinstance(block, Nested):
        part = getattr(state, block.name)
        assert isinstance(part, Part)
        assert np.shares_memory(part.reals, state.reals)
        return
    view = getattr(state, block.name)
    assert view.shape == sizes(block.shape, state.dimensions)
    before = state.reals.copy()
    view[...] = 0.123
    changed = np.flatnonzero(state.reals != before)
    begin = state.ints[block.index]
    assert changed.tolist() == list(range(begin, begin + view.size))


def test_a_name_that_is_no_slot_cannot_be_set(state: State) -> None:
    with pytest.raises(AttributeError):
        state.allarm = 1


def test_a_part_has_its_own_slots() -> None:
    colour = at.ColourSlots.zeros(INSTRUMENTED.numbers)
    colour.count, colour.squares[1, 2] = 3.0, 4.0
    assert colour.reals[at.ColourSlots.count.index] == 3.0
    assert colour.reals.sum() == 7.0
    assert colour.filtered.shape == (at.LAGS, 6)
