"""The choices that the data make when the user makes none: cutoff, scaling, step size, buffer (docs/defaults.md)."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.assessment import simulate
from replant.engine.regressors import regressors
from replant.model.structure import Structure
from replant.offline.least_squares import least_squares
from replant.optimizers import OPTIMIZERS, Optimizer
from replant.optimizers.optimizer import rounded
from replant.optimizers.replay import Replay
from replant.regressor.filters import RefinedFilter, StateVariableFilter
from replant.regressor.preprocess import Preprocess, screen
from replant.regressor.scaling import Scaling
from replant.settings import (
    AUTO,
    DEFAULT_OPTIMIZER,
    Request,
    Settings,
)

CANDIDATES = 16  # cutoffs tried, evenly spaced in the logarithm
MOST_SAMPLES = 20_000  # looked at for the choice
UNKNOWN_LENGTH = 2_000  # samples to come that an optimizer is tuned for where nobody knows better


def settle(request: Request, u: FloatArray, y: FloatArray, length: int | None = None) -> Settings:
    """Return definite settings, what is "auto" chosen from a record of raw input and output (K,).

    ``length`` is how many samples there will be in all, where that is known.
    """
    structure, dt, instruments = request.structure, request.dt, request.wants_instruments
    preprocess = request.preprocess.resolve(u, y)
    replay = _choose_replay(request)
    optimizer = request.optimizer
    if not isinstance(optimizer, Optimizer):
        updates = (length or UNKNOWN_LENGTH) * (replay.batch_size if replay else 1)
        optimizer = OPTIMIZERS[DEFAULT_OPTIMIZER if optimizer == AUTO else optimizer].suggested(dt, updates)
    chosen = request.filter
    if isinstance(chosen, str):
        follows = instruments and optimizer.keeps_covariance
        chosen = RefinedFilter() if follows else choose_filter(structure, dt, preprocess, u, y)
    if isinstance(chosen, RefinedFilter) and not structure.bias:
        preprocess = centre(preprocess, u, y)
    scaling = request.scaling
    if scaling is None or (scaling == AUTO and optimizer.keeps_colour):  # its estimate does not depend on the scaling
        scaling = Scaling.none(structure)
    elif not isinstance(scaling, Scaling):
        assumed = chosen if isinstance(chosen, StateVariableFilter) else choose_filter(structure, dt, preprocess, u, y)
        phi, _ = regressors(structure, dt, assumed, preprocess, u, y)
        scaling = Scaling.from_record(y - float(preprocess.output_offset), phi)
    return Settings(
        structure, dt, chosen, scaling, optimizer, replay, instruments, request.normalize, preprocess, u.size
    )


def _choose_replay(request: Request) -> Replay | None:
    """Return the buffer: none for an optimizer that remembers every sample by itself."""
    if request.replay is None or isinstance(request.replay, Replay):
        return request.replay
    optimizer = request.optimizer
    if isinstance(optimizer, str):
        return None if OPTIMIZERS[DEFAULT_OPTIMIZER if optimizer == AUTO else optimizer].keeps_covariance else Replay()
    return None if optimizer.keeps_covariance else Replay()


def centre(preprocess: Preprocess, u: FloatArray, y: FloatArray) -> Preprocess:
    """Return the same with the record's mean in the working point, where a constant is estimated beside G(s).

    That constant makes any working point right; one near the data keeps the regression well conditioned.
    """
    mapped = preprocess.map_input(u)
    accepted, _ = screen(mapped, y)
    if not accepted.any():
        return preprocess
    return Preprocess(preprocess.input_map, float(mapped[accepted].mean()), float(y[accepted].mean()))


def choose_filter(
    structure: Structure, dt: float, preprocess: Preprocess, u: FloatArray, y: FloatArray
) -> StateVariableFilter:
    """Return the filter whose least-squares model runs closest to the data when simulated from the input alone.

    The cutoffs tried run from ten times the slowest that the record can tell (10 / duration) up to 1/dt.  The
    simulated fit, not the equation error, is compared: the latter always favours a filter that hides the misfit.
    """
    u, y = u[:MOST_SAMPLES], y[:MOST_SAMPLES]
    accepted, _ = screen(preprocess.map_input(u), y)
    y = np.where(accepted, y, np.nan)
    slowest, fastest = 10.0 / (u.size * dt), 1.0 / dt
    candidates = np.geomspace(min(slowest, fastest / 10), fastest, CANDIDATES)
    linear_input = np.where(accepted, preprocess.map_input(u) - float(preprocess.input_offset), np.nan)
    best, best_fit = StateVariableFilter(cutoff=rounded(float(candidates[CANDIDATES // 2]))), -np.inf
    for cutoff in candidates:
        tried = StateVariableFilter(cutoff=rounded(float(cutoff)))
        phi, target = regressors(structure, dt, tried, preprocess, u, y)
        model = structure.transfer_function(least_squares(phi, target).parameters)
        fit = simulate(model, linear_input, y, dt).fit if model.is_stable else -np.inf
        if fit > best_fit:
            best, best_fit = tried, fit
    return best
