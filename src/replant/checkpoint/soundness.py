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

from replant.arguments import FloatArray
from replant.engine.dimensions import Dimensions
from replant.engine.state import State
from replant.errors import DamagedCheckpointError
from replant.kernels import schema as at
from replant.online.change_response import RECENT
from replant.online.readout import REASONS
from replant.online.startup import LARGEST
from replant.optimizers import OPTIMIZERS, Optimizer
from replant.optimizers.replay import Replay
from replant.regressor.filters import RefinedFilter
from replant.regressor.scaling import Scaling
from replant.settings import (
    AUTO,
    DEFAULT_OPTIMIZER,
    Request,
    Settings,
)

NEVER = 2**53  # samples: no stream is as long, a float64 tells them apart, and sums of many are inside int64

#: What the settings alone decide, beside the offsets of the blocks.
DECIDED = (
    "ORDER", "ENTRIES", "PARAMETERS", "INPUT_ENTRIES", "ALGORITHM", "SQUARE_INPUT", "NORMALIZE", "STRAIGHT_INPUT",
    "BILINEAR", "CONSTANT", "REFINED", "INSTRUMENTS", "CAPACITY", "BATCH", "WARMUP", "RING", "RECENT", "COLOURED",
    "GUARDED", "MEMORY_SIZE", "SETTINGS_SIZE", "SEED", "PAST_STEP",
)  # fmt: skip
DECIDED_REALS = ("INPUT_OFFSET", "OUTPUT_OFFSET", "OUTPUT_SCALE", "DELAY", "INTERVAL", "LONGEST_GAP")
#: Slots that count, or say at which sample something was or will be.
COUNTS = (
    "SAMPLES", "NOT_FINITE", "TOO_LARGE", "NOT_LATER", "TOO_DENSE", "REFUSED", "RESTED", "GAPS", "DRAWN", "OUTLIERS",
    "STUCK", "STILL", "IS_STUCK", "EARLIER", "REST_AFTER", "INPUT_STILL", "LOOK_AT", "DUE",
)  # fmt: skip
#: Slots that say at which sample something was, and how many estimates were kept.
PASSED = ("LEARNED", "PAST_KEPT", "CHANGE_BEGAN", "GAP_AT", "ORIGIN", "STUCK_LAST", "REVISED")
FLAGS = ("GUARD", "ADAPT", "STARTED", "WARMING", "ATTENTION")
#: Scalars that may be infinite or no number: never; not known yet; squares of samples near the end of float64.
UNBOUNDED = ("READY", "LONGEST_GAP", "LEAST_STEP", "LAST_RAW", "ERROR", "RATIO", "SPREAD", "USUAL", "PEAK", "CUSUM")
SHARES = ("FORGET_INPUT", "EQUAL")  # from 0 to 1
NOT_NEGATIVE = ("ELAPSED", "MARGIN", "WIDEST", "SEEN", "LIMIT", "INPUT_POWER", "LARGEST_POWER")
#: Blocks that may hold anything: room for work, statistics made of squares, and what was known before a change.
ANYTHING = ("AT_WORK", "AT_PHI", "AT_ZETA", "AT_COLOUR", "AT_PATH", "AT_PRIOR")


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


def shapes_of(settings: Settings) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of an identifier with these settings."""
    return Dimensions.of_settings(settings, RECENT).shapes


def check_start(request: Request, hold: int, rejects: dict[Any, Any]) -> None:
    """Raise DamagedCheckpointError unless so many samples are held back for this request, and rejections counted."""
    holds = [request.first_hold]
    while request.wants_instruments and 2 * holds[-1] <= LARGEST:
        holds.append(2 * holds[-1])
    if type(hold) is not int or hold not in holds:
        raise DamagedCheckpointError("it holds back other samples for its start-up than its settings say")
    if list(rejects) != list(REASONS) or any(type(n) is not int or not 0 <= n < NEVER for n in rejects.values()):
        raise DamagedCheckpointError("it does not say how many samples were rejected for which reason")


def check_held(held: list[tuple[float, float, float]], request: Request, hold: int) -> None:
    """Raise DamagedCheckpointError unless samples held back are such as an identifier accepts."""
    from replant.regressor.preprocess import screen

    if len(held) >= hold:
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
    fresh = State.laid_out(settings, len(state.recent))
    _check_decided(state, fresh, settings)
    _check_whole_numbers(state)
    _check_due(state.ints, resolve_at)
    _check_positions_in_reals(state)
    for what, sound in (
        ("times", _times_are_sound(state)),
        ("numbers", _numbers_are_sound(state, settings)),
        ("raw samples", _raw_samples_are_sound(state)),
    ):
        if not sound:
            raise DamagedCheckpointError(f"its state holds {what} that cannot be")


def _check_decided(state: State, fresh: State, settings: Settings) -> None:
    """What follows from the settings must be as it follows: all sizes and offsets, scaling, the optimizer's numbers."""
    for name, slot in vars(at).items():
        if (name in DECIDED or name.startswith("AT_")) and state.ints[slot] != fresh.ints[slot]:
            raise DamagedCheckpointError(f"its state and its settings differ in {name}")
    for name in DECIDED_REALS:
        if state.reals[getattr(at, name)] != fresh.reals[getattr(at, name)]:
            raise DamagedCheckpointError(f"its state and its settings differ in {name}")
    for name in ("AT_SIGMA", "AT_UNIT", "AT_SETTINGS"):
        size = fresh.settings_size if name == "AT_SETTINGS" else fresh.entries
        block, expected = (one.block(getattr(at, name), size) for one in (state, fresh))
        differs = block != expected
        if name == "AT_SETTINGS" and isinstance(settings.filter, RefinedFilter) and not settings.optimizer.keeps_colour:
            chosen = 1 + settings.structure.size  # the walk of the constant, which the start-up chooses
            differs[chosen] = not 0.0 <= block[chosen] < math.inf
        if differs.any():
            raise DamagedCheckpointError(f"its state and its settings differ in {name}")


def _check_whole_numbers(state: State) -> None:
    from replant.kernels.monitoring import outliers

    ints = state.ints
    capacity, samples, row = int(ints[at.CAPACITY]), int(ints[at.SAMPLES]), 0
    if len(state.recent):
        row = samples % len(state.recent)
    limits = {getattr(at, name): (0, NEVER) for name in COUNTS}
    limits |= {getattr(at, name): (0, samples) for name in PASSED}
    limits |= {getattr(at, name): (0, 1) for name in FLAGS}
    limits |= {
        at.BUFFER_HEAD: (0, capacity - 1),
        at.BUFFER_FILLED: (0, capacity),
        at.RING_HEAD: (0, int(ints[at.RING_SIZE]) - 1),
        at.SERVING_BANK: (1, 2),
        at.RECENT_HEAD: (row, row),
        at.PAST_DUE: (0, samples + int(ints[at.PAST_STEP])),
        at.DOUBT: (outliers.NONE, outliers.STANDS),
        at.ALARM: (0, outliers.FLOATS),
    }
    rows = ints[at.ROWS :]
    if (
        not all(low <= ints[slot] <= high for slot, (low, high) in limits.items())
        or ((rows < 0) | (rows >= capacity)).any()
    ):
        raise DamagedCheckpointError("its state points outside of its arrays")


def _check_due(ints: Any, resolve_at: int) -> None:
    if type(resolve_at) is not int or not 0 <= resolve_at < NEVER:
        raise DamagedCheckpointError("it does not say when its record is solved again")
    if ints[at.ATTENTION] == 1:  # it was interrupted before it could do what was due
        return
    dues = [due for due in (resolve_at, int(ints[at.LOOK_AT])) if due]
    if any(due <= ints[at.SAMPLES] for due in dues):
        raise DamagedCheckpointError("it waits for a sample that has passed")
    if ints[at.ATTENTION_AT] != min(dues, default=0) or (dues and not ints[at.EXAMINES_OUTPUT]):
        raise DamagedCheckpointError("it does not wait for the sample at which something is due")


def _check_positions_in_reals(state: State) -> None:
    """Numbers that serve as positions are whole, and inside of what they point into."""
    from replant.kernels.filters import bank
    from replant.kernels.monitoring import estimate_path, residual_colour

    kept = state.block(at.AT_PATH, estimate_path.size(state.entries))[estimate_path.KEPT]
    position = state.block(at.AT_COLOUR, residual_colour.size(state.entries))[residual_colour.POSITION]
    places = [(kept, estimate_path.ROOM), (position, residual_colour.LAGS - 1)]
    places += [(place, bank.KEPT - 1) for place in state.banks[:, bank.NEXT]]
    if not all(0 <= place <= last and place == int(place) for place, last in places):
        raise DamagedCheckpointError("its state points outside of its arrays")


def _times_are_sound(state: State) -> bool:
    """How far the past inputs reach back sizes a loop: each came after an interval such as an identifier accepts."""
    reals, ring = state.reals, int(state.ring_size)
    intervals = state.block(at.AT_INTERVALS, ring)
    least = reals[at.DELAY] / (ring - 2) * (1.0 - 1e-9)
    began = state.started == 0 or bool(((intervals > 0.0) & (intervals >= least)).all())
    past = state.past[: min(state.past_kept, at.PAST), 0]
    known = bool(((past >= 0.0) & (past <= state.samples)).all())
    never = bool(reals[at.READY_AT] >= 0.0) and not reals[at.SENSOR_STEP] < 0.0
    return began and known and never


def _numbers_are_sound(state: State, settings: Settings) -> bool:
    """Every number is finite but for those that tell "never", the estimate in physical units too; variances are."""
    from replant.kernels.filters import bank

    reals = state.reals[: at.SCALARS].copy()
    reals[[getattr(at, name) for name in UNBOUNDED]] = 0.0
    sizes = Dimensions.of_settings(settings, len(state.recent)).blocks
    blocks = [state.block(slot, size) for slot, size in sizes.items() if slot not in map(_slot, ANYTHING)]
    arrays: list[FloatArray] = [reals, *blocks, state.banks, state.buffer[: state.buffer_filled], state.recent]
    if not all(np.isfinite(array).all() for array in arrays):
        return False
    shares, others = reals[[*map(_slot, SHARES)]], reals[[*map(_slot, NOT_NEGATIVE)]]
    if not (((shares >= 0.0) & (shares <= 1.0)).all() and (others >= 0.0).all()):
        return False
    if not (state.banks[:, bank.SCALE] >= 0.0).all():
        return False
    with np.errstate(over="ignore"):
        physical = np.isfinite(state.theta * state.unit).all() and np.isfinite(state.past[:, 1:] * state.unit).all()
    size = state.entries
    variances = state.block(at.AT_MEMORY, size * size + size)[size * size :] if state.examines_output else np.zeros(0)
    return bool(physical and (variances >= 0.0).all())


def _raw_samples_are_sound(state: State) -> bool:
    from replant.kernels.monitoring import interruptions, outliers

    kept = state.recent[: state.samples]
    known = (np.abs(kept[:, : at.STEP]) <= at.LARGEST).all(axis=1)
    known &= (kept[:, at.STEP] > 0.0) & (kept[:, at.STEP] <= interruptions.LONGEST * state.interval)
    if state.examines_output:
        known &= np.isin(kept[:, at.DOUBTED], (outliers.NONE, outliers.OUTLIER, outliers.STANDS))
    return bool(known.all())


def _slot(name: str) -> int:
    return int(getattr(at, name))
