"""Begin the recursion: a state that starts at a refined estimate, with its covariance and statistics."""

from __future__ import annotations

import math

import numpy as np

from replant.estimation.engine.recent_samples import RecentSamples
from replant.estimation.engine.record import Record
from replant.estimation.engine.state import NOTHING, REASONS, REGULAR, State, step_kernels
from replant.estimation.settings import Settings
from replant.estimation.simulation.auxiliary_model import stability_margin
from replant.estimation.solver.refined_estimate import Refined
from replant.estimation.solver.solve import Solution
from replant.estimation.solver.srivc_steps import FASTEST
from replant.kernels.schema import BELIEVED, LOAD, Doubt
from replant.numerics.arguments import FloatArray
from replant.numerics.linear_algebra import compose, factor_covariance, quiet

# so many residuals give a standard deviation to 7 %
SHORTEST_MEMORY = 100  # least samples of constant input before it rests, if an optimizer forgets [samples]
# the memory is then ten start-ups
FORGETS = 0.1  # forgetting per sample, times the start-up's length, up to which it counts as none [ratio]
ROOM = 1e6  # largest growth of variances by forgetting: nothing is known then [variances of the start-up]

#: Slots that count rejected samples.  Samples that are learned again count outliers, stuck and missing outputs anew.
REJECTED = [slot for slot in REASONS.values() if slot not in (State.outliers, State.stuck, State.no_output)]


@quiet
def initialize(state: State, settings: Settings, refined: Refined, record: Record) -> None:
    """Write a refined estimate into a state: parameters, covariance, auxiliary model, and monitoring."""
    entries, rate = state.entries, _rates(state, settings)
    state.stability_margin = stability_margin(record)
    state.largest_bandwidth = settings.structure.poles * FASTEST / record.dt
    state.forget_input = 1.0 / record.u.size
    state.disagreement = refined.disagreement
    state.install(refined.theta[:entries] / rate)
    state.theta[:] = refined.theta[:entries] / rate / state.unit
    if state.examines_output:
        _write_monitoring(state, settings, refined, record)
    if settings.optimizer.keeps_covariance:
        state.rests_with_input = True
        _write_covariance(state, settings, refined, rate)
    _write_residual(state, settings, refined, rate)
    if state.has_reference and refined.reference is not None:
        state.reference.reals[:] = refined.reference.reals
    if settings.optimizer.keeps_covariance:
        if not settings.optimizer.keeps_colour:
            _write_tracking(state, settings, refined, record)
        state.rest_after = _memory(state, settings)


def _memory(state: State, settings: Settings) -> int:
    """Return the optimizer's memory in samples; 0 if it is infinite, or much longer than the start-up."""
    size = state.entries
    numbers = state.settings
    if settings.optimizer.keeps_colour:
        share = 1.0 - float(numbers[0])
    else:  # relative growth of a variance in one sample
        known = np.diag(compose(*state.factors))
        share = float((numbers[1 : 1 + size] * settings.dt / np.maximum(known, 1e-300)).max())
    return max(math.ceil(1.0 / share), SHORTEST_MEMORY) if share > FORGETS * state.forget_input else 0


def _rates(state: State, settings: Settings) -> FloatArray:
    """Return divisors (T,) that convert parameters of the refined filter to those of the state's filter."""
    from replant.kernels.filters.bank import DENOMINATOR

    rates = np.ones(state.entries)
    if settings.structure.bias and not state.refined:  # a fixed filter multiplies the bias by 1/lambda_0
        rates[-1] = state.banks[0, DENOMINATOR + settings.structure.poles - 1]
    return rates


def _write_covariance(state: State, settings: Settings, refined: Refined, rate: FloatArray) -> None:
    """Write the factors of the start-up's covariance in scaled parameters, for an optimizer that keeps them."""
    size = state.entries
    sigma = state.sigma / rate
    if state.refined:
        upper, diagonal = refined.upper * sigma[:, None] / sigma[None, :], refined.diagonal * sigma**2
    else:
        covariance = compose(refined.upper, refined.diagonal)[:size, :size]
        upper, diagonal = factor_covariance(covariance * np.outer(sigma, sigma))
    if settings.optimizer.keeps_colour:
        state.memory[size * size + size : size * size + 2 * size] = ROOM * diagonal
    else:
        diagonal = diagonal * max(refined.innovation, np.finfo(float).tiny) / settings.scaling.output**2
    state.factors[0][:], state.factors[1][:] = upper, diagonal


def _write_tracking(state: State, settings: Settings, refined: Refined, record: Record) -> None:
    """Write the residual's variance and the process noise of the constant into the Kalman filter's memory."""
    size, structure = state.entries, settings.structure
    scale = settings.scaling.output
    state.memory[size * size + size] = max(refined.variance / scale**2, np.finfo(float).tiny)
    if state.refined and not structure.bias:
        # with the working point subtracted, A y = B u + c has c = b0 u_R - a0 y_R: c walks as a0 and b0 do
        noise = state.settings[1 : 1 + size]
        constant, a0, b0 = structure.size, structure.poles - 1, structure.poles + structure.zeros
        of_a0 = noise[a0] * state.unit[a0] ** 2 * float(np.var(record.y))
        of_b0 = noise[b0] * state.unit[b0] ** 2 * float(np.var(record.u))
        noise[constant] = (of_a0 + of_b0) / state.unit[constant] ** 2


def _write_monitoring(state: State, settings: Settings, refined: Refined, record: Record) -> None:
    """Write the references of the monitoring: variance of the residual, size of the output, share of ties."""
    from replant.kernels.monitoring import outliers

    scale = settings.scaling.output
    state.late_variance = state.usual_variance = refined.variance / scale**2
    state.late_innovation = state.usual_innovation = refined.innovation / scale**2
    state.residuals_seen = record.u.size
    state.largest_output = float(np.var(record.y)) / scale**2
    state.tie_share = float(np.mean(record.y[1:] == record.y[:-1]))
    steps = np.abs(np.diff(record.y))
    state.sensor_step = float(steps[steps > 0.0].min(initial=math.inf))
    state.last_raw = math.nan
    state.cusum_limit = outliers.LIMIT if state.refined else 0.0  # a fixed filter's error is no output error


def _write_residual(state: State, settings: Settings, refined: Refined, rate: FloatArray) -> None:
    """Write power and colour of the start-up's residual, the path of its estimate and its noise model, all scaled."""
    size, scale, sigma = state.entries, settings.scaling.output, state.sigma / rate
    if state.coloured:
        colour, of_colour = state.colour, refined.colour
        colour.count, colour.power, colour.position = of_colour.count, of_colour.power / scale**2, of_colour.position
        colour.model[:] = of_colour.model
        colour.covariances[:], colour.errors[:] = of_colour.covariances / scale**2, of_colour.errors / scale
        colour.filtered[:] = of_colour.filtered[:, :size] / sigma
        colour.squares[:] = of_colour.squares[:size, :size] / np.outer(sigma, sigma)
    if state.coloured and state.path_size:
        path, of_path, kept = state.path, refined.path, int(refined.path.kept)
        path.step, path.due, path.kept, rows = of_path.step, of_path.due, kept, of_path.rows[:, :, :size]
        path.rows[:kept, 0], path.rows[:kept, 1] = rows[:kept, 0] / sigma / scale, rows[:kept, 1] * sigma**2
        path.rows[kept, 0] = rows[kept, 0] * sigma / scale
    if state.has_noise_model:  # its rows are filled as the filters warm up
        noise, of_noise = state.noise, refined.noise
        noise.order, noise.filters = of_noise.order, of_noise.filters
        noise.gain, noise.count = of_noise.gain, of_noise.count
        noise.models[:], noise.variances[:] = of_noise.models, of_noise.variances / scale**2
        noise.sums[:] = of_noise.sums / scale**2


def restart(old: State, settings: Settings, refined: Refined, record: Record, origin: int) -> State:
    """Return a state that starts at a refined estimate and continues at the newest sample of ``old``."""
    new = State.of_settings(settings, len(old.recent), old.path_size)  # fewer raw samples than kept, in the background
    initialize(new, settings, refined, record)
    stamps = REGULAR
    if record.intervals.size > 1:
        stamps = old.last_time - (record.intervals.sum() - np.cumsum(record.intervals))
    with new.without_preprocessing():
        warm_up(new, record.u, record.y, stamps, record.r, learn=False)
    new.ready_at = new.elapsed
    carry_over(old, new)
    new.record_began, new.solved_at = origin, old.samples
    return new


def restart_at(old: State, settings: Settings, solution: Solution, origin: int) -> State:
    """Return `restart` at a solution of the record as measured; samples that it left out are marked as doubtful."""
    new = restart(old, settings, solution.found, solution.record, origin)
    note_doubts(new, solution)
    return new


def note_doubts(state: State, solution: Solution, output: FloatArray | None = None) -> None:
    """Mark the newest raw samples that a solution has left out, and write their ``output`` (K,) if given."""
    if not (state.examines_output and len(state.recent)):
        return
    count = solution.doubt.size
    rows, recent = (state.samples - count + np.arange(count)) % len(state.recent), RecentSamples(state.recent)
    recent.bridged[rows], recent.doubt[rows] = solution.bridged, solution.doubt
    measured = recent.output[rows] if output is None else output
    recent.output[rows] = np.where(solution.doubt == Doubt.MISSING, solution.bridged, measured)


def note_loads(state: State, loads: tuple[int, ...], count: int) -> None:
    """Mark new ``loads`` in the newest ``count`` raw samples, each at the next sample that is not in doubt."""
    rows = (state.samples - count + np.arange(count)) % len(state.recent)
    doubt = RecentSamples(state.recent).doubt
    sound = np.flatnonzero(doubt[rows] <= Doubt.NONE)
    at = np.searchsorted(sound, loads)
    doubt[rows[sound[at[at < sound.size]]]] = LOAD


def clear_doubt(state: State, kept: RecentSamples) -> None:
    """Set the bridged outputs to those of the solution ``kept``; where these are measured, the doubt is removed."""
    doubted = np.flatnonzero(kept.is_bridged & (kept.output != kept.bridged))
    rows, recent = (state.samples - len(kept) + doubted) % len(state.recent), RecentSamples(state.recent)
    recent.bridged[rows] = kept.output[doubted]
    recent.doubt[rows[recent.output[rows] == recent.bridged[rows]]] = Doubt.NONE


def warm_up(state: State, u: FloatArray, y: FloatArray, t: FloatArray, r: FloatArray | None, *, learn: bool) -> float:
    """Run collected samples through the kernel; return the error of the last one."""
    _, steps = step_kernels(state, regular=t.size == 0)
    rested = state.rested
    state.adapt, state.held_at = learn, BELIEVED  # leaps among these samples have been accepted before
    errors = np.full(u.size, math.nan)
    steps(*state.arrays, u, y, t, NOTHING if r is None else r, errors, np.empty((u.size, 0)))
    state.adapt, state.held_at = True, 0
    if state.examines_output:
        state.change_began = state.samples
    if not learn:
        state.rested = rested
    # no past estimate is kept: settings or estimate were chosen with all of these samples, so none is held out
    state.past_kept, state.past_due = 0, state.samples
    state.learned = state.samples
    return float(errors[-1])


def carry_over(old: State, new: State) -> None:
    """Copy to a new state what outlasts the estimate: counters, clock, raw samples, past estimates, ``adapt``."""
    new.take_over(
        old,
        *(*REASONS.values(), State.refused, State.rested),
        *(State.gaps, State.gap_at, State.adapt, State.drawn, State.samples),
        *(State.past_kept, State.past_due, State.recent_head, State.alarm, State.look_at),
        *(State.change, State.undecided, State.change_price, State.changed_at, State.before_began),
    )
    new.learned = old.samples
    new.change_began = old.change_began if old.alarm else old.samples
    new.past[:], new.recent[:] = old.past, old.recent
    # not from the warm-up: a regular record has no stamps, and steps to bridged outputs are not the sensor's
    new.take_over(old, State.last_time, State.earlier_stamps, State.last_raw, State.sensor_step, State.cusum_limit)
    new.prior[:] = old.prior
    new.largest_power = max(old.largest_power, new.largest_power)
    if old.noise_has_grown:  # the mean over the whole record is that of smaller noise
        new.usual_variance = max(new.usual_variance, new.late_variance)
        new.usual_innovation = max(new.usual_innovation, new.late_innovation)
