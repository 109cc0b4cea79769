"""Begin the recursion: a refined estimate, its covariance and its statistics written into a state."""

from __future__ import annotations

import math

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.engine.state import State
from replant.offline.refined import Refined
from replant.offline.srivc_steps import FASTEST
from replant.settings import Settings
from replant.simulation.auxiliary_model import stability_margin
from replant.statistics.linear_algebra import compose, factor_covariance, quiet

SHORTEST_MEMORY = 100
"""Samples of an input that stands still before which it does not rest, where an optimizer forgets [samples].
Derivation: 100 residuals know a standard deviation to 7 %.
Sensitivity: halved or doubled, nothing changes on these records.
"""

FORGETS = 0.1
"""Share that is forgotten in a sample, times the start-up's samples, up to which an optimizer counts as one that never
forgets [ratio].
Derivation: its memory is then ten start-ups.
Sensitivity: halved or doubled, nothing changes on these records.
"""

ROOM = 1e6
"""How far forgetting may let the variances grow beyond those of the start-up [ratio of variances].
Derivation: a thousand standard deviations: nothing is known then.
Sensitivity: halved or doubled, nothing changes on these records.
"""


@quiet
def initialize(state: State, settings: Settings, refined: Refined, record: Record) -> None:
    """Write a refined estimate into a state: parameters, covariance, auxiliary model, and what is monitored."""
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
    if state.coloured:
        _write_colour(state, settings, refined, rate)
        if state.path_size:
            _write_path(state, settings, refined, rate)
    if state.has_noise_model:
        _write_noise(state, refined, settings.scaling.output)
    if state.has_reference and refined.reference is not None:
        state.reference.reals[:] = refined.reference.reals
    if not settings.optimizer.keeps_colour and settings.optimizer.keeps_covariance:
        _write_tracking(state, settings, refined, record)
    if settings.optimizer.keeps_covariance:
        state.rest_after = _memory(state, settings)


def _memory(state: State, settings: Settings) -> int:
    """Return the optimizer's memory in samples; 0 where it is infinite, or much longer than the start-up."""
    size = state.entries
    numbers = state.settings
    if settings.optimizer.keeps_colour:
        share = 1.0 - float(numbers[0])
    else:  # relative growth of a variance in one sample
        known = np.diag(compose(*state.factors))
        share = float((numbers[1 : 1 + size] * settings.dt / np.maximum(known, 1e-300)).max())
    return max(math.ceil(1.0 / share), SHORTEST_MEMORY) if share > FORGETS * state.forget_input else 0


def _rates(state: State, settings: Settings) -> FloatArray:
    """Return the divisors (T,) that turn the refined filter's parameters into those of this state's filter.

    Only the bias differs: a fixed filter multiplies it by 1/lambda_0.
    """
    from replant.kernels.filters.bank import DENOMINATOR

    rates = np.ones(state.entries)
    if settings.structure.bias and not state.refined:
        rates[-1] = state.banks[0, DENOMINATOR + settings.structure.poles - 1]
    return rates


def _write_covariance(state: State, settings: Settings, refined: Refined, rate: FloatArray) -> None:
    """Write the factors of the start-up's covariance, in scaled parameters, where the optimizer keeps them."""
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
    """Write the residual's variance and the process noise of the constant into the Kalman filter's memory.

    With the working point taken off, the constant of A y = B u + c is c = b0 u_R - a0 y_R: where a0 and b0 walk,
    so does the constant.
    """
    size, structure = state.entries, settings.structure
    scale = settings.scaling.output
    state.memory[size * size + size] = max(refined.variance / scale**2, np.finfo(float).tiny)
    if state.refined and not structure.bias:
        noise = state.settings[1 : 1 + size]
        constant, a0, b0 = structure.size, structure.poles - 1, structure.poles + structure.zeros
        of_a0 = noise[a0] * state.unit[a0] ** 2 * float(np.var(record.y))
        of_b0 = noise[b0] * state.unit[b0] ** 2 * float(np.var(record.u))
        noise[constant] = (of_a0 + of_b0) / state.unit[constant] ** 2


def _write_monitoring(state: State, settings: Settings, refined: Refined, record: Record) -> None:
    """Write what is monitored against: residual's variance, output's size, share of equal neighbours."""
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
    state.cusum_limit = outliers.LIMIT if state.refined else 0.0  # a fixed filter's error is not that of the output


def _write_colour(state: State, settings: Settings, refined: Refined, rate: FloatArray) -> None:
    """Write power and colour of the start-up's residual, in scaled signals."""
    size, scale, source, colour = state.entries, settings.scaling.output, refined.colour, state.colour
    sigma = state.sigma / rate
    colour.count, colour.power, colour.position = source.count, source.power / scale**2, source.position
    colour.model[:] = source.model
    colour.covariances[:], colour.errors[:] = source.covariances / scale**2, source.errors / scale
    colour.filtered[:] = source.filtered[:, :size] / sigma
    colour.squares[:] = source.squares[:size, :size] / np.outer(sigma, sigma)


def _write_noise(state: State, refined: Refined, scale: float) -> None:
    """Write the start-up's noise model, in the unit of the scaled output; the rows follow as the filters warm up."""
    source, noise = refined.noise, state.noise
    noise.order, noise.filters, noise.gain, noise.count = source.order, source.filters, source.gain, source.count
    noise.models[:], noise.variances[:] = source.models, source.variances / scale**2
    noise.sums[:] = source.sums / scale**2


def _write_path(state: State, settings: Settings, refined: Refined, rate: FloatArray) -> None:
    """Write the path that led to the start-up's estimate, in scaled parameters."""
    sigma, source, path = state.sigma / rate, refined.path, state.path
    path.step, path.due, path.kept = source.step, source.due, source.kept
    rows = source.rows[:, :, : state.entries]
    path.rows[:, 0], path.rows[:, 1] = rows[:, 0] * sigma / settings.scaling.output, rows[:, 1] * sigma**2
