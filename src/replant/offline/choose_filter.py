"""Choice of the state-variable filter whose least-squares model simulates a record best."""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.assessment import simulate
from replant.engine.record_regressors import regressors
from replant.model.structure import Structure
from replant.offline.least_squares import least_squares
from replant.optimizers.optimizer import rounded
from replant.regressor.filters import StateVariableFilter
from replant.regressor.preprocess import Preprocess, screen
from replant.statistics.linear_algebra import quiet

SLOWEST_CUTOFF = 10.0
"""Slowest cutoff tried [1 / duration of the record].
Derivation: five time constants of such a filter are half of the record.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

CANDIDATES = 16  # cutoffs tried, evenly spaced in the logarithm [count]

MOST_SAMPLES = 20_000  # samples looked at for the choice [samples]


@quiet
def choose_filter(
    structure: Structure,
    dt: float,
    preprocess: Preprocess,
    u: FloatArray,
    y: FloatArray,
    t: FloatArray | None = None,
    input_hold: str = "zoh",
) -> StateVariableFilter:
    """Return the filter whose least-squares model fits a record best when simulated from the input alone.

    The cutoffs tried lie between 10 / duration and 1 / dt.  The simulated fit is compared, not the equation error: a
    filter with a low cutoff makes the equation error small whatever the model is.
    """
    u, y, t = u[:MOST_SAMPLES], y[:MOST_SAMPLES], None if t is None else t[:MOST_SAMPLES]
    accepted, _ = screen(preprocess.map_input(u), y)
    y = np.where(accepted, y, np.nan)
    lasts = u.size * dt if t is None or t.size < 2 else float(t[-1] - t[0])
    slowest, fastest = SLOWEST_CUTOFF / lasts, 1.0 / dt
    candidates = np.geomspace(min(slowest, fastest / 10), fastest, CANDIDATES)
    linear_input = np.where(accepted, preprocess.map_input(u) - float(preprocess.input_offset), np.nan)
    best, best_fit = (
        StateVariableFilter(cutoff=rounded(float(candidates[CANDIDATES // 2])), input_hold=input_hold),
        -np.inf,
    )
    for cutoff in candidates:
        tried = StateVariableFilter(cutoff=rounded(float(cutoff)), input_hold=input_hold)
        phi, target = regressors(structure, dt, tried, preprocess, u, y, t)
        model = structure.transfer_function(least_squares(phi, target).parameters)
        fit = simulate(model, linear_input, y, dt, input_hold=input_hold, t=t).fit if model.is_stable else -np.inf
        if fit > best_fit:
            best, best_fit = tried, fit
    return best
