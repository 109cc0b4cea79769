"""Whether what a checkpoint holds fits together: settings, sizes, every position inside its array, every number.

The kernels do not check their indices; what they work on must be sound before they see it.  Nothing compiled runs
here: what the settings make of a state is laid out anew in plain whole numbers, and compared.
"""

from __future__ import annotations

import hashlib
import math
from functools import cache
from typing import Any

import numpy as np

from replant.engine.dimensions import RECENT, Dimensions
from replant.engine.recent_samples import RecentSamples
from replant.engine.state import REASONS, State
from replant.errors import DamagedCheckpointError
from replant.kernels.schema import (
    FIXED,
    LAGS,
    LARGEST,
    LAYOUT,
    MOST_EARLIER,
    PAST,
    ROOM,
    ROWS,
    ColourSlots,
    Doubt,
    PathSlots,
    StateSlots,
)
from replant.kernels.slots import NEVER
from replant.optimizers import OPTIMIZERS, Optimizer
from replant.optimizers.replay import Replay
from replant.regressor.scaling import Scaling
from replant.settings import (
    AUTO,
    DEFAULT_OPTIMIZER,
    LONGEST_STARTUP,
    Request,
    Settings,
)

#: What the settings alone decide, beside the offsets of the blocks.
DECIDED = [slot for slot in (*StateSlots.integers, *StateSlots.scalars, *StateSlots.blocks) if slot.writer == LAYOUT]


@cache
def layout_of_state() -> str:
    """Return a fingerprint of where each number lies in a state: another one means another version of the kernels."""
    from replant.kernels.filters import bank

    slots = [
        f"{table.__name__}.{slot.name}={slot.index} {getattr(slot, 'shape', '')}"
        for table in (StateSlots, ColourSlots, PathSlots)
        for slot in (*table.integers, *table.scalars, *table.blocks)
    ]
    sizes = [f"{name}={size}" for name, size in FIXED.items()]
    sizes += [f"bank.{name}={value}" for name, value in sorted(vars(bank).items()) if name.isupper()]
    return hashlib.sha256("\n".join(slots + sizes).encode()).hexdigest()[:16]


def shapes_of(settings: Settings) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of an identifier with these settings."""
    return Dimensions.of_settings(settings, RECENT).shapes


def check_start(request: Request, hold: int, rejects: dict[Any, Any], strays: list[Any]) -> None:
    """Raise DamagedCheckpointError unless so many samples are held back for this request, and rejections counted."""
    holds = [request.first_hold]
    while request.wants_instruments and 2 * holds[-1] <= LONGEST_STARTUP:
        holds.append(2 * holds[-1])
    if type(hold) is not int or hold not in holds:
        raise DamagedCheckpointError("it holds back other samples for its start-up than its settings say")
    if list(rejects) != list(REASONS) or any(type(n) is not int or not 0 <= n < NEVER for n in rejects.values()):
        raise DamagedCheckpointError("it does not say how many samples were rejected for which reason")
    if len(strays) > MOST_EARLIER or not all(type(stamp) is float and math.isfinite(stamp) for stamp in strays):
        raise DamagedCheckpointError("its stray time stamps are none")


def check_held(held: list[tuple[float, float, float]], request: Request, hold: int) -> None:
    """Raise DamagedCheckpointError unless samples held back are such as an identifier accepts."""
    from replant.regressor.preprocess import screen

    if len(held) > hold:  # as many where the newest awaits its successor
        raise DamagedCheckpointError("it holds back more samples than it waits for")
    u, y, t = np.array(held, np.float64).reshape(-1, 3).T
    if not screen(request.preprocess.map_input(u), y)[0].all() or np.isinf(t).any() or (t[1:] <= t[:-1]).any():
        raise DamagedCheckpointError("it holds back samples that are not accepted")


def check_settings(settings: Settings, request: Request, hold: int) -> None:
    """Raise DamagedCheckpointError unless what was asked for can have led to these settings."""
    optimizer, asked = type(settings.optimizer), request.optimizer
    agrees = {
        "structure": settings.structure == request.structure,
        "dt": settings.dt == request.dt,
        "filter": request.filter in (AUTO, settings.filter),
        "scaling": settings.scaling == (request.scaling or Scaling.none(request.structure)) or request.scaling == AUTO,
        "optimizer": settings.optimizer == asked
        if isinstance(asked, Optimizer)
        else optimizer is OPTIMIZERS[DEFAULT_OPTIMIZER if asked == AUTO else asked],
        "replay": settings.replay in ((None, Replay()) if request.replay == AUTO else (request.replay,)),
        "instruments": settings.instruments == request.wants_instruments,
        "normalize": settings.normalize == request.normalize,
        "input_map": settings.preprocess.input_map == request.preprocess.input_map,
        "startup": settings.startup <= hold,
    }
    wrong = next((name for name, right in agrees.items() if not right), None)
    if wrong is not None:
        raise DamagedCheckpointError(f"its settings and what was asked for differ in {wrong}")


def check_state(state: State, settings: Settings, resolve_at: int) -> None:
    """Raise DamagedCheckpointError unless the kernels can work on this state.

    Parameters
    ----------
    state : State
        Of the right shapes; see `shapes_of`.
    settings : Settings
    resolve_at : int
        How many samples the next solution of the whole record waits for, 0 for none.
    """
    _check_decided(state, State.laid_out(settings, len(state.recent)), settings)
    _check_positions(state)
    _check_due(state, resolve_at)
    for what, sound in (
        ("times", _times_are_sound(state)),
        ("numbers", _numbers_are_sound(state)),
        ("raw samples", _raw_samples_are_sound(state)),
    ):
        if not sound:
            raise DamagedCheckpointError(f"its state holds {what} that cannot be")


def _check_decided(state: State, fresh: State, settings: Settings) -> None:
    """What is laid out from the settings must be as they lay it out: sizes, offsets, scaling, the optimizer's numbers.

    Blocks are looked at last: where they begin is known to be right by then.
    """
    for block in StateSlots.blocks:
        if state.ints[block.index] != fresh.ints[block.index]:
            raise DamagedCheckpointError(f"its state and its settings differ in where {block.name} begins")
    for slot in DECIDED:
        differs = np.asarray(getattr(state, slot.name) != getattr(fresh, slot.name))
        if slot is StateSlots.settings and settings.filter.follows_estimate and not settings.optimizer.keeps_colour:
            chosen = 1 + settings.structure.size  # the walk of the constant, which the start-up chooses
            differs[chosen] = not 0.0 <= state.settings[chosen] < math.inf
        if differs.any():
            raise DamagedCheckpointError(f"its state and its settings differ in {slot.name}")


def _check_positions(state: State) -> None:
    """Whole numbers lie in the ranges that the schema gives them; numbers that serve as positions are whole."""
    from replant.kernels.filters import bank

    rows, size = state.ints[ROWS:], len(state.recent)
    places = [(state.path.kept, ROOM), (state.colour.position, LAGS - 1)]
    places += [(float(place), bank.KEPT - 1) for place in state.banks[:, bank.NEXT]]
    if not (
        all(slot.is_sound(state) for slot in StateSlots.integers)
        and state.recent_head == (state.samples % size if size else 0)
        and ((rows >= 0) & (rows < state.capacity)).all()
        and all(0 <= place <= last and place == int(place) for place, last in places)
    ):
        raise DamagedCheckpointError("its state points outside of its arrays")


def _check_due(state: State, resolve_at: int) -> None:
    if type(resolve_at) is not int or not 0 <= resolve_at < NEVER:
        raise DamagedCheckpointError("it does not say when its record is solved again")
    if state.attention:  # it was interrupted before it could do what was due
        return
    dues = [due for due in (resolve_at, state.look_at) if due]
    if any(due <= state.samples for due in dues):
        raise DamagedCheckpointError("it waits for a sample that has passed")
    if state.attention_at != min(dues, default=0) or (dues and not state.examines_output):
        raise DamagedCheckpointError("it does not wait for the sample at which something is due")


def _times_are_sound(state: State) -> bool:
    """How far the past inputs reach back sizes a loop: each came after an interval such as an identifier accepts."""
    least = state.delay / (state.ring_size - 2) * (1.0 - 1e-9)
    began = not state.started or bool(((state.intervals > 0.0) & (state.intervals >= least)).all())
    past = state.past[: min(state.past_kept, PAST), 0]
    known = bool(((past >= 0.0) & (past <= state.samples)).all())
    return began and known and not math.isnan(state.ready_at)


def _numbers_are_sound(state: State) -> bool:
    """Every number is as the schema says, the physical estimate is finite, and no variance is below 0."""
    from replant.kernels.filters import bank

    arrays = state.banks, state.buffer[: state.buffer_filled], state.recent
    if not all(slot.is_sound(state) for slot in (*StateSlots.scalars, *StateSlots.blocks)):
        return False
    if not all(np.isfinite(array).all() for array in arrays) or not (state.banks[:, bank.SCALE] >= 0.0).all():
        return False
    with np.errstate(over="ignore"):
        physical = np.isfinite(state.physical).all() and np.isfinite(state.past[:, 1:] * state.unit).all()
    return bool(physical and (not state.examines_output or (state.factors[1] >= 0.0).all()))


def _raw_samples_are_sound(state: State) -> bool:
    from replant.kernels.monitoring import interruptions

    kept = RecentSamples(state.recent[: state.samples])
    known = (np.abs(kept.input) <= LARGEST) & (np.abs(kept.output) <= LARGEST)
    known &= (kept.interval > 0.0) & (kept.interval <= interruptions.LONGEST * state.interval)
    if state.examines_output:
        known &= np.isin(kept.doubt, list(Doubt))
    return bool(known.all())
