"""From a record to its regressors: the chain of filters alone, for offline use."""

from __future__ import annotations

import numpy as np

from replant.errors import InvalidArgumentError
from replant.estimation.engine.state import State
from replant.estimation.filters import StateVariableFilter
from replant.model.preprocess import Preprocess
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray


def regressors(
    structure: Structure,
    dt: float,
    state_filter: StateVariableFilter,
    preprocess: Preprocess,
    u: FloatArray,
    y: FloatArray,
    t: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return the regressors phi (K, P) and the target s^n/Lambda y (K,), in physical units; NaN where a sample is."""
    from replant.kernels.step.stages import regressors as kernel

    if t is not None and state_filter.regular_only:
        raise InvalidArgumentError("the gbt filter knows a regular clock only: give no t, or use method='exact'")
    state = State.for_regressors(structure, dt, state_filter, preprocess)
    phi, target = np.empty((u.size, structure.size)), np.empty(u.size)
    if callable(preprocess.input_map):
        u = preprocess.call_map(u)
    intervals = np.array([dt]) if t is None or t.size < 2 else np.diff(t, prepend=t[:1] - dt)
    kernel(*state.arrays, u, y, intervals, np.zeros((0, 2)), phi, phi, target, target)
    return phi, target
