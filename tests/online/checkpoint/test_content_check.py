"""What tells a state of another version or of other settings from one that the kernels can work on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import pytest

import replant as rp
from fuzz.seeds import KINDS, LENGTHS, seed
from replant.estimation.engine.state import State
from replant.kernels import schema as at
from replant.kernels.filters import bank
from replant.kernels.schema import ROOM
from replant.kernels.slot_tables import Slot
from replant.online.checkpoint.content_check import check_state, layout_of_state, sizes_of
from support.builders import engine_state, identifier
from support.cases import every


@pytest.fixture(autouse=True)
def _fingerprint_made_anew() -> Iterator[None]:
    layout_of_state.cache_clear()
    yield
    layout_of_state.cache_clear()


def test_another_layout_has_another_fingerprint(monkeypatch: pytest.MonkeyPatch) -> None:
    prints = {layout_of_state()}
    for place, name in ((bank, "KEPT"), (at.StateSlots.alarm, "index"), (at.ColourSlots.power, "index")):
        with monkeypatch.context() as changed:
            changed.setattr(place, name, 77)
            layout_of_state.cache_clear()
            prints.add(layout_of_state())
    with monkeypatch.context() as changed:
        changed.setattr(at.StateSlots.past, "shape", "PAST, 2 + T")
        layout_of_state.cache_clear()
        prints.add(layout_of_state())
    assert len(prints) == 5


def test_a_checkpoint_of_another_layout_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    ident = identifier()
    ident.update(1.0, 0.0)
    data = ident.to_bytes()
    assert rp.Identifier.from_bytes(data).samples == 1
    monkeypatch.setattr(bank, "KEPT", 77)
    layout_of_state.cache_clear()
    with pytest.raises(rp.DamagedCheckpointError, match="of another version of replant"):
        rp.Identifier.from_bytes(data)


@every("kind", KINDS)
def test_shapes_are_known_from_the_settings_alone(kind: str) -> None:
    for samples in LENGTHS:
        ident = rp.Identifier.from_bytes(seed(kind, samples, False))
        if ident.settings is not None:
            assert sizes_of(ident.settings, ident._request, len(ident._state.recent), reference=False).shapes == {
                name: getattr(engine_state(ident), name).shape for name in at.STATE_ARRAYS
            }


@every("slot", at.StateSlots.integers, ids=lambda slot: slot.name)
@every("value", [-1, 2**62, -(2**63)])
def test_a_whole_number_outside_of_its_range_is_refused(slot: Slot, value: int) -> None:
    ident = identifier()
    ident.update_many(np.ones(20), np.ones(20))
    assert ident.settings is not None
    engine_state(ident).ints[slot.index] = value
    with pytest.raises(rp.DamagedCheckpointError):
        check_state(engine_state(ident), ident.settings, 0)


def test_nothing_compiled_runs_before_a_state_is_found_sound(monkeypatch: pytest.MonkeyPatch) -> None:
    ident = identifier(structure=rp.Structure(3, 1))
    ident.update_many(np.ones(20), np.ones(20))
    assert ident.settings is not None

    def called(*_: object) -> None:
        raise AssertionError("a kernel ran")

    monkeypatch.setattr(bank, "set_denominator", called)
    check_state(engine_state(ident), ident.settings, 0)


def test_an_identifier_without_a_sample_is_assessed() -> None:
    assert identifier().assess().status == "converging"


def put(array: str, place: tuple[int, ...], value: float) -> Callable[[State], None]:
    return lambda state: getattr(state, array).__setitem__(place, value)


POSITIONS = ["buffer_head", "buffer_filled", "ring_head", "serving_bank", "warming", "recent_head", "past_kept"]
NOT_VALID = {"reals": (at.StateSlots.input_now.index,), "banks": (0, 0), "buffer": (0, 0), "recent": (0, 0)}
CHANGES: list[tuple[str, Callable[[State], None], str]] = [
    *((f"{slot} {value}", partial(lambda slot, value, state: setattr(state, slot, value), slot, value), "outside")
      for slot in POSITIONS for value in (-1, 2**40)),
    # the discretisation that a bank computes next
    *((f"bank {value}", put("banks", (2, bank.NEXT), value), "outside") for value in (-1.0, bank.KEPT, np.nan, np.inf)),
    # a path of more rows than there is room for
    *((f"path {value}", partial(lambda value, state: setattr(state.path, "kept", value), value), "outside")
      for value in (-1.0, ROOM + 1.0, np.nan, np.inf)),
    *((f"{array} {value}", put(array, place, value), "not valid")
      for array, place in NOT_VALID.items() for value in (np.nan, np.inf, -np.inf)),
]  # fmt: skip


@every(("change", "words"), [row[1:] for row in CHANGES], ids=[row[0] for row in CHANGES])
def test_a_position_outside_of_its_array_or_a_number_that_is_not_finite_is_refused(
    change: Callable[[State], None], words: str
) -> None:
    ident = identifier()
    ident.update_many(np.ones(20), np.ones(20))
    assert ident.settings is not None
    check_state(engine_state(ident), ident.settings, 0)
    change(engine_state(ident))
    with pytest.raises(rp.DamagedCheckpointError, match=words):
        check_state(engine_state(ident), ident.settings, 0)


def test_waiting_for_a_sample_that_has_passed_is_refused() -> None:
    ident = identifier()
    ident.update_many(np.ones(20), np.ones(20))
    assert ident.settings is not None
    with pytest.raises(rp.DamagedCheckpointError, match="has passed"):
        check_state(engine_state(ident), ident.settings, 20)


def test_inputs_from_before_the_record_act_no_longer_than_the_dead_time() -> None:
    ident = rp.Identifier(rp.Structure(1, delay=0.3), 0.1)
    u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 100), 10)
    ident.update_many(u, np.cumsum(u) - 0.1 * u)
    assert engine_state(ident).refined
    rp.Identifier.from_bytes(ident.to_bytes())
    for value in (-0.1, 0.31, np.nan, np.inf):
        engine_state(ident).unknown_input = value
        with pytest.raises(rp.DamagedCheckpointError, match="not valid"):
            rp.Identifier.from_bytes(ident.to_bytes())


@pytest.mark.parametrize("seed", [0, 2**53, 2**63 - 1])
def test_any_seed_that_an_identifier_takes_can_be_saved(seed: int) -> None:
    ident = identifier(replay=rp.Replay(capacity=50, batch_size=4, warmup=4, seed=seed))
    ident.update_many(np.ones(20), np.ones(20))
    data = ident.to_bytes()
    assert rp.Identifier.from_bytes(data).to_bytes() == data
