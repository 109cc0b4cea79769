"""Start-up: from the first samples, held back, to a model, its covariance, and filters that have settled."""

from __future__ import annotations

import math

import numpy as np

from replant.arguments import FloatArray
from replant.engine.dispatch import step_kernels
from replant.engine.record import Record, ready_record
from replant.engine.state import State
from replant.offline.srivc import Refined, first_model
from replant.regressor.preprocess import Preprocess, screen
from replant.settings import Settings

SPIKE_NEIGHBOURS = 5  # samples that tell what an output is without its spikes


def hold_back(
    held: list[tuple[float, float, float]], rejects: dict[str, int], preprocess: Preprocess,
    u: FloatArray, y: FloatArray, t: FloatArray,
) -> None:  # fmt: skip
    """Add samples (u, y, t) to those held for start-up; count the ones that are rejected, by the reason.

    ``t`` is empty, or NaN, where there are no stamps, and infinite where a stamp is not finite.
    """
    accepted, rejected = screen(preprocess.map_input(u), y)
    for reason, count in rejected.items():
        rejects[reason] += count
    stamps, last = t.tolist() if t.size else [math.nan] * u.size, held[-1][2] if held else math.nan
    for k in np.flatnonzero(accepted).tolist():
        if math.isinf(stamps[k]):
            rejects["not finite"] += 1
        elif stamps[k] <= last:
            rejects["not later"] += 1
        else:
            last = stamps[k]
            held.append((float(u[k]), float(y[k]), last))


def warm_up(state: State, u: FloatArray, y: FloatArray, t: FloatArray, *, learn: bool) -> FloatArray:
    """Run held samples through the kernel and return the errors (K,).

    Without ``learn`` only filters, counters and kept samples follow: the estimate has been solved for.  No estimate
    is kept meanwhile: choices were made, or the estimate solved for, with all of these samples.
    """
    _, steps = step_kernels(state, regular=t.size == 0)
    errors, unseen = np.empty(u.size), np.empty((u.size, 0))
    rested = state.rested
    state.adapt = learn
    steps(*state.arrays, u, y, t, errors, unseen)
    state.adapt = True
    if state.examines_output:
        state.change_began = state.samples
    if not learn:
        state.rested = rested
    state.past_kept, state.past_due = 0, state.samples
    state.learned = state.samples
    return errors


def without_spikes(y: FloatArray) -> FloatArray:
    """Return an output with gross outliers replaced by the median of five neighbours.

    Gross is what lies further from that median than twice the whole range of it: nothing that a plant does.

    Examples
    --------
    >>> without_spikes(np.array([0.0, 1.0, 2.0, 3.0, 1e6, 4.0, 5.0, 6.0]))
    array([0., 1., 2., 3., 4., 4., 5., 6.])
    """
    if y.size < SPIKE_NEIGHBOURS or not np.isfinite(y).all():
        return y
    half = SPIKE_NEIGHBOURS // 2
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(y, half, mode="reflect"), SPIKE_NEIGHBOURS)
    median = np.median(windows, axis=1)
    limit = 2.0 * float(np.ptp(median))
    with np.errstate(over="ignore"):
        gross = (np.abs(y - median) > limit) & (limit > 0.0)
    return np.where(gross, median, y) if gross.any() else y


def modelled(settings: Settings, u: FloatArray, y: FloatArray, t: FloatArray) -> tuple[Record, Refined | None]:
    """Return held samples made ready, and their `first_model`; ``t`` is NaN where there is no stamp."""
    stamps, hold = None if np.isnan(t).any() else t, settings.filter.input_hold
    record = ready_record(settings.structure, settings.dt, settings.preprocess, u, y, stamps, hold)
    return record, first_model(settings.structure, record)


def carry_over(old: State, new: State) -> None:
    """Keep of a state that is replaced: counters, clock, raw samples, past estimates, the user's choice to freeze."""
    new.take_over(
        old,
        *(State.not_finite, State.too_large, State.not_later, State.too_dense, State.refused, State.rested),
        *(State.outliers, State.stuck, State.gaps, State.gap_at, State.adapt, State.drawn, State.samples),
        *(State.past_kept, State.past_due, State.recent_head, State.alarm, State.look_at),
    )
    new.learned = old.samples
    new.change_began = old.change_began if old.alarm else old.samples
    new.past[:], new.recent[:] = old.past, old.recent
    # stamps may have been as regular as none, and of a bridged output the least step is none of the sensor's
    new.take_over(old, State.last_time, State.last_raw, State.sensor_step, State.cusum_limit)
    new.prior[:] = old.prior
    new.largest_power = max(old.largest_power, new.largest_power)
