"""The choices that the data make when the user makes none: cutoff, scaling, step size, buffer (docs/defaults.md)."""

from __future__ import annotations

import numpy as np

from replant.assessment import simulate
from replant.filters import StateVariableFilter
from replant.least_squares import least_squares
from replant.optimizers import OPTIMIZERS, Optimizer
from replant.optimizers.optimizer import rounded
from replant.preprocess import Preprocess, screen
from replant.regression import regressors
from replant.replay import Replay
from replant.scaling import Scaling
from replant.settings import AUTO, Request, Settings
from replant.structure import Structure
from replant.validation import FloatArray

CANDIDATES = 16  # cutoffs tried, evenly spaced in the logarithm
MOST_SAMPLES = 20_000  # looked at for the choice
DEFAULT_OPTIMIZER = "amsgrad"
UNKNOWN_LENGTH = 2_000  # samples to come that an optimizer is tuned for where nobody knows better


def settle(request: Request, u: FloatArray, y: FloatArray, length: int | None = None) -> Settings:
    """Return definite settings, what is "auto" chosen from a record of raw input and output (K,).

    ``length`` is how many samples there will be in all, where that is known.
    """
    structure, dt = request.structure, request.dt
    preprocess = request.preprocess.resolve(u, y)
    state_filter, scaling = request.filter, request.scaling
    optimizer, replay = request.optimizer, request.replay
    if not isinstance(state_filter, StateVariableFilter):
        state_filter = choose_filter(structure, dt, preprocess, u, y)
    if scaling is None:
        scaling = Scaling.none(structure)
    elif not isinstance(scaling, Scaling):
        phi, _ = regressors(structure, dt, state_filter, preprocess, u, y)
        scaling = Scaling.from_record(y - float(preprocess.output_offset), phi)
    if not (replay is None or isinstance(replay, Replay)):
        replay = Replay()
    if not isinstance(optimizer, Optimizer):
        updates = (length or UNKNOWN_LENGTH) * (replay.batch_size if replay else 1)
        optimizer = OPTIMIZERS[DEFAULT_OPTIMIZER if optimizer == AUTO else optimizer].suggested(dt, updates)
    return Settings(structure, dt, state_filter, scaling, optimizer, replay, request.normalize, preprocess)


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
