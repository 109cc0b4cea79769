"""Initialization: a refined estimate, its covariance and its statistics written into a state."""

from __future__ import annotations

import math

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.engine.state import State
from replant.kernels import schema as at
from replant.offline.srivc import FASTEST, SLOWEST, Refined
from replant.settings import Settings
from replant.statistics.udu import compose, factor_covariance

LIMIT = 50.0  # usual variances by which the residual must have exceeded what is no growth, summed, to be looked into
SHORTEST_MEMORY = 100  # samples of an input that stands still, before which it does not rest
ROOM = 1e6  # how far forgetting may let the variances grow beyond those of the start-up


def initialize(state: State, settings: Settings, refined: Refined, record: Record) -> None:
    """Begin at a refined estimate: it makes the instruments, and its parameters and covariance are the start."""
    entries, rate = state.entries, _rates(state, settings)
    state.reals[at.MARGIN] = SLOWEST / record.span
    state.reals[at.WIDEST] = settings.structure.poles * FASTEST / record.dt
    state.reals[at.FORGET_INPUT] = 1.0 / record.u.size
    state.install(refined.model[:entries] / rate)
    state.theta[:] = refined.theta[:entries] / rate / state.unit
    if state.ints[at.GUARDED]:
        _write_monitoring(state, settings, refined, record)
    if settings.optimizer.keeps_covariance:
        state.ints[at.GUARD] = 1
        _write_covariance(state, settings, refined, rate)
    if state.ints[at.COLOURED]:
        _write_colour(state, settings, refined, rate)
        _write_path(state, settings, refined, rate)
    if not settings.optimizer.keeps_colour and settings.optimizer.keeps_covariance:
        _write_tracking(state, settings, refined, record)
    if settings.optimizer.keeps_covariance:
        state.ints[at.REST_AFTER] = _memory(state, settings)


def _memory(state: State, settings: Settings) -> int:
    """Return after how many samples the optimizer will have forgotten; 0: never, or after more than start-up had."""
    size = state.entries
    numbers = state.block(at.AT_SETTINGS, int(state.ints[at.SETTINGS_SIZE]))
    if settings.optimizer.keeps_colour:
        share = 1.0 - float(numbers[0])
    else:  # a variance that a parameter gains in a sample, over what it is
        memory = state.block(at.AT_MEMORY, size * size + size)
        known = np.diag(compose(memory[: size * size].reshape(size, size), memory[size * size :]))
        share = float((numbers[1 : 1 + size] * settings.dt / np.maximum(known, 1e-300)).max())
    return max(math.ceil(1.0 / share), SHORTEST_MEMORY) if share > 0.1 * state.reals[at.FORGET_INPUT] else 0


def _rates(state: State, settings: Settings) -> FloatArray:
    """Return what turns the refined filter's parameters (T,) into those of this state's filter.

    Only the bias differs: behind a fixed filter it is seen times 1/lambda_0.
    """
    from replant.kernels.filters.bank import DENOMINATOR

    rates = np.ones(state.entries)
    if settings.structure.bias and not state.ints[at.REFINED]:
        rates[-1] = state.banks[0, DENOMINATOR + settings.structure.poles - 1]
    return rates


def _write_covariance(state: State, settings: Settings, refined: Refined, rate: FloatArray) -> None:
    """Write the factors of the start-up's covariance, in scaled parameters, where the optimizer keeps them."""
    size = state.entries
    sigma = state.block(at.AT_SIGMA, size) / rate
    if state.ints[at.REFINED]:
        upper, diagonal = refined.upper * sigma[:, None] / sigma[None, :], refined.diagonal * sigma**2
    else:
        covariance = compose(refined.upper, refined.diagonal)[:size, :size]
        upper, diagonal = factor_covariance(covariance * np.outer(sigma, sigma))
    memory = state.block(at.AT_MEMORY, size * size + 2 * size)
    if settings.optimizer.keeps_colour:
        memory[size * size + size :] = ROOM * diagonal
    else:
        diagonal = diagonal * max(refined.variance, np.finfo(float).tiny) / settings.scaling.output**2
    memory[: size * size] = upper.ravel()
    memory[size * size : size * size + size] = diagonal


def _write_tracking(state: State, settings: Settings, refined: Refined, record: Record) -> None:
    """Give the Kalman filter the residual's variance, and the constant the walk that the others force on it.

    With the working point taken off, the constant of A y = B u + c is c = b0 u_R - a0 y_R: it walks when they do.
    """
    size, structure = state.entries, settings.structure
    scale = settings.scaling.output
    state.block(at.AT_MEMORY, size * size + size + 1)[-1] = max(refined.variance / scale**2, np.finfo(float).tiny)
    if state.ints[at.REFINED] and not structure.bias:
        noise = state.block(at.AT_SETTINGS, 1 + size)[1:]
        constant, a0, b0 = structure.size, structure.poles - 1, structure.poles + structure.zeros
        of_a0 = noise[a0] * state.unit[a0] ** 2 * float(np.var(record.y))
        of_b0 = noise[b0] * state.unit[b0] ** 2 * float(np.var(record.u))
        noise[constant] = (of_a0 + of_b0) / state.unit[constant] ** 2


def _write_monitoring(state: State, settings: Settings, refined: Refined, record: Record) -> None:
    """Tell the guard what is usual: the residual's variance, the output's size, and how often neighbours are equal."""
    scale, reals = settings.scaling.output, state.reals
    reals[at.SPREAD] = reals[at.USUAL] = refined.variance / scale**2
    reals[at.SEEN] = record.u.size
    reals[at.PEAK] = float(np.var(record.y)) / scale**2
    reals[at.EQUAL] = float(np.mean(record.y[1:] == record.y[:-1]))
    steps = np.abs(np.diff(record.y))
    reals[at.LEAST_STEP] = float(steps[steps > 0.0].min(initial=math.inf))
    reals[at.LAST_RAW] = math.nan
    reals[at.LIMIT] = LIMIT if state.ints[at.REFINED] else 0.0  # a fixed filter's error is not that of the output


def _write_colour(state: State, settings: Settings, refined: Refined, rate: FloatArray) -> None:
    """Write power and colour of the start-up's residual, in scaled signals."""
    from replant.kernels.monitoring import residual_colour

    size, lags = state.entries, residual_colour.LAGS
    sigma, scale = state.block(at.AT_SIGMA, size) / rate, settings.scaling.output
    of_full = refined.theta.size
    source, colour = refined.colour, state.block(at.AT_COLOUR, residual_colour.size(size))
    head = residual_colour.FILTERED
    colour[:head] = source[:head]
    colour[residual_colour.POWER] /= scale**2
    colour[residual_colour.COVARIANCES : residual_colour.ERRORS] /= scale**2
    colour[residual_colour.ERRORS : residual_colour.POSITION] /= scale
    ring = source[head : head + lags * of_full].reshape(lags, of_full)
    squares = source[head + lags * of_full :].reshape(of_full, of_full)
    colour[head : head + lags * size] = (ring[:, :size] / sigma).ravel()
    colour[head + lags * size :] = (squares[:size, :size] / np.outer(sigma, sigma)).ravel()


def _write_path(state: State, settings: Settings, refined: Refined, rate: FloatArray) -> None:
    """Write the path that led to the start-up's estimate, in scaled parameters."""
    from replant.kernels.monitoring import estimate_path

    size = state.entries
    sigma = state.block(at.AT_SIGMA, size) / rate
    kept = state.block(at.AT_PATH, estimate_path.size(size))
    kept[: estimate_path.ROWS] = refined.path[: estimate_path.ROWS]
    source = refined.path[estimate_path.ROWS :].reshape(estimate_path.ROOM, 2, -1)[:, :, :size]
    target = kept[estimate_path.ROWS :].reshape(estimate_path.ROOM, 2, size)
    target[:, 0], target[:, 1] = source[:, 0] * sigma / settings.scaling.output, source[:, 1] * sigma**2
