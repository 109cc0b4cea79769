"""Start-up: the first samples are held back; a model, its covariance and settled filters are made from them."""

from __future__ import annotations

import itertools
import math

import numpy as np

from replant.arguments import FloatArray
from replant.engine.dispatch import step_kernels
from replant.engine.record import Record, ready_record
from replant.engine.state import NOTHING, State
from replant.kernels.schema import BELIEVED, FARTHEST, LARGEST, LEAP, MOST_EARLIER
from replant.offline.refined import Refined
from replant.offline.srivc import first_model
from replant.regressor.preprocess import Preprocess, screen
from replant.settings import Request
from replant.statistics.linear_algebra import quiet

Held = tuple[float, float, float, float]  # a sample (u, y, t, r) held for start-up

FAR = 1e3
"""Distance of an input beyond which it was misread [times the largest other one].
Origin: as INPUT_LEAP of the recursion.
Sensitivity: halved or doubled, nothing changes on these records.
"""

MOST_LONE = 2
"""Inputs of a start-up that may be misread; more are pulses [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""


def hold_back(
    held: list[Held], strays: list[float], rejects: dict[str, int], request: Request,
    u: FloatArray, y: FloatArray, t: FloatArray, r: FloatArray,
) -> None:  # fmt: skip
    """Add samples to those held for start-up, and count the rejected ones by reason.

    Parameters
    ----------
    held : list of (u, y, t, r)
        Samples held so far; changed in place.
    strays : list of float
        The newest consecutive stamps that increase but lie before the newest one held; changed in place.
    rejects : dict
        Rejected samples by reason; changed in place.
    request : Request
    u, y : (K,) arrays
        Raw samples.
    t : (K,) or (0,) array
        Time stamps in s: empty or NaN where there are none, infinite where a stamp was not finite.
    r : (K,) or (0,) array
        Reference: empty or NaN where there is none, infinite where it was not finite.
    """
    accepted, rejected = screen(request.preprocess.map_input(u), y)
    for reason, count in rejected.items():
        rejects[reason] += count
    none = [math.nan] * u.size
    stamps, references = t.tolist() if t.size else none, r.tolist() if r.size else none
    for k in np.flatnonzero(accepted).tolist():
        if math.isinf(stamps[k]) or math.isinf(references[k]):
            rejects["not finite"] += 1
        elif abs(references[k]) > LARGEST:
            rejects["too large"] += 1
        elif abs(stamps[k]) > FARTHEST * request.dt:
            rejects["time too coarse"] += 1
        else:
            _admit(held, strays, rejects, request.dt, (float(u[k]), float(y[k]), stamps[k], references[k]))


def _admit(held: list[Held], strays: list[float], rejects: dict[str, int], dt: float, sample: Held) -> None:
    """Hold one sample, or reject it by its stamp, by the rules of `kernels.monitoring.interruptions`.

    Where the stamp of the newest sample held had leapt ahead and this one does not confirm it, that sample is rejected.
    """
    stamp = sample[2]
    last = held[-1][2] if held else math.nan
    if awaits_successor(held, dt):
        before = held[-2][2]
        if stamp > before and not 0.0 < stamp - last <= max(LEAP * dt, 2.0 * (last - before)):
            held.pop()
            rejects["time leap"] += 1
            last = before
    if stamp <= last:
        if not (strays and stamp > strays[-1]):
            strays.clear()
        strays.append(stamp)
        if len(strays) <= MOST_EARLIER:
            rejects["not later"] += 1
            return
        kept = [one for one in held if one[2] < strays[0]]  # the clock was set, or what lies ahead was misread
        rejects["time leap"] += len(held) - len(kept)
        held[:] = kept
    strays.clear()
    held.append(sample)


def awaits_successor(held: list[Held], dt: float) -> bool:
    """Return whether the stamp of the newest sample held leaps ahead, so that the next one must confirm it."""
    return len(held) > 1 and held[-1][2] - held[-2][2] > LEAP * dt


def lone_inputs(u: FloatArray) -> list[int]:
    """Return the indices of at most two isolated samples at which a mapped input (K,) is far beyond all others.

    Examples
    --------
    >>> u = np.tile([1.0, -1.0], 10)
    >>> u[7] = 4294967296.0
    >>> lone_inputs(u)
    [7]
    """
    away = np.abs(u - np.median(u))
    order = np.argsort(away)[::-1][: MOST_LONE + 1]
    for count in range(min(MOST_LONE, order.size - 1), 0, -1):
        far, next_one = sorted(order[:count].tolist()), away[order[count]]
        if away[order[count - 1]] > FAR * next_one > 0.0 and all(b - a > 1 for a, b in itertools.pairwise(far)):
            return far
    return []


def warm_up(
    state: State, u: FloatArray, y: FloatArray, t: FloatArray, r: FloatArray | None = None, *, learn: bool
) -> FloatArray:
    """Run held samples through the kernel and return the a-priori errors (K,).

    No past estimate is kept meanwhile: settings or estimate were chosen with all of these samples, so that none of them
    is unseen.

    Parameters
    ----------
    state : State
        It is changed.
    u, y : (K,) arrays
    t : (K,) or (0,) array
        Time stamps in s; empty for a regular clock.
    r : (K,) array, optional
        Reference.
    learn : bool
        False where the estimate has been solved for from these samples: only filters, counters and kept samples follow.
    """
    _, steps = step_kernels(state, regular=t.size == 0)
    errors, unseen = np.empty(u.size), np.empty((u.size, 0))
    rested = state.rested
    state.adapt, state.held_at = learn, BELIEVED  # leaps among the held samples have been judged
    steps(*state.arrays, u, y, t, NOTHING if r is None else r, errors, unseen)
    state.adapt, state.held_at = True, 0
    if state.examines_output:
        state.change_began = state.samples
    if not learn:
        state.rested = rested
    state.past_kept, state.past_due = 0, state.samples
    state.learned = state.samples
    return errors


@quiet
def modelled(
    request: Request, preprocess: Preprocess, u: FloatArray, y: FloatArray, t: FloatArray, r: FloatArray | None
) -> tuple[Record, Refined | None]:
    """Return held samples as a record, and their `first_model`.

    Parameters
    ----------
    request : Request
    preprocess : Preprocess
        With numbers for the working point.
    u, y, t : (K,) arrays
        Raw samples; t in s, NaN where there is no stamp.
    r : (K,) array, optional
        Reference.
    """
    stamps = None if np.isnan(t).any() else t
    record = ready_record(request.structure, request.dt, preprocess, u, y, stamps, request.input_hold, r)
    return record, first_model(request.structure, record)


def carry_over(old: State, new: State) -> None:
    """Copy to a new state what outlasts its estimate: counters, clock, raw samples, past estimates, a user's freeze."""
    new.take_over(
        old,
        *(State.not_finite, State.too_large, State.not_later, State.too_dense, State.refused, State.rested),
        *(State.time_leaps, State.too_coarse, State.input_leaps, State.no_output, State.no_reference),
        *(State.outliers, State.stuck, State.gaps, State.gap_at, State.adapt, State.drawn, State.samples),
        *(State.past_kept, State.past_due, State.recent_head, State.alarm, State.look_at),
    )
    new.learned = old.samples
    new.change_began = old.change_began if old.alarm else old.samples
    new.past[:], new.recent[:] = old.past, old.recent
    # not from the warm-up: a regular record has no stamps, and steps between bridged outputs are not the sensor's
    new.take_over(old, State.last_time, State.last_raw, State.sensor_step, State.cusum_limit)
    new.prior[:] = old.prior
    new.largest_power = max(old.largest_power, new.largest_power)
