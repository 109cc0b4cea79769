r"""The scatter of an estimate by resampling: records simulated with its model are solved again.

To first order an estimate scatters by its covariance.  If a short record hardly separates poles, the likelihood is not
quadratic: in field records with pairs of lightly damped poles, the output error of such an estimate was three times
that by its covariance, and in others, whose poles and zeros nearly cancel, half of it.  The model and its noise, an
autoregression of the residual, generate records

.. math:: y^* = \hat y + e^*, \qquad D(q)\, e^* = w^*,

and each estimate from them starts at the model.  The outputs of these estimates differ from the model's as much as the
error of the estimate itself changes the output.

Source: Efron and Tibshirani (1993), "An Introduction to the Bootstrap", section 6.5 (the parametric bootstrap).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.solver.refined_estimate import without_nuisances
from replant.estimation.solver.srivc_steps import Problem
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.linear_algebra import combined, quiet, sum_of_squares
from replant.numerics.projections import without

# the mean of ten squares is known to a third if two directions scatter, its root to a sixth
DRAWS = 10  # simulated records [count]
STEPS = 20  # most steps of each estimate, which starts near its end [count]


@quiet
def resampled_scatter(structure: Structure, record: Record, estimate: FloatArray, *, filtered: bool) -> float:
    """Return the rms error of the output due to the error of an estimate (P,), over the rms output.

    ``filtered``: whether it was found with its noise model as a filter.  Infinite if one record has no estimate.
    """
    problem = Problem(structure, record)
    model = problem.with_nuisances(without_nuisances(structure, estimate))
    own, done = problem.run(model), problem.run_whole(model)
    noise = Autoregression.of_residual(own.ahead, problem.record.predecessors, problem.record.count)
    white = noise.whiten_known(own.ahead, problem.record.predecessors)
    fitted = model.size + problem.record.nuisances_beside(structure.poles, bias=structure.bias)
    deviation = math.sqrt(sum_of_squares(white) / max(problem.record.count - fitted, 1))
    output, rng, squares = _output(problem, model), np.random.default_rng(0), 0.0
    nuisances = np.column_stack([done.phi[:, structure.coefficients :], np.ones(output.size)])
    for _ in range(DRAWS):
        y = done.output + deviation * _coloured(noise, rng.standard_normal(2 * record.u.size))
        drawn = Problem(structure, replace(record, y=np.where(record.is_measured, y, done.output)))
        found = _found(drawn, model, noise if filtered else None)
        if found is None:
            return math.inf
        squares += float(np.var(without(_output(problem, found) - output, nuisances)))
    power = float(np.var(without(output, nuisances)))
    return math.sqrt(squares / DRAWS / power) if power > 0.0 and math.isfinite(squares) else math.inf


def _coloured(noise: Autoregression, white: FloatArray) -> FloatArray:
    """Return the second half (K,) of white noise (2 K,) coloured by an autoregression."""
    from replant.kernels.filters.autoregressions import all_pole

    return np.asarray(all_pole(noise.coefficients, white[None])[0, white.size // 2 :])


def _found(problem: Problem, model: FloatArray, noise: Autoregression | None) -> FloatArray | None:
    """Return the estimate that steps from a model lead to; with a noise model, None if no step is possible."""
    if noise is None:
        return problem.polish(model)[0]
    problem.noise = noise
    root = problem.descend(model, STEPS)
    return None if root is None or np.array_equal(root.model, model) else root.model


def _output(problem: Problem, model: FloatArray) -> FloatArray:
    """Return the output (K,) of a model (T,) by the input alone, with the states after gaps projected out."""
    size, b = problem.structure.coefficients, problem.structure.numerator
    done = problem.run_whole(without_nuisances(problem.structure, model[:size]))
    return combined(done.zeta[:, b], model[b])
