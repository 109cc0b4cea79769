r"""Poles that a record does not determine: with these infinitely fast, it is as likely within chance.

Dynamics beyond the frequencies that the input excites, or below the noise, are badly determined: the estimate puts such
a pole, or a lightly damped pair, where it fits the noise, and by the curvature there it seems to be known.  The
coefficients of A(s) contain the product of all poles, so that they have the same relative error.

For each real pole p, and each pair, the model without it is fitted, with denominator :math:`A_-`.  Noise may look like
a pair at K/2 frequencies; the best of these explains by chance less than

.. math:: 2 \ln \frac{K}{2 \alpha}

variances of the residual, with a probability of 1 - alpha.  A pole that explains less may be infinitely fast.  The
covariance is then enlarged in the direction of such a model, :math:`[A, B] \propto [A_-, B_-]`, for a pair also of
:math:`[s A_-, 0]`, by the size of the coefficients.  G(s) hardly changes in this direction where it was excited.

If a model has more poles than the record determines, the least error may lie at infinitely fast surplus poles.  There
the coefficients are infinite, with unstable poles beyond, and steps from slower poles end far off.  The model with
fewer poles, `grown` by very fast poles, is close to it and explains as much.

Source: Davies (1987), "Hypothesis testing when a nuisance parameter is present only under the alternative", Biometrika
74; Turkman and Walker (1984), "On the asymptotic distributions of maxima of trigonometric polynomials and random sums
of exponentials", Advances in Applied Probability 16 (the largest of K/2 ordinates).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from replant.estimation.engine.dimensions import entries_of
from replant.estimation.engine.record import Record
from replant.estimation.solver.refined_estimate import Refined, without_nuisances
from replant.estimation.solver.srivc_steps import Problem
from replant.model.structure import Structure
from replant.model.uncertainty import cancelled_pole
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import combined, products, quiet, roots, sum_of_squares
from replant.numerics.projections import without

# a fit of the smaller model explains some of it again, but seldom as much
WORTH_FITTING = 10.0  # power due to a pole above which it is determined without such a fit [limits]

INFINITE = 300.0
"""Magnitude of a pole whose lag is too small to distinguish it from an infinitely fast one [1 / sampling time].
Origin: of 90 fits with one pole more than the fit before, of random plants up to twice as fast as the sampling, 6 were
worse by a point with 10, 1 with 30, none with 100, 300 and 1000; 8 without a start from fewer poles.
Sensitivity: not measured.
"""


@quiet
def with_untold(structure: Structure, record: Record, found: Refined) -> Refined:
    """Return an estimate with its covariance enlarged for poles that the record does not determine."""
    problem = Problem(structure, record)
    if structure.poles < 2 or problem.projection is not None or not problem.is_stable(found.theta):
        return found
    if cancelled_pole(structure, found.theta, found.covariance) is not None:
        return found  # no coefficient is determined anyway
    ways = list(_ways(problem, found))
    if not ways:
        return found
    along = np.column_stack(ways)
    zeta = problem.run(found.theta).zeta
    if found.noise.filters:
        zeta = problem.record.whitened(found.noise_model, zeta)
    # a recursion that continues from here has the covariance P Q P with P = (sum zeta zeta')^-1
    scores, colour = products(zeta, combined(zeta, along)), found.colour
    power = Autoregression.of_covariances(colour.covariances).power
    if not power > 0.0:
        return found
    colour.squares[:] += max(float(colour.count) - found.theta.size, 1.0) / power * scores @ scores.T
    larger = replace(found, covariance=found.covariance + along @ along.T)
    return larger if larger.is_finite and np.isfinite(colour.squares).all() else found


def _ways(problem: Problem, found: Refined) -> Iterator[FloatArray]:
    """Yield the directions (T,) in which undetermined poles may move."""
    structure, done = problem.structure, problem.run(found.theta)
    noise, limit = found.noise_model, 2.0 * math.log(0.5 * problem.record.count / ALPHA)

    def white(signals: FloatArray) -> FloatArray:
        return problem.record.whitened(noise, signals)

    error, columns = white(done.error), white(done.zeta)
    variance = sum_of_squares(error) / max(problem.record.count - found.theta.size, 1)
    poles = roots(np.append(1.0, found.theta[structure.denominator]))
    for pole in poles[poles.imag >= 0.0]:
        gone = {int(np.abs(poles - each).argmin()) for each in (pole, pole.conjugate())}
        left = np.delete(poles, list(gone))
        if left.size == 0:
            continue
        size = float(abs(pole)) ** (poles.size - left.size)
        other, b = with_poles(structure, left.size), found.theta[structure.numerator]
        # of the same gain at low frequencies
        rest = np.append(b[b.size - other.zeros - 1 :], found.theta[structure.coefficients : structure.size]) / size
        start = without_nuisances(other, np.append(np.poly(left).real[1:], rest))
        smaller = Problem(other, problem.whole)
        smaller.noise = noise
        first = smaller.run(start)
        part = without((white(first.error) - error)[:, None], columns)[:, 0]
        if not sum_of_squares(part) < WORTH_FITTING * limit * variance:
            continue
        model, fitted, _ = smaller.polish(start, whitened=bool(found.noise.filters))
        rest = white(fitted.error)
        if sum_of_squares(rest) - sum_of_squares(error) < limit * variance:
            yield from _towards(structure, other, model, float(abs(pole)))


def _towards(structure: Structure, other: Structure, model: FloatArray, speed: float) -> Iterator[FloatArray]:
    """Yield the directions (T,), of the size of the model, in which poles of this speed move to infinity."""
    a, b = np.append(1.0, model[other.denominator]), model[other.numerator]
    gone = structure.poles - other.poles
    for power in range(gone):
        way = np.zeros(entries_of(structure, refined=True))
        way[structure.poles - a.size - power : structure.poles - power] = a * speed ** (gone - power)
        if power == 0:
            way[structure.coefficients - b.size : structure.coefficients] = b * speed**gone
            way[structure.coefficients : structure.size] = model[other.coefficients : other.size] * speed**gone
        yield way


def with_poles(structure: Structure, poles: int) -> Structure:
    """Return a structure with ``poles`` poles, at most its own, and as many of its zeros as they allow."""
    return replace(structure, poles=poles, zeros=min(structure.zeros, poles - (not structure.feedthrough)))


def grown(less: Structure, theta: FloatArray, more: Structure, lag: float) -> FloatArray:
    """Return the coefficients of a model as one with more poles, of ``lag`` s each."""
    a, b = np.concatenate([[1.0], theta[less.denominator]]), theta[less.numerator]
    for _ in range(more.poles - less.poles):
        a, b = np.convolve(a, [1.0, 1.0 / lag]), b / lag
    model = np.zeros(more.coefficients)
    model[more.denominator] = a[1:]
    b = b[-(more.zeros + 1) :]
    model[more.coefficients - b.size :] = b
    return model
