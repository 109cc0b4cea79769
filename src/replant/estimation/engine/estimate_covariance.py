"""The covariance of a running estimate: from the optimizer's covariance, or from the content of the replay buffer."""

from __future__ import annotations

import numpy as np

from replant.estimation.engine.state import State
from replant.estimation.settings import Settings
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.batch_means import no_less_than_scattered, scatter_of
from replant.numerics.linear_algebra import combined, compose, larger, products, quiet


@quiet
def covariance(state: State, settings: Settings) -> FloatArray:
    """Return the estimate's covariance (P, P) in physical units; NaN without instruments, as noise then biases it."""
    size = settings.structure.size
    if not settings.instruments:
        return np.full((size, size), np.nan)
    if settings.optimizer.keeps_colour:
        scaled = _of_least_squares(state)
    elif settings.optimizer.keeps_covariance:
        scaled = compose(*state.factors)
    else:
        scaled = _of_buffer(state)
    physical = 0.5 * (scaled + scaled.T) * np.outer(state.unit, state.unit)  # symmetric to the bit
    return np.asarray(physical[:size, :size])


@quiet
def slowness(state: State, settings: Settings) -> float:
    """Return the largest ratio of a coefficient's scatter, as by drift, to its scatter by the colour; 1 if unknown."""
    if not (settings.instruments and settings.optimizer.keeps_colour):
        return 1.0
    coloured = np.diag(covariance_by_colour(state))
    if not (coloured > 0.0).all():
        return 1.0
    wider = np.sqrt(np.diag(_of_least_squares(state)) / coloured)[: settings.structure.size]
    return float(wider.max())


def _of_least_squares(state: State) -> FloatArray:
    """Return the covariance by the residual's colour; without forgetting, at least the scatter of the path."""
    from replant.kernels.monitoring.scatter import lasting

    coloured = covariance_by_colour(state)
    if state.settings[0] < 1.0:
        return coloured
    scatter = scatter_of(state.path, state.theta, compose(*state.factors), lasting(state))
    return no_less_than_scattered(coloured, scatter)


def covariance_by_colour(state: State) -> FloatArray:
    """Return sigma_w^2 P Q P (T, T) of the scaled parameters, with at least the variances under white noise.

    For a white residual Q is sum mu^2j zeta zeta', and P the inverse of sum mu^j zeta zeta'.  This gives sigma^2 P
    without forgetting, and about half as much with it (`replant.kernels.monitoring.scatter`).
    """
    colour, inverse = state.colour, compose(*state.factors)
    seen, forgetting = colour.count, float(state.settings[0])
    count = max(seen - state.entries, 1.0)
    share = (2.0 - seen * (1.0 - forgetting)) / (1.0 + forgetting)  # sum of mu^2j over sum of mu^j
    white = share * colour.power / count * inverse
    power = Autoregression.of_covariances(colour.covariances).power
    return larger(power / count * inverse @ colour.squares @ inverse, white)


def _of_buffer(state: State) -> FloatArray:
    """Return the covariance of the buffer's instrumental-variable estimate, plus the squared distance to it.

    Small gradient steps would converge to the solution of sum zeta (z - phi' theta) / m^2 = 0.  The estimate differs
    from it, as the steps scatter or have not converged; the square of this known distance is added.
    """
    size, filled = state.entries, state.buffer_filled
    unknown = np.full((size, size), np.nan)
    if filled <= 2 * size:
        return unknown
    rows = np.roll(state.buffer[:filled], -state.buffer_head if filled == len(state.buffer) else 0, axis=0)
    phi, target = rows[:, :size], rows[:, size]
    zeta = rows[:, size + 2 :] * rows[:, size + 1 : size + 2]
    cross = products(zeta, phi)
    if not (np.isfinite(cross).all() and np.linalg.cond(cross) < 1.0 / np.finfo(float).eps):
        return unknown
    inverse = np.linalg.inv(cross)
    solution = inverse @ products(zeta, target)
    error = target - combined(phi, solution)
    noise = Autoregression.of(error)
    filtered = noise.colour(zeta)
    distance = state.theta - solution
    spread = noise.power / (filled - size) * inverse @ products(filtered, filtered) @ inverse.T
    return np.asarray(spread + np.outer(distance, distance))
