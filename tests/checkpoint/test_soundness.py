"""What tells a state of another version or of other settings from one that the kernels can work on."""

from __future__ import annotations

from collections.abc import Iterator
from types import ModuleType

import numpy as np
import pytest

import replant as rp
from replant.checkpoint.soundness import DECIDED, check_state, layout_of_state
from replant.kernels import schema as at
from replant.kernels.filters import bank
from replant.kernels.monitoring import estimate_path, residual_colour
from replant.kernels.schema import ROOM
from support.builders import identifier


@pytest.fixture(autouse=True)
def _fingerprint_made_anew() -> Iterator[None]:
    layout_of_state.cache_clear()
    yield
    layout_of_state.cache_clear()


@pytest.mark.parametrize(
    ("module", "name"),
    [(at, "HEAD"), (at, "AT_PAST"), (at, "NEW"), (bank, "KEPT"), (residual_colour, "LAGS"), (estimate_path, "ROOM")],
)
def test_another_layout_has_another_fingerprint(module: ModuleType, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = layout_of_state()
    monkeypatch.setattr(module, name, 77, raising=False)
    layout_of_state.cache_clear()
    assert layout_of_state() != before


def test_a_checkpoint_of_another_layout_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    ident = identifier()
    ident.update(1.0, 0.0)
    data = ident.to_bytes()
    assert rp.Identifier.from_bytes(data).samples == 1
    monkeypatch.setattr(at, "NEW", 77, raising=False)
    layout_of_state.cache_clear()
    with pytest.raises(rp.DamagedCheckpointError, match="of another version of replant"):
        rp.Identifier.from_bytes(data)


def test_every_slot_that_the_settings_decide_has_its_name() -> None:
    assert all(isinstance(getattr(at, name), int) for name in DECIDED)


@pytest.mark.parametrize("slot", ["HEAD", "FILLED", "NEWEST", "ACTIVE", "WARMING", "RECENT_HEAD", "PAST_KEPT"])
@pytest.mark.parametrize("value", [-1, 2**40])
def test_a_position_outside_of_its_array_is_refused(slot: str, value: int) -> None:
    ident = identifier()
    ident.update_many(np.ones(20), np.ones(20))
    assert ident.settings is not None
    check_state(ident._state, ident.settings, 21)
    ident._state.ints[getattr(at, slot)] = value
    with pytest.raises(rp.DamagedCheckpointError, match="outside"):
        check_state(ident._state, ident.settings, 21)


@pytest.mark.parametrize("value", [-1.0, bank.KEPT, np.nan, np.inf])
def test_a_discretisation_outside_of_its_bank_is_refused(value: float) -> None:
    ident = identifier()
    assert ident.settings is not None
    ident._state.banks[2, bank.NEXT] = value
    with pytest.raises(rp.DamagedCheckpointError, match="outside"):
        check_state(ident._state, ident.settings, 0)


@pytest.mark.parametrize("value", [-1.0, ROOM + 1.0, np.nan, np.inf])
def test_a_path_of_more_rows_than_there_is_room_for_is_refused(value: float) -> None:
    ident = identifier()
    assert ident.settings is not None
    state = ident._state
    state.path.kept = value
    with pytest.raises(rp.DamagedCheckpointError, match="outside"):
        check_state(state, ident.settings, 0)


def test_waiting_for_a_sample_that_has_passed_is_refused() -> None:
    ident = identifier()
    ident.update_many(np.ones(20), np.ones(20))
    assert ident.settings is not None
    with pytest.raises(rp.DamagedCheckpointError, match="has passed"):
        check_state(ident._state, ident.settings, 20)
