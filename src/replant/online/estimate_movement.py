r"""Movement of an estimate: more than chance makes, and the change that its newest samples ask for.

Over the newest k of N samples an estimate that forgets nothing moves by

.. math:: \Delta\theta = P \sum_{i > N - k} \zeta_i e_i,

of mean zero and covariance C k / N where the model is right, C the estimate's covariance.  The estimate that the newest
samples alone would give differs by N / k times as much.
"""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray
from replant.engine.covariance import covariance_by_colour
from replant.engine.state import State
from replant.kernels.schema import PAST
from replant.settings import Settings
from replant.statistics.chi2 import chi2_quantile
from replant.statistics.linear_algebra import solve
from replant.statistics.udu import compose

UNLIKELY = 1e-4
"""Chance that a right estimate is taken for one that has moved: a model is then solved for in vain [probability].
Level: 0.01 %.
"""


def asked_for(state: State, settings: Settings) -> FloatArray | None:
    """Return the change (n + m + 1,) of the coefficients that the newest samples ask for, in physical units.

    Those since the oldest estimate kept since the last solution.  None where the estimate has moved no farther than a
    right one does by chance.
    """
    size, length = settings.structure.coefficients, state.learned - state.record_began
    past = state.past[: min(state.past_kept, PAST)]
    past = past[past[:, 0] >= state.solved_at]
    if not len(past):
        return None
    earlier = past[np.argmin(past[:, 0])]
    count, step = state.learned - earlier[0], state.theta[:size] - earlier[1 : 1 + size]
    if count <= 0:
        return None
    limit = chi2_quantile(1.0 - UNLIKELY, size) * count / length
    white = state.colour.power / max(state.colour.count, 1.0) * compose(*state.factors)
    # the residual's colour makes the covariance larger, never smaller, and takes longer to compute
    if not (_square(step, white) > limit and _square(step, covariance_by_colour(state)) > limit):
        return None
    return np.asarray(step * state.unit[:size] * (length / count))


def _square(step: FloatArray, covariance: FloatArray) -> float:
    """Return step' C^-1 step for the step's block C of a covariance; 0 where that is singular."""
    solution = solve(covariance[: step.size, : step.size], step)
    return 0.0 if solution is None else float(step @ solution)
