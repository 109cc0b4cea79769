"""Content check: settings, sizes, indices and all numbers of a checkpoint must agree.

Kernels do not check their indices, so a state must be sound before they use it.  No compiled code runs here: the layout
of the state is computed from the settings in Python, and compared.
"""

from __future__ import annotations

import hashlib
import math
from functools import cache

import numpy as np

from replant.errors import DamagedCheckpointError
from replant.estimation.engine.dimensions import Dimensions, collects_at_most, rooms
from replant.estimation.engine.recent_samples import RecentSamples
from replant.estimation.engine.state import State
from replant.estimation.optimizers import OPTIMIZERS, Optimizer
from replant.estimation.optimizers.optimizer import Replay
from replant.estimation.settings import AUTO, DEFAULT_OPTIMIZER, LONGEST_STARTUP, STORED, Request, Scaling, Settings
from replant.kernels.schema import (
    FIXED,
    LAGS,
    LARGEST,
    LOAD,
    PAST,
    ROWS,
    ColourSlots,
    Doubt,
    PathSlots,
    StateSlots,
    SumsSlots,
)
from replant.kernels.slot_tables import NEVER
from replant.online.background import Job

#: The slots whose values are determined by the settings, apart from the begins of the blocks.
DECIDED = [slot for slot in (*StateSlots.integers, *StateSlots.scalars, *StateSlots.blocks) if slot.laid_out]


@cache
def layout_of_state() -> str:
    """Return a fingerprint of the layout of a state; it differs between versions with different layouts."""
    from replant.kernels.filters import bank

    slots = [
        f"{table.__name__}.{slot.name}={slot.index} {getattr(slot, 'shape', '')}"
        for table in (StateSlots, ColourSlots, PathSlots, SumsSlots)
        for slot in (*table.integers, *table.scalars, *table.blocks)
    ]
    sizes = [f"{name}={size}" for name, size in FIXED.items()]
    sizes += [f"bank.{name}={value}" for name, value in sorted(vars(bank).items()) if name.isupper() and name[0] != "_"]
    return hashlib.sha256("\n".join(slots + sizes).encode()).hexdigest()[:16]


def sizes_of(settings: Settings | None, request: Request, rows: int, *, reference: bool) -> Dimensions:
    """Return the sizes of an identifier's arrays, with ``rows`` of raw samples if that is a possible number."""
    most = collects_at_most(request) if settings is None else request.history  # no settings: it is in a start-up
    recent = rows if rows in rooms(most) else most
    if settings is None:
        return Dimensions.of_request(request, recent, reference=reference)
    return Dimensions.of_settings(settings, recent)


def check_start(request: Request, hold: int, *, reference: bool) -> None:
    """Check the values that belong to the start-up."""
    holds = [request.first_hold]
    while request.wants_instruments and 2 * holds[-1] <= LONGEST_STARTUP:
        holds.append(2 * holds[-1])
    if type(hold) is not int or hold not in holds:
        raise DamagedCheckpointError("its start-up waits for another number of samples than its settings ask for")
    if reference and not request.takes_reference:
        raise DamagedCheckpointError("it has a reference, which its settings cannot use")


def check_collected(state: State, request: Request, resolve_at: int, *, reference: bool) -> None:
    """Check the state of a start-up."""
    if type(resolve_at) is not int or resolve_at != 0:
        raise DamagedCheckpointError("it plans to solve its record again, but has none yet")
    fresh = State.collecting(request, len(state.recent) - 1, reference=reference)
    _check_decided(state, fresh, None)
    _check_positions(state)
    due = state.samples + (not state.attention)  # attention: it was interrupted before the action that was due
    if not due <= state.attention_at <= max(len(state.recent), state.samples + 1):
        raise DamagedCheckpointError("it does not wait for the sample at which its start-up may end")
    numbers = all(slot.is_sound(state) for slot in (*StateSlots.scalars, *StateSlots.blocks))
    if not (numbers and np.isfinite(state.recent).all() and _raw_samples_are_sound(state)):
        raise DamagedCheckpointError("it has collected samples that are not accepted")


def check_settings(settings: Settings, request: Request, *, reference: bool) -> None:
    """Check that the settings agree with the request."""
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
        "startup": settings.startup <= collects_at_most(request),
        "reference": settings.reference == reference,
    }
    wrong = next((name for name, right in agrees.items() if not right), None)
    if wrong is not None:
        raise DamagedCheckpointError(f"its settings and its request differ in {wrong}")


def check_state(
    state: State, settings: Settings, resolve_at: int, most: int = STORED, *, has_job: bool = False
) -> None:
    """Check that the kernels can use a state; if a job is pending, `check_job` checks what the state waits for."""
    _check_decided(state, State.laid_out(settings, len(state.recent)), settings)
    _check_positions(state)
    _check_due(state, resolve_at, most, has_job=has_job)
    for what, sound in (
        ("times", _times_are_sound(state)),
        ("numbers", _numbers_are_sound(state)),
        ("raw samples", _raw_samples_are_sound(state)),
    ):
        if not sound:
            raise DamagedCheckpointError(f"its state holds {what} that are not valid")


def check_job(job: Job, state: State) -> None:
    """Check that a job began before this state, and that the state waits for it."""
    when = job.schedule
    if not (state.examines_output and when.begun <= state.samples <= when.until and len(state.recent) > 1):
        raise DamagedCheckpointError("its pending job belongs to other samples")
    waits = state.attention_at == when.next_stop(state.samples) and state.samples < when.until
    if not (state.attention or waits):
        raise DamagedCheckpointError("it does not wait for its pending job")


def _check_decided(state: State, fresh: State, settings: Settings | None) -> None:
    """Check the numbers determined by the settings: sizes, begins of blocks, scaling, the optimizer's settings."""
    for block in StateSlots.blocks:  # before their contents are compared
        if state.ints[block.index] != fresh.ints[block.index]:
            raise DamagedCheckpointError(f"its state and its settings differ in where {block.name} begins")
    for slot in DECIDED:
        differs = np.asarray(getattr(state, slot.name) != getattr(fresh, slot.name))
        if slot is StateSlots.settings and settings and _chooses_walk(settings):
            chosen = 1 + settings.structure.size  # the random walk of the offset, which the start-up chooses
            differs[chosen] = not 0.0 <= state.settings[chosen] < math.inf
        if differs.any():
            raise DamagedCheckpointError(f"its state and its settings differ in {slot.name}")


def _chooses_walk(settings: Settings) -> bool:
    """Return whether the start-up chooses the random walk of the offset: Kalman tracking with the refined filter."""
    optimizer = settings.optimizer
    return settings.filter.follows_estimate and optimizer.keeps_covariance and not optimizer.keeps_colour


def _check_positions(state: State) -> None:
    """Check that integers lie in the ranges of the schema, and that reals used as indices are integers in range."""
    from replant.kernels.filters import bank

    rows, size = state.ints[ROWS:], len(state.recent)
    places = [(state.path.kept, max(state.path_size - 1, 0)), (state.colour.position, LAGS - 1)]
    places += [(float(place), bank.KEPT - 1) for place in state.banks[:, bank.NEXT]]
    if not (
        all(slot.is_sound(state) for slot in StateSlots.integers)
        and state.recent_head == (state.samples % size if size else 0)
        and ((rows >= 0) & (rows < state.capacity)).all()
        and all(0 <= place <= last and place == int(place) for place, last in places)
    ):
        raise DamagedCheckpointError("its state points outside of its arrays")


def _check_due(state: State, resolve_at: int, most: int, *, has_job: bool) -> None:
    if type(resolve_at) is not int or not 0 <= resolve_at < NEVER:
        raise DamagedCheckpointError("its time of solving the record again is not valid")
    if state.attention or has_job:  # it was interrupted before the action that was due, or a job does it
        return
    dues = [due for due in (resolve_at, state.look_at) if due]
    if any(due <= state.samples for due in dues):
        raise DamagedCheckpointError("it waits for a sample that has passed")
    if room := state.room_until(most):
        dues.append(room)
    first = min(dues, default=0)
    # in the background also the two updates before it, and the one after a pending action
    stops = first, first - 1, first - 2, state.samples + 1
    if state.attention_at not in stops or (dues and not state.examines_output):
        raise DamagedCheckpointError("it does not wait for the sample at which something is due")


def _times_are_sound(state: State) -> bool:
    """Return whether all times are possible; the intervals of past inputs bound the length of a loop."""
    least = state.delay / (state.ring_size - 2) * (1.0 - 1e-9)
    began = not state.started or bool(((state.intervals > 0.0) & (state.intervals >= least)).all())
    past = state.past[: min(state.past_kept, PAST), 0]
    known = bool(((past >= 0.0) & (past <= state.samples)).all())
    waits = 0.0 <= state.unknown_input <= (state.delay if state.refined else 0.0)
    return began and known and waits and not math.isnan(state.ready_at)


def _numbers_are_sound(state: State) -> bool:
    """Return whether numbers are in the ranges of the schema, the estimate is finite, and no variance is negative."""
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
        known &= np.isin(kept.doubt, [*Doubt, LOAD])
    if state.has_reference:
        known &= (np.abs(kept.reference) <= LARGEST) & (abs(state.reference_now) <= LARGEST)
    return bool(known.all())
