"""Least squares on the regressors of a fixed filter, and the choice of that filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.errors import InvalidArgumentError
from replant.estimation.engine.state import State
from replant.estimation.filters import StateVariableFilter
from replant.estimation.optimizers.optimizer import rounded
from replant.estimation.simulation.fitted_run import simulate
from replant.model.preprocess import Preprocess, screen
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.linear_algebra import least_norm, quiet

# some hundred thousand times float64's precision
RANK_TOLERANCE = 1e-10  # singular value of the scaled regressor that counts as zero [part of the largest]
SLOWEST_CUTOFF = 10.0  # slowest cutoff tried: five time constants are half the record [1 / duration of the record]
CANDIDATES = 16  # cutoffs tried, evenly spaced in the logarithm [count]
MOST_SAMPLES = 20_000  # most samples used for the choice [samples]


def regressors(
    structure: Structure, dt: float, state_filter: StateVariableFilter, preprocess: Preprocess, u: FloatArray,
    y: FloatArray, t: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Return the regressors phi (K, P) and the target s^n/Lambda y (K,), in physical units; NaN where samples are."""
    from replant.kernels.step.stages import regressors as kernel

    if t is not None and state_filter.regular_only:
        raise InvalidArgumentError("the gbt filter knows a regular clock only: give no t, or use method='exact'")
    state = State.build(structure, dt, state_filter)
    state.square_input = preprocess.input_map == "square"
    state.input_offset, state.output_offset = float(preprocess.input_offset), float(preprocess.output_offset)
    phi, target = np.empty((u.size, structure.size)), np.empty(u.size)
    if callable(preprocess.input_map):
        u = preprocess.call_map(u)
    intervals = np.array([dt]) if t is None or t.size < 2 else np.diff(t, prepend=t[:1] - dt)
    kernel(*state.arrays, u, y, intervals, np.zeros((0, 2)), phi, phi, target, target)
    return phi, target


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """The solution of a least-squares problem."""

    parameters: FloatArray  # (P,); of least norm in scaled parameters where data do not determine them
    rank: int  # how many directions the data determine, at most P
    condition: float  # of the scaled regressors: largest over smallest singular value


@quiet
def least_squares(phi: FloatArray, target: FloatArray) -> LeastSquares:
    """Minimise ||target - phi theta|| over the rows that are finite; phi (K, P), target (K,)."""
    kept = np.isfinite(target) & np.isfinite(phi).all(axis=1)
    phi, target = phi[kept], target[kept]
    if phi.shape[0] == 0:
        return LeastSquares(np.zeros(phi.shape[1]), 0, np.inf)
    lengths = np.abs(phi).max(axis=0)
    lengths[lengths == 0.0] = 1.0
    lengths *= np.linalg.norm(phi / lengths, axis=0)
    lengths[lengths == 0.0] = 1.0
    scaled, rank, singular = least_norm(phi / lengths, target, RANK_TOLERANCE)
    condition = float(singular[0] / singular[-1]) if singular.size == phi.shape[1] and singular[-1] > 0 else np.inf
    return LeastSquares(scaled / lengths, rank, condition)


@quiet
def choose_filter(
    structure: Structure, dt: float, preprocess: Preprocess, u: FloatArray, y: FloatArray, t: FloatArray | None = None,
    input_hold: str = "zoh",
) -> StateVariableFilter:  # fmt: skip
    """Return the filter, its cutoff from 10 / duration to 1 / dt, whose least-squares model simulates a record best."""
    u, y, t = u[:MOST_SAMPLES], y[:MOST_SAMPLES], None if t is None else t[:MOST_SAMPLES]
    accepted, _ = screen(preprocess.map_input(u), y)
    y = np.where(accepted, y, np.nan)
    lasts = u.size * dt if t is None or t.size < 2 else float(t[-1] - t[0])
    slowest, fastest = SLOWEST_CUTOFF / lasts, 1.0 / dt
    candidates = np.geomspace(min(slowest, fastest / 10), fastest, CANDIDATES)
    linear_input = np.where(accepted, preprocess.map_input(u) - float(preprocess.input_offset), np.nan)
    filters = [StateVariableFilter(cutoff=rounded(float(each)), input_hold=input_hold) for each in candidates]
    best, best_fit = filters[CANDIDATES // 2], -np.inf
    for tried in filters:
        phi, target = regressors(structure, dt, tried, preprocess, u, y, t)
        model = structure.transfer_function(least_squares(phi, target).parameters)
        fit = simulate(model, linear_input, y, dt, input_hold=input_hold, t=t).fit if model.is_stable else -np.inf
        if fit > best_fit:
            best, best_fit = tried, fit
    return best
