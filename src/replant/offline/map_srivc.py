"""An estimate revised after the plant has changed: what a new record does not contradict stays where it was.

A plant that jumps mostly does so in one respect, and the samples that came since are few beside its slowest time
constant: alone they tell all but the slow mode, which the old record told well.  So the old estimate is the prior of a
maximum a-posteriori fit, minimising

    J = sum e^2 / sigma^2 + sum (theta - theta_0)^2 / d^2

with d small for coefficients that stay, and of their own size for those that move.  Which moved is asked of the record:
none, each one, the numerator, or all of them.  The evidence of each supposition is, by Laplace's method,

    -2 ln p = J + ln det(H) + sum ln d^2,     H = sum zeta zeta' / sigma^2 + diag(1 / d^2),

and the last fit is made with d^2 averaged over them by it: what may have moved, as far as the record tells, has room,
and the standard deviations say so; the samples to come decide.  Source: MacKay, "Bayesian
interpolation", Neural Computation 4, 1992.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.model.structure import Structure
from replant.offline.srivc import HALVINGS, NEARLY_DONE, POLISH, Pass, Problem, Refined, conclude
from replant.statistics.linear_algebra import quiet, roots, solve

STAYS = 0.01
"""Part of its size by which a coefficient is held to be off that has stayed [part of its size].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

MOVES = 1.0
"""The same of one that has moved [part of its size].
Origin: a coefficient that moves may double or vanish.
Sensitivity: not measured.
"""

FLOOR = 0.03
"""Part of what its neighbours make it, as which a coefficient counts at the least [part].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

ITERATIONS = 10
"""Instrumental-variable steps from the prior's mean [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

CONVERGED = 1e-3
"""Gain of a Gauss-Newton step below which the fit is done [variances of the residual].
Derivation: a thirtieth of a standard deviation.
Sensitivity: not measured.
"""

ALL, NONE = 0, 1
"""Places among the suppositions [index]."""


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of a model before a record.

    Attributes
    ----------
    mean : (T,) array
    spread : (T,) array
        Standard deviations; infinite for nuisances, of which nothing is known.
    variance : float
        Of the residual.
    """

    mean: FloatArray
    spread: FloatArray
    variance: float

    @property
    def weight(self) -> FloatArray:
        """What the prior adds to the diagonal of sum zeta zeta', (T,)."""
        return self.variance / self.spread**2

    def cost(self, model: FloatArray, done: Pass) -> float:
        """Return sigma^2 J of a model; infinite where its output leaves float64."""
        return done.error.size * done.cost + float(self.weight @ (model - self.mean) ** 2)

    def surprise(self, model: FloatArray, done: Pass) -> float:
        """Return -2 ln p of a record, up to what all suppositions have in common."""
        if not math.isfinite(done.cost):
            return math.inf
        information = done.zeta.T @ done.zeta / self.variance + np.diag(self.spread**-2.0)
        scale = np.sqrt(np.diag(information))
        logarithm = float(np.linalg.slogdet(information / np.outer(scale, scale))[1] + 2.0 * np.log(scale).sum())
        known = np.isfinite(self.spread)
        return self.cost(model, done) / self.variance + logarithm + 2.0 * float(np.log(self.spread[known]).sum())


@quiet
def revise(
    structure: Structure, record: Record, old: FloatArray, std: FloatArray, variance: float, slowest: float
) -> tuple[Refined, float] | None:
    """Return an estimate (T,) revised by a record, and how likely it is that no coefficient has moved.

    None where that leads to no model that can be used, or where the old one cannot be: unstable, without a numerator or
    of unknown uncertainty it is no prior.

    Parameters
    ----------
    structure : Structure
    record : Record
    old, std : (T,) arrays
        The estimate before, nuisances included, which are begun anew; and how well it was known.
    variance : float
        Of the residual, as it usually is.
    slowest : float
        Margin of stability, rad/s.
    """
    problem = Problem(structure, record)
    problem.slowest = min(problem.slowest, slowest)
    if not problem.is_usable(old[: structure.poles]):
        return None
    known = np.arange(old.size) < structure.poles + structure.zeros + 1
    mean, sizes = np.where(known, old, 0.0), _sizes(structure, old)
    if not (np.isfinite(std[known]).all() and (sizes[known] > 0.0).all()):
        return None
    suppositions = list(_suppositions(structure))
    priors = [Prior(mean, np.hypot(np.where(moves, MOVES, STAYS) * sizes, std), variance) for moves in suppositions]
    start = _approached(problem, priors[ALL])
    fits = [_most_likely(problem, start, priors[ALL])]
    for moves, prior in zip(suppositions[1:], priors[1:], strict=True):
        fits.append(_most_likely(problem, np.where(moves | ~known, fits[ALL][0], mean), prior))
    surprise = np.array([prior.surprise(model, done) for prior, (model, done, _) in zip(priors, fits, strict=True)])
    if not np.isfinite(surprise.min()):
        return None
    likelihood = np.exp(0.5 * (surprise.min() - surprise))
    squares = np.array([prior.spread[known] ** 2 for prior in priors])
    spread = np.full(old.size, np.inf)
    spread[known] = np.sqrt(likelihood @ squares / likelihood.sum())
    mixed = Prior(mean, spread, variance)
    model, done, converged = _most_likely(problem, fits[int(surprise.argmin())][0], mixed)
    if not converged:
        return None
    revised = conclude(problem, model, done, True, mixed.weight, mixed.weight * (mean - model))
    return None if revised is None else (revised, float(likelihood[NONE] / likelihood.sum()))


def _suppositions(structure: Structure) -> Iterator[npt.NDArray[np.bool_]]:
    """Yield which coefficients have moved, (T,), for each supposition: all, none, each one, the numerator.

    Without zeros the numerator is one coefficient, which counts twice: a gain changes more easily than a mode.
    """
    n, coefficients = structure.poles, structure.poles + structure.zeros + 1
    entries = np.arange(coefficients + 1 + n)
    yield entries < coefficients
    yield entries < 0
    for i in range(coefficients):
        yield entries == i
    yield (entries >= n) & (entries < coefficients)


def _sizes(structure: Structure, model: FloatArray) -> FloatArray:
    """Return the size of each entry (T,), infinite for nuisances.

    Its own, or a part of what a_i would be with all poles real, and b_j beside its neighbours at the geometric mean of
    the poles.
    """
    n, inputs = structure.poles, structure.zeros + 1
    poles = np.abs(roots(np.concatenate([[1.0], model[:n]])))
    powers = math.exp(float(np.log(poles).mean())) ** np.arange(inputs - 1, -1, -1)
    numerator = np.abs(model[n : n + inputs])
    numerator = np.maximum(numerator, FLOOR * float((numerator * powers).max()) / powers)
    denominator = np.maximum(np.abs(model[:n]), FLOOR * np.poly(-poles)[1:])
    return np.concatenate([denominator, numerator, np.full(model.size - n - inputs, np.inf)])


def _approached(problem: Problem, prior: Prior) -> FloatArray:
    """Return the model of the least cost that the instrumental-variable step comes by, from the prior's mean.

    The first step is one of least squares: the old model's output is no instrument for a plant that has changed.
    """
    n, best, least, model = problem.structure.poles, prior.mean, math.inf, prior.mean
    for iteration in range(ITERATIONS + 1):
        done = problem.run(model[:n], model[n:])
        if prior.cost(model, done) < least:
            best, least = model, prior.cost(model, done)
        zeta = done.phi if iteration == 0 else done.zeta
        found = solve(zeta.T @ done.phi + np.diag(prior.weight), zeta.T @ done.target + prior.weight * prior.mean)
        if found is None:
            break
        model = np.concatenate([problem.project(found[:n]), found[n:]])
    return best


def _most_likely(problem: Problem, model: FloatArray, prior: Prior) -> tuple[FloatArray, Pass, bool]:
    """Take damped Gauss-Newton steps to the least J; return the model, its pass, whether it converged."""
    n = problem.structure.poles
    done = problem.run(model[:n], model[n:])
    for _ in range(POLISH):
        gradient = done.zeta.T @ done.error + prior.weight * (prior.mean - model)
        direction = solve(done.zeta.T @ done.zeta + np.diag(prior.weight), gradient)
        if direction is None:
            return model, done, False
        gain, cost = float(direction @ gradient), prior.cost(model, done)
        for halvings in range(HALVINGS):
            tried = model + direction * 0.5**halvings
            if not problem.is_usable(tried[:n]):
                continue
            after = problem.run(tried[:n], tried[n:])
            if prior.cost(tried, after) < cost:
                model, done = tried, after
                break
        else:
            return model, done, gain <= NEARLY_DONE * prior.variance
        if gain <= CONVERGED * prior.variance:
            return model, done, True
    return model, done, False
