"""Whether a state that was read fits its settings: every size as they make it, every position inside its array.

The kernels do not check their indices; what they work on must be sound before they see it.
"""

from __future__ import annotations

import hashlib
from dataclasses import fields
from functools import cache

from replant.engine.state import State
from replant.errors import DamagedCheckpointError
from replant.kernels import schema as at
from replant.settings import Settings


@cache
def layout_of_state() -> str:
    """Return a fingerprint of where each number lies in a state: another one means another version of the kernels."""
    from replant.kernels.filters import bank
    from replant.kernels.monitoring import estimate_path, residual_colour

    slots = [
        f"{module.__name__}.{name}={value}"
        for module in (at, bank, estimate_path, residual_colour)
        for name, value in sorted(vars(module).items())
        if name.isupper() and isinstance(value, int | float)
    ]
    return hashlib.sha256("\n".join(slots).encode()).hexdigest()[:16]


#: What the settings alone decide, beside the offsets of the blocks.
DECIDED = (
    "ORDER", "ENTRIES", "PARAMETERS", "INPUT_ENTRIES", "ALGORITHM", "STRAIGHT_INPUT", "BILINEAR", "CONSTANT", "REFINED",
    "INSTRUMENTS", "CAPACITY", "BATCH", "WARMUP", "RING", "RECENT", "COLOURED", "GUARDED", "MEMORY_SIZE",
    "SETTINGS_SIZE",
)  # fmt: skip


def check_state(state: State, settings: Settings, resolve_at: int) -> None:
    """Raise DamagedCheckpointError unless the kernels can work on this state.

    ``resolve_at`` is how many samples the next solution of the whole record waits for, 0 for none.
    """
    from replant.kernels.filters import bank

    capacity = settings.replay.capacity if settings.replay else 1
    if len(state.buffer) != capacity:  # before one of that size is laid out to compare with
        raise DamagedCheckpointError("its buffer is not as long as its settings say")
    fresh = State.of_settings(settings, len(state.recent))
    for field in fields(State):
        shape, expected = getattr(state, field.name).shape, getattr(fresh, field.name).shape
        if shape != expected:
            raise DamagedCheckpointError(f"its {field.name} have the shape {shape} where the settings need {expected}")
    for name, slot in vars(at).items():
        if (name in DECIDED or name.startswith("AT_")) and state.ints[slot] != fresh.ints[slot]:
            raise DamagedCheckpointError(f"its state and its settings differ in {name}")
    ints = state.ints
    limits = {
        at.BUFFER_HEAD: (0, capacity - 1),
        at.BUFFER_FILLED: (0, capacity),
        at.RING_HEAD: (0, ints[at.RING_SIZE] - 1),
        at.SERVING_BANK: (1, 2),
        at.WARMING: (0, 1),
        at.RECENT_HEAD: (0, max(len(state.recent) - 1, 0)),
        at.PAST_KEPT: (0, ints[at.SAMPLES]),
        at.RECORD_BEGAN: (0, ints[at.SAMPLES]),
        at.GAP_AT: (0, ints[at.SAMPLES]),
        at.REVISED_FROM: (0, ints[at.SAMPLES]),
        at.CHANGE_BEGAN: (0, ints[at.SAMPLES]),
        at.ALARM: (0, at.Alarm.FLOATS),
    }
    positions = all(low <= ints[slot] <= high for slot, (low, high) in limits.items())
    passed = any(due and due <= ints[at.SAMPLES] for due in (resolve_at, ints[at.LOOK_AT]))
    if passed and ints[at.ATTENTION] == 0:  # else it was interrupted before it could do what was due
        raise DamagedCheckpointError("it waits for a sample that has passed")
    nexts = state.banks[:, bank.NEXT]
    positions = positions and 0 <= state.path.kept <= at.ROOM
    if not positions or not ((nexts >= 0) & (nexts < bank.KEPT)).all():
        raise DamagedCheckpointError("its state points outside of its arrays")
