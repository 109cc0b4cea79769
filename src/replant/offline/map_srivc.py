"""Refined instrumental variables with a prior: an estimate revised by a record taken after the plant has changed.

A plant that changes suddenly mostly changes in one respect.  The samples since then span few of its slowest time
constants: alone they determine every mode except the slow one, which the old record determined well.  The old estimate
theta_0 is therefore the prior of a maximum a-posteriori fit, which minimises

    J = sum e^2 / sigma^2 + sum (theta - theta_0)^2 / d^2.

The spread d is small for a coefficient that has stayed, and as large as the coefficient for one that has moved.  Which
have moved is unknown: the suppositions are none, each one alone, the numerator, or all.  By Laplace's method the
evidence of a supposition is

    -2 ln p = J + ln det(H) + sum ln d^2,     H = sum zeta zeta' / sigma^2 + diag(1 / d^2).

The last fit takes for d^2 the average over the suppositions, weighted by p: a coefficient that may have moved has room
to move, its standard deviation is large accordingly, and later samples decide.

Source: MacKay (1992), "Bayesian interpolation", Neural Computation 4.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.model.structure import Structure
from replant.offline.prior import Prior
from replant.offline.refined import Refined, Root, conclude
from replant.offline.srivc_steps import Problem, is_long_enough
from replant.simulation.auxiliary_model import Pass
from replant.statistics.autoregression import Autoregression
from replant.statistics.linear_algebra import quiet, roots, solve

STAYS = 0.01
"""Part of its size by which a coefficient is held to be off that has stayed [part of its size].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

MOVES = 1.0
"""The same of one that has moved [part of its size].
Origin: a coefficient that moves may double or vanish.
Sensitivity: halved or doubled, nothing changes on these records.
"""

FLOOR = 0.03
"""Part of what its neighbours make it, as which a coefficient counts at the least [part].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

ITERATIONS = 10
"""Instrumental-variable steps from the prior's mean [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, nothing changes on these records.
"""

ALL, NONE = 0, 1
"""Places among the suppositions [index]."""


@quiet
def revise(
    structure: Structure, record: Record, old: FloatArray, std: FloatArray, variance: float, slowest: float
) -> tuple[Refined, float] | None:
    """Return an estimate revised by a record, and the probability that no coefficient has moved.

    None where the fit does not converge, and where the old estimate cannot be a prior: unstable, without a numerator,
    or of unknown uncertainty.

    Parameters
    ----------
    structure : Structure
    record : Record
        The samples since the change.
    old, std : (T,) arrays
        The estimate before the change, and its standard deviations.  The nuisances are estimated anew.
    variance : float
        Usual variance of the residual, in the output's unit squared.
    slowest : float
        Margin of stability in rad/s.
    """
    if not is_long_enough(structure, record):
        return None
    problem = Problem(structure, record)
    problem.slowest = min(problem.slowest, slowest)
    if not problem.is_usable(old):
        return None
    known = np.arange(old.size) < structure.coefficients
    mean, sizes = np.where(known, old, 0.0), _sizes(structure, old)
    if not (np.isfinite(std[known]).all() and (sizes[known] > 0.0).all()):
        return None
    suppositions = list(_suppositions(structure))
    spreads = [np.hypot(np.where(moves, MOVES, STAYS) * sizes, std) for moves in suppositions]
    priors = [Prior.of_spread(mean, spread, variance) for spread in spreads]
    start = _iterated(problem, priors[ALL])
    fits = [problem.polish(start, prior=priors[ALL])]
    for moves, prior in zip(suppositions[1:], priors[1:], strict=True):
        fits.append(problem.polish(np.where(moves | ~known, fits[ALL][0], mean), prior=prior))
    evidence = np.array([_evidence(prior, model, done) for prior, (model, done, _) in zip(priors, fits, strict=True)])
    if not np.isfinite(evidence.min()):
        return None
    likelihood = np.exp(0.5 * (evidence.min() - evidence))
    squares = np.array([each[known] ** 2 for each in spreads])
    spread = np.full(old.size, np.inf)
    spread[known] = np.sqrt(likelihood @ squares / likelihood.sum())
    mixed = Prior.of_spread(mean, spread, variance)
    revised = most_likely(problem, [fits[int(evidence.argmin())][0]], mixed)
    if revised is None or not revised.converged:
        return None
    return revised, float(likelihood[NONE] / likelihood.sum())


def most_likely(problem: Problem, starts: Sequence[FloatArray], prior: Prior) -> Refined | None:
    """Return the estimate of the least J that steps from some starts lead to; None if it is not finite."""
    ends = [problem.polish(start, prior=prior) for start in starts]
    model, done, converged = min(ends, key=lambda end: end[1].power + prior.cost(end[0]))
    noise = Autoregression.white(float(done.error @ done.error), done.error.size)
    root = Root(model, done, noise, done.cost, done.power, converged, converged)
    return conclude(problem.structure, problem.record, problem.known, root, problem.projection, prior)


def _suppositions(structure: Structure) -> Iterator[npt.NDArray[np.bool_]]:
    """Yield which entries have moved, (T,), for each supposition: all, none, each one, the numerator.

    Without zeros the numerator is one coefficient.  It then counts twice: a gain changes more often than a mode.
    """
    coefficients = structure.coefficients
    entries = np.arange(coefficients + 1 + structure.poles)
    yield entries < coefficients
    yield entries < 0
    for i in range(coefficients):
        yield entries == i
    yield (entries >= structure.poles) & (entries < coefficients)


def _sizes(structure: Structure, model: FloatArray) -> FloatArray:
    """Return the size of each entry (T,), infinite for nuisances.

    It is the magnitude of the coefficient, and at least a part of a comparison: for a_i of the value that it would have
    if all poles were real, for b_j of the largest term of B(s) at the geometric mean of the poles.
    """
    poles = np.abs(roots(np.concatenate([[1.0], model[structure.denominator]])))
    powers = math.exp(float(np.log(poles).mean())) ** np.arange(structure.zeros, -1, -1)
    numerator = np.abs(model[structure.numerator])
    numerator = np.maximum(numerator, FLOOR * float((numerator * powers).max()) / powers)
    denominator = np.maximum(np.abs(model[structure.denominator]), FLOOR * np.poly(-poles)[1:])
    return np.concatenate([denominator, numerator, np.full(model.size - structure.coefficients, np.inf)])


def _iterated(problem: Problem, prior: Prior) -> FloatArray:
    """Return the model of least cost among those that the instrumental-variable step passes through from the mean.

    The first step is one of least squares: the old model's output is no instrument for a plant that has changed.
    """
    best, least, model = prior.mean, math.inf, prior.mean
    for iteration in range(ITERATIONS + 1):
        done = problem.run(model)
        cost = done.power + prior.cost(model)
        if cost < least:
            best, least = model, cost
        zeta = done.phi if iteration == 0 else done.zeta
        found = solve(zeta.T @ done.phi + prior.weight, zeta.T @ done.target + prior.weight @ prior.mean)
        if found is None:
            break
        model = problem.bounded(found)
    return best


def _evidence(prior: Prior, model: FloatArray, done: Pass) -> float:
    """Return -2 ln p of a record under a prior, up to a constant that all suppositions share."""
    if not math.isfinite(done.cost):
        return math.inf
    information = done.zeta.T @ done.zeta / prior.variance + prior.information
    scale = np.sqrt(np.diag(information))
    logarithm = float(np.linalg.slogdet(information / np.outer(scale, scale))[1] + 2.0 * np.log(scale).sum())
    known = np.diag(prior.information) > 0.0
    cost = (done.power + prior.cost(model)) / prior.variance
    return cost + logarithm - float(np.log(np.diag(prior.information)[known]).sum())
