r"""Refined instrumental variables for continuous-time models (SRIVC) on a record: the offline reference and start-up.

The regression :math:`s^n/A\, y = \varphi^T \theta`, prefiltered by the current model's own 1/A, is solved with the
instruments :math:`\zeta`, the same regressor built from the model's noise-free output, until nothing moves:

.. math:: \theta \leftarrow \Big(\sum \zeta \varphi^T\Big)^{-1} \sum \zeta\, s^n/A\, y

At that point the equation error equals the output error of the model, y - B/A u, exactly: there is no discretisation
error left, whatever y does between samples.  An offset and the initial state enter as nuisance regressors, 1/A and
s^i/A of an impulse, of which only the user's bias is reported.

Source: Young and Jakeman (1980); Garnier and Wang (2008), "Identification of Continuous-time Models from Sampled
Data", chapter 4; the damped Gauss-Newton steps at the end guard against the fixed point's failing to converge.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.engine.state import State
from replant.kernels.schema import FIXED, LAGS, ColourSlots, PathSlots
from replant.model.structure import Structure
from replant.statistics.autoregression import Autoregression
from replant.statistics.batch_means import no_less_than_scattered, path_of_record, rows_of
from replant.statistics.linear_algebra import (
    eigenvalues,
    quiet,
    roots,
    solve,
)
from replant.statistics.udu import compose, factor_information, larger

CUTOFFS = 8
"""State-variable filters tried for a start, evenly spaced in the logarithm [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

SHORT = 4
"""Iterations of each start [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

LONG = 20
"""Iterations of the most promising starts [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

SLOWEST_CUTOFF = 5.0
"""Slowest of their cutoffs; the fastest is 1 / dt [1 / duration of the record].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

PROMISING = 3
"""Starts that are iterated further [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

STALLED = 1e-6
"""Decrease of the cost below which an iteration stalls [part of the cost].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

STALLS = 6
"""Iterations that may stall [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

STILL = 1e-3
"""Movement of the estimate below which the iteration has converged [standard deviations of what a regressor's entry
tells].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

DONE = 1e-6
"""Gain of a Gauss-Newton step below which the fit is done [variances of the residual].
Derivation: a thousandth of a standard deviation.
Sensitivity: not measured.
"""

NEARLY_DONE = 0.1
"""The same where no shorter step gains anything either [variances of the residual].
Derivation: a third of a standard deviation: where poles are as fast as the sampling the instruments' root lies a
little beside the least cost.
Sensitivity: not measured.
"""

ROUNDING = 1e-18
"""Power of the residual below which only rounding is left [part of the output's power].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

HALVINGS = 10
"""Halvings of a Gauss-Newton step at the most [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

BINDING = 4.0
"""Distance of a pole from the axis up to which that margin binds, as with an integrator [margins].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

POLISH = 30
"""Gauss-Newton steps at the most [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

SLOWEST = 0.01
"""Margin of stability [1 / duration of the record].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

FASTEST = 3.0
"""Bound of a pole's magnitude [1 / sampling time].
Derivation: beyond pi / dt a pole lies above half the sampling rate.
Sensitivity: not measured.
"""

ACCEPTABLE = 0.25
"""Relative uncertainty up to which a start-up is long enough [part of a coefficient's size].
Origin: a recursion from a bad first model can go wrong; a quarter leaves the sign and the size of each coefficient
known.
Sensitivity: not measured.
"""


@dataclass(frozen=True, eq=False)
class Pass:
    """What one pass over a record with a model gives: sums over samples, and the model's error.

    Attributes
    ----------
    zeta, phi : (K, T) arrays
    target : (K,) array
    error : (K,) array
        y minus the model's output, nuisances included.
    """

    zeta: FloatArray
    phi: FloatArray
    target: FloatArray
    error: FloatArray

    @property
    def cost(self) -> float:
        """Mean square of the error."""
        with np.errstate(over="ignore", invalid="ignore"):
            cost = float(np.mean(self.error**2))
        return cost if math.isfinite(cost) else math.inf


@dataclass(frozen=True, eq=False)
class Refined:
    """A refined instrumental-variable estimate of a record.

    Attributes
    ----------
    theta : (T,) array
        Parameters, then nuisances.
    model : (T,) array
        The same, with a denominator that can serve as a filter (an integrator's pole moved a little to the left).
    upper, diagonal : (T, T), (T,) arrays
        Factors of (sum zeta zeta')^-1.
    covariance : (T, T) array
        Of ``theta``, the residual's colour and the scatter along the record taken into account.
    variance : float
        Of the residual.
    converged : bool
    uncertainty : float
        Largest relative uncertainty of a coefficient, see `relative_uncertainty`.
    colour : ColourSlots
    path : PathSlots
    """

    theta: FloatArray
    model: FloatArray
    upper: FloatArray
    diagonal: FloatArray
    covariance: FloatArray
    variance: float
    converged: bool
    uncertainty: float
    colour: ColourSlots
    path: PathSlots

    def condition(self, size: int) -> float:
        """Return the condition number of the scaled information of the first ``size`` parameters, square root taken.

        Comparable with that of a scaled regressor: largest over smallest singular value.
        """
        covariance = compose(self.upper, self.diagonal)[:size, :size]
        scale = np.sqrt(np.diag(covariance))
        if not (np.isfinite(scale).all() and (scale > 0).all()):
            return math.inf
        values = eigenvalues(covariance / np.outer(scale, scale))
        return float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else math.inf

    @property
    def is_finite(self) -> bool:
        """Whether float64 holds the estimate and its factors; a covariance beyond it is one that is not known."""
        parts = self.theta, self.model, self.upper, self.diagonal, self.variance
        return all(bool(np.isfinite(part).all()) for part in parts)

    @property
    def acceptable(self) -> bool:
        """Whether it can start a recursion."""
        return self.converged and self.uncertainty < ACCEPTABLE


class Problem:
    """One record and one structure: passes over it, and the search for the model that explains it."""

    def __init__(self, structure: Structure, record: Record) -> None:
        self.structure, self.record = structure, record
        self.state = State.for_model(structure, record.dt, record.input_hold)
        self.slowest, self.fastest = SLOWEST / record.span, FASTEST / record.dt
        self.passes = 0

    def run(self, denominator: FloatArray, weights: FloatArray) -> Pass:
        """Filter the record by 1/D and simulate weights / D, nuisances included."""
        from replant.kernels.step.shared import regressors

        state, size, samples = self.state, self.state.entries, self.record.u.size
        state.install(np.concatenate([denominator, weights]))
        state.started = False
        phi, zeta = np.empty((samples, size)), np.empty((samples, size))
        target, output = np.empty(samples), np.empty(samples)
        regressors(
            state.ints, state.reals, state.banks, self.record.u, self.record.y, self.record.intervals,
            phi, zeta, target, output,
        )  # fmt: skip
        self.passes += 1
        return Pass(zeta, phi, target, self.record.y - output)

    def is_usable(self, a: FloatArray) -> bool:
        """Return whether ``a`` can be a filter: finite, stable with a margin, not beyond the sampling rate."""
        if not np.isfinite(a).all():
            return False
        magnitudes = np.abs(a) ** (1.0 / np.arange(1, a.size + 1))
        if magnitudes.max() >= a.size * self.fastest:
            return False
        return bool(roots(np.concatenate([[1.0], a])).real.max() < -self.slowest)

    def project(self, a: FloatArray) -> FloatArray:
        """Return ``a`` with unstable poles reflected, and each pole within the margins."""
        if self.is_usable(a):
            return a
        poles = roots(np.concatenate([[1.0], a]))
        if not np.isfinite(poles).all():
            return np.asarray(np.poly(np.full(a.size, -math.sqrt(self.slowest * self.fastest)))[1:], np.float64)
        poles = np.minimum(-np.abs(poles.real), -self.slowest) + 1j * poles.imag
        poles *= np.minimum(1.0, self.fastest / np.abs(poles))
        return np.asarray(np.poly(poles).real[1:], np.float64)

    def from_cutoff(self, cutoff: float) -> FloatArray | None:
        """Return the least-squares estimate behind (s + cutoff)^n, projected."""
        n = self.structure.poles
        a = np.asarray(np.poly(np.full(n, -cutoff))[1:], np.float64)
        done = self.run(a, np.zeros(self.state.entries - n))
        return self._projected(solve(done.phi.T @ done.phi, done.phi.T @ done.target))

    def improve(self, theta: FloatArray, iterations: int, patience: int) -> tuple[float, FloatArray, FloatArray | None]:
        """Iterate the instrumental-variable step; return the least cost, its model, and the last estimate."""
        n = self.structure.poles
        best, best_model, stalls = math.inf, theta, 0
        current: FloatArray | None = theta
        for _ in range(iterations):
            assert current is not None
            model = current
            done = self.run(model[:n], model[n:])
            stalls += not done.cost < best * (1.0 - STALLED)
            if done.cost < best:
                best, best_model = done.cost, model
            found = solve(done.zeta.T @ done.phi, done.zeta.T @ done.target)
            if found is None:
                return best, best_model, None
            change = np.abs(found - model) * np.linalg.norm(done.zeta, axis=0)
            current = self._projected(found)
            if change.max() <= STILL * math.sqrt(done.cost) or stalls >= patience:
                break
        return best, best_model, current

    def polish(self, model: FloatArray) -> tuple[FloatArray, Pass, bool]:
        """Take damped Gauss-Newton steps on the output error; return the model, its pass, whether it converged."""
        done = self.run(model[: self.structure.poles], model[self.structure.poles :])
        power = float(np.mean(self.record.y**2))
        for _ in range(POLISH):
            gradient = done.zeta.T @ done.error
            direction = solve(done.zeta.T @ done.zeta, gradient)
            if direction is None:
                return model, done, False
            gain = float(direction @ gradient) / self.record.u.size
            samples = self.record.u.size
            # done at a thousandth of a standard deviation, or where only rounding is left
            if gain * samples <= DONE * done.cost or done.cost <= ROUNDING * power:
                return model, done, True
            better = self._line_search(model, direction, done.cost)
            if better is None:
                # no descent left: the instruments are exact but for the model output's run between samples, so that
                # where poles are as fast as the sampling their root lies a little beside the least cost
                return model, done, gain * samples <= NEARLY_DONE * done.cost
            model, done = better
        return model, done, False

    def _line_search(self, model: FloatArray, direction: FloatArray, cost: float) -> tuple[FloatArray, Pass] | None:
        n = self.structure.poles
        for halvings in range(HALVINGS):
            tried = model + direction * 0.5**halvings
            if self.is_usable(tried[:n]):
                done = self.run(tried[:n], tried[n:])
                if done.cost < cost:
                    return tried, done
        return None

    def _projected(self, theta: FloatArray | None) -> FloatArray | None:
        if theta is None:
            return None
        n = self.structure.poles
        return np.concatenate([self.project(theta[:n]), theta[n:]])


@quiet
def refine(structure: Structure, record: Record, given: Sequence[FloatArray] = ()) -> Refined | None:
    """Return the refined instrumental-variable estimate of a record; None where no start leads anywhere.

    Parameters
    ----------
    structure : Structure
    record : Record
        Usable samples, a few more than there are parameters and nuisances.
    given : sequence of (T,) arrays
        Estimates to start from; without any, least squares behind `CUTOFFS` state-variable filters.
    """
    problem = Problem(structure, record)
    starts = [problem._projected(np.asarray(theta, np.float64)) for theta in given]
    if not starts:
        cutoffs = np.geomspace(SLOWEST_CUTOFF / record.span, 1.0 / record.dt, CUTOFFS)
        starts = [problem.from_cutoff(float(cutoff)) for cutoff in cutoffs]
    tried = [problem.improve(start, SHORT, SHORT) for start in starts if start is not None]
    tried.sort(key=lambda outcome: outcome[0])
    for _, _, last in list(tried[:PROMISING]):
        if last is not None:
            tried.append(problem.improve(last, LONG, STALLS))
    if not tried:
        return None
    best, model, _ = min(tried, key=lambda outcome: outcome[0])
    if not math.isfinite(best):
        return None
    return conclude(problem, *problem.polish(model))


@quiet
def conclude(
    problem: Problem,
    model: FloatArray,
    done: Pass,
    converged: bool,
    known: FloatArray | float = 0.0,
    pull: FloatArray | float = 0.0,
) -> Refined | None:
    """Turn the last pass into an estimate with its covariance; None where that has left float64.

    ``known`` is what was known before on the diagonal of sum zeta zeta', and ``pull`` that times how far it was away.
    """
    n, samples, size = problem.structure.poles, problem.record.u.size, model.size
    theta, error = model, done.error
    if not np.any(known) and roots(np.concatenate([[1.0], model[:n]])).real.max() > -BINDING * problem.slowest:
        # the margin binds, as with an integrator: one free step from the projected filter is the estimate
        step = solve(done.zeta.T @ done.phi, done.zeta.T @ done.error)
        if step is not None:
            theta, converged = model + step, True
            error = done.target - done.phi @ theta
    variance = float(error @ error) / max(samples - size, 1)
    before = np.diag(np.broadcast_to(known, size))
    upper, diagonal = factor_information(done.zeta.T @ done.zeta + before)
    inverse = compose(upper, diagonal)
    colour, innovation = _colour(done.zeta, error)
    innovation /= max(samples - size, 1)
    covariance = innovation * inverse @ colour.squares @ inverse
    covariance = larger(covariance, variance * inverse)
    # chance in the few blocks of a start-up's path must not decide when it suffices
    uncertainty = relative_uncertainty(problem.structure, model, covariance, done.phi, problem.record)
    path = path_of_record(done.zeta, error, theta, before, np.broadcast_to(pull, size))
    covariance = no_less_than_scattered(covariance, *rows_of(path, theta, np.diag(inverse)))
    refined = Refined(theta, model, upper, diagonal, covariance, variance, converged, uncertainty, colour, path)
    return refined if refined.is_finite else None


def relative_uncertainty(
    structure: Structure, model: FloatArray, covariance: FloatArray, phi: FloatArray, record: Record
) -> float:
    """Return how uncertain a model is, as a part: 0.25 is a start, 0.05 a model.

    The largest of std(a_i) over the coefficient of prod(s + abs(pole)), the size that it would have with all poles
    real (a pole slower than the record is long counts as one just as long), and of half the output that one std(b_j)
    makes, over the output.
    """
    n = structure.poles
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    magnitudes = np.abs(roots(np.concatenate([[1.0], model[:n]])))
    sizes = np.poly(-np.maximum(magnitudes, 1.0 / record.span))[1:]
    worst = float((std[:n] / np.maximum(sizes, 1e-300)).max())
    of_input = slice(n, n + structure.zeros + 1)
    made = std[of_input] * np.linalg.norm(phi[:, of_input], axis=0) / max(float(np.linalg.norm(record.y)), 1e-300)
    return max(worst, float((0.5 * made).max()))


def _colour(zeta: FloatArray, error: FloatArray) -> tuple[ColourSlots, float]:
    """Return power and colour of the residual at the record's end, and the sum of the innovation's squares."""
    samples, size = zeta.shape
    colour = ColourSlots.zeros(FIXED | {"T": size})
    colour.covariances[:] = [error[lag:] @ error[: samples - lag] for lag in range(LAGS + 1)]
    noise = Autoregression.of_covariances(colour.covariances)
    filtered = noise.colour(zeta)
    colour.model[:] = noise.coefficients
    colour.count, colour.power = samples, float(error @ error)
    colour.errors[:] = error[-LAGS:][::-1]
    for age in range(min(LAGS, samples)):
        colour.filtered[-age % LAGS] = filtered[-1 - age]
    colour.squares[:] = filtered.T @ filtered
    return colour, noise.power


def first_model(structure: Structure, record: Record) -> Refined | None:
    """Return the refined estimate of held samples; None where they are too few or the input does not move."""
    least = 2 * structure.poles + structure.zeros + 3
    if record.u.size <= least or float(np.ptp(record.u)) == 0.0:
        return None
    return refine(structure, record)
